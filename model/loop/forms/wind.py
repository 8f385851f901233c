"""Weather: a measured wind."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.features import Features, quantity
from joulemap.model.loop.forms.base import Form

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Wind(Form):
    """Aerodynamic drag along the motion in the logged wind, less that in still air.

    Attributes
    ----------
    quadratic : bool
        Drag with the square of the relative air speed, instead of in proportion to the component of the wind.
    """

    quadratic: bool = True

    key = "wind"
    label = "wind"
    meaning = "drag added per unit of relative air speed"
    reveals = "one line there and back in wind"
    low = 0.0
    weather = True

    @property
    def covariates(self) -> tuple[str, ...]:
        return ("column:wind_speed",)

    def units(self, energy: str) -> tuple[str, ...]:
        return (f"{energy}/m per " + ("(m/s)^2" if self.quadratic else "m/s"),)

    def column(self, rows: Features) -> FloatArray:
        speed = quantity(rows, "column:wind_speed")
        towards = speed * np.cos(np.radians(quantity(rows, "column:wind_from")) - rows.heading_rad)
        if not self.quadratic:
            return rows.work_m / rows.unit_j * rows.pulling * towards
        ahead = rows.speed_mps + towards
        across2 = np.maximum(speed**2 - towards**2, 0.0)
        drag = ahead * np.sqrt(ahead**2 + across2) - rows.speed_mps**2
        return rows.work_m / rows.unit_j * rows.pulling * drag

    @classmethod
    def variants(cls, rows: Features) -> Iterator[Form]:
        if {"wind_speed", "wind_from"} <= set(rows.columns):
            yield from (cls(quadratic) for quadratic in (True, False))
