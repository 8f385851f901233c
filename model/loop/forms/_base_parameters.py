"""The base model's own parameters: what its owner declared is where they start, what the runs say comes first."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray

Values = Sequence[float] | FloatArray
Energy = Callable[[Features], FloatArray]


@dataclass(frozen=True)
class BaseParameters(Form):
    """Corrections of what was declared, or a prediction from nothing of a charge; `names` are those of `PARTS`."""

    names: tuple[str, ...]

    key = "base_parameters"
    label = "base parameters"
    meaning = "correction of what was declared"
    unit = ""
    reveals = "level ground, climbs, and a minute without motion"

    def coefficient_names(self) -> tuple[str, ...]:
        return self.names

    def units(self, energy: str) -> tuple[str, ...]:
        return tuple(PARTS[name].unit for name in self.names)

    def columns(self, rows: Features) -> FloatArray:
        return np.stack([np.nan_to_num(PARTS[name].column(rows)) for name in self.names], axis=1)

    def lowest(self, rows: Features) -> FloatArray:
        """Lower limit of each coefficient, (k,): nothing is negative, and descents return no more than they release."""
        return np.array([PARTS[name].lowest(rows) for name in self.names])

    @classmethod
    def of(cls, *, charge: bool, motors: bool = False, level: bool = False) -> BaseParameters:
        """All parameters of runs. charge : whether scale and zero are unknown. motors : whether it is the motors'.
        level : whether no run has a slope, which then costs what the base model says.
        """
        every = (*(SCALE if charge else _DECLARED), *(_DRIVING_OF_MOTORS if motors else _DRIVING), MEASURED_SLOPE)
        return cls(tuple(name for name in every if not (level and name in _OF_SLOPE)))

    @property
    def level(self) -> bool:
        """Whether they say nothing of slopes."""
        return not set(_OF_SLOPE) & set(self.names)


def with_base_parameters(rows: Features, base: Form, coefficients: Values) -> Features:
    """Rows whose energy of motion has base parameters of these values, (k,), in it, as `corrected`."""
    assert isinstance(base, BaseParameters)
    of_motion = np.array([name not in _OF_TIME for name in base.names])
    energy = base.columns(rows)[:, of_motion] @ np.asarray(coefficients)[of_motion]
    of_charge = set(SCALE) & set(base.names)  # then nothing of the base model's own prediction is kept
    return replace(rows, corrected=energy - rows.base_motion if of_charge else energy)


def with_forces(
    rows: Features, first: Values, base: Form, value: Mapping[str, float], forces: Sequence[Energy]
) -> tuple[Features, FloatArray]:
    """Rows whose drives pull or brake against all forces, with base parameters as `with_base_parameters`; and what the
    forces of effects resist, as a tangent, (n,).

    first : base parameters before any effect. value : those beside the effects. forces : what each costs rows.
    """
    of_slope = value["uphill"] * rows.unit_j if "uphill" in value else 1.0 + value.get("energy_of_motion", 0.0)
    per_tan = rows.weight_length * (of_slope + value.get(MEASURED_SLOPE, 0.0))
    added = np.zeros(len(rows)) + sum(rows.resistance_of(force, per_tan) for force in forces)
    return with_base_parameters(rows.resisted_by(added) if forces else rows, base, first), added


class _Part(NamedTuple):
    """A parameter: its unit, the energy of rows per unit of it, (n,) [J, or A s], and its lower physical limit."""

    unit: str
    column: Callable[[Features], FloatArray]
    lowest: Callable[[Features], float] = lambda rows: 0.0


def _released(rows: Features) -> FloatArray:
    """What descents release beyond the rolling resistance; a metre over the top of a hill counts in part."""
    return rows.weight_length * rows.along(lambda grades: np.maximum(rows.coasting_tans - grades, 0.0))


def _of_mass(rows: Features, squares_m2ps2: FloatArray) -> FloatArray:
    """Energy of motion of the declared mass."""
    return rows.slowness * rows.robot.mass_kg * squares_m2ps2 / rows.unit_j


PARTS: dict[str, _Part] = {
    "rolling_resistance": _Part("", lambda rows: rows.weight_length * rows.pulling, lambda rows: rows.coasting_tan),
    "energy_of_motion": _Part("", lambda rows: rows.base_motion, lambda rows: -1.0),
    "idle_power_w": _Part("W", lambda rows: rows.duration_s / rows.unit_j, lambda rows: -rows.robot.idle_power_w),
    "descents": _Part("", _released, lambda rows: rows.robot.regeneration - 1.0),
    "per_metre": _Part("A s/m", lambda rows: rows.work_m, lambda rows: -np.inf),
    "uphill": _Part("1/V", lambda rows: rows.work_m * rows.pull_n * rows.pulls),
    "downhill": _Part("1/V", lambda rows: rows.work_m * rows.pull_n * ~rows.pulls),
    "standing_current": _Part("A", lambda rows: rows.duration_s),
    "driving_power": _Part("W", lambda rows: np.where(rows.standing, 0.0, rows.duration_s) / rows.unit_j),
    "with_speed": _Part("A s/m", lambda rows: rows.length_m),
    "speeding_up": _Part("", lambda rows: _of_mass(rows, rows.gained_m2ps2)),
    "slowing_down": _Part("", lambda rows: _of_mass(rows, rows.kinetic_m2ps2 - rows.gained_m2ps2)),
    "measured_slope": _Part(
        "", lambda rows: rows.weight_length * rows.pulling * rows.measured_tan, lambda rows: -np.inf
    ),
}
"""Every parameter by name. Slowing down is what rolling needs less from the drives."""

SCALE = ("per_metre", "uphill", "downhill", "standing_current")
"""Scale and zero of a charge."""
MEASURED_SLOPE = "measured_slope"
"""What no plan knows."""
_OF_SLOPE = ("energy_of_motion", "descents", "uphill", "downhill", MEASURED_SLOPE)
"""On level ground rolling resistance, or charge per metre, is all of the energy of motion."""
_OF_TIME = ("idle_power_w", "standing_current", "driving_power", "speeding_up", "slowing_down")
_DECLARED = ("rolling_resistance", "energy_of_motion", "idle_power_w", "descents")
_DRIVING = ("driving_power", "speeding_up", "slowing_down")
_DRIVING_OF_MOTORS = ("with_speed", "speeding_up", "slowing_down")  # their current needs no time that a force does not
