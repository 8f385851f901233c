"""Features of driven segments: path, ground, time, weather and whatever was logged, but not their energy."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.frames import heading_vector
from joulemap.model.robot import Robot
from joulemap.model.runs.segments import Segments
from joulemap.model.runs.track import TURN_LIMITS_RADPS
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]

_REACH_M = 0.5  # half the side of the square metre around a segment
_SIDE = 5  # samples along its sides, and places of a segment
_ENDS_HALF = np.array([0.5, 1.0, 1.0, 1.0, 0.5]) / (_SIDE - 1)  # weight of each place
_PLACES = np.linspace(-2.0 * _REACH_M, 2.0 * _REACH_M, 2 * _SIDE - 1)  # half a metre before to half a metre after
_LEAST_M = 0.1  # between wheels
_AROUND_M = 2.5  # radius of the surroundings of a place: several times the robot, and less than a hill
_BEARINGS = 8
_LIKE_OTHER_STANDS = 0.3  # of their power: otherwise the robot did something while stationary


@dataclass(frozen=True, eq=False)
class Drive:
    """Features of segments and stationary intervals, the only input of an effect's formula.

    Attributes
    ----------
    robot : Robot
        As declared.
    run : ndarray of int, (n,)
        Index into `runs`.
    x, y : ndarray of float, (n,)
        Centre [m].
    heading_rad : ndarray of float, (n,)
        Of the segment.
    length_m : ndarray of float, (n,)
        0 for a stationary interval, which has no path and no ground (zeros).
    duration_s : ndarray of float, (n,)
        Of the segment.
    traction_per_m : ndarray of float, (n,)
        Prediction of the base model [J/m].
    turned_rad, turned_abs_rad, gained_m2ps2 : ndarray of float, (n,)
        As `heading_change_rad`, `turned_abs_rad` and `gained_m2ps2` in `Segments`.
    gentle_turn_rad : ndarray of float, (n, 7)
        As in `Segments`.
    grade : ndarray of float, (n,)
        Tangent of the slope along the heading, positive uphill, mean over the segment between both axles.
    grades : ndarray of float, (n, places)
        The same over a metre, at evenly spaced places from one end of the segment to the other.
    cross : ndarray of float, (n,)
        Tangent of the slope across the heading, positive down to the right.
    cross_abs, cross_sq : ndarray of float, (n,)
        Mean of the magnitude and of the square of the tangent across, between the wheels.
    roughness_m : ndarray of float, (n,)
        Root mean square distance of the square metre from its plane.
    elevation_m : ndarray of float, (n,)
        Of the centre.
    hollow_m : ndarray of float, (n,)
        Topographic position index over 2.5 m with the opposite sign: how much lower a place is than its surroundings.
    since_s, driven_m : ndarray of float, (n,)
        Since the start of the run.
    clock_s : ndarray of float, (n,)
        Since the start of the first run.
    columns : dict of str to ndarray of float, (n,)
        Further columns of the log; NaN where blank.
    words : dict of str to ndarray of str, (n,)
        Columns of text in small letters; empty where blank.
    unit_j : float
        Joules of one unit of energy: 1, or the nominal voltage for charge in ampere seconds.
    runs : tuple of str
        Name and first stamp of each run, so that runs of the same name differ.
    """

    robot: Robot
    run: NDArray[np.int64]
    x: FloatArray
    y: FloatArray
    heading_rad: FloatArray
    length_m: FloatArray
    duration_s: FloatArray
    traction_per_m: FloatArray
    turned_rad: FloatArray
    turned_abs_rad: FloatArray
    gentle_turn_rad: FloatArray
    gained_m2ps2: FloatArray
    grade: FloatArray
    grades: FloatArray
    cross: FloatArray
    cross_abs: FloatArray
    cross_sq: FloatArray
    roughness_m: FloatArray
    elevation_m: FloatArray
    hollow_m: FloatArray
    since_s: FloatArray
    driven_m: FloatArray
    clock_s: FloatArray
    columns: dict[str, FloatArray] = field(default_factory=dict)
    words: dict[str, NDArray[np.str_]] = field(default_factory=dict)
    unit_j: float = 1.0
    runs: tuple[str, ...] = ()

    def __len__(self) -> int:
        return int(self.x.size)

    def along(self, of_grade: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """Return the mean over each segment of a function of the slope.

        Parameters
        ----------
        of_grade : callable
            Takes and returns (n, places).

        Returns
        -------
        ndarray of float, (n,)
            With half weight at both ends.
        """
        return of_grade(self.grades) @ _ENDS_HALF

    def take(self, which: ArrayLike) -> Drive:
        """Return some of the rows.

        Parameters
        ----------
        which : array_like
            A mask, or indices.

        Returns
        -------
        Drive
            In the order of `which`.
        """
        index = np.asarray(which)
        changed: dict[str, Any] = {
            f.name: getattr(self, f.name)[index] for f in fields(self) if isinstance(getattr(self, f.name), np.ndarray)
        }
        changed["columns"] = {key: values[index] for key, values in self.columns.items()}
        changed["words"] = {key: values[index] for key, values in self.words.items()}
        return replace(self, **changed)

    @property
    def standing(self) -> NDArray[np.bool_]:
        """Whether each row is a stationary interval, (n,)."""
        return self.length_m == 0.0

    @property
    def speed_mps(self) -> FloatArray:
        """Mean speed over each segment, (n,) [m/s]; the robot's cruising speed for a stationary interval."""
        moving = ~self.standing & (self.duration_s > 0)
        return np.where(moving, self.length_m / np.where(moving, self.duration_s, 1.0), self.robot.speed_mps)

    @property
    def backwards(self) -> NDArray[np.bool_]:
        """Whether the compass pointed against the direction of motion, (n,); False without a compass."""
        compass = np.radians(self.columns.get("heading", np.full(len(self), np.nan)))
        return ~self.standing & (np.cos(compass - self.heading_rad) < 0.0)

    @property
    def odometer_m(self) -> FloatArray:
        """Distance driven since the start of the first run, (n,) [m]."""
        order = np.argsort(self.clock_s, kind="stable")
        out = np.empty(len(self))
        out[order] = np.cumsum(self.length_m[order])
        return out

    @property
    def hotel_part(self) -> FloatArray:
        """Energy of the declared idle power over each row, (n,) [J, or A s]."""
        return self.robot.idle_power_w * self.duration_s / self.unit_j

    @property
    def motion_part(self) -> FloatArray:
        """Prediction of the base model for the motion, (n,) [J, or A s], with what regeneration returns."""
        t = self.traction_per_m
        return self.length_m * (np.maximum(t, 0.0) + self.robot.regeneration * np.minimum(t, 0.0)) / self.unit_j

    @property
    def predicted(self) -> FloatArray:
        """Prediction of the base model, (n,) [J, or A s]: idle power and motion."""
        return self.hotel_part + self.motion_part


