"""Cut runs into segments of 1 m as the paper does: p and q exactly 1 m apart in the horizontal plane.

A run is first divided into pieces: at gaps in its stamps or its usable positions, at position breaks, and where the
robot is stationary. Positions are smoothed within a piece by local straight lines in time. In each piece segments
follow one another without overlap. What is left out is counted in `Segments.left_out`:

gaps, stops : divisions of a run for that reason. bent : segments whose track is much longer than their straight length.
slow : segments that took much longer than usual in their run. remainders : ends of pieces shorter than a segment.
not_positive : segments whose measured energy is not above zero. fast : segments faster than the robot can drive.
undriven : segments of runs that draw next to nothing.

References
----------
Wei & Isler 2022, section V.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError, RunsError
from joulemap.model.frames import heading_of
from joulemap.model.runs.reader import Run
from joulemap.model.runs.segments import Segments
from joulemap.model.runs.table import add_count
from joulemap.model.runs.track import (
    SMOOTHING_S,
    cut_chords,
    integral,
    pieces_of,
    smooth,
    stationary_intervals,
    track_headings,
    track_speeds,
    turns_between,
)

FloatArray = NDArray[np.float64]

CARRIED = 3.0
"""A robot that is faster than so many times its declared speed is carried, or its positions wander: such segments are
left out where the robot is known."""

_ANGLE_COLUMNS = frozenset({"heading", "wind_from", "yaw", "gps_course"})  # [deg]
_LONGEST_GAP_S = 0.75  # or two and a half of the run's usual intervals between fixes
_STATIONARY_S = 1.0


def cut_segments(
    run: Run,
    *,
    length_m: float = 1.0,
    charge: bool = False,
    max_driven_ratio: float = 1.2,
    max_duration_ratio: float = 3.0,
    max_speed_mps: float = math.inf,
) -> Segments:
    """Cut a run into segments.

    Parameters
    ----------
    run : Run
        With positions.
    length_m : float
        Straight length of a segment [m].
    charge : bool
        Integrate the current alone [A s], for logs without a voltage.
    max_driven_ratio : float
        A segment whose track is longer than so many times `length_m` is left out as bent.
    max_duration_ratio : float
        A segment that takes longer than so many times the usual duration of its run is left out as slow.
    max_speed_mps : float
        A segment faster than this is left out: the robot was carried, or its positions wander.

    Returns
    -------
    Segments
        In driving order.

    Raises
    ------
    InputError
        If the length is not positive.
    RunsError
        If the run has no voltage and `charge` is False.
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
    add_count(left_out, "gaps", int(gap.sum()) - 1)
    x, y, vx, vy = smooth(t, x, y, np.cumsum(gap), max(SMOOTHING_S, interval))
    speed = np.hypot(vx, vy)
    own = speed[(speed > 0.0) & (speed <= max_speed_mps)]
    usual = float(np.median(own[own > 0.25 * np.quantile(own, 0.9)])) if own.size else 0.0
    piece, stops = pieces_of(t, speed, gap, 0.15 * usual, _STATIONARY_S)
    add_count(left_out, "stops", stops)

    ends, remainders = cut_chords(x, y, piece, length_m)  # (n, 2) fractional positions of p and q
    add_count(left_out, "remainders", remainders)
    station = np.arange(t.size, dtype=np.float64)

    def _at(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.interp(ends[:, 0], station, values), np.interp(ends[:, 1], station, values)

    (px, qx), (py, qy), (pt, qt) = _at(x), _at(y), _at(t)
    ps, qs = _at(np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))]))
    turned, turned_abs, gentle = turns_between(t, track_headings(run, good, np.cumsum(gap), interval, speed), ends)
    rises = np.maximum(np.diff(0.5 * track_speeds(run, good, np.cumsum(gap), interval, speed) ** 2, prepend=0.0), 0.0)
    gained_p, gained_q = _at(np.cumsum(np.where(gap, 0.0, rises)))
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
        add_count(left_out, key, int(mask.sum()))
    keep = ~(bent | slow | dead | fast)
    middle = np.clip(np.searchsorted(run.t, (pt + qt) / 2), 0, len(run) - 1)
    return Segments(
        **{key: np.ascontiguousarray(values[keep]) for key, values in columns.items()},
        run=np.zeros(int(keep.sum()), dtype=np.int64),
        runs=(run.name,),
        length_m=length_m,
        charge=charge,
        extras={key: _mean(values, first, last, key in _ANGLE_COLUMNS)[keep] for key, values in run.extras.items()},
        texts={key: values[middle][keep] for key, values in run.texts.items()},
        stationary=stationary_intervals(t, x, y, piece, run.t, power, run.extras.get("speed")),
        left_out=left_out,
    )


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
