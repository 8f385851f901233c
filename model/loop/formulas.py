"""The formulas of missing effects: what each would add to a segment's energy, per unit of its coefficients.

A formula reads a `Drive` and gives columns (n, k) in joules (ampere seconds for charge) per unit of k coefficients, so
that effects add up and their coefficients follow from least squares.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import ModelError
from joulemap.model.loop.drive import Drive
from joulemap.model.runs.track import TURN_LIMITS_RADPS

FloatArray = NDArray[np.float64]
Formula = Callable[..., FloatArray]

FORMULAS: dict[str, Formula] = {}
"""By the name that a Term keeps."""


def _formula(function: Formula) -> Formula:
    FORMULAS[function.__name__] = function
    return function


def quantity(drive: Drive, name: str) -> FloatArray:
    """What a term or a threshold may depend on, (n,): a name below, or "column:NAME", logged (NaN: unknown)."""
    if name.startswith("column:"):
        return drive.columns.get(name.removeprefix("column:"), np.full(len(drive), np.nan))
    values = {
        "grade": lambda: drive.grade,
        "cross_slope": lambda: drive.cross_abs,
        "roughness": lambda: drive.roughness_m,
        "elevation": lambda: drive.elevation_m,
        "hollow": lambda: drive.hollow_m,
        "speed": lambda: drive.speed_mps,
        "turning": lambda: drive.turned_abs_rad,
        "turn": lambda: drive.turned_rad,
        "since_start": lambda: drive.since_s,
        "driven": lambda: drive.driven_m,
        "clock": lambda: drive.clock_s,
        "odometer": lambda: drive.odometer_m,
        "x": lambda: drive.x,
        "y": lambda: drive.y,
    }
    if name not in values:
        raise ModelError(f"a model depends on {name!r}, which this version does not know", quantity=name)
    return values[name]()


@_formula
def turning(drive: Drive, *, limit_radps: float | None = None, share: float = 1.0) -> FloatArray:
    """J/rad. Scrubbing while the heading changes, to either side; up to a rate where it saturates.

    share : of a radian that is turned no faster than that, as runs drive it: with it the coefficient is that of their
    usual radian, whatever the rate.
    """
    if limit_radps is None:
        return drive.turned_abs_rad[:, None]
    return drive.gentle_turn_rad[:, [TURN_LIMITS_RADPS.index(limit_radps)]] / share


@_formula
def turning_both(drive: Drive, *, limit_radps: float) -> FloatArray:
    """J/rad twice: of every turn, and on top of it of the part below a rate."""
    return np.concatenate([turning(drive), turning(drive, limit_radps=limit_radps)], axis=1)


@_formula
def turning_sides(drive: Drive) -> FloatArray:
    """J/rad of turning right, and of turning left."""
    sides = [drive.turned_abs_rad * (drive.turned_rad > 0), drive.turned_abs_rad * (drive.turned_rad <= 0)]
    return np.stack(sides, axis=1)


@_formula
def hotel_load(drive: Drive) -> FloatArray:
    """W. Power drawn all the time, standing too."""
    return drive.duration_s[:, None]


@_formula
def sensor_gain(drive: Drive) -> FloatArray:
    """1. A factor on everything that is measured."""
    return drive.predicted[:, None]


@_formula
def level(drive: Drive) -> FloatArray:
    """1. A factor on what the base model says of driven segments: how far its level is off."""
    return np.where(drive.standing, 0.0, drive.predicted)[:, None]


@_formula
def standing(drive: Drive) -> FloatArray:
    """W. What a stand draws beyond the declared idle power."""
    return np.where(drive.standing, drive.duration_s, 0.0)[:, None]


@_formula
def plane(drive: Drive) -> FloatArray:
    """A s/m, 1/V, 1/V. Level, and shares of the traction uphill and downhill, where neither zero nor scale is known."""
    t, length = drive.traction_per_m, drive.length_m
    return np.stack([length, length * np.maximum(t, 0.0), length * np.minimum(t, 0.0)], axis=1)


@_formula
def friction(drive: Drive) -> FloatArray:
    """1. Rolling resistance on top of the declared one."""
    return (drive.robot.weight_n * drive.length_m / drive.unit_j)[:, None]


@_formula
def payload(drive: Drive, *, column: str | None = None, reference: float = 0.0) -> FloatArray:
    """kg, or kg per logged kg. Everything that motion asks for goes with the mass."""
    per_kg = drive.motion_part / drive.robot.mass_kg
    return (per_kg if column is None else per_kg * _known(drive, column, reference))[:, None]


@_formula
def temperature(
    drive: Drive, *, reference: float, of_motion: bool, begun: bool = False, of_time: bool = False
) -> FloatArray:
    """1/K, or J/m/K, or (a heater's) W/K. A share of the motion's energy, or energy, or power, per degree above the
    reference [degC]; before it, with `begun`, what it takes at the reference already.
    """
    amount = drive.duration_s if of_time else drive.motion_part if of_motion else drive.length_m
    return _from_zero(amount, _known(drive, "temperature", reference), begun)


def _from_zero(amount: FloatArray, grows: FloatArray, begun: bool) -> FloatArray:
    return np.stack([amount] * begun + [amount * grows], axis=1)


@_formula
def speed(drive: Drive, *, power: int, absolute: bool) -> FloatArray:
    """J/m per (m/s)^power: of the speed, or of what it differs from the robot's own."""
    usual = 0.0 if absolute else drive.robot.speed_mps**power
    return (drive.length_m * (drive.speed_mps**power - usual))[:, None]


@_formula
def acceleration(drive: Drive) -> FloatArray:
    """kg. Mass (of the robot, or of what spins in it) that is brought to speed and not given back."""
    return (drive.gained_m2ps2 / drive.unit_j)[:, None]


@_formula
def cross_slope(drive: Drive, *, power: int) -> FloatArray:
    """1. Rolling resistance per tangent (to a power) of the slope across the motion."""
    across = drive.cross_abs if power == 1 else drive.cross_sq
    return (drive.robot.weight_n * drive.length_m / drive.unit_j * across)[:, None]


@_formula
def roughness(drive: Drive) -> FloatArray:
    """1/m. Rolling resistance per metre of the ground's roughness."""
    return (drive.robot.weight_n * drive.length_m / drive.unit_j * drive.roughness_m)[:, None]


@_formula
def reversing(drive: Drive, *, of_motion: bool) -> FloatArray:
    """J/m, or a share of the motion's energy, while driving backwards."""
    return ((drive.motion_part if of_motion else drive.length_m) * drive.backwards)[:, None]


@_formula
def braking(drive: Drive, *, from_grade: float | None) -> FloatArray:
    """1. Share of the energy released downhill that is drawn on top; all that is steeper than a grade, or (None) what
    is left once the rolling resistance is paid.
    """
    if from_grade is None:
        return (drive.length_m * np.maximum(-drive.traction_per_m, 0.0) / drive.unit_j)[:, None]
    below = drive.along(lambda grade: np.maximum(-grade - from_grade, 0.0))
    return (drive.robot.weight_n * drive.length_m * below / drive.unit_j)[:, None]


@_formula
def climbing(drive: Drive) -> FloatArray:
    """1. Share of the energy of climbing that is drawn on top."""
    above = drive.along(lambda grade: np.maximum(grade, 0.0))
    return (drive.robot.weight_n * drive.length_m * above / drive.unit_j)[:, None]


@_formula
def wind_measured(drive: Drive, *, quadratic: bool) -> FloatArray:
    """N per (m/s)^2 of relative air speed, or N per m/s: the drag along the motion, less that in still air."""
    towards = _known(drive, "wind_speed", 0.0) * np.cos(
        np.radians(np.nan_to_num(drive.columns.get("wind_from", np.zeros(len(drive))))) - drive.heading_rad
    )
    across2 = np.maximum(_known(drive, "wind_speed", 0.0) ** 2 - towards**2, 0.0)
    if not quadratic:
        return (drive.length_m * towards / drive.unit_j)[:, None]
    ahead = drive.speed_mps + towards
    drag = ahead * np.sqrt(ahead**2 + across2) - drive.speed_mps**2
    return (drive.length_m * drag / drive.unit_j)[:, None]


@_formula
def wind_constant(drive: Drive) -> FloatArray:
    """J/m twice: of driving towards the east, and towards the north, against a wind that nobody recorded."""
    return heading(drive, harmonics=1)


@_formula
def heading(drive: Drive, *, harmonics: int, level: bool = False, of_motion: bool = False) -> FloatArray:
    """J/m, or with `of_motion` a share of the motion's energy, as ruts take. sin and cos of the heading and of its
    multiples; before them, with `level`, what does not depend on it.
    """
    angles = [order * drive.heading_rad for order in range(1, harmonics + 1)]
    waves = [f(angle) for angle in angles for f in (np.sin, np.cos)]
    constant = [np.ones(len(drive))] if level else []
    return np.stack([*constant, *waves], axis=1) * (drive.motion_part if of_motion else drive.length_m)[:, None]


@_formula
def by_run(drive: Drive, *, of: str, runs: list[str]) -> FloatArray:
    """What another formula says, with coefficients of its own in every run; in a run not listed, their mean (of a
    load), or nothing (of a wind: another day has another).
    """
    columns = FORMULAS[of](drive)
    numbers = {name: k for k, name in enumerate(runs)}
    which = np.array([numbers.get(name, -1) for name in drive.runs] or [-1])[drive.run]
    elsewhere = 0.0 if of == "wind_constant" else 1.0 / len(runs)
    share = np.where(which[:, None] < 0, elsewhere, which[:, None] == np.arange(len(runs)))  # (n, runs)
    return (share[:, :, None] * columns[:, None, :]).reshape(len(drive), -1)


@_formula
def drift(drive: Drive, *, over: str, unit: float, of_all: bool = True, begun: bool = False) -> FloatArray:
    """A share of everything (or J/m) that grows from 0 at the start, per `unit` of a quantity (an hour, a kilometre);
    before it, with `begun`, what it takes at the start already.
    """
    return _from_zero(drive.predicted if of_all else drive.length_m, quantity(drive, over) / unit, begun)


@_formula
def battery(drive: Drive, *, ripple: float = 1.0) -> FloatArray:
    """Ohm. Losses with the square of the current that the prediction asks for. ripple : mean square of a current over
    the square of its mean within a segment, where it is not steady.
    """
    volts = drive.robot.nominal_voltage_v
    amps = drive.predicted * drive.unit_j / np.maximum(drive.duration_s, 1e-6) / volts
    return (ripple * amps**2 * drive.duration_s / drive.unit_j)[:, None]


@_formula
def words(drive: Drive, *, column: str, values: list[str], of_motion: bool) -> FloatArray:
    """J/m (or a share of the motion's energy) per word of a text column; the words not listed are the reference."""
    found = drive.words.get(column, np.full(len(drive), ""))
    amount = drive.motion_part if of_motion else drive.length_m
    return np.stack([(found == word) * amount for word in values], axis=1)


@_formula
def turning_words(drive: Drive, *, column: str, values: list[str]) -> FloatArray:
    """J/rad per word of a text column, on top of what turning takes where no listed word stands."""
    found = drive.words.get(column, np.full(len(drive), ""))
    return np.stack([(found == word) * drive.turned_abs_rad for word in values], axis=1)


@_formula
def disk(drive: Drive, *, x: float, y: float, radius_m: float) -> FloatArray:
    """1. Rolling resistance on top within a circle."""
    return friction(drive) * (np.hypot(drive.x - x, drive.y - y) <= radius_m)[:, None]


@_formula
def place(drive: Drive, *, centres: list[list[float]], width_m: float, of_all: bool) -> FloatArray:
    """1. Rolling resistance on top (or a share of everything) as a smooth field: bell curves around centres."""
    at = np.asarray(centres, dtype=np.float64)
    far = (drive.x[:, None] - at[:, 0]) ** 2 + (drive.y[:, None] - at[:, 1]) ** 2
    amount = level(drive) if of_all else friction(drive)
    return amount * np.exp(-0.5 * far / width_m**2)


@_formula
def smooth(drive: Drive, *, over: str, knots: list[float], of: str, level: bool = False) -> FloatArray:
    """J/m (or a share of all that is predicted, or of the motion's part) at the knots of a piecewise linear curve over
    a quantity; it is 0 at the middle one, unless it brings its own level.

    The curve is constant beyond its outer knots; where the quantity is unknown it says what it says at the middle. So
    it does of heights outside `driven_heights`.
    """
    values = quantity(drive, over)
    if over == "elevation":
        low, high = driven_heights(knots)
        values = np.where((values >= low) & (values <= high), values, np.nan)
    amount = {
        "length": drive.length_m,
        "all": np.where(drive.standing, 0.0, drive.predicted),
        "motion": drive.motion_part,
    }[of]
    middle = len(knots) // 2
    filled = np.where(np.isfinite(values), values, knots[middle])
    hats = [np.interp(filled, knots, row) for k, row in enumerate(np.eye(len(knots))) if level or k != middle]
    return np.stack(hats, axis=1) * amount[:, None]


def driven_heights(knots: Sequence[float]) -> tuple[float, float]:
    """(lowest, highest) [m] that a curve over heights speaks of: a quarter of its range beyond its outer knots, which
    leave out the lowest and the highest of the drives. A height further off is one of another place.
    """
    margin = 0.25 * (knots[-1] - knots[0])
    return knots[0] - margin, knots[-1] + margin


def _known(drive: Drive, column: str, reference: float) -> FloatArray:
    """A logged column less its reference; 0 where it was not recorded."""
    values = drive.columns.get(column, np.full(len(drive), np.nan))
    return np.where(np.isfinite(values), values - reference, 0.0)


GROUND = frozenset({"grade", "cross_slope", "roughness", "elevation", "hollow", "braking", "climbing"})
"""Formulas and quantities that read the ground under a drive."""

FORCES = frozenset(
    {
        "friction",
        "cross_slope",
        "roughness",
        "wind_measured",
        "wind_constant",
        "heading",
        "speed",
        "temperature",
        "drift",
        "words",
        "disk",
        "place",
        "reversing",
        "acceleration",
        "length",
    }
)
"""Formulas of what pushes against the motion, and curves of the length."""