def describe_segments(
    segments: Segments, heightmap: Heightmap, robot: Robot, traction_per_m: ArrayLike, *, with_stands: bool = True
) -> tuple[Drive, FloatArray]:
    """Return the features of segments, and after them those of the stationary intervals.

    Parameters
    ----------
    segments : Segments
        Measured.
    heightmap : Heightmap
        On which they were driven.
    robot : Robot
        That drove.
    traction_per_m : array_like, (n,)
        Of the base model [J/m].
    with_stands : bool
        Add the stationary intervals.

    Returns
    -------
    tuple of (Drive, ndarray of float)
        The features; and the measured energy of each row [J, or A s].
    """
    n = len(segments)
    ground = _ground(heightmap, robot, segments.x, segments.y, segments.heading_rad)
    first = np.array([segments.t0[segments.run == k].min(initial=math.inf) for k in range(len(segments.runs))])
    start = first[segments.run] if n else np.zeros(0)
    driven = np.zeros(n)
    for k in range(len(segments.runs)):
        mine = np.flatnonzero(segments.run == k)
        driven[mine] = np.cumsum(segments.driven_m[mine])
    drive = Drive(
        robot=robot,
        run=segments.run,
        x=segments.x,
        y=segments.y,
        heading_rad=segments.heading_rad,
        length_m=np.full(n, segments.length_m),
        duration_s=segments.duration_s,
        traction_per_m=np.asarray(traction_per_m, dtype=np.float64),
        turned_rad=segments.heading_change_rad,
        turned_abs_rad=segments.turned_abs_rad,
        gentle_turn_rad=segments.gentle_turn_rad,
        gained_m2ps2=segments.gained_m2ps2,
        **ground,
        since_s=segments.t0 - start,
        driven_m=driven,
        clock_s=segments.t0 - float(first.min()) if n else np.zeros(0),
        columns=dict(segments.extras),
        words={key: np.char.lower(np.char.strip(values)) for key, values in segments.texts.items()},
        unit_j=robot.nominal_voltage_v if segments.charge else 1.0,
        runs=tuple(f"{name}@{stamp:.1f}" for name, stamp in zip(segments.runs, first, strict=True)),
    )
    if not with_stands or not segments.stationary:
        return drive, segments.energy_j
    run, seconds, energy = (np.array(values) for values in zip(*segments.stationary, strict=True))
    usual = float(np.median(energy / seconds))
    even = np.abs(energy / seconds - usual) < _LIKE_OTHER_STANDS * usual
    even &= np.isin(run, segments.run)  # of a run without a segment nothing else is known
    stood = _with_stands(drive, run[even].astype(np.int64), seconds[even])
    return stood, np.concatenate([segments.energy_j, energy[even]])


