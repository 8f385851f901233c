"""Drag that depends on the speed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features

FloatArray = NDArray[np.float64]


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
    label = "speed"
    meaning = "energy per metre in proportion to the speed or its square"
    reveals = "the same line at several speeds"

    @property
    def covariates(self) -> tuple[str, ...]:
        return ("speed",)

    def units(self, energy: str) -> tuple[str, ...]:
        return (f"{energy}/m per " + ("m/s" if self.power == 1 else f"(m/s)^{self.power}"),)

    def column(self, rows: Features) -> FloatArray:
        return rows.work_m * rows.pulling * rows.speed_mps**self.power

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        yield from (cls(power) for power in (1, 2))
