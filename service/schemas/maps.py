"""Heightmaps and cost maps in requests and answers, and what the page draws of them: every field with its unit."""

from __future__ import annotations

import datetime as dt
from typing import Any, Literal

from pydantic import Field

from joulemap.service.schemas.base import JobOut, Problem, ResponseModel, RobotOut


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
        min_length=4, max_length=4, description="west, south, east, north [m]", examples=[[0.0, 0.0, 300.0, 200.0]]
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
    layer: bool = Field(default=False, description="whether its numbers are no heights but a layer of cost maps")
    band: int | None = Field(
        default=None, description="band of the sent GeoTIFF that holds the heights, from 1; null where none was named"
    )
    notes: list[str] = Field(
        default=[], description="what was done to the heights as they were read, and what of them is hardly right"
    )
    links: dict[str, str]


class FrameOut(ResponseModel):
    """Where the cost map's cells lie; row 0 is north."""

    rows: int = Field(examples=[200])
    cols: int = Field(examples=[300])
    spacing_m: float = Field(description="side of a cell [m]", examples=[1.0])
    bounds: list[float] = Field(min_length=4, max_length=4, description="west, south, east, north [m]")
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


class ColourScaleOut(ResponseModel):
    """What the colours of a layer mean."""

    low: float = Field(description="value of the first colour; what is below has it too [J/m]")
    high: float = Field(description="value of the last colour; what is above has it too [J/m]")
    colours: list[str] = Field(description="evenly spaced from low to high, as #rrggbb")


class BlockedColourOut(ResponseModel):
    """How blocked ground is painted."""

    reason: str = Field(description="why it is blocked", examples=["step"])
    colour: str = Field(description="as #rrggbb")


class LayersOut(ResponseModel):
    """Where the layers of a cost map lie, and what their colours mean."""

    bounds: list[float] = Field(
        min_length=4, max_length=4, description="[west, south, east, north] of the pictures of `layer.png` [m]"
    )
    height_min_m: float | None = Field(description="lowest known height [m]")
    height_max_m: float | None = Field(description="highest known height [m]")
    mean: ColourScaleOut = Field(description="of the view `mean`")
    heading: ColourScaleOut = Field(description="of the view `heading`, the same for all headings")
    directionality: ColourScaleOut = Field(description="of the view `directionality`")
    blocked: list[BlockedColourOut] = Field(description="a colour for each reason")
    lat_lon: list[list[list[float]]] | None = Field(
        description="latitude and longitude [deg] of the map's corners, middles of its edges and its middle: three "
        "rows from north to south, each from west to east; null where the CRS is unknown"
    )
    piece_levels: int = Field(description="how many levels `piece.png` has; 0 where `layer.png` shows every cell")
    piece_pixels: int = Field(description="longest side of a piece [pixels]; smaller at the east and south edge")


class RosesOut(ResponseModel):
    """Energy per metre by heading at evenly spaced cells."""

    headings_deg: list[float] = Field(description="clockwise from north [deg]")
    points: list[list[float]] = Field(description="world [x, y] of each cell [m]")
    energy_per_m: list[list[float | None]] = Field(
        description="[J/m] per heading, for each cell; null where it is blocked"
    )


class SurfaceOut(ResponseModel):
    """Heights on a coarse grid, for a view in three dimensions."""

    x: list[float] = Field(description="from west to east [m]")
    y: list[float] = Field(description="from north to south [m]")
    z: list[list[float | None]] = Field(description="heights, a row for each y [m]; null where unknown")
