"""Weather: a measured wind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray, quantity


@dataclass(frozen=True)
class Wind(Form):
    """Aerodynamic drag along the motion in the logged wind, less that in still air.

    Reference: Wong 2008, "Theory of Ground Vehicles", section 3.2 (the square).

    Attributes
    ----------
    law : {"air", "head", "linear"}
        With the square of the speed of the air that the robot meets, from any side; with that of its component from
        ahead; or in proportion to the component of the wind.
    """

    law: str = "air"

    key = "wind"
    resists = True
    label = "wind"
    meaning = "drag added per unit of relative air speed"
    reveals = "one line there and back in wind"
    covariates = ("column:wind_speed", "column:wind_from")
    options: ClassVar = {"law": ("air", "head", "linear")}
    low = 0.0
    weather = True
    extrapolates = True

    def units(self, energy: str) -> tuple[str, ...]:
        return (f"{energy}/m per " + ("m/s" if self.law == "linear" else "(m/s)^2"),)

    def column(self, rows: Features) -> FloatArray:
        speed = quantity(rows, "column:wind_speed")
        towards = speed * np.cos(np.radians(quantity(rows, "column:wind_from")) - rows.heading_rad)
        ahead = rows.speed_mps + towards
        across2 = np.maximum(speed**2 - towards**2, 0.0) if self.law == "air" else 0.0
        square = ahead * np.sqrt(ahead**2 + across2) - rows.speed_mps**2
        return rows.work_m / rows.unit_j * rows.pulling * (towards if self.law == "linear" else square)