def planned_drive(
    heightmap: Heightmap,
    robot: Robot,
    x: FloatArray,
    y: FloatArray,
    heading_rad: FloatArray,
    traction_per_m: ArrayLike,
    conditions: Mapping[str, float],
    *,
    with_ground: bool = True,
) -> Drive:
    """Return the features of straight 1 m segments at cruising speed that were not driven yet.

    Parameters
    ----------
    heightmap : Heightmap
        The ground.
    robot : Robot
        That will drive.
    x, y : ndarray of float, (n,)
        Centres [m].
    heading_rad : ndarray of float, (n,)
        Headings [rad].
    traction_per_m : array_like, (n,)
        Of the base model [J/m].
    conditions : mapping
        Logged columns as expected.
    with_ground : bool
        Read slopes, roughness and heights, which takes most of the time; otherwise they are NaN.

    Returns
    -------
    Drive
        Of one run.
    """
    n = x.size
    zero = np.zeros(n)
    ground = _ground(heightmap, robot, x, y, heading_rad) if with_ground else _unread_ground(n)
    return Drive(
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
        gentle_turn_rad=np.zeros((n, len(TURN_LIMITS_RADPS))),
        gained_m2ps2=zero,
        **ground,
        since_s=zero,
        driven_m=zero,
        clock_s=zero,
        columns={key: np.full(n, value) for key, value in conditions.items()},
    )


def _with_stands(drive: Drive, run: NDArray[np.int64], seconds: FloatArray) -> Drive:
    """With stationary intervals after the segments. They take time and have no path and no ground; further columns have
    the mean of their run.
    """
    m = run.size

    def longer(values: FloatArray) -> FloatArray:
        return np.concatenate([values, np.zeros((m, *values.shape[1:]), dtype=values.dtype)])

    changed: dict[str, Any] = {
        f.name: longer(getattr(drive, f.name)) for f in fields(drive) if isinstance(getattr(drive, f.name), np.ndarray)
    }
    changed["run"] = np.concatenate([drive.run, run])
    changed["duration_s"] = np.concatenate([drive.duration_s, seconds])
    changed["columns"] = {
        key: np.concatenate([v, _means_of_runs(v, drive.run)[run]]) for key, v in drive.columns.items()
    }
    changed["words"] = {key: np.concatenate([v, np.full(m, "")]) for key, v in drive.words.items()}
    return replace(drive, **changed)


