"""Cut runs into segments along the track.

Every piece of track between gaps is cut into parts of equal arc length, about 1 m each (`joulemap.model.runs.arcs`).
All that the robot drives is in them: curves, slow metres, turns on the spot, starts and short stops, and metres on
which it feeds energy back. A stop of 2 s or more is in no segment.

What is left out is counted in `Segments.left_out`, and its metres of track are in `Segments.left_out_m`:

gaps : where positions or rows are missing, with the straight distance across. stops : stationary intervals.
remainders : pieces, or ends of pieces, too short for a segment. fast : segments faster than the robot can drive.
undriven : the other segments of runs in which the robot was carried: most metres are too fast, or its wheels did not
roll. What the robot draws does not decide.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError, RunsError
from joulemap.model.frames import heading_of, wrap_angle
from joulemap.model.runs.arcs import arc_track, equal_parts, on_rows, segment_length, station_at, stops_of
from joulemap.model.runs.headings import headings
from joulemap.model.runs.run import Run
from joulemap.model.runs.segments import Segments
from joulemap.model.runs.table import add_count
from joulemap.model.runs.track import integral, track_speeds, turns_between

FloatArray = NDArray[np.float64]

CARRIED = 3.0
"""A robot that is faster than so many times its declared speed is carried, or its positions wander: such segments are
left out where the robot is known."""

_CARRIED_SHARE = 0.5  # of the metres of a run: most of it
ANGLE_COLUMNS = frozenset({"heading", "wind_from", "yaw", "gps_course"})
"""Logged columns that are directions [deg]: 359 is beside 0."""


def cut_segments(
    run: Run, *, length_m: float | None = None, charge: bool = False, max_speed_mps: float = math.inf
) -> Segments:
    """Cut a run into segments. `charge`: integrate the current alone [A s], for logs without a voltage."""
    if length_m is not None and not (math.isfinite(length_m) and length_m > 0):
        raise InputError(f"the length of a segment must be positive, got {length_m} m", length_m=str(length_m))
    if not (np.isfinite(run.x) & np.isfinite(run.y)).any():
        raise RunsError.of_run(run.name, "there is no usable position")
    if length_m is None:
        length_m = segment_length(run)
    track = arc_track(run, length_m)
    ends, short = equal_parts(track.arc_m, track.gap, track.stop, length_m)
    station = np.arange(track.t.size, dtype=np.float64)

    def _at(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.interp(ends[:, 0], station, values), np.interp(ends[:, 1], station, values)

    def _between(steps: FloatArray) -> FloatArray:
        first, last = _at(np.cumsum(steps))
        return last - first

    t, x, y, filled, piece = track.t, track.x, track.y, on_rows(run, track), np.cumsum(track.gap, dtype=np.int64)
    stops = track.stop & np.concatenate([[False], track.stop[:-1]]) & ~track.gap
    stays = track.still & np.concatenate([[False], track.still[:-1]]) & ~track.gap
    pt, qt = _at(t)
    ps, qs = _at(track.arc_m)
    pointed = headings(run, track.rows, track.gap, track.velocity, ~track.still)
    heading = pointed.smoothed.value
    change, _ = turns_between(heading, ends)
    moving = np.where(stays | stops, 0.0, wrap_angle(np.diff(heading, prepend=heading[:1])))
    _, turned_abs = turns_between(np.cumsum(moving), ends)
    half_square = 0.5 * track_speeds(filled, track.rows, piece, track.interval_s, track.speed) ** 2
    rises = np.where(track.gap | stops, 0.0, np.maximum(np.diff(half_square, prepend=0.0), 0.0))
    kinetic_p, kinetic_q = _at(half_square)
    dt = np.diff(t, prepend=t[0])
    power = run.drawn(charge=charge)
    drawn = np.diff(integral(run.t, power, t), prepend=0.0)
    duration = qt - pt - _between(np.where(stops, dt, 0.0))
    energy = integral(run.t, power, qt) - integral(run.t, power, pt) - _between(np.where(stops, drawn, 0.0))

    middle = station_at(track.arc_m, (ps + qs) / 2)
    before, after = (station_at(track.arc_m, (ps + qs) / 2 + side * (qs - ps) / 4) for side in (-1.0, 1.0))
    along, across = (np.interp(after, station, way) - np.interp(before, station, way) for way in (x, y))
    rows = np.ones(len(run), dtype=bool)
    rows[track.rows[track.stop]] = False
    first, last = np.searchsorted(run.t, pt), np.searchsorted(run.t, qt, side="right")
    fast = qs - ps > max_speed_mps * duration
    edges = np.diff(np.concatenate([[False], track.stop, [False]]).astype(int)) == 1
    columns = {
        "x": np.interp(middle, station, x),
        "y": np.interp(middle, station, y),
        "heading_rad": heading_of(along, across),
        "energy_j": energy,
        "duration_s": duration,
        "driven_m": qs - ps,
        "heading_change_rad": change,
        "turn_sd_rad": pointed.turn_sd(ends),
        "turned_abs_rad": turned_abs,
        "gained_m2ps2": _between(rises),
        "kinetic_m2ps2": kinetic_q - kinetic_p,
        "standing_s": _between(np.where(stays & ~stops, dt, 0.0)),
        "t0": pt,
    }
    too_fast_m = float((qs - ps)[fast].sum())
    carried = ~fast & (too_fast_m > _CARRIED_SHARE * float((qs - ps).sum()))
    left_out: dict[str, int] = {}
    for key, count in (
        ("gaps", int(track.gap.sum()) - 1),
        ("stops", int(edges.sum())),
        ("remainders", len(short)),
        ("fast", int(fast.sum())),
        ("undriven", int(carried.sum())),
    ):
        add_count(left_out, key, count)
    left_out_m = {
        "gaps": track.gap_m,
        "remainders": sum(short),
        "fast": too_fast_m,
        "undriven": float((qs - ps)[carried].sum()),
    }
    return segments_of(
        run,
        columns,
        first,
        last,
        np.interp(middle, station, t),
        ~(fast | carried),
        rows,
        length_m=length_m,
        charge=charge,
        of_motors=charge and run.of_motors,
        stationary=stops_of(t, track.gap, track.stop, run.t, power),
        left_out=left_out,
        left_out_m=left_out_m,
        track_m=float(track.arc_m[-1]) + track.gap_m,
    )


def segments_of(
    run: Run,
    columns: dict[str, FloatArray],
    first: NDArray[np.int64],
    last: NDArray[np.int64],
    middle_s: FloatArray,
    keep: NDArray[np.bool_],
    rows: NDArray[np.bool_],
    *,
    left_out_m: dict[str, float],
    **more: Any,
) -> Segments:
    """Make segments of a run, with the means of what it logged.

    `columns` (n,): what is known of each segment; `first`, `last` (n,): its rows; `middle_s` (n,): stamp of its middle
    [s]; `keep` (n,): which are used; `rows`: mask of the rows that count; `more`: what is said of the whole run.
    """
    columns = columns | _electric(run, first, last, rows)
    middle = np.clip(np.searchsorted(run.t, middle_s), 0, len(run) - 1)
    extras = {key: _mean(column, first, last, key in ANGLE_COLUMNS, rows) for key, column in run.extras.items()}
    kept: dict[str, Any] = {key: np.ascontiguousarray(column[keep]) for key, column in columns.items()}
    return Segments(
        **kept,
        run=np.zeros(int(keep.sum()), dtype=np.int64),
        runs=(run.name,),
        extras={key: column[keep] for key, column in extras.items()},
        texts={key: column[middle][keep] for key, column in run.texts.items()},
        left_out_m={key: metres for key, metres in left_out_m.items() if metres > 0},
        **more,
    )


def _electric(
    run: Run, first: NDArray[np.int64], last: NDArray[np.int64], rows: NDArray[np.bool_]
) -> dict[str, FloatArray]:
    """Mean voltage, mean current and ripple between two rows."""
    current, square = (_mean(values, first, last, False, rows) for values in (run.current_a, run.current_a**2))
    voltage = np.full(first.size, np.nan)
    if run.voltage_v is not None:
        voltage = _mean(run.voltage_v, first, last, False, rows)
    return {"voltage_v": voltage, "current_a": current, "ripple": _ripple(square, current)}


def _ripple(square: FloatArray, mean: FloatArray) -> FloatArray:
    """Mean square over squared mean, 1 where no current flows."""
    flows = np.abs(mean) > 1e-9
    return np.where(flows, square / np.where(flows, mean, 1.0) ** 2, 1.0)


def _mean(
    values: FloatArray, first: NDArray[np.int64], last: NDArray[np.int64], angle: bool, rows: NDArray[np.bool_]
) -> FloatArray:
    """Mean of the known samples in rows [first, last); NaN where there is none. Angles [deg] as directions, 0..360."""
    if angle:
        radians = np.radians(values)
        sine, cosine = (_mean(part, first, last, False, rows) for part in (np.sin(radians), np.cos(radians)))
        return np.degrees(heading_of(sine, cosine))
    known = np.isfinite(values) & rows
    centre = float(values[known].mean()) if known.any() else 0.0
    sums = np.concatenate([[0.0], np.cumsum(np.where(known, values - centre, 0.0))])
    counts = np.concatenate([[0], np.cumsum(known)])
    n = counts[last] - counts[first]
    return np.where(n > 0, centre + (sums[last] - sums[first]) / np.maximum(n, 1), np.nan)
