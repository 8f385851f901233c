"""Features of driven rows: path, ground, time, weather and whatever was logged, but not their measured energy.

`describe.py` makes them of segments, measured or planned.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import ModelError
from joulemap.model.robot import Robot
from joulemap.model.runs.cutting import ANGLE_COLUMNS

FloatArray = NDArray[np.float64]

GROUND = "terrain"
"""Column of text with the kind of ground, of a log or of a layer."""
PLACES = 5
"""Places of a segment whose slopes are known, from one end to the other."""
_ENDS_HALF = np.array([0.5, 1.0, 1.0, 1.0, 0.5]) / (PLACES - 1)  # weight of each place: the trapezoidal rule
LEAST_M = 0.1
"""Between wheels."""
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
        return self.tilted(np.nan_to_num(self.grade_east * east_m + self.grade_north * north_m))

    def tilted(self, more: FloatArray) -> Features:
        """Return the rows on steeper ground.

        Parameters
        ----------
        more : ndarray of float, (n,)
            Tangent that is added to every slope.

        Returns
        -------
        Features
            With the base model's traction there, to first order.
        """
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
_RANGED = {"cross_slope": "cross_abs", "roughness": "roughness_m", "position_index": "position_index_m"}
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
    """Return a quantity that effects may depend on. Result (n,): NaN where it is not known."""
    if name.startswith("column:"):
        return rows.columns.get(name.removeprefix("column:"), np.full(len(rows), np.nan))
    if name not in _QUANTITIES:
        raise ModelError(f"a model depends on {name!r}, which this version does not know", quantity=name)
    return _QUANTITIES[name](rows)


def driven_ranges(rows: Features) -> dict[str, tuple[float, float]]:
    """Return the range of every quantity in which rows were driven.

    Result: lowest and highest value without the outermost hundredth at either end; nothing of a direction.
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
    """Return which share of the values of a quantity lies beyond a range; rounding does not."""
    margin = 1e-6 * max(abs(low), abs(high))
    return float(np.mean((values < low - margin) | (values > high + margin)))


def concatenate_features(parts: Sequence[Features]) -> Features:
    """Join the rows of several sets of runs of one robot.

    A column that some part lacks is NaN, or an empty text, there.
    """
    offsets = np.cumsum([0] + [len(p.runs) for p in parts])
    numbers = sorted({key for p in parts for key in p.columns})
    texts = sorted({key for p in parts for key in p.words})
    joined: dict[str, Any] = {name: np.concatenate([getattr(p, name) for p in parts]) for name in row_arrays()}
    joined["run"] = np.concatenate([p.run + o for p, o in zip(parts, offsets, strict=False)])
    joined["columns"] = {k: np.concatenate([quantity(p, f"column:{k}") for p in parts]) for k in numbers}
    joined["words"] = {k: np.concatenate([p.words.get(k, np.full(len(p), "")) for p in parts]) for k in texts}
    return replace(parts[0], **joined, runs=tuple(name for p in parts for name in p.runs))
