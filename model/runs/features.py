"""Features of driven rows: path, ground, time, weather and whatever was logged, but not their measured energy."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from joulemap.model.errors import ModelError
from joulemap.model.frames import heading_vector
from joulemap.model.robot import Robot
from joulemap.model.runs.cutting import ANGLE_COLUMNS
from joulemap.model.runs.segments import Segments
from joulemap.model.runs.track import TURN_LIMITS_RADPS
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]

_REACH_M = 0.5  # half the side of the square metre around a segment
_SIDE = 5  # samples along its sides, and places of a segment
_ENDS_HALF = np.array([0.5, 1.0, 1.0, 1.0, 0.5]) / (_SIDE - 1)  # weight of each place: the trapezoidal rule
_PLACES = np.linspace(-2.0 * _REACH_M, 2.0 * _REACH_M, 2 * _SIDE - 1)
LEAST_M = 0.1
"""Between wheels."""
_AROUND_M = 2.5  # radius of the surroundings of a place: several times the robot, and less than a hill
_BEARINGS = 8
SHARE_DRIVEN = 0.01
"""Share of the driven rows beyond either border of a range: one odd reading in a hundred widens no range."""


@dataclass(frozen=True)
class Drives:
    """What is known of a robot's drives and their meter, before any coefficient.

    Attributes
    ----------
    coasting_shift : float
        Tangent by which they coast on a steeper descent than the declared rolling resistance says.
    motor_speed_mps : float, optional
        For a charge that the motors take: the speed at which a force costs its work over the nominal voltage. Without
        it the energy, or the charge, is that of the battery.
    resisted_tan : float, optional
        Mean of what the forces of effects resist, as a tangent, in the runs to which the coasting was fitted: it is in
        the shift already. Without it such forces do not move the descent on which the drives coast.
    """

    coasting_shift: float = 0.0
    motor_speed_mps: float | None = None
    resisted_tan: float | None = None


@dataclass(frozen=True, eq=False)
class Features:
    """Features of segments and stationary intervals: all that a form of an effect may read.

    Attributes
    ----------
    robot : Robot
        As declared.
    run : ndarray of int, (n,)
        Index into `runs`.
    x, y : ndarray of float, (n,)
        Middle [m].
    heading_rad : ndarray of float, (n,)
        Direction of travel.
    length_m : ndarray of float, (n,)
        Driven length; 0 for a stationary interval, which has no path and no ground (zeros).
    duration_s : ndarray of float, (n,)
        Of the row.
    traction_per_m : ndarray of float, (n,)
        Prediction of the base model [J/m].
    turned_rad, turned_abs_rad, gained_m2ps2, kinetic_m2ps2 : ndarray of float, (n,)
        As `heading_change_rad`, `turned_abs_rad`, `gained_m2ps2` and `kinetic_m2ps2` of `Segments`.
    gentle_turn_rad : ndarray of float, (n, 7)
        As in `Segments`.
    grade : ndarray of float, (n,)
        Tangent of the slope along the heading, positive uphill, mean over the segment between both axles.
    grades : ndarray of float, (n, places)
        The same over a metre, at evenly spaced places from one end of the segment to the other.
    grade_east, grade_north : ndarray of float, (n,)
        Change of `grade` per metre by which the map is moved [1/m].
    cross_abs, cross_sq : ndarray of float, (n,)
        Mean of the magnitude and of the square of the tangent across the heading, between the wheels.
    roughness_m : ndarray of float, (n,)
        Root mean square distance of the square metre from its plane.
    elevation_m : ndarray of float, (n,)
        Of the middle.
    position_index_m : ndarray of float, (n,)
        Topographic position index over 2.5 m: how much higher a place is than its surroundings.
    since_s, driven_m : ndarray of float, (n,)
        Since the start of the run.
    clock_s : ndarray of float, (n,)
        Stamp of the log.
    columns : dict of str to ndarray of float, (n,)
        Further columns of the log; NaN where blank.
    words : dict of str to ndarray of str, (n,)
        Columns of text in small letters; empty where blank.
    unit_j : float
        Joules of one unit of energy: 1, or the nominal voltage for charge in ampere seconds.
    runs : tuple of str
        Name and first stamp of each run, so that runs of the same name differ.
    speeds_mps : tuple of float
        Between which `speed_mps` is held.
    drives : Drives
        Of the robot.
    corrected : ndarray of float, (n,), optional
        Energy of motion that base parameters add to the base model's [J, or A s].
    added_resistance : ndarray of float, (n,), optional
        Tangent by which the forces of effects make the descent steeper on which the drives coast.
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
    kinetic_m2ps2: FloatArray
    grade: FloatArray
    grades: FloatArray
    grade_east: FloatArray
    grade_north: FloatArray
    cross_abs: FloatArray
    cross_sq: FloatArray
    roughness_m: FloatArray
    elevation_m: FloatArray
    position_index_m: FloatArray
    since_s: FloatArray
    driven_m: FloatArray
    clock_s: FloatArray
    columns: dict[str, FloatArray] = field(default_factory=dict)
    words: dict[str, NDArray[np.str_]] = field(default_factory=dict)
    unit_j: float = 1.0
    runs: tuple[str, ...] = ()
    speeds_mps: tuple[float, float] = (0.0, math.inf)
    drives: Drives = Drives()
    corrected: FloatArray | None = None
    added_resistance: FloatArray | None = None

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

    def take(self, which: ArrayLike) -> Features:
        """Return some of the rows.

        Parameters
        ----------
        which : array_like
            A mask, or indices.

        Returns
        -------
        Features
            In the order of `which`.
        """
        index = np.asarray(which)
        changed: dict[str, Any] = {name: getattr(self, name)[index] for name in row_arrays()}
        optional = {name: getattr(self, name) for name in ("corrected", "added_resistance")}
        changed |= {name: None if values is None else values[index] for name, values in optional.items()}
        changed["columns"] = {key: values[index] for key, values in self.columns.items()}
        changed["words"] = {key: values[index] for key, values in self.words.items()}
        return replace(self, **changed)

    def within(self, ranges: Mapping[str, tuple[float, float]]) -> Features:
        """Return the rows with every quantity held inside a range.

        Parameters
        ----------
        ranges : mapping
            Lowest and highest value by name of the quantity, as `driven_ranges` returns them.

        Returns
        -------
        Features
            Beyond a border the quantity has the border's value. The base model's traction stays as it is.
        """
        changed: dict[str, Any] = {}
        columns = dict(self.columns)
        for name, (low, high) in ranges.items():
            if name.startswith("column:"):
                if (key := name.removeprefix("column:")) in columns:
                    columns[key] = np.clip(columns[key], low, high)
            elif name == "speed":
                changed["speeds_mps"] = (low, high)
            elif name == "grade":
                changed |= {"grade": np.clip(self.grade, low, high), "grades": np.clip(self.grades, low, high)}
            elif name in _RANGED:
                changed[_RANGED[name]] = np.clip(getattr(self, _RANGED[name]), low, high)
        return replace(self, columns=columns, **changed)

    @property
    def standing(self) -> NDArray[np.bool_]:
        """Whether each row is a stationary interval, (n,)."""
        return self.length_m == 0.0

    @property
    def speed_mps(self) -> FloatArray:
        """Mean speed over each segment, (n,) [m/s]; the robot's cruising speed for a stationary interval."""
        moving = ~self.standing & (self.duration_s > 0)
        speed = np.where(moving, self.length_m / np.where(moving, self.duration_s, 1.0), self.robot.speed_mps)
        return np.clip(speed, *self.speeds_mps)

    @property
    def slowness(self) -> FloatArray:
        """Time that each row took over the time at `motor_speed_mps`, (n,): by this factor a force takes more charge
        from a motor, whose current is in proportion to its torque (Krishnan 2001, section 2.4); 1 for a battery.
        """
        if self.drives.motor_speed_mps is None:
            return np.ones(len(self))
        length = np.where(self.standing, 1.0, self.length_m)
        return np.where(self.standing, 1.0, self.drives.motor_speed_mps * self.duration_s / length)

    @property
    def work_m(self) -> FloatArray:
        """Driven length times `slowness`, (n,) [m]: over which a force costs."""
        return self.length_m * self.slowness

    def turned_up_to(self, limit_per_m: float | None) -> FloatArray:
        """Return the change of heading, up to a curvature.

        Parameters
        ----------
        limit_per_m : float, optional
            The curvature [rad/m]; none without it.

        Returns
        -------
        ndarray of float, (n,)
            Magnitude [rad].
        """
        return (
            self.turned_abs_rad if limit_per_m is None else np.minimum(self.turned_abs_rad, limit_per_m * self.length_m)
        )

    @property
    def pivot_per_m(self) -> float:
        """Curvature at which one side stands still, and beyond which the sides push against each other [rad/m]."""
        return 2.0 / max(self.robot.width_m, LEAST_M)

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
        """Energy of the motion, (n,) [J, or A s], with what regeneration returns and with the base parameters."""
        return self.base_motion if self.corrected is None else self.base_motion + self.corrected

    @property
    def hotel_and_motion(self) -> FloatArray:
        """Energy of idle power and motion, (n,) [J, or A s], with the base parameters."""
        return self.hotel_part + self.motion_part

    @property
    def power_w(self) -> FloatArray:
        """Mean power of `hotel_and_motion` over each row, (n,)."""
        return self.hotel_and_motion * self.unit_j / np.maximum(self.duration_s, 1e-6)

    @property
    def base_motion(self) -> FloatArray:
        """Prediction of the base model for the motion, (n,) [J, or A s], with what regeneration returns."""
        return self.work_m * self.pull_n * np.where(self.pulls, 1.0, self.robot.regeneration) / self.unit_j

    @property
    def pull_n(self) -> FloatArray:
        """Force of the drives by the base model, (n,) [N]; negative where they brake."""
        return self.traction_per_m + self.robot.weight_n * self.drives.coasting_shift

    @property
    def pulls(self) -> NDArray[np.bool_]:
        """Whether the drives pull and do not brake, (n,), against all that resists."""
        return self.pull_n + self.robot.weight_n * self._more > 0.0

    @property
    def _more(self) -> FloatArray:
        return np.zeros(len(self)) if self.added_resistance is None else self.added_resistance

    @property
    def predicted(self) -> FloatArray:
        """Prediction of the base model, (n,) [J, or A s]: idle power and motion."""
        return self.hotel_part + self.base_motion

    @property
    def weight_length(self) -> FloatArray:
        """Declared weight times the driven length, (n,) [J, or A s]: what one unit of rolling resistance costs on level
        ground.
        """
        return self.robot.weight_n * self.work_m / self.unit_j

    @property
    def coasting_tan(self) -> float:
        """Tangent of the descent on which the drives neither pull nor brake."""
        return -(self.robot.rolling_resistance + self.drives.coasting_shift)

    @property
    def coasting_tans(self) -> FloatArray:
        """The same of each row, (n, 1), against all that resists."""
        return (self.coasting_tan - self._more)[:, None]

    @property
    def measured_tan(self) -> FloatArray:
        """Tangent of the slope by the robot's own attitude sensor, the column `pitch` [deg], (n,); NaN where it is not
        known. The sensor's tilt, the median of the run, is taken out.
        """
        pitch = self.columns.get("pitch", np.full(len(self), np.nan)).copy()
        pitch[self.standing] = np.nan
        for run in np.unique(self.run):
            mine = self.run == run
            if np.isfinite(pitch[mine]).any():
                pitch[mine] -= np.nanmedian(pitch[mine])
        return np.tan(np.radians(np.clip(pitch, -60.0, 60.0)))

    def moved(self, east_m: float, north_m: float) -> Features:
        """Return the rows as if the map lay elsewhere.

        Parameters
        ----------
        east_m, north_m : float
            By which it is moved [m].

        Returns
        -------
        Features
            With other slopes, to first order, and the base model's traction on them.
        """
        more = np.nan_to_num(self.grade_east * east_m + self.grade_north * north_m)
        traction = self.traction_per_m + self.robot.weight_n * more
        return replace(self, grade=self.grade + more, grades=self.grades + more[:, None], traction_per_m=traction)

    def resistance_of(self, energy: Callable[[Features], FloatArray], per_tan: FloatArray) -> FloatArray:
        """Return by which tangent a force makes the descent steeper on which the drives coast.

        Parameters
        ----------
        energy : callable
            What the force costs each row, (n,) [J, or A s].
        per_tan : ndarray of float, (n,)
            What a slope of the tangent 1 costs each row [J, or A s].

        Returns
        -------
        ndarray of float, (n,)
            Nothing of a stationary interval.

        Notes
        -----
        A force F costs F s where the drives pull, and r F s where they brake, with the regeneration r. The difference
        between both is (1 - r) F s.
        """
        pulling, braking = (replace(self, added_resistance=np.full(len(self), end)) for end in (np.inf, -np.inf))
        kink = (1.0 - self.robot.regeneration) * per_tan
        force = energy(pulling) - energy(braking)
        return np.where(kink > 0.0, force / np.where(kink > 0.0, kink, 1.0), 0.0)

    def resisted_by(self, added: FloatArray | float) -> Features:
        """Return the rows with forces that resist beside the rolling resistance.

        Parameters
        ----------
        added : ndarray of float, (n,), or float
            As tangents; on level ground what resists pushes nowhere.

        Returns
        -------
        Features
            With another descent on which the drives coast.
        """
        if self.drives.resisted_tan is None:
            return self
        more = np.maximum(np.asarray(added) - self.drives.resisted_tan, min(self.coasting_tan, 0.0))
        return replace(self, added_resistance=np.broadcast_to(more, (len(self),)))

    def read_late(self, energy: FloatArray, lag_s: float) -> FloatArray:
        """Return what a late meter says of each row.

        Parameters
        ----------
        energy : ndarray of float, (n,)
            That each row took [J, or A s].
        lag_s : float
            Of the meter [s].

        Returns
        -------
        ndarray of float, (n,)
            Energy by a cubic spline through what was drawn until the end of each row. A stationary interval has its
            own.
        """
        out = energy.copy()
        for run in np.unique(self.run[~self.standing]):
            mine = np.flatnonzero((self.run == run) & ~self.standing)
            ends = np.append(0.0, np.cumsum(np.maximum(self.duration_s[mine], 1e-6)))
            drawn = CubicSpline(ends, np.append(0.0, np.cumsum(energy[mine])))
            out[mine] = np.diff(drawn(np.clip(ends - lag_s, 0.0, ends[-1])))
        return out

    @property
    def pulling(self) -> FloatArray:
        """Share of each row on which the drives pull, (n,) 0..1: a force costs nothing where the slope pushes harder.

        Where they brake, a newton more costs what regeneration would have returned.
        """
        share = self.along(lambda grades: np.where(grades > self.coasting_tans, 1.0, self.robot.regeneration))
        return np.where(self.standing, 0.0, share)


