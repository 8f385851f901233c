"""What requests and answers look like: every field with its unit."""

from __future__ import annotations

import datetime as dt
from dataclasses import fields
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, create_model, model_validator

from model.robot import Robot
from planner.lattice_build import DEFAULT_HEADINGS
from planner.plan import PLANNERS
from planner.tiles import HEADING_LIMITS
from service.models import DEFAULT_MODEL


class Request(BaseModel):
    """Strict: unknown fields, numbers in quotes, NaN and infinity are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class Answer(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


Point = Annotated[
    list[float],
    Field(min_length=2, max_length=3, description="world [x, y] in the map's CRS [m], east and north; z is ignored"),
]
PathPoint = Annotated[
    list[float | None],
    Field(min_length=2, max_length=3, description="world [x, y] or [x, y, z] [m]; z, which may be null, is ignored"),
]
Point3 = Annotated[
    list[float | None], Field(min_length=3, max_length=3, description="world [x, y, z] [m]; z null where unknown")
]

_ROBOT_WORDS = {
    "name": "what the robot is called",
    "mass_kg": "mass [kg]",
    "width_m": "width over the wheels [m]",
    "length_m": "length [m]",
    "wheel_radius_m": "wheel radius [m]; a higher step blocks",
    "nominal_voltage_v": "nominal battery voltage [V]",
    "speed_mps": "cruising speed [m/s]",
    "battery_wh": "energy of the full battery [Wh]",
    "idle_power_w": "power drawn by everything but the motion [W]",
    "max_grade_deg": "steepest slope along the motion, up and down [deg]",
    "max_cross_slope_deg": "steepest slope across the motion [deg]",
    "rolling_resistance": "coefficient of rolling resistance, dimensionless",
    "regeneration": "share of the energy released downhill that returns to the battery, 0..0.99",
    "turn_j_per_rad": "energy of turning by one radian [J/rad]",
}
_KIND: dict[str, Any] = {f.name: str if f.name == "name" else float for f in fields(Robot)}

RobotIn = create_model(  # type: ignore[call-overload]
    "RobotIn",
    __base__=Request,
    __doc__="A robot; a field left out has the default robot's value (in a question: the cost map's).",
    **{
        key: (kind | None, Field(default=None, description=_ROBOT_WORDS[key], examples=[getattr(Robot(), key)]))
        for key, kind in _KIND.items()
    },
)
RobotOut = create_model(  # type: ignore[call-overload]
    "RobotOut",
    __base__=Answer,
    __doc__="The robot whose prices and limits these are.",
    **{
        key: (kind, Field(description=_ROBOT_WORDS[key], examples=[getattr(Robot(), key)]))
        for key, kind in _KIND.items()
    },
)


def robot_values(robot: BaseModel | None) -> dict[str, Any]:
    """The fields that a request gave."""
    return robot.model_dump(exclude_none=True) if robot is not None else {}


class UploadOptions(BaseModel):
    """What a heightmap file may leave unsaid; as query parameters or form fields."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    name: str | None = Field(
        default=None, min_length=1, max_length=200, description="what to call it; else the file's name"
    )
    resolution_m: float | None = Field(
        default=None,
        description="side of a cell [m]; needed where the file does not say, refused where it says otherwise",
    )
    west_m: float = Field(default=0.0, description="x of the map's west edge [m], where the file does not say")
    north_m: float | None = Field(
        default=None,
        description="y of the map's north edge [m], where the file does not say; else south is y = 0",
    )
    crs: str | None = Field(
        default=None,
        min_length=1,
        max_length=4000,
        description="CRS in metres, e.g. EPSG:32630, where the file does not say",
    )
    scale_m: float | None = Field(default=None, description="metres per stored count; a PNG needs it")
    offset_m: float = Field(default=0.0, description="height of stored count 0 [m]")
    nodata: float | None = Field(
        default=None, description="stored value that means unknown, where the file does not declare it"
    )


class HeightmapOut(Answer):
    """A heightmap that is kept."""

    id: str = Field(examples=["hm-5f0c2a9d41be"])
    name: str = Field(examples=["uma_rescue_area_1m.tif"])
    created_at: dt.datetime = Field(description="UTC")
    rows: int = Field(description="cells from north to south", examples=[200])
    cols: int = Field(description="cells from west to east", examples=[300])
    resolution_m: float = Field(description="side of a cell [m]", examples=[1.0])
    crs: str | None = Field(description="coordinate reference system, null when unknown", examples=["EPSG:32630"])
    bounds: list[float] = Field(
        min_length=4, max_length=4, description="[west, south, east, north] [m]", examples=[[0.0, 0.0, 300.0, 200.0]]
    )
    known_share: float = Field(description="share of cells whose height is known, 0..1", examples=[0.98])
    height_min_m: float = Field(description="lowest known height [m]", examples=[48.2])
    height_max_m: float = Field(description="highest known height [m]", examples=[73.9])
    hash: str = Field(description="identity of heights and position", examples=["9e107d9d372bb682"])
    links: dict[str, str]


class CostmapOptions(Request):
    """How to make a cost map."""

    robot: RobotIn | None = Field(default=None, description="default: the paper's 4WD robot")  # type: ignore[valid-type]
    model: str = Field(
        default=DEFAULT_MODEL, max_length=100, description="`physics`, `default`, or the id of a trained model",
        examples=["physics"],
    )  # fmt: skip
    spacing_m: float = Field(default=1.0, ge=0.01, le=10_000.0, description="side of a cell [m]", examples=[1.0])
    headings: int = Field(
        default=DEFAULT_HEADINGS,
        ge=HEADING_LIMITS[0],
        le=HEADING_LIMITS[1],
        description="number of heading bins",
        examples=[16],
    )


