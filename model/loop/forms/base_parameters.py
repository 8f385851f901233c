"""The base model's own parameters: what its owner declared is where they start, what the runs say comes first."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.features import Features
from joulemap.model.loop.forms.base import Form

FloatArray = NDArray[np.float64]


def released(rows: Features) -> FloatArray:
    """Return the energy that descents release beyond the rolling resistance.

    Parameters
    ----------
    rows : Features
        Of n rows.

    Returns
    -------
    ndarray of float, (n,)
        Energy [J, or A s], from the slopes along each row, so that a metre over the top of a hill counts in part.
    """
    return rows.weight_length * rows.along(lambda grades: np.maximum(rows.coasting_tan - grades, 0.0))


def kinetic(rows: Features) -> FloatArray:
    """Return the energy of motion that is gained while speeding up.

    Parameters
    ----------
    rows : Features
        Of n rows.

    Returns
    -------
    ndarray of float, (n,)
        Energy [J, or A s] of the declared mass; slowing down does not count.
    """
    return rows.robot.mass_kg * rows.gained_m2ps2 / rows.unit_j


def slowed(rows: Features) -> FloatArray:
    """Return the energy of motion that slowing down gives back, with a minus.

    Parameters
    ----------
    rows : Features
        Of n rows.

    Returns
    -------
    ndarray of float, (n,)
        Energy [J, or A s] of the declared mass: what rolling needs less from the drives.
    """
    return rows.robot.mass_kg * (rows.kinetic_m2ps2 - rows.gained_m2ps2) / rows.unit_j


def measured_slope(rows: Features) -> FloatArray:
    """Return the work against the slope that the robot's own attitude sensor measured.

    Parameters
    ----------
    rows : Features
        Of n rows.

    Returns
    -------
    ndarray of float, (n,)
        Energy [J, or A s]; 0 without a column `pitch` [deg]. The sensor's tilt, the median of the run, is taken out.
    """
    pitch = rows.columns.get("pitch", np.full(len(rows), np.nan)).copy()
    pitch[rows.standing] = np.nan
    for run in np.unique(rows.run):
        mine = rows.run == run
        if np.isfinite(pitch[mine]).any():
            pitch[mine] -= np.nanmedian(pitch[mine])
    return np.nan_to_num(rows.weight_length * rows.pulling * np.tan(np.radians(np.clip(pitch, -60.0, 60.0))))


Part = tuple[str, str, Callable[[Features], FloatArray]]
"""Name, unit and column of a parameter."""


@dataclass(frozen=True)
class BaseParameters(Form):
    """Corrections of what an owner declares, or a prediction from nothing where only charge was logged.

    Attributes
    ----------
    of_charge : bool
        Whether scale and zero of the energy are unknown, so that nothing of the base model's prediction is kept.
    lowest : tuple of float
        Lower physical limit of each coefficient: rolling resistance, idle power and mass are not negative, and descents
        return no more than they release.
    measured : bool
        Whether the slope that the robot measured is one of them. Plans do without.
    """

    of_charge: bool
    lowest: tuple[float, ...]
    measured: bool = True

    key = "base_parameters"
    label = "base parameters"
    meaning = "correction of what was declared"
    unit = ""
    reveals = "level ground, climbs, and a minute without motion"

    @property
    def parts_of(self) -> tuple[Part, ...]:
        """Its parameters."""
        some = _CHARGE if self.of_charge else _DECLARED
        return some + _ALWAYS[: 3 if self.measured else 2]

    def coefficient_names(self) -> tuple[str, ...]:
        return tuple(name for name, _, _ in self.parts_of)

    def units(self, energy: str) -> tuple[str, ...]:
        return tuple(unit for _, unit, _ in self.parts_of)

    def columns(self, rows: Features) -> FloatArray:
        return np.stack([np.nan_to_num(column(rows)) for _, _, column in self.parts_of], axis=1)

    def as_dict(self) -> dict[str, Any]:
        lowest = [None if limit == -np.inf else limit for limit in self.lowest]  # JSON knows no infinity
        return {**super().as_dict(), "lowest": lowest}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> BaseParameters:
        lowest = [-np.inf if limit is None else float(limit) for limit in values.get("lowest", ())]
        return super().from_dict({**values, "lowest": lowest})

    @property
    def before_driving(self) -> BaseParameters:
        """The same without the slope that the robot measured, which no plan knows."""
        return BaseParameters(self.of_charge, self.lowest[:6], measured=False)

    @classmethod
    def of(cls, rows: Features, *, of_charge: bool) -> BaseParameters:
        """Return the form for a robot.

        Parameters
        ----------
        rows : Features
            Whose robot's declared values give the limits.
        of_charge : bool
            As in the attributes.

        Returns
        -------
        BaseParameters
            With limits.
        """
        robot = rows.robot
        low = (rows.coasting_tan, -1.0, -robot.idle_power_w, robot.regeneration - 1.0)
        if of_charge:
            low = (-np.inf, 0.0, 0.0, 0.0)
        return cls(of_charge, (*low, 0.0, 0.0, -np.inf))


_DECLARED: tuple[Part, ...] = (
    ("rolling_resistance", "", lambda rows: rows.weight_length * rows.pulling),
    ("energy_of_motion", "", lambda rows: rows.motion_part),
    ("idle_power_w", "W", lambda rows: rows.duration_s / rows.unit_j),
    ("descents", "", released),
)
_CHARGE: tuple[Part, ...] = (
    ("per_metre", "A s/m", lambda rows: rows.length_m),
    ("uphill", "1/V", lambda rows: rows.length_m * np.maximum(rows.pull_n, 0.0)),
    ("downhill", "1/V", lambda rows: rows.length_m * np.minimum(rows.pull_n, 0.0)),
    ("per_second", "A", lambda rows: rows.duration_s),
)
_ALWAYS: tuple[Part, ...] = (
    ("speeding_up", "", kinetic),
    ("slowing_down", "", slowed),
    ("measured_slope", "", measured_slope),
)
