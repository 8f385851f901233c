"""Answers to questions about routes: every field with its unit."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from joulemap.service.schemas.base import Point3, ResponseModel

_UNKNOWN = "null where the model does not know its uncertainty"
_STD = Field(description=f"standard deviation of energy_j [J]; {_UNKNOWN}", examples=[1234.5])
_P05, _P50, _P95 = (
    Field(description=f"energy that {percent} % of drives do not exceed [J]; {_UNKNOWN}", examples=[energy])
    for percent, energy in ((5, 10432.1), (50, 12345.6), (95, 14259.1))
)


class ObjectiveOut(ResponseModel):
    """How a route does by its objective, beside the route of least expected energy."""

    name: Literal["quantile", "arrival"] = Field(description="of the objective")
    quantile: float | None = Field(description="share of drives; null for arrival")
    quantile_j: float | None = Field(description="energy that this share of drives does not exceed [J]; null as above")
    mean_quantile_j: float | None = Field(
        description="the same on the route of least expected energy [J], never less; null as above"
    )
    probability: float | None = Field(description="that the battery lasts, with its tails; null for quantile")
    mean_probability: float | None = Field(
        description="the same on the route of least expected energy, never more; null as above"
    )
    gap: float | None = Field(
        description="by how much a better route may be better: as a share of the energy, or as a difference of "
        "probabilities, if every search found its cheapest route and the variance of a route is that of its metres; "
        "null where nothing is known"
    )
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


class PlaceOut(ResponseModel):
    """A place on the way, where something happens."""

    distance_m: float = Field(description="from the start; over both ways of a round trip [m]")
    time_s: float = Field(description="from the start, at the robot's speed [s]")
    x: float = Field(description="[m]")
    y: float = Field(description="[m]")


class VerdictOut(ResponseModel):
    """Whether the battery lasts."""

    feasible: bool = Field(description="whether the battery lasts without using the reserve")
    message: str = Field(description="the verdict in words")
    energy_j: float = Field(description="energy of the task [J]")
    available_j: float = Field(
        description="energy above the reserve at the start [J]; negative where the charge is already below it"
    )
    margin_j: float = Field(ge=0, description="energy left above the reserve [J]; 0 where it does not last")
    shortfall_j: float = Field(ge=0, description="energy that is missing [J]; 0 where it lasts")
    charge_at_start: float = Field(description="state of charge before the task, 0..1")
    charge_at_end: float = Field(description="state of charge after the task, 0..1")
    reserve: float = Field(description="share of the capacity that must remain, 0..1")
    energy_std_j: float | None = _STD
    energy_p05_j: float | None = _P05
    energy_p50_j: float | None = _P50
    energy_p95_j: float | None = _P95
    verdict: Literal["yes", "likely", "marginal", "no"] = Field(
        description="yes: lasts with a probability of 95 % or more; likely: 2/3 or more; marginal: 1/3 or more; no: "
        "less. Without a probability, as if whole routes erred by half of their energy (a standard deviation)"
    )
    verdict_text: str = Field(description="one sentence: how likely, what it takes, where most of it goes")
    charge_for_yes: float | None = Field(
        description="least state of charge at the start for a yes, 0..1; null where a full battery is not enough"
    )
    yes_until_m: float | None = Field(
        description="distance up to which it is a yes [m]; null where it is one to the end"
    )
    reserve_at: PlaceOut | None = Field(
        description="where and when the reserve is touched, at the expected energy; null where it is not"
    )
    overload_at: PlaceOut | None = Field(
        description="where the power is first more than the battery can give; null where it never is, and for a "
        "battery of which only energy is known"
    )
    overload_w: float | None = Field(description="power there [W]")
    most_power_w: float | None = Field(description="most power that the battery can give there [W]")
    least_voltage_v: float | None = Field(
        description="least voltage under load [V], before any overload; null where only the energy of the battery is "
        "known"
    )
    probability: float | None = Field(
        description="probability that the battery lasts, 0.01..0.99: 0.99 means at least 0.99 and 0.01 at most 0.01, "
        "because the tails of the distribution are not known; null where the model does not know its uncertainty"
    )


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
    back: RouteOut | None = Field(description="the way back; null unless a round trip was asked for")
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
    """The tour of least energy. Turning on arrival at a stop is not counted."""

    order: list[int] = Field(
        description="numbers of the stops in the order of the visit, 0 first", examples=[[0, 2, 1]]
    )
    profile: list[PieceOut] = Field(repr=False, description="energy and height along the whole tour")
    legs: list[RouteOut] = Field(description="from each stop to the next, and from the last home unless `one_way`")
    grid_energy_j: float = Field(description="energy of the tour along the grid, before `refine` [J]")
    bound_j: float = Field(description="lower bound of the energy of any order along the grid [J]")
    proven: bool = Field(description="whether no other order costs less energy along the grid, or the order was given")
    battery: VerdictOut | None = Field(description="whether the battery lasts; null unless asked for")
    warnings: list[str]
    crs: str | None
