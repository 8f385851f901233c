"""A run as arc length over time: short blanks bridged, stops found, and cut into parts of equal arc length.

Between two fixes the track is a straight line. It is divided into pieces where that line says too little: at jumps of
the position, where two fixes lie far apart, and where rows are missing from the log. A stop lies inside a piece and
adds neither metres nor time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.runs.headings import Velocity
from joulemap.model.runs.reckoning import WHEELS
from joulemap.model.runs.run import STOP_S, Run
from joulemap.model.runs.smoothing import SMOOTHING_S, cuts_corners, position_noise, smooth
from joulemap.model.runs.table import TURNING
from joulemap.model.runs.track import integral

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

STILL_M = 0.05
"""Within `STOP_S` a stationary robot moves no further, about twice the noise of positions from RTK or lidar. A setting.
Together they are the standing speed, 0.025 m/s."""

_BRIDGED_LENGTHS = 1.0 / math.tan(math.pi / 8.0)
# An arc that turns by a quarter leaves its chord c by c / 2 tan(pi / 8). At c = 2.41 lengths this is half a length: the
# straight line still lies in the patch of the segment.
_MOST_FIXES = 0.9
_RIM_M = 0.5  # half the width of a robot of 1 m: turning moves its side so far per radian
_WHEEL_RADIUS_M = 0.2  # of a wheel whose rate is logged in rad/s, to tell rolling from standing only
_NOISES = 4.0  # a stationary position wanders by up to so many standard deviations, as in 99.99 % of a normal one
_HEADINGS = ("heading", "yaw")  # [deg]
_WHEELS = {key: _WHEEL_RADIUS_M if key in TURNING else 1.0 for pair in WHEELS for key in pair}
"""Columns that say how fast a side rolls -> metres per unit."""


@dataclass(frozen=True)
class ArcTrack:
    """A smoothed track.

    Attributes
    ----------
    rows : ndarray of int, (m,)
        Rows of the run that it passes.
    t, x, y : ndarray of float, (m,)
        Stamps [s] and positions [m].
    speed : ndarray of float, (m,)
        Speed [m/s].
    gap : ndarray of bool, (m,)
        True where a piece begins.
    stop : ndarray of bool, (m,)
        True in a stop.
    still : ndarray of bool, (m,)
        True where the robot neither drives nor turns, in a stop or not.
    arc_m : ndarray of float, (m,)
        Driven so far [m]; nothing is driven across gaps.
    gap_m : float
        Straight distances across gaps, without jumps of the position [m].
    interval_s : float
        The usual time between fixes.
    velocity : Velocity
        Of the positions.
    """

    rows: NDArray[np.int64]
    t: FloatArray
    x: FloatArray
    y: FloatArray
    speed: FloatArray
    gap: BoolArray
    stop: BoolArray
    still: BoolArray
    arc_m: FloatArray
    gap_m: float
    interval_s: float
    velocity: Velocity


def arc_track(run: Run, length_m: float) -> ArcTrack:
    """Return the track of a run.

    Result: of all its rows between the first and the last usable fix, but those in gaps.
    """
    fixes = np.flatnonzero(np.isfinite(run.x) & np.isfinite(run.y))
    between, gap_m = _gaps(run, fixes, length_m)
    firsts = np.concatenate([[fixes[0]], fixes[1:][between]])  # rows at which pieces begin and end
    lasts = np.concatenate([fixes[:-1][between], [fixes[-1]]])
    inside = np.zeros(len(run) + 1, dtype=np.int64)
    np.add.at(inside, firsts, 1)
    np.add.at(inside, lasts + 1, -1)
    rows = np.flatnonzero(np.cumsum(inside[:-1]))
    gap = np.isin(rows, firsts)
    t = run.t[rows]
    x, y = (np.interp(t, run.t[fixes], values[fixes]) for values in (run.x, run.y))
    moved = (np.diff(run.x[fixes]) != 0) | (np.diff(run.y[fixes]) != 0)
    interval = float(np.median(np.diff(run.t[fixes])[moved])) if moved.any() else 0.0
    piece = np.cumsum(gap, dtype=np.int64)
    smoothing_s = max(SMOOTHING_S, interval)
    smooth_x, smooth_y, vx, vy = smooth(t, x, y, piece, smoothing_s)
    speed = np.hypot(vx, vy)
    noise = position_noise(run.x[fixes], run.y[fixes], moved)
    if interval <= SMOOTHING_S or not cuts_corners(run.x[fixes], run.y[fixes], between):
        x, y = smooth_x, smooth_y
    within = max(STILL_M, _NOISES * noise)
    # with fixes seconds apart, what a vehicle accelerates is in the noise too, and the speed is that over more time
    still_mps = within / max(STOP_S, 2.0 * interval)
    rims = _rims(run, rows, piece)
    rates = [np.abs(np.gradient(rim, t)) if t.size > 1 else np.zeros(t.size) for rim in rims]
    still = np.max([speed, *rates], axis=0) < still_mps
    stop = _stops(t, np.stack([x, y, *rims]), still, gap, within, STOP_S)
    step = np.hypot(np.diff(x, prepend=x[0]), np.diff(y, prepend=y[0]))
    stays = _both(speed < still_mps) | _both(stop)
    arc = np.cumsum(np.where(gap | stays, 0.0, step))
    return ArcTrack(rows, t, x, y, speed, gap, stop, still, arc, gap_m, interval, Velocity(vx, vy, noise, smoothing_s))


def segment_length(run: Run) -> float:
    """Return the length of segments that the positions of a run can carry.

    Result: 1 m where nine of ten fixes lie close enough for that, else the distance between fixes that nine of ten do
    not exceed: a car that is logged once a second has a fix each 10 to 40 m.
    """
    fixes = np.flatnonzero(np.isfinite(run.x) & np.isfinite(run.y))
    step = np.hypot(np.diff(run.x[fixes]), np.diff(run.y[fixes]))[~run.breaks[fixes][1:]]
    moved = step[step > STILL_M]
    usual = float(np.quantile(moved, _MOST_FIXES)) if moved.size else 0.0
    return usual if usual > _BRIDGED_LENGTHS else 1.0


def equal_parts(arc_m: FloatArray, gap: BoolArray, stop: BoolArray, length_m: float) -> tuple[FloatArray, list[float]]:
    """Cut every piece of a track into parts of equal arc length.

    `arc_m` (m,): driven so far [m]; `gap`, `stop` (m,). Result: fractional positions of both ends, (n, 2); and the arc
    lengths of pieces without a part [m].
    """
    firsts = np.flatnonzero(gap)
    lasts = np.append(firsts[1:], gap.size) - 1
    begins, ends, short = [np.empty(0)], [np.empty(0)], []
    for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
        length = float(arc_m[last] - arc_m[first])
        count = math.floor(length / length_m + 0.5 + 1e-9)
        if count == 0:
            if length > 0:
                short.append(length)
            continue
        cuts = station_at(arc_m, arc_m[first] + length * np.arange(1, count) / count)
        begins.append(np.concatenate([[float(first)], cuts]))
        ends.append(np.concatenate([cuts, [float(last)]]))
    begin, end = np.concatenate(begins), np.concatenate(ends)
    index = np.arange(gap.size)  # a segment neither begins nor ends in a stop
    after = np.minimum.accumulate(np.where(stop, gap.size - 1, index)[::-1])[::-1]
    before = np.maximum.accumulate(np.where(stop, 0, index))
    leaves = stop[np.floor(begin).astype(np.int64)] & stop[np.ceil(begin).astype(np.int64)]
    begin = np.where(leaves, after[np.floor(begin).astype(np.int64)] - 1.0, begin)
    arrives = stop[np.floor(end).astype(np.int64)] & stop[np.ceil(end).astype(np.int64)]
    end = np.where(arrives, before[np.ceil(end).astype(np.int64)] + 1.0, end)
    return np.stack([begin, end], axis=1), short


def station_at(arc_m: FloatArray, at_m: FloatArray) -> FloatArray:
    """Return the first fractional positions at which so much was driven.

    `arc_m` (m,): driven so far [m]; `at_m` (n,): arc lengths [m] above the first and not above the last. The result is
    (n,).
    """
    after = np.clip(np.searchsorted(arc_m, at_m, side="left"), 1, arc_m.size - 1)
    step = arc_m[after] - arc_m[after - 1]
    share = np.where(step > 0, (at_m - arc_m[after - 1]) / np.where(step > 0, step, 1.0), 1.0)
    return np.asarray(after - 1 + np.clip(share, 0.0, 1.0), dtype=np.float64)


def on_rows(run: Run, track: ArcTrack) -> Run:
    """Return the run with a position in every row of its track, on straight lines between fixes.

    Positions in gaps are NaN.
    """
    fixes = np.flatnonzero(np.isfinite(run.x) & np.isfinite(run.y))
    x, y = np.full((2, len(run)), np.nan)
    x[track.rows], y[track.rows] = (np.interp(track.t, run.t[fixes], way[fixes]) for way in (run.x, run.y))
    return replace(run, x=x, y=y)


def stops_of(
    t: FloatArray, gap: BoolArray, stop: BoolArray, stamps: FloatArray, power: FloatArray
) -> tuple[tuple[int, float, float], ...]:
    """Return the stationary intervals of a track.

    `t` (m,): stamps of the track [s]; `gap`, `stop` (m,); `stamps`, `power` (n,): stamps [s] and power [W], or current
    [A], of all rows. Result: 0, duration [s] and energy of each stop, without its first and last half second. A stop
    next to a gap does not count, unless the run begins or ends with it: there the positions may have stopped, and not
    the robot.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stop, [False]]).astype(int)))
    before_gap = np.append(gap[1:], False)
    found = []
    for first, after in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if (gap[first] and first > 0) or gap[first + 1 : after].any() or before_gap[after - 1]:
            continue
        ends = np.array([t[first] + 0.5, t[after - 1] - 0.5])
        energy = integral(stamps, power, ends)
        found.append((0, float(ends[1] - ends[0]), float(energy[1] - energy[0])))
    return tuple(found)


