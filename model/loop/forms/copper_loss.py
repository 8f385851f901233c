"""Losses with the square of a force or of a current."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray


@dataclass(frozen=True)
class CopperLoss(Form):
    """Heat in windings, wires and the battery's internal resistance, with the square of the current.

    Attributes
    ----------
    of_motors : bool
        The square of the drives' force, whatever the speed, as in the windings of the motors; otherwise the square of
        the battery's current.
    """

    of_motors: bool = False

    low = 0.0
    key = "battery"
    label = "losses with the square of the current"
    meaning = "resistance in which energy is lost with the square of the current"
    reveals = "steep climbs and level ground at the same state of charge"
    options: ClassVar = {"of_motors": (False, True)}

    @property
    def name(self) -> str:
        return "copper_loss" if self.of_motors else self.key

    @property
    def title(self) -> str:
        return "copper losses of the motors" if self.of_motors else "internal resistance of the battery"

    def units(self, energy: str) -> tuple[str, ...]:
        return ("W at the robot's weight" if self.of_motors else "ohm",)

    def column(self, rows: Features) -> FloatArray:
        if self.of_motors:
            force = np.where(rows.standing, 0.0, rows.pull_n) / rows.robot.weight_n
            return rows.duration_s / rows.unit_j * force**2
        return (rows.power_w / rows.robot.nominal_voltage_v) ** 2 * rows.duration_s / rows.unit_j
