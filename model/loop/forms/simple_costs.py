"""Costs of length, climb, turned angle, time, drag and kinetic energy: a calibration's simplest rival."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray
from joulemap.model.runs.residuals import Residuals

_COLUMNS: dict[str, tuple[str, float, Callable[[Features], FloatArray]]] = {
    "length": ("{E}/m", -np.inf, lambda rows: rows.length_m),
    "climb": ("{E}/m", 0.0, lambda rows: rows.grade * rows.length_m),
    "turned": ("{E}/rad", 0.0, lambda rows: rows.turned_abs_rad),
    "time": ("{P}", -np.inf, lambda rows: np.where(rows.standing, rows.duration_s, rows.length_m / rows.speed_mps)),
    "drag": ("{E} s2/m3", -np.inf, lambda rows: rows.speed_mps**2 * rows.length_m),
    "speeding_up": ("{E} s2/m2", -np.inf, lambda rows: rows.gained_m2ps2),
    "kinetic_energy": ("{E} s2/m2", -np.inf, lambda rows: rows.kinetic_m2ps2),
}
"""Unit, lower limit, and values by name."""


@dataclass(frozen=True)
class SimpleCosts(Form):
    """In place of a base model and of all effects; `names` are those of the columns."""

    names: tuple[str, ...] = tuple(_COLUMNS)

    key = "simple_costs"
    label = "costs of length, climb, turned angle, time, drag and kinetic energy"
    meaning = "cost of each"
    unit = ""
    reveals = "climbs, curves, and several speeds"

    def coefficient_names(self) -> tuple[str, ...]:
        return self.names

    def units(self, energy: str) -> tuple[str, ...]:
        power = "W" if energy == "J" else "A"
        return tuple(_COLUMNS[name][0].format(E=energy, P=power) for name in self.names)

    def columns(self, rows: Features) -> FloatArray:
        return np.stack([np.nan_to_num(_COLUMNS[name][2](rows)) for name in self.names], axis=1)

    def fitted(self, rows: Residuals) -> tuple[float, ...]:
        """Fit it by least squares to metres and stops."""
        low = np.array([_COLUMNS[name][1] for name in self.names])
        return tuple(lsq_linear(self.columns(rows.features), rows.measured, bounds=(low, np.inf)).x.tolist())
