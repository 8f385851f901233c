"""Speeding up: energy of motion that braking does not give back."""

from __future__ import annotations

from dataclasses import dataclass

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray


@dataclass(frozen=True)
class Acceleration(Form):
    """Mass, of the robot or of what spins in it, that is accelerated and whose energy is lost when it slows down."""

    key = "acceleration"
    label = "acceleration"
    meaning = "mass whose energy of motion is not recovered when the robot slows down"
    unit = "kg"
    reveals = "stop and go on level ground"
    low = 0.0
    planned = False

    def column(self, rows: Features) -> FloatArray:
        return rows.slowness * rows.gained_m2ps2 / rows.unit_j
