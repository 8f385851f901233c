"""Load: a logged mass."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, quantity

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Payload(Form):
    """Energy of motion in proportion to a logged load."""

    key = "payload"
    label = "payload"
    meaning = "kilograms by which each logged kilogram counts, on top of what the base model already counts"
    unit = ""
    reveals = "the same loop with and without a load"
    low = -1.0
    high = 2.0
    weather = True

    @property
    def covariates(self) -> tuple[str, ...]:
        return ("column:payload",)

    def column(self, rows: Features) -> FloatArray:
        return rows.motion_part / rows.robot.mass_kg * quantity(rows, "column:payload")

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        if "payload" in rows.columns:
            yield cls()
