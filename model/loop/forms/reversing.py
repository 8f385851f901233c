"""Driving backwards."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray


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
    resists = True
    label = "driving backwards"
    meaning = "energy added while driving backwards"
    reveals = "the same line forwards and backwards"
    planned = False
    covariates = ("column:heading",)
    options: ClassVar = {"of_motion": (False, True)}

    def units(self, energy: str) -> tuple[str, ...]:
        return ("of the motion's energy" if self.of_motion else f"{energy}/m",)

    def column(self, rows: Features) -> FloatArray:
        return (rows.motion_part if self.of_motion else rows.work_m * rows.pulling) * rows.backwards