def _gaps(run: Run, fixes: NDArray[np.int64], length_m: float) -> tuple[BoolArray, float]:
    """(True where the track breaks between a fix and the next, (k - 1,); metres across them that were driven)."""
    distance = np.hypot(np.diff(run.x[fixes]), np.diff(run.y[fixes]))
    if fixes.size < 2:
        return np.zeros(0, dtype=bool), 0.0
    broke = np.add.reduceat(run.breaks[1 : fixes[-1] + 1], fixes[:-1]) > 0
    unmeasured = np.logical_or.reduceat(run.missing(length_m)[: fixes[-1]], fixes[:-1])
    between = broke | unmeasured | (distance > _BRIDGED_LENGTHS * length_m)
    return between, float(distance[between & ~broke].sum())


def _rims(run: Run, rows: NDArray[np.int64], piece: NDArray[np.int64]) -> list[FloatArray]:
    """How far the sides of the robot have moved by turning or rolling [m], (m,) each, as far as the log tells."""
    t = run.t[rows]
    rims = []
    for key in _HEADINGS:
        degrees = run.extras.get(key)
        if degrees is not None and np.isfinite(degrees[rows]).mean() >= 0.8:
            known = np.isfinite(degrees)
            turned = np.interp(t, run.t[known], np.unwrap(np.radians(degrees[known])))
            rims.append(_RIM_M * smooth(t, turned, turned, piece, SMOOTHING_S)[0])
            break
    for key, metres in _WHEELS.items():
        rate = run.extras.get(key)
        if rate is not None and np.isfinite(rate[rows]).mean() >= 0.8:
            known = np.isfinite(rate)
            rims.append(integral(run.t[known], metres * np.abs(rate[known]), np.clip(t, *run.t[known][[0, -1]])))
    return rims


