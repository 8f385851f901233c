"""Questions to a cost map, paths and verdicts, and their answers: every field with its unit."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from joulemap.planner.plan import PLANNERS
from joulemap.service.schemas.base import PathPoint, Point, Point3, Request, ResponseModel, RobotIn


class BatteryIn(Request):
    """A battery; what is left out is the robot's own, full and without a reserve."""

    capacity_wh: float | None = Field(default=None, gt=0, le=1e9, description="energy when full [Wh]", examples=[280.0])
    charge: float = Field(
        default=1.0, ge=0, le=1, description="state of charge at the start, 0..1 (0.6 is 60 %)", examples=[0.8]
    )
    reserve: float = Field(
        default=0.0, ge=0, le=1, description="share of the capacity that must remain at the end, 0..1", examples=[0.2]
    )

    @field_validator("charge", "reserve", mode="before")
    @classmethod
    def _no_percentage(cls, value: Any, info: ValidationInfo) -> Any:
        if isinstance(value, int | float) and 1 < value <= 100:
            raise ValueError(
                f"{info.field_name} is {value:g}; it lies between 0 and 1: for {value:g} % write {value / 100:g}"
            )
        return value


class PathRequest(Request):
    """From where to where, and how to search."""

    start: Point = Field(examples=[[12.5, 40.5]])
    goal: Point = Field(examples=[[80.0, 15.0]])
    planner: Literal[PLANNERS] = Field(default="astar", description="sampling planners use the whole time limit")  # type: ignore[valid-type]
    neighbours: Literal[8, 16, 32] = Field(default=16, description="moves per cell of the grid planners")
    refine: bool = Field(default=True, description="any-angle improvement of the grid path")
    time_limit_s: float = Field(default=5.0, ge=0.05, le=60.0, description="for the sampling planners [s]")
    seed: int = Field(default=0, ge=0, le=2**31 - 1, description="for the sampling planners")
    alternatives: int = Field(default=0, ge=0, le=10, description="other good ways to look for, at most")
    battery: BatteryIn | None = Field(default=None, description="asks for a verdict")
    robot: RobotIn | None = Field(default=None, description="refused when it differs from the cost map's")


class PieceOut(ResponseModel):
    """A piece of at most a metre."""

    distance_m: float = Field(description="horizontal distance from the start at its end [m]")
    x: float = Field(description="at its end [m]")
    y: float = Field(description="at its end [m]")
    z: float | None = Field(description="at its end [m]")
    heading_deg: float = Field(description="clockwise from north [deg]")
    energy_j: float = Field(description="energy of the piece, the turn at its beginning included [J]")
    cumulative_j: float = Field(description="energy from the start to its end [J]")


class VerdictOut(ResponseModel):
    """Whether the battery lasts."""

    feasible: bool
    message: str = Field(description="the verdict in words")
    energy_j: float = Field(description="energy of the task [J]")
    available_j: float = Field(description="energy above the reserve at the start [J]; negative when already below")
    margin_j: float = Field(ge=0, description="what is left above the reserve [J]; 0 when infeasible")
    shortfall_j: float = Field(ge=0, description="what is missing [J]; 0 when feasible")
    charge_at_start: float = Field(description="state of charge, 0..1")
    charge_at_end: float = Field(description="state of charge after the task, 0..1")
    reserve: float = Field(description="share of the capacity that must remain, 0..1")
    energy_std_j: float | None = Field(
        description="standard deviation of energy_j [J]; null where the model does not know how far off it may be"
    )
    probability: float | None = Field(description="that the battery lasts, 0..1; null likewise")


class ShortestOut(ResponseModel):
    """The shortest path within the same limits, priced the same way."""

    energy_j: float = Field(description="[J]")
    length_m: float = Field(description="horizontal [m]")
    path: list[Point3]


class RouteOut(ResponseModel):
    """A path with its price."""

    energy_j: float = Field(description="[J]", examples=[12345.6])
    energy_wh: float = Field(description="[Wh]", examples=[3.43])
    length_m: float = Field(description="horizontal [m]", examples=[97.1])
    duration_s: float = Field(description="at the robot's speed [s]", examples=[194.2])
    climb_m: float = Field(ge=0, description="all ascents [m]", examples=[4.2])
    descent_m: float = Field(ge=0, description="all descents [m]", examples=[1.1])
    path: list[Point3]


class PathOut(RouteOut):
    """The energy-optimal path, and the shortest one beside it."""

    profile: list[PieceOut]
    shortest: ShortestOut
    alternatives: list[RouteOut] = Field(description="other good ways, cheapest first; empty unless asked for")
    saving_j: float = Field(description="energy saved against the shortest path [J]")
    saving_percent: float = Field(description="the same, as a percentage of the shortest path's energy")
    battery: VerdictOut | None = Field(description="null unless asked for")
    planner: str = Field(examples=["astar"])
    details: dict[str, Any] = Field(description="how it was found")
    warnings: list[str]
    crs: str | None


class FeasibilityRequest(Request):
    """A task, either a path or start and goal, and a battery."""

    path: list[PathPoint] | None = Field(
        default=None, min_length=2, max_length=100_000, description="world points [m], in order"
    )
    start: Point | None = Field(default=None, examples=[[12.5, 40.5]])
    goal: Point | None = Field(default=None, examples=[[80.0, 15.0]])
    round_trip: bool = Field(default=False, description="and back: a path reversed, or the best way back")
    battery: BatteryIn | None = Field(default=None, description="default: the robot's own, full, without a reserve")
    robot: RobotIn | None = Field(default=None, description="refused when it differs from the cost map's")

    @model_validator(mode="after")
    def _one_task(self) -> FeasibilityRequest:
        ends = (self.start is not None) + (self.goal is not None)
        if (self.path is None and ends < 2) or (self.path is not None and ends > 0):
            raise ValueError("give either `path`, or `start` and `goal`")
        return self


class FeasibilityOut(VerdictOut):
    """The verdict with the routes it was judged by."""

    length_m: float = Field(description="horizontal, there and back [m]")
    duration_s: float = Field(description="there and back at the robot's speed [s]")
    out: RouteOut
    back: RouteOut | None = Field(description="null unless a round trip")
    warnings: list[str]
