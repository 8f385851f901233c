"""A drive that is followed: the forecast of its rest."""

from __future__ import annotations

import datetime as dt
from typing import Literal

from pydantic import Field

from joulemap.service.driving.forecast import Cause, ChargeAt, Forecast
from joulemap.service.driving.tracking import Alarm
from joulemap.service.schemas.base import ResponseModel, like
from joulemap.service.storage.tables import DriveRow


class CauseOut(like(Cause)):  # type: ignore[misc]
    """How much more something takes in this run than planned."""

    name: Literal["level", "ground", "slope", "power"] = Field(
        description="all energy, the rolling resistance, the weight that is lifted, or the power at rest"
    )


class AlarmOut(like(Alarm)):  # type: ignore[misc]
    """A change that was noticed."""

    side: Literal["more", "less"] = Field(description="whether the robot takes more or less since")
    text: str = Field(description="the same in a sentence")


class ForecastOut(like(Forecast, Cause=CauseOut, Alarm=AlarmOut)):  # type: ignore[misc]
    """What is expected of the rest of a drive."""

    verdict: Literal["yes", "likely", "marginal", "no"] = Field(description="by that probability")


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


class ChargeAtOut(like(ChargeAt)):  # type: ignore[misc]
    """A place of the route of a drive."""

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
