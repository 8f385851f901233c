"""Drag that depends on the speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray


@dataclass(frozen=True)
class Speed(Form):
    """Energy per metre in proportion to a power of the speed.

    Attributes
    ----------
    power : int
        1 for viscous losses, 2 for drag and for bumps.
    """

    power: int = 1

    key = "speed"
    resists = True
    label = "speed"
    meaning = "energy per metre in proportion to the speed or its square"
    reveals = "the same line at several speeds"
    covariates = ("speed",)
    options: ClassVar = {"power": (1, 2)}

    def units(self, energy: str) -> tuple[str, ...]:
        return (f"{energy}/m per " + ("m/s" if self.power == 1 else f"(m/s)^{self.power}"),)

    def column(self, rows: Features) -> FloatArray:
        return rows.work_m * rows.pulling * rows.speed_mps**self.power
