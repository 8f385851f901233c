"""Load: a logged mass."""

from __future__ import annotations

from dataclasses import dataclass

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray, quantity


@dataclass(frozen=True)
class Payload(Form):
    """Energy of motion in proportion to a logged load; its kilograms are those of the declared mass."""

    key = "payload"
    label = "payload"
    meaning = "kilograms by which each logged kilogram counts, on top of what the base model already counts"
    unit = ""
    reveals = "the same loop with and without a load"
    covariates = ("column:payload",)
    low = -1.0
    high = 2.0
    weather = True
    extrapolates = True

    def column(self, rows: Features) -> FloatArray:
        return rows.motion_part / rows.robot.mass_kg * quantity(rows, "column:payload")
