"""Cut runs into 1 m segments as the paper does: p and q exactly 1 m apart in the horizontal plane (Wei & Isler, V).

A run is first divided into pieces: at gaps in its stamps or its usable positions, at position breaks, and where the
robot stands. Positions are smoothed within a piece (local straight lines in time). In each piece segments follow one
another without overlap. What is left out is counted in `Segments.left_out`:

gaps, stops : divisions of a run for that reason. bent : segments driven much longer than their straight length.
slow : segments that took much longer than the run's usual pace. remainders : ends of pieces shorter than a segment.
not_positive : segments whose measured energy is not above zero. fast : segments faster than the robot can drive.
undriven : segments of runs that draw next to nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from model.errors import InputError, RunsError
from model.frames import heading_of, wrap_angle
from model.loop.runs import Run

FloatArray = NDArray[np.float64]

ANGLE_COLUMNS = frozenset({"heading", "wind_from", "yaw", "gps_course"})
"""Columns [deg] whose mean over a segment is the mean direction."""

TURN_LIMITS_RADPS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.8)
"""Limits up to which `Segments.gentle_turn_rad` counts how fast a robot turns."""

_LONGEST_GAP_S = 0.75  # or two and a half of the run's usual intervals between fixes
_SMOOTHING_S = 0.3  # or one interval
_TRACK_HEADING_S = 0.5  # directions need more smoothing than places
_COMPASS_AGREES_RAD = 0.25
_STAND_S = 1.0
UNDRIVEN = 0.15
"""Share of the usual current below which a whole run was not driven."""
CARRIED = 3.0
"""Faster than so many times its declared speed a robot was carried, or its positions wandered: such segments are left
out where a robot is known."""
_STANDS_WITHIN_M = 0.05
_STANDS_EVENLY = 0.25


@dataclass(frozen=True)
class Segments:
    """Measured segments, (n,) each.

    x, y : the centre [m]. heading_rad : of p -> q. energy_j : drawn from the battery [J], or charge [A s] if `charge`.
    duration_s. driven_m : horizontal length of the track. heading_change_rad : of the track from p to q, > 0 to the
    right. turned_abs_rad : turns to both sides added up. gentle_turn_rad : (n, 7), the same where every rate of turning
    counts up to the limits `TURN_LIMITS_RADPS` only. gained_m2ps2 : half the square of the
    speed, what it rose by between p and q (falls do not count). voltage_v (NaN where it
    was not recorded), current_a : means. t0 : stamp at p. run : index into `runs`. extras : mean of each further
    numeric column (NaN where blank); texts : text columns at the middle. stands : (run, seconds, energy) of every
    stand of 2 s or more without its first and last half second. left_out : reason -> count.
    """

    x: FloatArray
    y: FloatArray
    heading_rad: FloatArray
    energy_j: FloatArray
    duration_s: FloatArray
    driven_m: FloatArray
    heading_change_rad: FloatArray
    turned_abs_rad: FloatArray
    gentle_turn_rad: FloatArray
    gained_m2ps2: FloatArray
    voltage_v: FloatArray
    current_a: FloatArray
    t0: FloatArray
    run: NDArray[np.int64]
    runs: tuple[str, ...]
    length_m: float = 1.0
    charge: bool = False
    extras: dict[str, FloatArray] = field(default_factory=dict)
    texts: dict[str, NDArray[np.str_]] = field(default_factory=dict)
    stands: tuple[tuple[int, float, float], ...] = ()
    left_out: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for item in fields(self):
            values = getattr(self, item.name)
            if isinstance(values, np.ndarray):
                values.setflags(write=False)

    def __len__(self) -> int:
        return int(self.x.size)

    def take(self, which: ArrayLike) -> Segments:
        """The segments of a mask or of indices; `runs`, `stands` and `left_out` stay."""
        index = np.asarray(which)
        per_segment = {f.name: getattr(self, f.name) for f in fields(self)}
        changed: dict[str, Any] = {k: v[index] for k, v in per_segment.items() if isinstance(v, np.ndarray)}
        changed["extras"] = {key: values[index] for key, values in self.extras.items()}
        changed["texts"] = {key: values[index] for key, values in self.texts.items()}
        return replace(self, **changed)


def cut_segments(
    run: Run,
    *,
    length_m: float = 1.0,
    charge: bool = False,
    max_driven_ratio: float = 1.2,
    max_duration_ratio: float = 3.0,
    max_speed_mps: float = math.inf,
) -> Segments:
    """Cut one run. charge : integrate the current alone [A s], for logs without voltage. max_speed_mps : what is faster
    was not driven but carried, or its positions wander.

    Raises RunsError where the voltage is missing and `charge` is not asked for.
    """
    if not (math.isfinite(length_m) and length_m > 0):
        raise InputError(f"the length of a segment must be positive, got {length_m} m", length_m=str(length_m))
    if run.voltage_v is None and not charge:
        raise RunsError(f"run {run.name}: no voltage was recorded; ask for charge [A s] instead", run=run.name)
    left_out: dict[str, int] = {}
    good = np.flatnonzero(np.isfinite(run.x) & np.isfinite(run.y))
    t, x, y = run.t[good], run.x[good], run.y[good]
    fresh = np.diff(t)[(np.diff(x) != 0) | (np.diff(y) != 0)]
    interval = float(np.median(fresh)) if fresh.size else 0.0
    longest_gap = max(_LONGEST_GAP_S, 2.5 * interval)
    gap = np.concatenate([[True], (np.diff(t) > longest_gap) | run.breaks[good][1:]])
    _count(left_out, "gaps", int(gap.sum()) - 1)
    x, y, vx, vy = _smooth(t, x, y, np.cumsum(gap), max(_SMOOTHING_S, interval))
    speed = np.hypot(vx, vy)
    own = speed[(speed > 0.0) & (speed <= max_speed_mps)]
    usual = float(np.median(own[own > 0.25 * np.quantile(own, 0.9)])) if own.size else 0.0
    piece, stops = _pieces(t, speed, gap, 0.15 * usual, _STAND_S)
    _count(left_out, "stops", stops)

    ends, remainders = _cut(x, y, piece, length_m)  # (n, 2) fractional positions of p and q
    _count(left_out, "remainders", remainders)
    station = np.arange(t.size, dtype=np.float64)

    def at(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.interp(ends[:, 0], station, values), np.interp(ends[:, 1], station, values)

    (px, qx), (py, qy), (pt, qt) = at(x), at(y), at(t)
    ps, qs = at(np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))]))
    turned, turned_abs, gentle = _turned(t, _headings(run, good, np.cumsum(gap), interval, speed), ends)
    rises = np.maximum(np.diff(0.5 * _speeds(run, good, np.cumsum(gap), interval, speed) ** 2, prepend=0.0), 0.0)
    gained_p, gained_q = at(np.cumsum(np.where(gap, 0.0, rises)))
    power = run.current_a if charge or run.voltage_v is None else run.current_a * run.voltage_v
    energy = _integral(run.t, power, qt) - _integral(run.t, power, pt)
    first, last = np.searchsorted(run.t, pt), np.searchsorted(run.t, qt, side="right")
    voltage = np.full(pt.size, np.nan) if run.voltage_v is None else _mean(run.voltage_v, first, last, False)
    columns = {
        "x": (px + qx) / 2, "y": (py + qy) / 2, "heading_rad": heading_of(qx - px, qy - py), "energy_j": energy,
        "duration_s": qt - pt, "driven_m": qs - ps, "heading_change_rad": turned, "t0": pt,
        "turned_abs_rad": turned_abs, "gentle_turn_rad": gentle, "gained_m2ps2": gained_q - gained_p,
        "voltage_v": voltage, "current_a": _mean(run.current_a, first, last, False),
    }  # fmt: skip
    bent = (qs - ps) > max_driven_ratio * length_m
    slow = ~bent & ((qt - pt) * usual > max_duration_ratio * length_m)
    dead = ~bent & ~slow & ~(energy > 0)
    fast = ~bent & ~dead & (qs - ps > max_speed_mps * (qt - pt))
    for key, mask in (("bent", bent), ("slow", slow), ("not_positive", dead), ("fast", fast)):
        _count(left_out, key, int(mask.sum()))
    keep = ~(bent | slow | dead | fast)
    middle = np.clip(np.searchsorted(run.t, (pt + qt) / 2), 0, len(run) - 1)
    return Segments(
        **{key: np.ascontiguousarray(values[keep]) for key, values in columns.items()},
        run=np.zeros(int(keep.sum()), dtype=np.int64),
        runs=(run.name,),
        length_m=length_m,
        charge=charge,
        extras={key: _mean(values, first, last, key in ANGLE_COLUMNS)[keep] for key, values in run.extras.items()},
        texts={key: values[middle][keep] for key, values in run.texts.items()},
        stands=_stands(t, x, y, piece, run.t, power, run.extras.get("speed")),
        left_out=left_out,
    )


def concatenate(parts: Sequence[Segments]) -> Segments:
    """Several runs' segments in one value; a column that some part lacks is NaN (or empty text) there.

    Raises InputError for parts that mix energy with charge, or lengths.
    """
    if not parts:
        raise InputError("there are no segments to put together")
    if len({(p.charge, p.length_m) for p in parts}) > 1:
        raise InputError("segments of energy and of charge, or of different lengths, cannot be put together")
    offsets = np.cumsum([0] + [len(p.runs) for p in parts])
    names = sorted({key for p in parts for key in p.extras})
    words = sorted({key for p in parts for key in p.texts})
    plain = [f.name for f in fields(Segments) if isinstance(getattr(parts[0], f.name), np.ndarray) and f.name != "run"]
    left_out: dict[str, int] = {}
    for part in parts:
        for key, count in part.left_out.items():
            _count(left_out, key, count)
    return Segments(
        **{key: np.concatenate([getattr(p, key) for p in parts]) for key in plain},
        run=np.concatenate([p.run + o for p, o in zip(parts, offsets, strict=False)]),
        runs=tuple(name for p in parts for name in p.runs),
        length_m=parts[0].length_m,
        charge=parts[0].charge,
        extras={k: np.concatenate([p.extras.get(k, np.full(len(p), np.nan)) for p in parts]) for k in names},
        texts={k: np.concatenate([p.texts.get(k, np.full(len(p), "")) for p in parts]) for k in words},
        stands=tuple((r + int(o), t, e) for p, o in zip(parts, offsets, strict=False) for r, t, e in p.stands),
        left_out=left_out,
    )


def driven_only(segments: Segments) -> Segments:
    """Without the runs that draw next to nothing: their median current is below `UNDRIVEN` of that of the median run,
    as of a robot on a trailer, or of one that stands while its positions wander. Counted as `undriven`; never with
    fewer than three runs."""
    medians = {int(k): float(np.median(segments.current_a[segments.run == k])) for k in np.unique(segments.run)}
    if len(medians) < 3:
        return segments
    least = UNDRIVEN * float(np.median(list(medians.values())))
    still = [k for k, current in medians.items() if current < least]
    if not still:
        return segments
    apart = np.isin(segments.run, still)
    return replace(segments.take(~apart), left_out=segments.left_out | {"undriven": int(apart.sum())})


def split_runs(segments: Segments, held_out: Iterable[int]) -> tuple[Segments, Segments]:
    """(the rest, the held-out ones) by whole runs; held_out : indices into `segments.runs`."""
    chosen = sorted(set(held_out))
    wrong = [k for k in chosen if not 0 <= k < len(segments.runs)]
    if wrong:
        raise InputError(f"there is no run {wrong[0]}; there are {len(segments.runs)}", run=wrong[0])
    apart = np.isin(segments.run, chosen)
    return segments.take(~apart), segments.take(apart)


def _count(counts: dict[str, int], key: str, count: int) -> None:
    if count:
        counts[key] = counts.get(key, 0) + count


def _integral(t: FloatArray, power: FloatArray, at: FloatArray) -> FloatArray:
    """Integral of piecewise linear `power` from t[0] to `at`, exactly."""
    total = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(t))])
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
    there = np.interp(at, t, power)
    return total[k] + 0.5 * (power[k] + there) * (at - t[k])


def _mean(values: FloatArray, first: NDArray[np.int64], last: NDArray[np.int64], angle: bool) -> FloatArray:
    """Mean of the known samples in rows [first, last); NaN where there is none. Angles [deg] as directions, 0..360."""
    if angle:
        radians = np.radians(values)
        sine, cosine = _mean(np.sin(radians), first, last, False), _mean(np.cos(radians), first, last, False)
        return np.degrees(heading_of(sine, cosine))
    known = np.isfinite(values)
    centre = float(values[known].mean()) if known.any() else 0.0
    sums = np.concatenate([[0.0], np.cumsum(np.where(known, values - centre, 0.0))])
    counts = np.concatenate([[0], np.cumsum(known)])
    n = counts[last] - counts[first]
    return np.where(n > 0, centre + (sums[last] - sums[first]) / np.maximum(n, 1), np.nan)


def _headings(
    run: Run, good: NDArray[np.int64], piece: NDArray[np.int64], interval: float, speed: FloatArray
) -> FloatArray:
    """Where the robot points [rad] at the rows `good`: its `heading` column where that agrees with the track, which it
    knows better than positions do; else the direction of the track."""
    t, x, y = run.t[good], run.x[good], run.y[good]
    _, _, vx, vy = _smooth(t, x, y, piece, max(_TRACK_HEADING_S, interval))
    track = heading_of(vx, vy)
    compass = run.extras.get("heading")
    if compass is None or np.isfinite(compass[good]).mean() < 0.8:
        return track
    known = np.isfinite(compass)
    turns = np.unwrap(np.radians(compass[known]))
    pointed = np.interp(t, run.t[known], turns)
    clear = speed > 0.5 * float(np.quantile(speed, 0.9))
    if np.median(np.abs(wrap_angle(pointed - track)[clear])) > _COMPASS_AGREES_RAD:
        return track
    north, east, _, _ = _smooth(t, np.cos(pointed), np.sin(pointed), piece, max(_SMOOTHING_S, interval))
    return heading_of(east, north)


def _turned(t: FloatArray, heading: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Heading change between fractional positions, followed through every sample: signed (> 0 to the right), absolute,
    and absolute with every rate up to the limits only (n, limits)."""
    step, dt = wrap_angle(np.diff(heading)), np.diff(t)
    station = np.arange(t.size, dtype=np.float64)

    def between(steps: FloatArray) -> FloatArray:
        total = np.concatenate([[0.0], np.cumsum(steps)])
        return np.interp(ends[:, 1], station, total) - np.interp(ends[:, 0], station, total)

    gentle = [between(np.minimum(np.abs(step), limit * dt)) for limit in TURN_LIMITS_RADPS]
    return between(step), between(np.abs(step)), np.stack(gentle, axis=1)


