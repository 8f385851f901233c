"""How a heightmap's file is to be read, where it does not say so: `read_heightmap` takes these by the same names."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from joulemap.model.ranges import COORDINATE_M, HEIGHT_M, NOISE_LENGTH_M, NOISE_M, RESOLUTION_M, SCALE_M, STORED
from joulemap.service.schemas.base import ClosedModel, FilePlace, InPython, Name, within


class UploadOptions(ClosedModel):
    """What the heightmap file does not say."""

    name: Name | None = Field(default=None, description="name of the heightmap; default: the file's name")
    resolution_m: Annotated[float, within(RESOLUTION_M)] | None = Field(
        default=None,
        description="side of a cell [m]; needed where the file does not say it, refused where the file says another",
    )
    west_m: Annotated[float, within(COORDINATE_M)] = Field(
        default=0.0, description="x of the map's west edge [m], where the file does not say"
    )
    north_m: Annotated[float, within(COORDINATE_M)] | None = Field(
        default=None,
        description="y of the map's north edge [m], where the file does not say; default: the south edge is y = 0",
    )
    crs: str | None = Field(
        default=None,
        min_length=1,
        max_length=4000,
        description="CRS in metres, e.g. EPSG:32630, where the file does not say",
    )
    scale_m: Annotated[float, within(SCALE_M)] | None = Field(
        default=None, description="metres per stored unit; a picture (PNG) needs it, unless its colours are heights"
    )
    offset_m: Annotated[float, within(HEIGHT_M)] = Field(default=0.0, description="height of the stored value 0 [m]")
    nodata: Annotated[float, within(STORED)] | None = Field(
        default=None,
        description="stored value that means unknown, where the file does not declare it",
    )
    band: int | None = Field(
        default=None,
        ge=1,
        le=65_535,
        description="band or variable that holds the heights, from 1; a file with several needs it",
    )
    reproject: str | None = Field(
        default=None,
        min_length=1,
        max_length=4000,
        description="resample a map in degrees, feet or Web Mercator, rotated or with oblong cells, to true metres: "
        "`auto` (its UTM zone), EPSG:n or WKT; `resolution_m` is then the side of the new cells",
        examples=["auto"],
    )
    layer: Annotated[bool, InPython()] = Field(
        default=False,
        description="the file is a raster of kinds of ground, obstacles or the like, which a cost map names as a "
        "layer: its numbers stay as they are; where it must be reprojected (in degrees, rotated) each is that of the "
        "nearest cell",
    )
    window: Annotated[str | None, InPython("str | Sequence[float] | None")] = Field(
        default=None,
        min_length=7,
        max_length=200,
        description="read a part of the map: two opposite corners, x,y of its CRS or latitude,longitude",
        examples=["366990,4064300,367080,4064400"],
    )
    noise_m: Annotated[float, within(NOISE_M)] | None = Field(
        default=None,
        description="standard deviation of the survey's noise [m]; 0 takes the map as it is; estimated by default",
        examples=[0.05],
    )
    noise_length_m: Annotated[float, within(NOISE_LENGTH_M)] = Field(
        default=0.0,
        description="length over which that noise is alike [m], as in photogrammetry; needs `noise_m`; 0 where it is "
        "independent from cell to cell",
        examples=[0.3],
    )


class ReadingOptions(UploadOptions):
    """What the heightmap file does not say, and files of what else is known of the ground."""

    layers: Annotated[
        dict[str, list[str]] | None, InPython("Mapping[str, str | Path | Sequence[str | Path]] | None")
    ] = Field(
        default=None,
        description="layers over the heightmap, each in its own resolution and coordinate system: files of `kinds` "
        "(kinds of ground), `obstacles` (raster, GeoJSON, or YAML of a Nav2 map), `free` (the only ground to be driven "
        "on), `factor` (of the energy), `cost` (added J/m) or `height` (in place of the map's, of bridges and ramps); "
        "there may be several of each",
    )
    legend: Annotated[FilePlace | None, InPython("str | Path | Mapping[str, Any] | None")] = Field(
        default=None,
        description="legend of kinds of ground (TOML): a table for each, with its `value` in the layer, and "
        "`rolling_resistance` or `factor`, with `std`, or `blocked`; default: those of the library",
    )
