"""Driving backwards."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Reversing(Form):
    """Energy that driving backwards takes in addition.

    Attributes
    ----------
    of_motion : bool
        A share of the energy of motion instead of energy per metre.
    """

    of_motion: bool = False

    key = "reversing"
    label = "driving backwards"
    meaning = "energy added while driving backwards"
    reveals = "the same line forwards and backwards"
    planned = False

    def units(self, energy: str) -> tuple[str, ...]:
        return ("of the motion's energy" if self.of_motion else f"{energy}/m",)

    def column(self, rows: Features) -> FloatArray:
        return (rows.motion_part if self.of_motion else rows.work_m * rows.pulling) * rows.backwards

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        if rows.backwards.any():
            yield from (cls(of_motion) for of_motion in (False, True))
