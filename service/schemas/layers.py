"""What the page draws of a cost map: where its pictures lie, what their colours mean, roses and a surface."""

from __future__ import annotations

from pydantic import Field

from joulemap.service.schemas.base import ResponseModel


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