def row_arrays() -> list[str]:
    """Return the names of the attributes of `Features` that have a value for each row."""
    return [f.name for f in fields(Features) if f.name not in _NO_ARRAYS]


_NO_ARRAYS = {"robot", "columns", "words", "unit_j", "runs", "speeds_mps", "drives", "corrected", "added_resistance"}
_RANGED = {
    "cross_slope": "cross_abs",
    "roughness": "roughness_m",
    "position_index": "position_index_m",
}
_QUANTITIES: dict[str, Callable[[Features], FloatArray]] = {
    "grade": lambda rows: rows.grade,
    "cross_slope": lambda rows: rows.cross_abs,
    "roughness": lambda rows: rows.roughness_m,
    "elevation": lambda rows: rows.elevation_m,
    "position_index": lambda rows: rows.position_index_m,
    "speed": lambda rows: rows.speed_mps,
    "turning": lambda rows: rows.turned_abs_rad,
    "turn": lambda rows: rows.turned_rad,
    "heading": lambda rows: np.mod(rows.heading_rad, 2.0 * math.pi),
    "since_start": lambda rows: rows.since_s,
    "driven": lambda rows: rows.driven_m,
    "clock": lambda rows: rows.clock_s,
    "odometer": lambda rows: rows.odometer_m,
}