def _speeds(
    run: Run, good: NDArray[np.int64], piece: NDArray[np.int64], interval: float, track: FloatArray
) -> FloatArray:
    """Speed at the rows `good` [m/s]: the `speed` column, evened out, where it agrees with the track; else its."""
    logged = run.extras.get("speed")
    if logged is None or np.isfinite(logged[good]).mean() < 0.8:
        return track
    known = np.isfinite(logged)
    told = np.interp(run.t[good], run.t[known], logged[known])
    if np.median(np.abs(told - track)) > 0.2 * float(np.median(track)):
        return track
    return _smooth(run.t[good], told, told, piece, max(_SMOOTHING_S, interval))[0]


def _stands(
    t: FloatArray, x: FloatArray, y: FloatArray, piece: NDArray[np.int64], stamps: FloatArray, power: FloatArray,
    speed: FloatArray | None,
) -> tuple[tuple[int, float, float], ...]:  # fmt: skip
    """(0, seconds, energy) of every stand, without its first and last half second. The robot stays where it is and
    draws evenly and little: one that turns on the spot, or that lost its position on the way, is not standing."""
    edges = np.flatnonzero(np.diff(np.concatenate([[1], (piece != 0).astype(int), [1]])))
    usual = float(np.median(power))
    found = []
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        start, end = float(t[first]) + 0.5, float(t[after - 1]) - 0.5
        rows = (stamps >= start) & (stamps <= end)
        drawn = power[rows]
        if end - start < 1.0 or drawn.size < 5 or drawn.std() > _STANDS_EVENLY * drawn.mean() > 0:
            continue
        moved = math.hypot(x[after - 1] - x[first], y[after - 1] - y[first])
        told = 0.0 if speed is None else float(np.nan_to_num(np.abs(speed[rows])).mean())
        if moved < _STANDS_WITHIN_M and told < _STANDS_WITHIN_M and 0.0 < drawn.mean() < 0.7 * usual:
            ends = _integral(stamps, power, np.array([start, end]))
            found.append((0, end - start, float(ends[1] - ends[0])))
    return tuple(found)


