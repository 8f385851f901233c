"""From stamps and positions to a track: in pieces, with headings, speeds and stationary intervals."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.frames import wrap_angle
from joulemap.model.runs.reader import Run
from joulemap.model.runs.smoothing import SMOOTHING_S, smooth

FloatArray = NDArray[np.float64]

TURN_LIMITS_RADPS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.8)
"""Limits up to which a gentle turn counts how fast a robot turns."""
_STATIONARY_WITHIN_M = 0.05
_STATIONARY_EVENLY = 0.25


def turns_between(t: FloatArray, heading: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the heading change of segments, followed through every sample.

    `t` (m,): stamps [s]; `heading` (m,): at these stamps [rad]; `ends` (n, 2): fractional positions of p and q. Result:
    signed [rad], positive to the right, (n,); absolute, (n,); and absolute, where a rate counts only up to each of
    `TURN_LIMITS_RADPS`, (n, limits).
    """
    step, dt = wrap_angle(np.diff(heading)), np.diff(t)
    station = np.arange(t.size, dtype=np.float64)

    def _between(steps: FloatArray) -> FloatArray:
        total = np.concatenate([[0.0], np.cumsum(steps)])
        return np.interp(ends[:, 1], station, total) - np.interp(ends[:, 0], station, total)

    gentle = [_between(np.minimum(np.abs(step), limit * dt)) for limit in TURN_LIMITS_RADPS]
    return _between(step), _between(np.abs(step)), np.stack(gentle, axis=1)


def track_speeds(
    run: Run, good: NDArray[np.int64], piece: NDArray[np.int64], interval: float, track: FloatArray
) -> FloatArray:
    """Return the speed of the robot.

    `good` (m,): its rows with a usable fix; `piece` (m,): number of the piece between gaps; `interval`: the usual time
    between fixes [s]; `track` (m,): speed of the track [m/s]. Result (m,): speed [m/s]: the column `speed`, smoothed,
    where it agrees with the track; otherwise that of the track.
    """
    logged = run.extras.get("speed")
    if logged is None or np.isfinite(logged[good]).mean() < 0.8:
        return track
    known = np.isfinite(logged)
    recorded = np.interp(run.t[good], run.t[known], logged[known])
    if np.median(np.abs(recorded - track)) > 0.2 * float(np.median(track)):
        return track
    return smooth(run.t[good], recorded, recorded, piece, max(SMOOTHING_S, interval))[0]


def stationary_intervals(
    t: FloatArray,
    x: FloatArray,
    y: FloatArray,
    piece: NDArray[np.int64],
    stamps: FloatArray,
    power: FloatArray,
    speed: FloatArray | None,
) -> tuple[tuple[int, float, float], ...]:
    """Return the stationary intervals of a run.

    In such an interval the robot stays where it is and draws evenly and little. A robot that turns on the spot, or that
    lost its position while driving, is not stationary.

    `t`, `x`, `y` (m,): stamps [s] and smoothed positions [m]; `piece` (m,): as `pieces_of` returns it; `stamps`,
    `power` (n,): stamps [s] and power [W], or current [A], of all rows; `speed` (n,): logged speed [m/s]. Result: 0,
    duration [s] and energy of each, without its first and last half second.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[1], (piece != 0).astype(int), [1]])))
    usual = float(np.median(power))
    found = []
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        start, end = float(t[first]) + 0.5, float(t[after - 1]) - 0.5
        rows = (stamps >= start) & (stamps <= end)
        drawn = power[rows]
        if end - start < 1.0 or drawn.size < 5 or drawn.std() > _STATIONARY_EVENLY * drawn.mean() > 0:
            continue
        moved = math.hypot(x[after - 1] - x[first], y[after - 1] - y[first])
        logged = 0.0 if speed is None else float(np.nan_to_num(np.abs(speed[rows])).mean())
        if moved < _STATIONARY_WITHIN_M and logged < _STATIONARY_WITHIN_M and 0.0 < drawn.mean() < 0.7 * usual:
            ends = integral(stamps, power, np.array([start, end]))
            found.append((0, end - start, float(ends[1] - ends[0])))
    return tuple(found)


@njit(cache=True)
def pieces_of(
    t: FloatArray, speed: FloatArray, gap: NDArray[np.bool_], standing_mps: float, standing_s: float
) -> tuple[NDArray[np.int64], int]:
    """Divide a track at gaps and stationary intervals.

    `t`, `speed` (n,): stamps [s] and speeds [m/s]; `gap` (n,): True where a gap lies before the sample. Result: number
    of the piece of each sample, (n,), 0 while stationary; and the number of stationary intervals.
    """
    n = t.size
    piece = np.zeros(n, dtype=np.int64)
    now = 0
    stops = 0
    fresh = True
    k = 0
    while k < n:
        fresh = fresh or gap[k]
        if speed[k] < standing_mps:
            j = k
            while j + 1 < n and speed[j + 1] < standing_mps and not gap[j + 1]:
                j += 1
            if t[j] - t[k] >= standing_s:
                stops += 1
                fresh = True
                k = j + 1
                continue
        if fresh:
            now += 1
            fresh = False
        piece[k] = now
        k += 1
    return piece, stops


@njit(cache=True)
def cut_chords(x: FloatArray, y: FloatArray, piece: NDArray[np.int64], length: float) -> tuple[FloatArray, int]:
    """Cut a track into chords of equal length, one after the other within each piece.

    `x`, `y` (n,): positions [m]; `piece` (n,): number of the piece, 0 is not cut; `length`: of a chord, in a straight
    line [m]. Result: fractional positions of both ends, (chords, 2); and how many pieces end in a remainder.
    """
    n = x.size
    ends = np.empty((n + 1, 2))
    count = 0
    remainders = 0
    k = 0
    while k < n:
        if piece[k] == 0:
            k += 1
            continue
        here = piece[k]
        start = float(k)
        px, py = x[k], y[k]
        j = k + 1
        while j < n and piece[j] == here:
            if math.hypot(x[j] - px, y[j] - py) < length:
                j += 1
                continue
            ax, ay = x[j - 1] - px, y[j - 1] - py
            f0 = start - (j - 1) if start > j - 1 else 0.0
            dx, dy = x[j] - x[j - 1], y[j] - y[j - 1]
            a = dx * dx + dy * dy  # |a + f d| = length, the later root
            b = ax * dx + ay * dy
            c = ax * ax + ay * ay - length * length
            f = min(max((-b + math.sqrt(max(b * b - a * c, 0.0))) / a, f0), 1.0)
            end = j - 1 + f
            ends[count, 0] = start
            ends[count, 1] = end
            count += 1
            if count == ends.shape[0]:
                grown = np.empty((2 * count, 2))
                grown[:count] = ends
                ends = grown
            start = end
            px, py = x[j - 1] + f * dx, y[j - 1] + f * dy
        if start < j - 1:
            remainders += 1
        k = j
    return ends[:count].copy(), remainders


def integral(t: FloatArray, power: FloatArray, at: FloatArray) -> FloatArray:
    """Integrate a piecewise linear power from the first stamp, exactly.

    `t`, `power` (n,): stamps [s] and values; `at` (m,): stamps to integrate to [s]. The result is (m,).
    """
    total = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(t))])
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
    there = np.interp(at, t, power)
    return total[k] + 0.5 * (power[k] + there) * (at - t[k])
