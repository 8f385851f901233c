"""Time: what grows over a run or over a day."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray, quantity


@dataclass(frozen=True)
class Drift(Form):
    """A share of everything, or energy per metre, that grows in proportion to time or distance.

    Attributes
    ----------
    over : str
        `since_start`, `driven` or `clock`.
    start, end : float
        Values of the covariate in the runs between which it grows: it is nil at the first stamp of the day.
    of_all : bool
        A share of the predicted energy instead of energy per metre.
    """

    over: str
    start: float = 0.0
    of_all: bool = True
    end: float | None = None

    key = "drift"
    resists = True
    label = "drift over time or distance"
    meaning = "energy added per hour or per kilometre"
    reveals = "the same loop at the start and at the end of a long day"
    planned = False

    @property
    def per(self) -> tuple[float, str]:
        """Amount of the covariate to which a coefficient belongs, and its unit."""
        return (3600.0, "h") if self.over in ("since_start", "clock") else (1000.0, "km")

    def units(self, energy: str) -> tuple[str, ...]:
        return (f"{'1' if self.of_all else energy + '/m'}/{self.per[1]}",)

    def column(self, rows: Features) -> FloatArray:
        amount = rows.hotel_and_motion if self.of_all else rows.work_m * rows.pulling
        return amount * (np.clip(quantity(rows, self.over), self.start, self.end) - self.start) / self.per[0]

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        for over in ("since_start", "driven", "clock"):
            start = float(rows.clock_s.min()) if over == "clock" else 0.0
            yield from (cls(over, start, of_all, float(quantity(rows, over).max())) for of_all in (True, False))
