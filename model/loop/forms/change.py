"""A step in time: from one run on everything costs more, or less."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray

_DATED_S = 1e8  # a stamp above this is a date; below it counts from the start of something
_LEAST_RUNS = 2  # before and after a step: one run that differs is a run that differs


@dataclass(frozen=True)
class Change(Form):
    """A share of everything that is added from a time on, as after a repair, a puncture or a bearing that fails.

    Reference: Hinkley 1970, "Inference about the change-point in a sequence of random variables".

    Attributes
    ----------
    from_s : float
        Stamp from which it is there [s].
    run : int
        Number of the first run after it, from 1 in the order of time.
    """

    from_s: float
    run: int

    key = "change"
    label = "change in time"
    meaning = "share by which everything costs more from then on"
    unit = ""
    reveals = "looking at the robot, and the same loop again"
    low = -1.0
    planned = False

    def column(self, rows: Features) -> FloatArray:
        return rows.hotel_and_motion * (rows.clock_s >= self.from_s)

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        first = np.sort([rows.clock_s[rows.run == run].min() for run in np.unique(rows.run)])
        for k in range(_LEAST_RUNS, first.size - _LEAST_RUNS + 1):
            yield cls(float(first[k]), k + 1)

    def where(self, coefficients: tuple[float, ...]) -> str:
        (share,) = coefficients
        stamp = f"stamp {self.from_s:.0f} s"
        if self.from_s > _DATED_S:
            stamp = f"{datetime.fromtimestamp(self.from_s, UTC):%Y-%m-%d %H:%M} UTC"
        much = f"{abs(share):.0%}".replace("%", " %")
        return f"from run {self.run} on ({stamp}): {much} {'more' if share > 0.0 else 'less'}, look at the robot"
