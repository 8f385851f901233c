"""What a route costs at other speeds: the question and its answer."""

from __future__ import annotations

from dataclasses import asdict
from typing import Literal

from pydantic import Field

from joulemap.planner.route import Route
from joulemap.service.schemas.answers import path_points
from joulemap.service.schemas.base import Point3, ResponseModel
from joulemap.service.speeds import Speeds


class AtSpeedOut(ResponseModel):
    """The route at one speed."""

    speed_mps: float = Field(description="cruising speed [m/s]")
    energy_j: float = Field(description="energy of the route, idle power and turns included [J]")
    duration_s: float = Field(description="time, turns on the spot not counted [s]")


class SpeedProfileOut(ResponseModel):
    """A speed for each stretch of the route."""

    until_m: list[float] = Field(description="where each stretch ends, from the start [m]")
    speed_mps: list[float] = Field(description="its speed [m/s]")
    energy_j: float = Field(description="energy, idle power, changes of speed and turns included [J]")
    duration_s: float = Field(description="time, turns on the spot not counted [s]")


class SpeedsOut(ResponseModel):
    """Energy against time along one route, at the speeds that the model learned from."""

    text: str = Field(description="the answer in one sentence")
    cheapest: AtSpeedOut = Field(description="the speed of least energy")
    declared: AtSpeedOut | None = Field(description="the robot's own speed; null where the model does not know it")
    curve: list[AtSpeedOut] = Field(description="from the slowest to the fastest speed that the model knows")
    at_border: Literal["slowest", "fastest"] | None = Field(
        description="where the cheapest speed is at the border of what the model knows"
    )
    profile: SpeedProfileOut | None = Field(description="a speed for each stretch; null where it was not asked for")
    source: str = Field(description="where the range of speeds comes from")
    length_m: float = Field(description="horizontal length of the route [m]")
    path: list[Point3] = Field(repr=False)
    warnings: list[str]


def speeds_out(found: Speeds, route: Route, warnings: list[str]) -> SpeedsOut:
    """Return the answer to the question for speeds.

    Parameters
    ----------
    found : Speeds
        What was found.
    route : Route
        Along which.
    warnings : list of str
        Of the cost map.

    Returns
    -------
    SpeedsOut
        As it is sent.
    """
    return SpeedsOut(
        text=f"{found}.",
        **asdict(found),
        length_m=route.length_m,
        path=path_points(route),
        warnings=[*warnings, *route.notes],
    )
