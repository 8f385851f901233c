"""Driving across a slope."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray


@dataclass(frozen=True)
class CrossSlope(Form):
    """Rolling resistance that grows with the tangent across the motion to a power, as of a robot that crabs."""

    power: int = 1

    key = "cross_slope"
    resists = True
    label = "cross slope"
    meaning = "coefficient of rolling resistance added per tangent of the cross slope"
    reveals = "lines along the contours of a slope, both ways"
    covariates = ("cross_slope",)
    options: ClassVar = {"power": (1, 2)}
    low = 0.0

    def units(self, energy: str) -> tuple[str, ...]:
        return ("" if self.power == 1 else "1/tan",)

    def column(self, rows: Features) -> FloatArray:
        return rows.weight_length * rows.pulling * (rows.cross_abs if self.power == 1 else rows.cross_sq)
