"""Heightmaps and cost maps in requests and answers: every field with its unit."""

from __future__ import annotations

import datetime as dt
from typing import Annotated, Any, Literal

from pydantic import Field

from joulemap.model.ranges import HEADINGS, SPACING_M
from joulemap.model.terrain.layers.kinds import MOST_FACTOR, MOST_KINDS, MOST_RESISTANCE
from joulemap.model.terrain.layers.layer import COST, FACTOR, LIMITS, ROLES
from joulemap.planner.lattice.build import DEFAULT_HEADINGS
from joulemap.service.models import DEFAULT_MODEL
from joulemap.service.schemas.base import (
    JobOut,
    Problem,
    Request,
    ResponseModel,
    RobotIn,
    RobotOut,
    within,
)


class HeightmapOut(ResponseModel):
    """A heightmap that is kept."""

    id: str = Field(examples=["hm-5f0c2a9d41be"])
    name: str = Field(examples=["uma_rescue_area_1m.tif"])
    created_at: dt.datetime = Field(description="UTC")
    rows: int = Field(description="cells from north to south", examples=[200])
    cols: int = Field(description="cells from west to east", examples=[300])
    resolution_m: float = Field(description="side of a cell [m]", examples=[1.0])
    crs: str | None = Field(description="coordinate reference system; null where unknown", examples=["EPSG:32630"])
    bounds: list[float] = Field(
        min_length=4, max_length=4, description="[west, south, east, north] [m]", examples=[[0.0, 0.0, 300.0, 200.0]]
    )
    known_share: float = Field(description="share of cells whose height is known, 0..1", examples=[0.98])
    height_min_m: float = Field(description="lowest known height [m]", examples=[48.2])
    height_max_m: float = Field(description="highest known height [m]", examples=[73.9])
    hash: str = Field(
        description="hash of heights and position: equal maps have equal hashes", examples=["9e107d9d372bb682"]
    )
    noise_m: float | None = Field(
        default=None,
        description="standard deviation of the survey's noise [m], given or estimated: prices and limits are made of "
        "the ground without it; null for maps of earlier versions, which estimate it when they are used",
        examples=[0.031],
    )
    noise_length_m: float = Field(default=0.0, description="length over which that noise is alike [m]", examples=[0.0])
    band: int | None = Field(
        default=None, description="band of the sent GeoTIFF that holds the heights, from 1; null where none was named"
    )
    notes: list[str] = Field(
        default=[], description="what was done to the heights as they were read, and what of them is hardly right"
    )
    links: dict[str, str]


LayerRole = Literal["kinds", "obstacles", "free", "factor", "cost"]


StoredValue = Annotated[int, Field(ge=-(2**31), le=2**32 - 1)]
"""A value of a raster, which has at most 32 bits."""


class KindIn(Request):
    """What a kind of ground costs: one of `rolling_resistance` and `factor`, or nothing where it is `blocked`."""

    rolling_resistance: float | None = Field(
        default=None, ge=0.0, le=MOST_RESISTANCE, description="in place of the robot's own", examples=[0.06]
    )
    factor: float | None = Field(
        default=None,
        ge=0.0,
        le=MOST_FACTOR,
        description="of the energy of motion on the robot's own ground",
        examples=[None],
    )
    std: float = Field(
        default=0.0,
        ge=0.0,
        le=MOST_FACTOR,
        description="standard deviation of whichever of both is given",
        examples=[0.02],
    )
    blocked: bool = Field(default=False, description="no part of the robot may be over it", examples=[False])
    value: Annotated[list[StoredValue], Field(max_length=MOST_KINDS)] | StoredValue = Field(
        default=[],
        description="numbers that mean it where polygons have the property `kind`, `value` or `DN` as a number",
        examples=[2],
    )


class CostmapOptions(Request):
    """Settings of a cost map."""

    robot: RobotIn | None = Field(default=None, description="default: the paper's 4WD robot")
    model: str = Field(
        default=DEFAULT_MODEL,
        max_length=100,
        description="`physics`, `default`, or the id of a trained model",
        examples=["physics"],
    )
    spacing_m: Annotated[float, within(SPACING_M)] = Field(
        default=1.0, description="side of a cell [m]", examples=[1.0]
    )
    layers: dict[LayerRole, dict[str, Any]] = Field(
        default={},
        max_length=len(ROLES),
        description="what is known of the ground beside its height, as GeoJSON with polygons, in the map's CRS or in "
        "degrees: `kinds` (features with the property `kind`, a name or a value of the legend), `obstacles`, `free` "
        "(the only ground to be driven on), `factor` (property `factor`, of the energy, 0 to "
        f"{LIMITS[FACTOR][1]:,.0f}) or `cost` (property `cost`, added J/m, 0 to {LIMITS[COST][1]:,.0f})",
        examples=[{}],
    )
    legend: dict[str, KindIn] = Field(
        default={},
        max_length=MOST_KINDS,
        description="what kinds of ground cost, by name; others are those of the library",
        examples=[{}],
    )
    headings: int = Field(
        default=DEFAULT_HEADINGS,
        ge=int(HEADINGS.low),
        le=int(HEADINGS.high),
        description="number of heading bins",
        examples=[16],
    )