def quantity(rows: Features, name: str) -> FloatArray:
    """Return a quantity that effects may depend on.

    Parameters
    ----------
    rows : Features
        Of n rows.
    name : str
        Such as `grade`, or `column:NAME` for a logged column.

    Returns
    -------
    ndarray of float, (n,)
        NaN where it is not known.

    Raises
    ------
    ModelError
        If there is no such quantity.
    """
    if name.startswith("column:"):
        return rows.columns.get(name.removeprefix("column:"), np.full(len(rows), np.nan))
    if name not in _QUANTITIES:
        raise ModelError(f"a model depends on {name!r}, which this version does not know", quantity=name)
    return _QUANTITIES[name](rows)


def driven_ranges(rows: Features) -> dict[str, tuple[float, float]]:
    """Return the range of every quantity in which rows were driven.

    Parameters
    ----------
    rows : Features
        Measured.

    Returns
    -------
    dict of str to tuple of float
        Lowest and highest value without the outermost hundredth at either end; nothing of a direction.
    """
    moving = rows.take(~rows.standing)
    logged = (f"column:{key}" for key in rows.columns if key not in ANGLE_COLUMNS)
    names = ["speed", "grade", *_RANGED, *logged]
    out = {}
    for name in names:
        values = quantity(moving, name)
        values = values[np.isfinite(values)]
        if values.size:
            low, high = np.quantile(values, [SHARE_DRIVEN, 1.0 - SHARE_DRIVEN])
            out[name] = (float(low), float(high))
    return out


