"""A limit of the power."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from joulemap.model.loop.forms.base import Form, steps
from joulemap.model.runs.features import Features, FloatArray


@dataclass(frozen=True)
class PowerLimit(Form):
    """Power that the drives do not take above a limit, because controllers cut it off.

    Attributes
    ----------
    power_w : float
        From which the prediction is too high [W].
    """

    power_w: float = 0.0

    key = "power_limit"
    label = "power limit"
    meaning = "share of the power above the limit that is not drawn, with a minus"
    unit = ""
    reveals = "steep climbs at full speed"
    low = -1.0
    high = 0.0

    def column(self, rows: Features) -> FloatArray:
        return np.maximum(rows.power_w - self.power_w, 0.0) * rows.duration_s / rows.unit_j

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        moving = rows.take(~rows.standing)
        powers = moving.predicted * moving.unit_j / np.maximum(moving.duration_s, 1e-6)
        yield from (cls(limit) for limit in steps(powers, 11)[6:10:2])

    def where(self, coefficients: tuple[float, ...]) -> str:
        return f"above {self.power_w:.0f} W"