class CostmapRequest(CostmapOptions):
    """A cost map of a heightmap that is kept already."""

    heightmap_id: str = Field(max_length=100, examples=["hm-5f0c2a9d41be"])


class FrameOut(Answer):
    """Where the cost map's cells lie; row 0 is north."""

    rows: int = Field(examples=[200])
    cols: int = Field(examples=[300])
    spacing_m: float = Field(description="side of a cell [m]", examples=[1.0])
    bounds: list[float] = Field(min_length=4, max_length=4, description="[west, south, east, north] [m]")
    crs: str | None = Field(examples=["EPSG:32630"])


class SpreadOut(Answer):
    """Over all cells and headings that may be driven."""

    min: float = Field(description="[J/m]")
    mean: float = Field(description="[J/m]")
    max: float = Field(description="[J/m]")


class BlockedOut(Answer):
    """Share of (cell, heading) pairs, 0..1, under each reason."""

    free: float
    outside: float = Field(description="the square metre around the cell leaves the heightmap")
    unknown: float = Field(description="a height in it is unknown")
    step: float = Field(description="a height jump above the wheel radius")
    grade: float = Field(description="steeper along the motion than max_grade_deg")
    cross_slope: float = Field(description="steeper across the motion than max_cross_slope_deg")


class Problem(BaseModel):
    """RFC 9457 problem details."""

    type: str = Field(examples=["urn:joulemap:problem:blocked"])
    title: str = Field(examples=["The question has no answer"])
    status: int = Field(examples=[422])
    detail: str = Field(examples=["start (3, 4) stands on blocked ground: step"])
    code: str = Field(description="the leaf of the error tree", examples=["blocked"])
    request_id: str | None = Field(examples=["3f9c1a7be2d04c55"])
    context: dict[str, Any] = Field(description="the offending value and the limit", examples=[{"reason": "step"}])


class CostmapOut(Answer):
    """A cost map: asked for, being made, or done. What is only known when done is null before."""

    id: str = Field(examples=["cm-0d4b8f6a2c17"])
    status: Literal["queued", "running", "done", "failed"]
    progress: float = Field(ge=0, le=1, description="0..1", examples=[1.0])
    created_at: dt.datetime = Field(description="UTC")
    finished_at: dt.datetime | None = Field(description="UTC")
    heightmap_id: str = Field(examples=["hm-5f0c2a9d41be"])
    robot: RobotOut  # type: ignore[valid-type]
    model: str = Field(description="the model's name or id", examples=["physics"])
    headings: int = Field(description="number of heading bins; bin k points to 360 k / headings degrees", examples=[16])
    spacing_m: float = Field(description="side of a cell [m]", examples=[1.0])
    frame: FrameOut | None
    energy_per_m: SpreadOut | None = Field(description="null too where nothing may be driven")
    blocked: BlockedOut | None
    warnings: list[str] = Field(description="where map or robot lie outside what the model knows")
    provenance: dict[str, Any] | None = Field(description="model, heightmap, settings and versions it was made with")
    problem: Problem | None = Field(description="why it failed")
    links: dict[str, str]


class AtOut(Answer):
    """Energy per metre at one place over all headings."""

    x: float = Field(description="[m]")
    y: float = Field(description="[m]")
    elevation_m: float | None = Field(description="[m]; null where unknown")
    headings_deg: list[float] = Field(description="clockwise from north [deg]")
    energy_per_m: list[float | None] = Field(description="[J/m] per heading; null where it may not be driven")
    blocked: list[str | None] = Field(description="reason per heading; null where it may be driven")


class BatteryIn(Request):
    """A battery; what is left out is the robot's own, full and without a reserve."""

    capacity_wh: float | None = Field(default=None, gt=0, le=1e9, description="energy when full [Wh]", examples=[280.0])
    charge: float = Field(default=1.0, ge=0, le=1, description="state of charge at the start, 0..1", examples=[0.8])
    reserve: float = Field(default=0.0, ge=0, le=1, description="share of it that must remain, 0..1", examples=[0.2])


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
    robot: RobotIn | None = Field(default=None, description="refused when it differs from the cost map's")  # type: ignore[valid-type]


class PieceOut(Answer):
    """A piece of at most a metre."""

    distance_m: float = Field(description="horizontal distance from the start at its end [m]")
    x: float = Field(description="at its end [m]")
    y: float = Field(description="at its end [m]")
    z: float | None = Field(description="at its end [m]")
    heading_deg: float = Field(description="clockwise from north [deg]")
    energy_j: float = Field(description="energy of the piece, the turn at its beginning included [J]")
    cumulative_j: float = Field(description="energy from the start to its end [J]")


class VerdictOut(Answer):
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


class ShortestOut(Answer):
    """The shortest path within the same limits, priced the same way."""

    energy_j: float = Field(description="[J]")
    length_m: float = Field(description="horizontal [m]")
    path: list[Point3]


class RouteOut(Answer):
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
    robot: RobotIn | None = Field(default=None, description="refused when it differs from the cost map's")  # type: ignore[valid-type]

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