def share_beyond(values: FloatArray, low: float, high: float) -> float:
    """Return which share of the values of a quantity lies beyond a range; rounding does not.

    Parameters
    ----------
    values : ndarray of float
        Of the quantity.
    low, high : float
        Of the range.

    Returns
    -------
    float
        0 to 1.
    """
    margin = 1e-6 * max(abs(low), abs(high))
    return float(np.mean((values < low - margin) | (values > high + margin)))


def concatenate_features(parts: Sequence[Features]) -> Features:
    """Join the rows of several sets of runs of one robot.

    Parameters
    ----------
    parts : sequence of Features
        At least one.

    Returns
    -------
    Features
        One after the other. A column that some part lacks is NaN, or an empty text, there.
    """
    offsets = np.cumsum([0] + [len(p.runs) for p in parts])
    numbers = sorted({key for p in parts for key in p.columns})
    texts = sorted({key for p in parts for key in p.words})
    joined: dict[str, Any] = {name: np.concatenate([getattr(p, name) for p in parts]) for name in row_arrays()}
    joined["run"] = np.concatenate([p.run + o for p, o in zip(parts, offsets, strict=False)])
    joined["columns"] = {k: np.concatenate([quantity(p, f"column:{k}") for p in parts]) for k in numbers}
    joined["words"] = {k: np.concatenate([p.words.get(k, np.full(len(p), "")) for p in parts]) for k in texts}
    return replace(parts[0], **joined, runs=tuple(name for p in parts for name in p.runs))


