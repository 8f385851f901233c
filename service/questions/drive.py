"""A drive to follow: its route and battery, and what its log says meanwhile."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from joulemap.model.ranges import BATTERY, Range
from joulemap.service.questions.parts import BatteryIn
from joulemap.service.schemas.base import GivenPath, Place, Request, within

MOST_SAMPLES = 500
"""In one request, each of at most two objects and eight names, as `joulemap.service.http.middleware` lets pass."""
TIME_S = Range(-1e11, 1e11)
POWER_W = Range(-1e7, 1e7)
VOLTAGE_V = Range(0.0, 1e4)
CURRENT_A = Range(-1e5, 1e5)


class DriveRequest(Request):
    """A route, and the battery at its start."""

    path: GivenPath = Field(min_length=2, max_length=100_000, description="the route, world points [m], in order")
    battery: BatteryIn | None = Field(
        default=None, description="at the start; default: the robot's own, full, without a reserve"
    )


class SampleIn(Request):
    """A moment of a drive, in any order within five seconds."""

    time_s: Annotated[float, within(TIME_S)] = Field(description="when, by any clock that runs on [s]", examples=[12.5])
    position: Place = Field(examples=[[12.5, 40.5]])
    power_w: Annotated[float, within(POWER_W)] | None = Field(
        default=None, description="power drawn from the battery [W]", examples=[64.0]
    )
    voltage_v: Annotated[float, within(VOLTAGE_V)] | None = Field(
        default=None, description="voltage [V], with `current_a` in place of the power"
    )
    current_a: Annotated[float, within(CURRENT_A)] | None = Field(
        default=None, description="current [A], positive while the battery discharges"
    )
    charge: Annotated[float, within(BATTERY["charge"])] | None = Field(
        default=None, description="state of charge as the battery says it, 0..1; default: by what was used"
    )

    @model_validator(mode="after")
    def _power(self) -> Self:
        if self.power_w is None and (self.voltage_v is None or self.current_a is None):
            raise ValueError("give `power_w`, or `voltage_v` and `current_a`")
        return self


class UpdateRequest(Request):
    """What the log of a drive says since the last update. A sample that was sent before changes nothing."""

    samples: list[SampleIn] = Field(min_length=1, max_length=MOST_SAMPLES, description="of the log, in any order")
