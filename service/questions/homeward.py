"""Until where a robot may follow its path and still come home: the point of no return."""

from __future__ import annotations

from pydantic import Field

from joulemap.model.ranges import MOST_CHARGING, QUANTILE
from joulemap.service.questions.parts import BatteryIn, OnMap
from joulemap.service.schemas.base import GivenPath, Place

CONFIDENCE = 0.95
"""Probability with which the battery must last, unless another is asked for."""


class ReturnRequest(OnMap):
    """Where the robot is, what is left of its path and its charge, and where home is."""

    position: Place = Field(examples=[[40.0, 30.0]])
    home: Place = Field(examples=[[12.5, 40.5]])
    path: GivenPath | None = Field(
        default=None,
        min_length=1,
        max_length=100_000,
        description="the rest of the path, world points [m], in order; without it, only whether it still comes home",
    )
    charging: list[Place] = Field(
        default=[], max_length=MOST_CHARGING, description="places to charge", examples=[[[60.0, 20.0]]]
    )
    battery: BatteryIn | None = Field(
        default=None, description="with the charge now; default: the robot's own, full, without a reserve"
    )
    confidence: float | None = Field(
        default=CONFIDENCE,
        ge=QUANTILE.low,
        le=QUANTILE.high,
        description="probability with which the battery must last; null where the expected energy decides",
    )
