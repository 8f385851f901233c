"""A drive that is followed: the forecast of its rest."""

from __future__ import annotations

import datetime as dt
from typing import Literal

from pydantic import Field

from joulemap.service.schemas.base import ResponseModel
from joulemap.service.storage.tables import DriveRow


class CauseOut(ResponseModel):
    """How much more something takes in this run than planned."""

    name: Literal["level", "ground", "slope", "power"] = Field(
        description="all energy, the rolling resistance, the weight that is lifted, or the power at rest"
    )
    share: float = Field(description="as a share of the plan; 0.31 is 31 % more")
    low: float = Field(description="5 % of its distribution lie below")
    high: float = Field(description="5 % of its distribution lie above")


class AlarmOut(ResponseModel):
    """A change that was noticed."""

    at_m: float = Field(description="where it was noticed, from the start [m]")
    since_m: float = Field(description="where it probably began [m]")
    time_s: float = Field(description="time of the sample at which it was noticed [s]")
    side: Literal["more", "less"] = Field(description="whether the robot takes more or less since")
    text: str = Field(description="the same in a sentence")


class ForecastOut(ResponseModel):
    """What is expected of the rest of a drive."""

    at_m: float = Field(description="where the robot is, from the start of the route [m]")
    left_m: float = Field(description="length of the rest [m]")
    off_route_m: float = Field(description="how far the robot is beside the route [m]")
    used_j: float = Field(description="energy drawn since the first sample [J]")
    energy_j: float = Field(description="expected energy of the rest [J]")
    energy_p05_j: float = Field(description="energy of the rest that 5 % of drives do not exceed [J]")
    energy_p95_j: float = Field(description="energy of the rest that 95 % of drives do not exceed [J]")
    planned_j: float = Field(description="energy of the rest as planned [J]")
    left_s: float = Field(description="time of the rest at the robot's speed [s]")
    charge: float = Field(description="state of charge now, 0..1")
    charge_at_end: float = Field(description="expected state of charge at the end, 0..1")
    probability: float = Field(description="that the battery lasts to the end with its reserve, 0.01..0.99")
    verdict: Literal["yes", "likely", "marginal", "no"] = Field(description="by that probability")
    learnt_m: float = Field(description="distance that was learnt from [m]")
    more: CauseOut = Field(description="how much more the rest takes, or the one cause that is seen")
    causes: list[CauseOut] = Field(description="each cause by itself")
    alarms: list[AlarmOut] = Field(description="at most 20, the newest last")
    text: str = Field(description="all this in a sentence or two")


class DriveOut(ResponseModel):
    """A drive that is followed."""

    id: str
    costmap_id: str = Field(description="of the cost map of its route")
    created_at: dt.datetime
    updates: int = Field(description="how often its log was sent")
    unused: int = Field(description="samples that were not used: too late, or there already")
    forecast: ForecastOut


class DriveList(ResponseModel):
    """A page of drives."""

    total: int
    items: list[DriveOut]


class ChargeAtOut(ResponseModel):
    """A place of the route of a drive."""

    distance_m: float = Field(description="from the start [m]")
    x: float = Field(description="world x, east [m]")
    y: float = Field(description="world y, north [m]")
    planned: float = Field(description="state of charge there as planned; below 0: empty before")
    charge: float = Field(ge=0, le=1, description="what it was behind the robot; ahead of it what is expected")
    low: float = Field(ge=0, le=1, description="5 % of drives have less there")
    high: float = Field(ge=0, le=1, description="5 % of drives have more there")


class ChargeOut(ResponseModel):
    """The state of charge along the route of a drive."""

    at_m: float = Field(description="where the robot is, from the start of the route [m]")
    position: list[float] | None = Field(description="where its last sample was, world x, y [m]; null: none was sent")
    reserve: float = Field(description="share of the battery that the robot must keep")
    places: list[ChargeAtOut] = Field(description="at most 200, in order")


class BetterRouteOut(ResponseModel):
    """Another way from where the robot is to the goal."""

    path: list[list[float]] = Field(description="world x, y [m]")
    length_m: float = Field(description="length [m]")
    energy_j: float = Field(description="energy at what driving costs in this run [J]")
    saving_j: float = Field(description="what it saves of the rest of the present route [J]")
    saving_std_j: float = Field(description="standard deviation of that [J]")


class BetterOut(ResponseModel):
    """Whether another way has become better."""

    route: BetterRouteOut | None = Field(description="null where none is cheaper by more than its uncertainty")


def drive_out(row: DriveRow) -> DriveOut:
    """Return a drive as it is sent."""
    return DriveOut(
        id=row.id,
        costmap_id=row.costmap_id,
        created_at=row.created_at.replace(tzinfo=dt.UTC),
        updates=row.updates,
        unused=row.unused or 0,
        forecast=ForecastOut.model_validate(row.forecast),
    )