def describe_segments(
    segments: Segments, heightmap: Heightmap, robot: Robot, traction_per_m: ArrayLike, *, with_stationary: bool = True
) -> tuple[Features, FloatArray]:
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
    with_stationary : bool
        Add the stationary intervals.

    Returns
    -------
    tuple of (Features, ndarray of float)
        The features; and the measured energy of each row [J, or A s].
    """
    n = len(segments)
    first = np.array([segments.t0[segments.run == k].min(initial=math.inf) for k in range(len(segments.runs))])
    driven = np.zeros(n)
    for k in range(len(segments.runs)):
        mine = np.flatnonzero(segments.run == k)
        driven[mine] = np.cumsum(segments.driven_m[mine])
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
        gentle_turn_rad=segments.gentle_turn_rad,
        gained_m2ps2=segments.gained_m2ps2,
        kinetic_m2ps2=segments.kinetic_m2ps2,
        **_ground(heightmap, robot, segments.x, segments.y, segments.heading_rad),
        since_s=segments.t0 - (first[segments.run] if n else 0.0),
        driven_m=driven,
        clock_s=segments.t0,
        columns=dict(segments.extras),
        words={key: np.char.lower(np.char.strip(values)) for key, values in segments.texts.items()},
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

    Parameters
    ----------
    heightmap : Heightmap
        The ground.
    robot : Robot
        That will drive.
    x, y : ndarray of float, (n,)
        Middles [m].
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
    Features
        Of one run.
    """
    n = x.size
    zero = np.zeros(n)
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
        gentle_turn_rad=np.zeros((n, len(TURN_LIMITS_RADPS))),
        gained_m2ps2=zero,
        kinetic_m2ps2=zero,
        **(_ground(heightmap, robot, x, y, heading_rad, moved=False) if with_ground else _unread_ground(n)),
        since_s=zero,
        driven_m=zero,
        clock_s=zero,
        columns={key: np.full(n, value) for key, value in conditions.items()},
    )


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


