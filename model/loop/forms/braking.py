"""Downhill: energy that braking draws."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray


@dataclass(frozen=True)
class Braking(Form):
    """Share of the energy released downhill that the battery supplies in addition, as of a motor that holds back.

    Attributes
    ----------
    from_grade : float
        Only what is steeper than this tangent is released: the rest overcomes the rolling resistance.
    """

    from_grade: float = 0.0

    key = "braking"
    label = "downhill braking"
    meaning = "share of the energy released downhill that the battery supplies on top"
    unit = ""
    reveals = "long descents at constant speed"
    covariates = ("grade",)

    def column(self, rows: Features) -> FloatArray:
        return rows.weight_length * rows.along(lambda grades: np.maximum(-grades - self.from_grade, 0.0))

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        yield from (cls(limit) for limit in (0.0, rows.robot.rolling_resistance))