def _both(flags: BoolArray) -> BoolArray:
    """True where the flag is set at a sample and at the one before."""
    return flags & np.concatenate([[False], flags[:-1]])


@njit(cache=True)
def _stops(
    t: FloatArray, ways: FloatArray, still: BoolArray, gap: BoolArray, within: float, stop_s: float
) -> BoolArray:
    """True in intervals of `stop_s` or more that begin and end still and in which no way (k, m) moves by `within`."""
    n = t.size
    marked = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        j = i
        stays = True
        while stays and t[j] - t[i] < stop_s:
            j += 1
            if j >= n or gap[j]:
                stays = False
                break
            if math.hypot(ways[0, j] - ways[0, i], ways[1, j] - ways[1, i]) > within:
                stays = False
            for way in range(2, ways.shape[0]):
                if abs(ways[way, j] - ways[way, i]) > within:
                    stays = False
        if stays:
            marked[i : j + 1] = True
    k = 0
    while k < n:
        if not marked[k]:
            k += 1
            continue
        last = k
        while last + 1 < n and marked[last + 1] and not gap[last + 1]:
            last += 1
        after = last + 1
        while k < last and not still[k]:
            marked[k] = False
            k += 1
        while last > k and not still[last]:
            marked[last] = False
            last -= 1
        if t[last] - t[k] < stop_s:
            marked[k : last + 1] = False
        k = after
    return marked
