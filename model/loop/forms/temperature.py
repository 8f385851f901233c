"""Weather: the temperature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray, quantity


@dataclass(frozen=True)
class Temperature(Form):
    """Energy that changes with the logged temperature.

    Attributes
    ----------
    reference : float
        Temperature at which it is nil [degC].
    of : str
        `motion` for a share of the energy of motion (grease, tyres), `length` for energy per metre, `time` for power
        (a heater).
    """

    reference: float
    of: str = "motion"

    key = "temperature"
    resists = True
    label = "temperature"
    meaning = "energy or power added per degree above the reference temperature"
    reveals = "the same loop on a cold and on a warm day"
    covariates = ("column:temperature",)
    weather = True

    def units(self, energy: str) -> tuple[str, ...]:
        return ({"motion": "1/K", "length": f"{energy}/m/K", "time": "W/K" if energy == "J" else "A/K"}[self.of],)

    def column(self, rows: Features) -> FloatArray:
        amount = {"motion": rows.motion_part, "length": rows.work_m * rows.pulling, "time": rows.duration_s}[self.of]
        return amount * (quantity(rows, "column:temperature") - self.reference)

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        logged = quantity(rows, "column:temperature")
        if np.isfinite(logged).any():
            usual = round(float(np.nanmean(logged)), 2)
            yield from (cls(usual, of) for of in ("motion", "length", "time"))
