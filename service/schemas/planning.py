"""Answers to questions about routes: every field with its unit, and routes and verdicts as them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, Literal

import numpy as np
from pydantic import Field

from joulemap.planner.route import Route
from joulemap.planner.verdict.battery_trace import BatteryTrace
from joulemap.planner.verdict.budget import Verdict
from joulemap.planner.verdict.trajectory import Course
from joulemap.service.analysis.objectives import Weighed
from joulemap.service.analysis.route_uncertainty import odds_along, quantiles_of_route
from joulemap.service.schemas.base import PlaceOut, Point3, ResponseModel, like
from joulemap.service.words import verdict_words

_UNKNOWN = "null where the model does not know its uncertainty"
_STD = Field(description=f"standard deviation of energy_j [J]; {_UNKNOWN}", examples=[1234.5])
_P05, _P50, _P95 = (
    Field(description=f"energy that {percent} % of drives do not exceed [J]; {_UNKNOWN}", examples=[energy])
    for percent, energy in ((5, 10432.1), (50, 12345.6), (95, 14259.1))
)


class ObjectiveOut(like(Weighed)):  # type: ignore[misc]
    """How a route does by its objective, beside the route of least expected energy."""

    name: Literal["quantile", "arrival"] = Field(description="of the objective")
    searches: int = Field(ge=1, description="number of prices of uncertainty that were searched")


class PieceOut(ResponseModel):
    """A piece of the path, at most a metre long."""

    distance_m: float = Field(description="horizontal distance from the start to the end of the piece [m]")
    x: float = Field(description="at the end of the piece [m]")
    y: float = Field(description="at the end of the piece [m]")
    z: float | None = Field(description="at the end of the piece [m]")
    heading_deg: float = Field(description="clockwise from north [deg]")
    energy_j: float = Field(description="energy of the piece, including the turn at its beginning [J]")
    cumulative_j: float = Field(description="energy from the start to the end of the piece [J]")
    cumulative_p05_j: float | None = Field(
        description="5 % of such drives take less up to there [J]; null where the model does not know its uncertainty"
    )
    cumulative_p95_j: float | None = Field(description="95 % of such drives take less up to there [J]; null as above")


class VerdictOut(like(Verdict, Place=PlaceOut)):  # type: ignore[misc]
    """Whether the battery lasts."""

    message: str = Field(description="the verdict in words")
    margin_j: float = Field(ge=0, description="energy left above the reserve [J]; 0 where it does not last")
    shortfall_j: float = Field(ge=0, description="energy that is missing [J]; 0 where it lasts")
    energy_std_j: float | None = _STD
    energy_p05_j: float | None = _P05
    energy_p50_j: float | None = _P50
    energy_p95_j: float | None = _P95
    verdict: Literal["yes", "likely", "marginal", "no"] = Field(
        description="yes: lasts with a probability of 95 % or more; likely: 2/3 or more; marginal: 1/3 or more; no: "
        "less. Without a probability, as if whole routes erred by half of their energy (a standard deviation)"
    )
    overload_w: float | None = Field(description="power there [W]")
    most_power_w: float | None = Field(description="most power that the battery can give there [W]")


class ShortestOut(ResponseModel):
    """The shortest path within the same limits, with its energy by the same model."""

    energy_j: float = Field(description="energy [J]")
    length_m: float = Field(description="horizontal length [m]")
    path: list[Point3] = Field(repr=False)


class RouteOut(ResponseModel):
    """A path with its energy."""

    energy_j: float = Field(description="energy [J]", examples=[12345.6])
    energy_std_j: float | None = _STD
    energy_p05_j: float | None = _P05
    energy_p50_j: float | None = _P50
    energy_p95_j: float | None = _P95
    energy_wh: float = Field(description="energy [Wh]", examples=[3.43])
    length_m: float = Field(description="horizontal length [m]", examples=[97.1])
    duration_s: float = Field(description="time at the robot's speed [s]", examples=[194.2])
    climb_m: float = Field(ge=0, description="sum of all ascents [m]", examples=[4.2])
    descent_m: float = Field(ge=0, description="sum of all descents [m]", examples=[1.1])
    goal_moved_m: float = Field(
        default=0.0, ge=0, description="how far `snap` moved the goal, or it was moved within its cell [m]"
    )
    tightest_radius_m: float | None = Field(
        default=None,
        ge=0,
        description="radius of its tightest curve, an arc within its legs [m]; null if straight",
    )
    path: list[Point3] = Field(repr=False)


class PathOut(RouteOut):
    """The energy-optimal path, and the shortest path for comparison."""

    profile: list[PieceOut] = Field(repr=False, description="energy and height along the path")
    shortest: ShortestOut
    alternatives: list[RouteOut] = Field(
        description="other good paths, the one of least energy first; empty unless asked for"
    )
    saving_j: float = Field(description="energy saved against the shortest path [J]")
    saving_percent: float = Field(description="energy saved, as a percentage of the shortest path's energy")
    battery: VerdictOut | None = Field(description="whether the battery lasts; null unless asked for")
    bound_j: float | None = Field(
        description="no path between the two places takes less energy than this, proven [J]; null if unknown"
    )
    gap: float | None = Field(description="by which share the path may cost more than the best one: energy / bound - 1")
    objective: ObjectiveOut | None = Field(
        description="what the path was chosen by, and how well it does; null for the least expected energy"
    )
    planner: str = Field(examples=["astar"])
    details: dict[str, Any] = Field(description="how the path was found")
    warnings: list[str]
    crs: str | None


class BatteryPieceOut(ResponseModel):
    """The battery at the end of a piece of the way, at the expected energy."""

    distance_m: float = Field(description="from the start; over both ways of a round trip [m]")
    time_s: float = Field(description="from the start, at the robot's speed [s]")
    charge: float = Field(description="state of charge, 0..1")
    voltage_v: float = Field(description="voltage under load [V]; 0 where the battery cannot give the power")
    power_w: float = Field(description="mean power of the piece [W]")


class FeasibilityOut(VerdictOut):
    """The verdict, and the routes that it was made from."""

    length_m: float = Field(description="horizontal length of all routes [m]")
    duration_s: float = Field(description="time for all routes at the robot's speed [s]")
    out: RouteOut
    back: RouteOut | None = Field(description="the way back, its first turn included; null unless it was asked for")
    objective: ObjectiveOut | None = Field(
        description="what both ways were chosen by together; null for the least expected energy"
    )
    profile: list[BatteryPieceOut] | None = Field(
        repr=False,
        description="charge and voltage along the way, of a plain lithium-ion pack where the battery does not say; "
        "null unless asked for",
    )
    warnings: list[str]


class TourOut(RouteOut):
    """The tour of least energy. The energy of a leg has the turn from the end of the leg before it."""

    order: list[int] = Field(
        description="numbers of the stops in the order of the visit, 0 first", examples=[[0, 2, 1]]
    )
    profile: list[PieceOut] = Field(repr=False, description="energy and height along the whole tour")
    legs: list[RouteOut] = Field(description="from each stop to the next, and from the last home unless `one_way`")
    grid_energy_j: float = Field(description="energy along the grid, before `refine`, without turns at stops [J]")
    bound_j: float = Field(description="lower bound of the energy of any order along the grid [J]")
    proven: bool = Field(description="whether no other order costs less energy along the grid, or the order was given")
    battery: VerdictOut | None = Field(description="whether the battery lasts; null unless asked for")
    warnings: list[str]
    crs: str | None


BAND = 0.05, 0.95
"""Nine of ten drives end between these quantiles."""


def verdict_out(verdict: Verdict) -> VerdictOut:
    """Return a verdict as an answer."""
    return VerdictOut(message=verdict_words(verdict), **asdict(verdict))


def route_values(route: Route) -> dict[str, Any]:
    """Return the values of a route that `RouteOut` takes."""
    return {
        "energy_j": route.energy_j,
        **quantiles_of_route(route),
        "energy_wh": route.energy_j / 3600.0,
        "length_m": route.length_m,
        "duration_s": route.duration_s,
        "climb_m": route.climb_m,
        "descent_m": route.descent_m,
        "goal_moved_m": route.goal_moved_m,
        "tightest_radius_m": route.tightest_radius_m,
        "path": path_points(route),
    }


def profile_pieces(routes: Sequence[Route]) -> list[Any]:
    """Return the values of `PieceOut` along routes of one lattice that are driven one after another."""
    odds = odds_along(routes)
    profiles = [route.profile for route in routes]
    x, y, z, heading, energy = (
        np.concatenate([getattr(p, name) for p in profiles]) for name in ("x", "y", "z", "heading_rad", "energy_j")
    )
    driven = np.cumsum([0.0, *(route.length_m for route in routes)])
    distance = np.concatenate([p.distance_m + before for p, before in zip(profiles, driven, strict=False)])
    columns = [c.tolist() for c in (distance, x, y, z, np.rad2deg(heading), energy, np.cumsum(energy))]
    if not np.isfinite(z).all():
        columns[3] = [number(height) for height in columns[3]]
    columns += [[None] * energy.size if odds is None else odds.quantile(share).tolist() for share in BAND]
    names = tuple(PieceOut.model_fields)
    return [dict(zip(names, piece, strict=True)) for piece in zip(*columns, strict=True)]


def path_points(route: Route) -> list[list[float | None]]:
    """Return the points of a route, world [x, y, z] [m]; z is None where unknown."""
    if np.isfinite(route.points).all():
        return route.points.tolist()
    return [[number(v) for v in point] for point in route.points.tolist()]


def number(value: float) -> float | None:
    """Return a number as JSON knows it: None where it is not finite."""
    return value if math.isfinite(value) else None


def battery_pieces(course: Course, trace: BatteryTrace) -> list[Any]:
    """Return the values of `BatteryPieceOut` along a way."""
    columns = (course.distance_m, np.cumsum(course.duration_s), trace.charge, trace.voltage_v, trace.power_w)
    return [
        {"distance_m": distance, "time_s": time, "charge": charge, "voltage_v": voltage, "power_w": power}
        for distance, time, charge, voltage, power in zip(*(column.tolist() for column in columns), strict=True)
    ]