@njit(cache=True)
def _smooth(
    t: FloatArray, x: FloatArray, y: FloatArray, piece: NDArray[np.int64], sigma_s: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Local straight lines in time with Gaussian weights, never across pieces: position and velocity, (n,) each."""
    n = t.size
    sx, sy, vx, vy = np.empty(n), np.empty(n), np.zeros(n), np.zeros(n)
    reach = 3.0 * sigma_s + 1e-6  # rounding must not take one side's last sample
    for k in range(n):
        w0 = w1 = w2 = x0 = x1 = y0 = y1 = 0.0
        for side in (-1, 1):
            j = k if side == 1 else k - 1
            while 0 <= j < n and piece[j] == piece[k] and abs(t[j] - t[k]) <= reach:
                dt = t[j] - t[k]
                w = math.exp(-0.5 * (dt / sigma_s) ** 2)
                w0 += w
                w1 += w * dt
                w2 += w * dt * dt
                x0 += w * (x[j] - x[k])
                x1 += w * dt * (x[j] - x[k])
                y0 += w * (y[j] - y[k])
                y1 += w * dt * (y[j] - y[k])
                j += side
        det = w0 * w2 - w1 * w1
        if det > 1e-12:
            sx[k] = x[k] + (w2 * x0 - w1 * x1) / det
            sy[k] = y[k] + (w2 * y0 - w1 * y1) / det
            vx[k] = (w0 * x1 - w1 * x0) / det
            vy[k] = (w0 * y1 - w1 * y0) / det
        else:
            sx[k], sy[k] = x[k], y[k]
    return sx, sy, vx, vy


@njit(cache=True)
def _pieces(
    t: FloatArray, speed: FloatArray, gap: NDArray[np.bool_], standing_mps: float, standing_s: float
) -> tuple[NDArray[np.int64], int]:
    """Number of the piece each sample belongs to (0 while standing for `standing_s` or more), and how many stands."""
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
def _cut(x: FloatArray, y: FloatArray, piece: NDArray[np.int64], length: float) -> tuple[FloatArray, int]:
    """Fractional positions (n, 2) of p and q, `length` apart in a straight line, and the number of remainders."""
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
