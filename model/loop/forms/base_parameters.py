"""The base model's own parameters: what its owner declared is where they start, what the runs say comes first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.features import Features
from joulemap.model.loop.forms.base import Form

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class BaseParameters(Form):
    """Corrections of the declared rolling resistance, of the energy of motion and of the idle power.

    Attributes
    ----------
    lowest : tuple of float
        Physical limits: none of the three may become negative.
    """

    lowest: tuple[float, ...]

    key = "base_parameters"
    label = "base parameters"
    meaning = "correction of what was declared"
    unit = ""
    reveals = "level ground, climbs, and a minute without motion"

    def coefficient_names(self) -> tuple[str, ...]:
        return ("rolling_resistance", "energy_of_motion", "idle_power_w")

    def units(self, energy: str) -> tuple[str, ...]:
        return ("", "", "W")

    def columns(self, rows: Features) -> FloatArray:
        return np.stack([rows.weight_length * rows.pulling, rows.motion_part, rows.duration_s], axis=1)

    @classmethod
    def of(cls, rows: Features) -> BaseParameters:
        """Return the form for a robot.

        Parameters
        ----------
        rows : Features
            Whose robot's declared values are the limits.

        Returns
        -------
        BaseParameters
            With limits.
        """
        return cls((-rows.robot.rolling_resistance, -1.0, -rows.robot.idle_power_w))


@dataclass(frozen=True)
class ChargeScale(Form):
    """What replaces the prediction where only charge was logged, whose scale and zero are unknown."""

    key = "charge_scale"
    label = "scale of the charge"
    meaning = "charge per metre, per joule of traction uphill and downhill, and per second"
    unit = ""
    reveals = "a log with a voltage"

    @property
    def lowest(self) -> tuple[float, ...]:
        """Physical limits: charge grows with distance, with traction and with time."""
        return (-np.inf, 0.0, 0.0, 0.0)

    def coefficient_names(self) -> tuple[str, ...]:
        return ("per metre", "uphill", "downhill", "per second")

    def units(self, energy: str) -> tuple[str, ...]:
        return ("A s/m", "1/V", "1/V", "A")

    def columns(self, rows: Features) -> FloatArray:
        t, length = rows.traction_per_m, rows.length_m
        return np.stack([length, length * np.maximum(t, 0.0), length * np.minimum(t, 0.0), rows.duration_s], axis=1)
