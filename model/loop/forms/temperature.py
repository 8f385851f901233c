"""Weather: the temperature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray, quantity

_OF_OIL_PER_K = 0.06  # mineral oils from 0 to 40 degC: 0.05 of ISO VG 10 to 0.065 of VG 220 (ISO 3448, ASTM D341)


@dataclass(frozen=True)
class Temperature(Form):
    """Energy that changes with the logged temperature.

    Reference: Stachowiak & Batchelor 2014, "Engineering Tribology", section 2.4 (the viscosity of oil: Reynolds'
    equation).

    Attributes
    ----------
    reference : float
        Temperature to which the coefficient belongs [degC]: on a straight line it is nil there.
    of : str
        `motion` for a share of the energy of motion (grease, tyres), `length` for energy per metre, `time` for power
        (a heater).
    rate_per_k : float
        By which it falls exponentially, as the viscosity of oil does; 0 for a straight line.
    """

    reference: float
    of: str = "motion"
    rate_per_k: float = 0.0

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
        warmer = quantity(rows, "column:temperature") - self.reference
        if self.rate_per_k == 0.0:
            return amount * warmer
        return -amount * np.exp(-self.rate_per_k * warmer) / self.rate_per_k

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        logged = quantity(rows, "column:temperature")
        if np.isfinite(logged).any():
            usual = round(float(np.nanmean(logged)), 2)
            yield from (cls(usual, of) for of in ("motion", "length", "time"))
            yield from (cls(usual, of, _OF_OIL_PER_K) for of in ("motion", "length"))
