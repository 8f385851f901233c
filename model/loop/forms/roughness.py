"""Rough ground."""

from __future__ import annotations

from dataclasses import dataclass

from joulemap.model.loop.forms.base import Form
from joulemap.model.runs.features import Features, FloatArray


@dataclass(frozen=True)
class Roughness(Form):
    """Rolling resistance that grows with the roughness of the ground."""

    key = "roughness"
    resists = True
    label = "roughness"
    meaning = "coefficient of rolling resistance added per metre of roughness"
    unit = "1/m"
    reveals = "the same manoeuvres on smooth and on rough ground"
    covariates = ("roughness",)
    low = 0.0

    def column(self, rows: Features) -> FloatArray:
        return rows.weight_length * rows.pulling * rows.roughness_m