def _means_of_runs(values: FloatArray, run: NDArray[np.int64]) -> FloatArray:
    """Mean of a column by number of the run; NaN where it has none."""
    known = np.isfinite(values)
    count = np.bincount(run[known], minlength=run.max(initial=0) + 1)
    total = np.bincount(run[known], weights=values[known], minlength=count.size)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _unread_ground(n: int) -> dict[str, FloatArray]:
    names = ("grade", "cross", "cross_abs", "cross_sq", "roughness_m", "elevation_m", "hollow_m")
    return dict.fromkeys(names, np.full(n, np.nan)) | {"grades": np.full((n, _SIDE), np.nan)}


def _ground(
    heightmap: Heightmap, robot: Robot, x: FloatArray, y: FloatArray, heading_rad: FloatArray
) -> dict[str, Any]:
    """Slopes, roughness and height of the square metre around each centre, along its heading; NaN where unknown."""
    dx, dy = heading_vector(heading_rad)

    def heights_at(along: FloatArray, right: FloatArray) -> FloatArray:
        return heightmap.sample(
            x[:, None] + np.outer(dx, along) + np.outer(dy, right),
            y[:, None] + np.outer(dy, along) - np.outer(dx, right),
        )

    side = np.linspace(-_REACH_M, _REACH_M, _SIDE)
    a, r = (grid.ravel() for grid in np.meshgrid(side, side, indexing="ij"))
    heights = heights_at(a, r)  # (n, 25)
    plane = np.stack([np.ones_like(a), a, r], axis=1)
    coefficients = heights @ np.linalg.pinv(plane).T  # (n, 3)
    rest = heights - coefficients @ plane.T
    length, width = max(robot.length_m, _LEAST_M), max(robot.width_m, _LEAST_M)
    axles = np.concatenate([side - 0.5 * length, side + 0.5 * length])
    half = np.full(axles.size, 0.5 * width)
    left, right = heights_at(axles, -half), heights_at(axles, half)  # (n, 10): rear axle, front axle
    tilt = (left - right) / width  # > 0 down to the right
    roll = 0.5 * (tilt[:, :_SIDE] + tilt[:, _SIDE:])
    climb = 0.5 * (left + right)
    grade = ((climb[:, _SIDE:] - climb[:, :_SIDE]) / length).mean(axis=1)
    cross = -coefficients[:, 2]
    grade = np.where(np.isfinite(grade), grade, coefficients[:, 1])
    track = np.mean([heights_at(_PLACES, np.full(_PLACES.size, w)) for w in (-0.5 * width, 0.5 * width)], axis=0)
    grades = (track[:, _SIDE - 1 :] - track[:, : 1 - _SIDE]) / (2.0 * _REACH_M)
    off_map = ~np.isfinite(roll)  # the wheels reach further than the square metre
    roll = np.where(off_map, cross[:, None], roll)
    return {
        "grade": grade,
        "grades": np.where(np.isfinite(grades), grades, grade[:, None]),
        "cross": cross,
        "cross_abs": np.abs(roll).mean(axis=1),
        "cross_sq": (roll**2).mean(axis=1),
        "roughness_m": np.sqrt(np.mean(rest**2, axis=1)),
        "elevation_m": coefficients[:, 0],
        "hollow_m": _around(heightmap, x, y) - coefficients[:, 0],
    }


def _around(heightmap: Heightmap, x: FloatArray, y: FloatArray) -> FloatArray:
    """(n,) mean height of the known ground on a circle of 2.5 m and on one of half its radius around each centre
    (topographic position: Weiss 2001); NaN where none is known.
    """
    dx, dy = heading_vector(np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False))
    total, count = np.zeros(x.size), np.zeros(x.size)
    for radius in (0.5 * _AROUND_M, _AROUND_M):
        heights = heightmap.sample(x[:, None] + radius * dx, y[:, None] + radius * dy)
        total += np.nansum(heights, axis=1)
        count += np.isfinite(heights).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
