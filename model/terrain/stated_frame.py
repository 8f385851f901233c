"""Where a heightmap lies: what the file states, and what the user states where it does not."""

from __future__ import annotations

import math
from dataclasses import dataclass

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame
from joulemap.model.ranges import RESOLUTION_M
from joulemap.model.terrain.coordinate_systems import Bounds, crs_name
from joulemap.model.terrain.cut_out import WindowLike
from joulemap.model.terrain.decoded import SAME_LENGTH, Decoded, Scaling
from joulemap.model.terrain.formats.contract import WindowReader


@dataclass(frozen=True)
class Reading:
    """What the user states of a heightmap's file, in the words of `read_heightmap`."""

    resolution_m: float | None = None
    west_m: float = 0.0
    north_m: float | None = None
    crs: str | None = None
    scale_m: float | None = None
    offset_m: float = 0.0
    nodata: float | None = None
    band: int | None = None
    reproject: str | None = None
    window: WindowLike | None = None
    noise_m: float | None = None
    noise_length_m: float = 0.0
    nearest: bool = False
    """Whether each cell of a file that is reprojected has the value of the nearest one, for numbers without between."""

    @property
    def scaling(self) -> Scaling:
        """How stored values become metres."""
        return Scaling(self.scale_m, self.offset_m, self.nodata, self.resolution_m)


def stated_frame(said: Decoded | WindowReader, reading: Reading) -> GridFrame:
    """Return the file's own place where it states one, and the user's where it does not."""
    resolution_m, west_m, north_m, crs = reading.resolution_m, reading.west_m, reading.north_m, reading.crs
    if resolution_m is not None and not (math.isfinite(resolution_m) and resolution_m > 0):
        raise HeightmapError(
            f"`resolution_m` must be a positive number of metres, got {resolution_m}", resolution_m=str(resolution_m)
        )
    rows, cols = said.shape
    own = said.resolution_m
    if own is not None and resolution_m is not None and abs(own - resolution_m) > SAME_LENGTH * abs(own):
        raise HeightmapError(
            f"`resolution_m` of {resolution_m:g} m was given, but the file's cells are {own:g} m: leave it out, or "
            "resample the file",
            resolution_m=resolution_m,
            file_resolution_m=own,
        )
    resolution = own if own is not None else resolution_m
    if resolution is None:
        raise HeightmapError(
            "the file does not say how large a cell is: give `resolution_m`, the side of a cell in metres (or send a "
            "GeoTIFF with a transform)"
        )
    placed = said.west_m is not None or west_m != 0.0 or north_m is not None
    west = said.west_m if said.west_m is not None else west_m
    north = next((edge for edge in (said.north_m, north_m) if edge is not None), rows * resolution)
    bounds = (west, north - rows * resolution, west + cols * resolution, north) if placed else None
    own_crs = crs_name(said.crs, bounds) if said.crs is not None else None
    if own_crs is not None and crs is not None and _name_or_text(crs, bounds) != own_crs:
        raise HeightmapError(
            f"`crs` {crs[:80]} was given, but the file says {own_crs[:80]}: leave it out, or reproject the file",
            crs=crs[:80],
            file_crs=own_crs[:80],
        )
    if 0.0 < resolution < RESOLUTION_M.low and own_crs is None and crs is None:
        raise HeightmapError(
            f"the file's cells are {resolution:g} m, below {RESOLUTION_M.low:g} m: are they degrees? Then give `crs` "
            "as EPSG:4326 and `reproject` as auto",
            resolution_m=resolution,
            limit=RESOLUTION_M.low,
        )
    named = own_crs if own_crs is not None or crs is None else crs_name(crs, bounds)
    return GridFrame(
        west_m=west,
        north_m=north,
        resolution_m=resolution,
        rows=rows,
        cols=cols,
        crs=named,
    )


def _name_or_text(crs: str, bounds: Bounds | None) -> str:
    """The name of a CRS, or the text itself where it names none that could be used."""
    try:
        return crs_name(crs, bounds)
    except HeightmapError:
        return crs
