"""Warming up: grease, gears and tyres that resist less as a run goes on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray

_TIMES_S = (150.0, 600.0, 2400.0)  # of a small motor, of a gearbox, of a tyre or an axle: minutes to an hour


@dataclass(frozen=True)
class WarmingUp(Form):
    """Energy per metre that a cold robot takes more, and that falls exponentially since the start of a run.

    Reference: Wong 2008, "Theory of Ground Vehicles", section 1.2: the rolling resistance of a tyre falls with its
    temperature, which approaches that of steady driving exponentially.

    Attributes
    ----------
    time_s : float
        In which it falls to 1/e [s].
    """

    time_s: float

    key = "warming_up"
    resists = True
    label = "warming up since the start of a run"
    meaning = "energy per metre that is added at the start of a run"
    unit = "{E}/m"
    reveals = "the same loop again and again from a cold start"
    covariates = ("since_start",)
    low = 0.0
    planned = False

    def column(self, rows: Features) -> FloatArray:
        return rows.work_m * rows.pulling * np.exp(-rows.since_s / self.time_s)

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        yield from (cls(time_s) for time_s in _TIMES_S if time_s < float(rows.since_s.max()))

    def where(self, coefficients: tuple[float, ...]) -> str:
        return f"at the start of every run; after {self.time_s / 60.0:.3g} minutes 37 % of it is left"
