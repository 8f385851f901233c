"""Driving across a slope."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class CrossSlope(Form):
    """Rolling resistance that grows with the slope across the motion, as of a robot that crabs.

    Attributes
    ----------
    power : int
        Of the tangent.
    """

    power: int = 1

    key = "cross_slope"
    label = "cross slope"
    meaning = "coefficient of rolling resistance added per tangent of the cross slope"
    reveals = "lines along the contours of a slope, both ways"
    low = 0.0

    @property
    def covariates(self) -> tuple[str, ...]:
        return ("cross_slope",)

    def units(self, energy: str) -> tuple[str, ...]:
        return ("" if self.power == 1 else "1/tan",)

    def column(self, rows: Features) -> FloatArray:
        return rows.weight_length * rows.pulling * (rows.cross_abs if self.power == 1 else rows.cross_sq)

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        yield from (cls(power) for power in (1, 2))
