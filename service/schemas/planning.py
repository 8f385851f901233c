"""Questions to a cost map, paths and verdicts, and their answers: every field with its unit."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, WrapValidator, field_validator, model_validator

from joulemap.model.ranges import BATTERY, BATTERY_CURVES, CURVE_POINTS, SEARCH_S, Range
from joulemap.planner.route_planner import PLANNERS
from joulemap.service.schemas.base import (
    Areas,
    PathPlace,
    Place,
    Point3,
    Request,
    ResponseModel,
    RobotIn,
    quick_points,
    within,
)
from joulemap.service.schemas.objectives import ObjectiveOut, WeighedRequest

_UNKNOWN = "null where the model does not know its uncertainty"
_STD = Field(description=f"standard deviation of energy_j [J]; {_UNKNOWN}", examples=[1234.5])
_P05, _P50, _P95 = (
    Field(description=f"energy that {percent} % of drives do not exceed [J]; {_UNKNOWN}", examples=[energy])
    for percent, energy in ((5, 10432.1), (50, 12345.6), (95, 14259.1))
)


def _curve_of(name: str) -> Any:
    """The type of a battery's curve: points of two numbers, within the bounds of either."""
    at, value = BATTERY_CURVES[name]
    number = Annotated[float, within(Range(min(at.low, value.low), max(at.high, value.high)))]
    return list[Annotated[list[number], Field(min_length=2, max_length=2)]]


class BatteryIn(Request):
    """A battery. What is left out is as in the robot's own battery, full and without a reserve.

    With capacity, charge, reserve, health and temperature alone, a verdict counts energy. Once one of `open_circuit_v`,
    `resistance_ohm`, `cutoff_v` and `max_power_w` is given, it counts losses inside the battery and its voltage under
    the power of every metre too.
    """

    capacity_wh: Annotated[float, within(BATTERY["capacity_wh"])] | None = Field(
        default=None, description="energy when full [Wh]", examples=[280.0]
    )
    charge: Annotated[float, within(BATTERY["charge"])] = Field(
        default=1.0,
        description="state of charge at the start, 0..1 (0.6 is 60 %)",
        examples=[0.8],
    )
    reserve: Annotated[float, within(BATTERY["reserve"])] = Field(
        default=0.0,
        description="share of the capacity that must remain at the end, 0..1",
        examples=[0.2],
    )

    health: Annotated[float, within(BATTERY["health"])] = Field(
        default=1.0, description="share of the capacity that age has left, 0.05..1"
    )
    temperature_c: Annotated[float, within(BATTERY["temperature_c"])] | None = Field(
        default=None, description="temperature of the battery [degC]; below 15 degC it needs `capacity_curve`"
    )
    capacity_curve: _curve_of("capacity_curve") | None = Field(  # type: ignore[valid-type]
        default=None,
        min_length=2,
        max_length=CURVE_POINTS,
        description="points [temperature in degC, share of the capacity that the battery gives there], ascending",
        examples=[[[-20.0, 0.6], [0.0, 0.85], [20.0, 1.0]]],
    )
    nominal_voltage_v: Annotated[float, within(BATTERY["nominal_voltage_v"])] | None = Field(
        default=None, description="nominal voltage [V]; default: that of the robot"
    )
    open_circuit_v: _curve_of("open_circuit_v") | None = Field(  # type: ignore[valid-type]
        default=None,
        min_length=2,
        max_length=CURVE_POINTS,
        description="points [state of charge, voltage without a load in V] from 0 to 1, ascending; default: the curve "
        "of a plain lithium-ion pack of the nominal voltage",
        examples=[[[0.0, 21.0], [0.2, 26.5], [1.0, 33.2]]],
    )
    resistance_ohm: Annotated[float, within(BATTERY["resistance_ohm"])] | None = Field(
        default=None, description="internal resistance of the pack [ohm]; default: that of a plain pack"
    )
    cutoff_v: Annotated[float, within(BATTERY["cutoff_v"])] | None = Field(
        default=None, description="voltage under load below which the robot switches off [V]; default: a plain pack's"
    )
    max_power_w: Annotated[float, within(BATTERY["max_power_w"])] | None = Field(
        default=None, description="most power that the battery gives [W]; default: no limit of its own"
    )

    @field_validator("charge", "reserve", "health", mode="before")
    @classmethod
    def _no_percentage(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, int | float) and 1 < value <= 100:
            raise ValueError(
                f"{info.field_name} is {value:g}; it lies between 0 and 1: for {value:g} % write {value / 100:g}"
            )
        return value


class PathRequest(WeighedRequest):
    """From where to where, and how to search."""

    start: Place = Field(examples=[[12.5, 40.5]])
    goal: Place = Field(examples=[[80.0, 15.0]])
    planner: Literal[PLANNERS] = Field(default="astar", description="the sampling planners use the whole time limit")  # type: ignore[valid-type]
    neighbours: Literal[8, 16, 32] = Field(
        default=16, description="moves per cell of the grid planners without `refine`; with it they are 32"
    )
    refine: bool = Field(default=True, description="shorten the grid path where it need not follow the grid")
    time_limit_s: Annotated[float, within(SEARCH_S)] = Field(
        default=5.0, description="how long the sampling planners search [s]"
    )
    seed: int = Field(default=0, ge=0, le=2**31 - 1, description="seed of the sampling planners")
    alternatives: int = Field(default=0, ge=0, le=10, description="most other good paths to look for")
    bound: bool = Field(
        default=False, description="search for a sharper `bound_j`, which takes some seconds once per cost map"
    )
    snap: bool = Field(
        default=False,
        description="move a start or goal on blocked ground to the nearest free place; a warning says where that is",
    )
    avoid: Areas = Field(default=[])
    battery: BatteryIn | None = Field(default=None, description="given: the answer says whether this battery lasts")
    robot: RobotIn | None = Field(default=None, description="refused where it differs from the cost map's robot")


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


class FeasibilityRequest(WeighedRequest):
    """A task, either a path or start and goal, and a battery."""

    path: Annotated[list[PathPlace], Field(fail_fast=True), WrapValidator(quick_points)] | None = Field(
        default=None, min_length=2, max_length=100_000, description="world points [m], in order"
    )
    start: Place | None = Field(default=None, examples=[[12.5, 40.5]])
    goal: Place | None = Field(default=None, examples=[[80.0, 15.0]])
    snap: bool = Field(
        default=False,
        description="move a start or goal on blocked ground to the nearest free place; a warning says where that is. A "
        "given path is never moved",
    )
    round_trip: bool = Field(
        default=False, description="also drive back: a given path in reverse, else the best way back"
    )
    avoid: Areas = Field(default=[])
    battery: BatteryIn | None = Field(default=None, description="default: the robot's own, full, without a reserve")
    profile: bool = Field(default=False, description="also answer charge and voltage along the way")
    robot: RobotIn | None = Field(default=None, description="refused where it differs from the cost map's robot")

    @model_validator(mode="after")
    def _one_task(self) -> FeasibilityRequest:
        ends = (self.start is not None) + (self.goal is not None)
        if (self.path is None and ends < 2) or (self.path is not None and ends > 0):
            raise ValueError("give either `path`, or `start` and `goal`")
        if self.path is not None and (self.objective != "mean" or self.max_power_w is not None):
            raise ValueError("`objective` and `max_power_w` choose a path: give `start` and `goal` in place of `path`")
        return self


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
