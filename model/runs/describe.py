"""Makes the features of segments: of those that were measured, and of those that a plan asks about."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.robot import Robot
from joulemap.model.runs.features import GROUND, Drives, Features, FloatArray, row_arrays
from joulemap.model.runs.segments import Segments
from joulemap.model.runs.under_segments import ground_under, unread_ground
from joulemap.model.terrain.heightmap import Heightmap


def describe_segments(
    segments: Segments, heightmap: Heightmap, robot: Robot, traction_per_m: ArrayLike, *, with_stationary: bool = True
) -> tuple[Features, FloatArray]:
    """Return the features of segments, and after them those of the stationary intervals.

    `traction_per_m` (n,): of the base model [J/m]. Result: the features; and the measured energy of each row [J, or A
    s].
    """
    n = len(segments)
    first = np.array([segments.t0[segments.run == k].min(initial=math.inf) for k in range(len(segments.runs))])
    driven = np.zeros(n)
    for k in range(len(segments.runs)):
        mine = np.flatnonzero(segments.run == k)
        driven[mine] = np.cumsum(segments.driven_m[mine])
    ground: dict[str, Any] = ground_under(heightmap, robot, segments.x, segments.y, segments.heading_rad)
    rows = Features(
        robot=robot,
        run=segments.run,
        x=segments.x,
        y=segments.y,
        heading_rad=segments.heading_rad,
        length_m=segments.driven_m,
        duration_s=segments.duration_s,
        traction_per_m=np.asarray(traction_per_m, dtype=np.float64),
        turned_rad=segments.heading_change_rad,
        turned_abs_rad=segments.turned_abs_rad,
        gained_m2ps2=segments.gained_m2ps2,
        kinetic_m2ps2=segments.kinetic_m2ps2,
        **ground,
        since_s=segments.t0 - (first[segments.run] if n else 0.0),
        driven_m=driven,
        clock_s=segments.t0,
        columns=dict(segments.extras),
        words=_words(segments, heightmap),
        unit_j=robot.nominal_voltage_v if segments.charge else 1.0,
        drives=Drives(motor_speed_mps=robot.speed_mps if segments.of_motors else None),
        runs=tuple(f"{name}@{stamp:.1f}" for name, stamp in zip(segments.runs, first, strict=True)),
    )
    stationary = [(run, s, e) for run, s, e in segments.stationary if np.any(segments.run == run)]
    if not with_stationary or not stationary:
        return rows, segments.energy_j
    run, seconds, energy = (np.array(values) for values in zip(*stationary, strict=True))
    return _with_stationary(rows, run.astype(np.int64), seconds), np.concatenate([segments.energy_j, energy])


def planned_features(
    heightmap: Heightmap,
    robot: Robot,
    x: FloatArray,
    y: FloatArray,
    heading_rad: FloatArray,
    traction_per_m: ArrayLike,
    conditions: Mapping[str, float],
    *,
    with_ground: bool = True,
) -> Features:
    """Return the features of straight 1 m segments at cruising speed that were not driven yet.

    `x`, `y` (n,): middles [m]; `heading_rad` (n,); `traction_per_m` (n,): of the base model [J/m]; `with_ground`: read
    slopes, roughness and heights, which takes most of the time, otherwise they are NaN.
    """
    n = x.size
    zero = np.zeros(n)
    ground: dict[str, Any] = (
        ground_under(heightmap, robot, x, y, heading_rad, moved=False) if with_ground else unread_ground(n)
    )
    return Features(
        robot=robot,
        run=np.zeros(n, dtype=np.int64),
        x=x,
        y=y,
        heading_rad=heading_rad,
        length_m=np.ones(n),
        duration_s=np.full(n, 1.0 / robot.speed_mps),
        traction_per_m=np.asarray(traction_per_m, dtype=np.float64),
        turned_rad=zero,
        turned_abs_rad=zero,
        gained_m2ps2=zero,
        kinetic_m2ps2=zero,
        **ground,
        since_s=zero,
        driven_m=zero,
        clock_s=zero,
        columns={key: np.full(n, value) for key, value in conditions.items()},
        words={GROUND: heightmap.layers.names_at(x, y)} if heightmap.layers.kinds else {},
    )


def _words(segments: Segments, heightmap: Heightmap) -> dict[str, NDArray[np.str_]]:
    """Columns of text in small letters; where a layer knows the kind of ground, it is that of the layer."""
    words = {key: np.char.lower(np.char.strip(values)) for key, values in segments.texts.items()}
    if heightmap.layers.kinds:
        named = heightmap.layers.names_at(segments.x, segments.y)
        logged = words.get(GROUND, np.full(len(segments), ""))
        words[GROUND] = np.where(named == "", logged, named)
    return words


def _with_stationary(rows: Features, run: NDArray[np.int64], seconds: FloatArray) -> Features:
    """With stationary intervals after the segments. They take time and have no path and no ground; times and further
    columns have the mean of their run.
    """

    def longer(values: FloatArray) -> FloatArray:
        return np.concatenate([values, np.zeros((run.size, *values.shape[1:]), dtype=values.dtype)])

    def means(values: FloatArray) -> FloatArray:
        known = np.isfinite(values)
        count = np.bincount(rows.run[known], minlength=rows.run.max(initial=0) + 1)
        total = np.bincount(rows.run[known], weights=values[known], minlength=count.size)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    changed: dict[str, Any] = {name: longer(getattr(rows, name)) for name in row_arrays()}
    changed["run"] = np.concatenate([rows.run, run])
    changed["duration_s"] = np.concatenate([rows.duration_s, seconds])
    for name in ("since_s", "driven_m", "clock_s"):
        values = getattr(rows, name)
        changed[name] = np.concatenate([values, means(values)[run]])
    changed["columns"] = {key: np.concatenate([v, means(v)[run]]) for key, v in rows.columns.items()}
    changed["words"] = {key: np.concatenate([v, np.full(run.size, "")]) for key, v in rows.words.items()}
    return replace(rows, **changed)
