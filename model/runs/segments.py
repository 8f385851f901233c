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
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError, RunsError
from joulemap.model.frames import heading_of
from joulemap.model.runs.reader import Run
from joulemap.model.runs.track import (
    SMOOTHING_S,
    cut_chords,
    find_stands,
    integral,
    pieces_of,
    smooth,
    track_headings,
    track_speeds,
    turns_between,
)

FloatArray = NDArray[np.float64]

ANGLE_COLUMNS = frozenset({"heading", "wind_from", "yaw", "gps_course"})
"""Columns [deg] whose mean over a segment is the mean direction."""
UNDRIVEN = 0.15
"""Share of the usual current below which a whole run was not driven."""
CARRIED = 3.0
"""Faster than so many times its declared speed a robot was carried, or its positions wandered: such segments are left
out where a robot is known."""

_LONGEST_GAP_S = 0.75  # or two and a half of the run's usual intervals between fixes
_STAND_S = 1.0


@dataclass(frozen=True)
class Segments:
    """Measured segments, (n,) each.

    x, y : the centre [m]. heading_rad : of p -> q. energy_j : drawn from the battery [J], or charge [A s] if `charge`.
    duration_s. driven_m : horizontal length of the track. heading_change_rad : of the track from p to q, > 0 to the
    right. turned_abs_rad : turns to both sides added up. gentle_turn_rad : (n, 7), the same where every rate of turning
    counts up to the limits `track.TURN_LIMITS_RADPS` only. gained_m2ps2 : half the square of the speed, what it rose by
    between p and q (falls do not count). voltage_v (NaN where it was not recorded), current_a : means. ripple : mean
    square of the current over the square of its mean. t0 : stamp at p. run : index into `runs`. extras : mean of each
    further numeric column (NaN where blank); texts : text columns at the middle. stands : (run, seconds, energy) of
    every stand of 2 s or more without its first and last half second. left_out : reason -> count.
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
    ripple: FloatArray
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
    x, y, vx, vy = smooth(t, x, y, np.cumsum(gap), max(SMOOTHING_S, interval))
    speed = np.hypot(vx, vy)
    own = speed[(speed > 0.0) & (speed <= max_speed_mps)]
    usual = float(np.median(own[own > 0.25 * np.quantile(own, 0.9)])) if own.size else 0.0
    piece, stops = pieces_of(t, speed, gap, 0.15 * usual, _STAND_S)
    _count(left_out, "stops", stops)

    ends, remainders = cut_chords(x, y, piece, length_m)  # (n, 2) fractional positions of p and q
    _count(left_out, "remainders", remainders)
    station = np.arange(t.size, dtype=np.float64)

    def at(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.interp(ends[:, 0], station, values), np.interp(ends[:, 1], station, values)

    (px, qx), (py, qy), (pt, qt) = at(x), at(y), at(t)
    ps, qs = at(np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))]))
    turned, turned_abs, gentle = turns_between(t, track_headings(run, good, np.cumsum(gap), interval, speed), ends)
    rises = np.maximum(np.diff(0.5 * track_speeds(run, good, np.cumsum(gap), interval, speed) ** 2, prepend=0.0), 0.0)
    gained_p, gained_q = at(np.cumsum(np.where(gap, 0.0, rises)))
    power = run.current_a if charge or run.voltage_v is None else run.current_a * run.voltage_v
    energy = integral(run.t, power, qt) - integral(run.t, power, pt)
    first, last = np.searchsorted(run.t, pt), np.searchsorted(run.t, qt, side="right")
    voltage = np.full(pt.size, np.nan) if run.voltage_v is None else _mean(run.voltage_v, first, last, False)
    current, square = (_mean(values, first, last, False) for values in (run.current_a, run.current_a**2))
    columns = {
        "x": (px + qx) / 2,
        "y": (py + qy) / 2,
        "heading_rad": heading_of(qx - px, qy - py),
        "energy_j": energy,
        "duration_s": qt - pt,
        "driven_m": qs - ps,
        "heading_change_rad": turned,
        "t0": pt,
        "turned_abs_rad": turned_abs,
        "gentle_turn_rad": gentle,
        "gained_m2ps2": gained_q - gained_p,
        "voltage_v": voltage,
        "current_a": current,
        "ripple": _ripple(square, current),
    }
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
        stands=find_stands(t, x, y, piece, run.t, power, run.extras.get("speed")),
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
    fewer than three runs.
    """
    medians = {int(k): float(np.median(segments.current_a[segments.run == k])) for k in np.unique(segments.run)}
    if len(medians) < 3:
        return segments
    least = UNDRIVEN * float(np.median(list(medians.values())))
    still = [k for k, current in medians.items() if current < least]
    if not still:
        return segments
    apart = np.isin(segments.run, still)
    return replace(segments.take(~apart), left_out=segments.left_out | {"undriven": int(apart.sum())})


def _count(counts: dict[str, int], key: str, count: int) -> None:
    if count:
        counts[key] = counts.get(key, 0) + count


def _ripple(square: FloatArray, mean: FloatArray) -> FloatArray:
    """Mean square over squared mean, 1 where no current flows."""
    flows = np.abs(mean) > 1e-9
    return np.where(flows, square / np.where(flows, mean, 1.0) ** 2, 1.0)


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