class CostmapRequest(CostmapOptions):
    """A cost map of a heightmap that was sent before."""

    heightmap_id: str = Field(max_length=100, examples=["hm-5f0c2a9d41be"])


class FrameOut(ResponseModel):
    """Where the cost map's cells lie; row 0 is north."""

    rows: int = Field(examples=[200])
    cols: int = Field(examples=[300])
    spacing_m: float = Field(description="side of a cell [m]", examples=[1.0])
    bounds: list[float] = Field(min_length=4, max_length=4, description="[west, south, east, north] [m]")
    crs: str | None = Field(examples=["EPSG:32630"])


class SpreadOut(ResponseModel):
    """Energy per metre over all cells and headings that are not blocked."""

    min: float = Field(description="[J/m]")
    mean: float = Field(description="[J/m]")
    max: float = Field(description="[J/m]")


class BlockedOut(ResponseModel):
    """Share of all pairs of cell and heading, 0..1, by the reason why they are blocked."""

    free: float = Field(description="not blocked")
    outside: float = Field(description="the square metre around the cell leaves the heightmap")
    unknown: float = Field(description="a height in this square is unknown")
    step: float = Field(description="a boulder or a hole: ground that departs from a plane by a wheel's diameter")
    obstacle: float = Field(default=0.0, description="the robot's outline meets a height jump above the wheel radius")
    grade: float = Field(description="steeper along the motion than max_grade_deg")
    cross_slope: float = Field(description="steeper across the motion than max_cross_slope_deg")
    avoid: float = Field(default=0.0, description="inside an area of a question that is to be avoided")
    power: float = Field(default=0.0, description="takes more power than a question allows")


class CostmapOut(JobOut):
    """A cost map that waits, is made, or is done. What is known only at the end is null before."""

    id: str = Field(examples=["cm-0d4b8f6a2c17"])
    heightmap_id: str = Field(examples=["hm-5f0c2a9d41be"])
    robot: RobotOut = Field(description="once done, with the energy of turning that the model learned")
    model: str = Field(description="the model's name or id", examples=["physics"])
    headings: int = Field(description="number of heading bins; bin k points to 360 k / headings degrees", examples=[16])
    spacing_m: float = Field(description="side of a cell [m]", examples=[1.0])
    frame: FrameOut | None
    energy_per_m: SpreadOut | None = Field(description="null before it is done, and where everything is blocked")
    blocked: BlockedOut | None
    warnings: list[str] = Field(description="how the map or the robot differs from what the model was trained on")
    provenance: dict[str, Any] | None = Field(
        description="model (name, kind, version, and what it was made from), heightmap, settings and versions it was "
        "made with; the link `provenance` says everything about the model"
    )
    problem: Problem | None = Field(description="why it failed")
    links: dict[str, str]


class FieldOut(ResponseModel):
    """Figures of an energy field."""

    kind: Literal["from", "to", "through"] = Field(description="from the start, to the goal, or over the cell")
    cells: int = Field(description="cells of the map")
    reached: int = Field(description="cells with a path")
    least_j: float | None = Field(description="least energy of a cell; with start and goal, of the best grid path [J]")
    most_j: float | None = Field(description="largest energy of a cell [J]")
    corridor_cells: int | None = Field(description="cells of the corridor, where one was asked for")
    warnings: list[str] = Field(default=[], description="how places in degrees were read")


class AtOut(ResponseModel):
    """Energy per metre at one place in all headings."""

    x: float = Field(description="[m]")
    y: float = Field(description="[m]")
    elevation_m: float | None = Field(description="[m]; null where unknown")
    headings_deg: list[float] = Field(description="clockwise from north [deg]")
    energy_per_m: list[float | None] = Field(description="[J/m] per heading; null where it is blocked")
    blocked: list[str | None] = Field(description="reason per heading; null where it is not blocked")