_GROUND = (
    "grade",
    "grade_east",
    "grade_north",
    "cross_abs",
    "cross_sq",
    "roughness_m",
    "elevation_m",
    "position_index_m",
)


def _unread_ground(n: int) -> dict[str, FloatArray]:
    return dict.fromkeys(_GROUND, np.full(n, np.nan)) | {"grades": np.full((n, _SIDE), np.nan)}


def _ground(
    heightmap: Heightmap, robot: Robot, x: FloatArray, y: FloatArray, heading_rad: FloatArray, *, moved: bool = True
) -> dict[str, Any]:
    """Slopes, roughness and height of the square metre around each middle, along its heading; NaN where unknown.

    moved : also say how the grade changes when the map is moved.
    """
    dx, dy = heading_vector(heading_rad)

    def heights_at(along: FloatArray, right: FloatArray, east: float = 0.0, north: float = 0.0) -> FloatArray:
        return heightmap.sample(
            x[:, None] - east + np.outer(dx, along) + np.outer(dy, right),
            y[:, None] - north + np.outer(dy, along) - np.outer(dx, right),
        )

    side = np.linspace(-_REACH_M, _REACH_M, _SIDE)
    a, r = (grid.ravel() for grid in np.meshgrid(side, side, indexing="ij"))
    heights = heights_at(a, r)  # (n, 25)
    plane = np.stack([np.ones_like(a), a, r], axis=1)
    coefficients = heights @ np.linalg.pinv(plane).T  # (n, 3)
    rest = heights - coefficients @ plane.T
    length, width = max(robot.length_m, LEAST_M), max(robot.width_m, LEAST_M)
    axles = np.concatenate([side - 0.5 * length, side + 0.5 * length])
    half = np.full(axles.size, 0.5 * width)
    left, right = heights_at(axles, -half), heights_at(axles, half)  # (n, 10): rear axle, front axle
    tilt = (left - right) / width  # > 0 down to the right
    roll = 0.5 * (tilt[:, :_SIDE] + tilt[:, _SIDE:])
    climb = 0.5 * (left + right)
    grade = ((climb[:, _SIDE:] - climb[:, :_SIDE]) / length).mean(axis=1)
    grade = np.where(np.isfinite(grade), grade, coefficients[:, 1])
    track = np.mean([heights_at(_PLACES, np.full(_PLACES.size, w)) for w in (-0.5 * width, 0.5 * width)], axis=0)
    grades = (track[:, _SIDE - 1 :] - track[:, : 1 - _SIDE]) / (2.0 * _REACH_M)
    roll = np.where(np.isfinite(roll), roll, -coefficients[:, 2:])  # the wheels reach further than the square metre

    def change(east: float, north: float) -> FloatArray:
        ends = [heights_at(np.array([-_REACH_M, _REACH_M]), np.zeros(2), s * east, s * north) for s in (1.0, -1.0)]
        rise = [(e[:, 1] - e[:, 0]) / (2.0 * _REACH_M) for e in ends]
        return (rise[0] - rise[1]) / 2.0

    return {
        "grade": grade,
        "grades": np.where(np.isfinite(grades), grades, grade[:, None]),
        "grade_east": change(1.0, 0.0) if moved else np.zeros(x.size),
        "grade_north": change(0.0, 1.0) if moved else np.zeros(x.size),
        "cross_abs": np.abs(roll).mean(axis=1),
        "cross_sq": (roll**2).mean(axis=1),
        "roughness_m": np.sqrt(np.mean(rest**2, axis=1)),
        "elevation_m": coefficients[:, 0],
        "position_index_m": coefficients[:, 0] - _around(heightmap, x, y),
    }


def _around(heightmap: Heightmap, x: FloatArray, y: FloatArray) -> FloatArray:
    """(n,) mean height of the known ground on a circle of 2.5 m and on one of half its radius around each middle
    (topographic position: Weiss 2001); NaN where none is known.
    """
    dx, dy = heading_vector(np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False))
    total, count = np.zeros(x.size), np.zeros(x.size)
    for radius in (0.5 * _AROUND_M, _AROUND_M):
        heights = heightmap.sample(x[:, None] + radius * dx, y[:, None] + radius * dy)
        total += np.nansum(heights, axis=1)
        count += np.isfinite(heights).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
