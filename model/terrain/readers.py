"""Read a heightmap from a file or from bytes, whatever of the known formats it is in."""

from __future__ import annotations

import io
import math
import sys
from contextlib import AbstractContextManager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.array_files import decode_ascii, decode_npy, decode_npz
from joulemap.model.terrain.decoded import Decoded, Scaling
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.raster_files import SQUARE_TOLERANCE, crs_name, decode_geotiff, decode_png, geotiff_header
from joulemap.model.terrain.windows import Ground, HeightmapFile

FORMATS = "GeoTIFF, ESRI ASCII grid, NumPy .npy or .npz, greyscale PNG"
MAX_CELLS = 400_000_000
"""Default limit of declared cells: 1.6 GB of float32."""

_MAGIC = (
    ("geotiff", (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")),
    ("png", (b"\x89PNG\r\n\x1a\n",)),
    ("npy", (b"\x93NUMPY",)),
    ("npz", (b"PK\x03\x04", b"PK\x05\x06")),
)
_ASC_WORDS = (
    b"ncols",
    b"nrows",
    b"xllcorner",
    b"xllcenter",
    b"yllcorner",
    b"yllcenter",
    b"cellsize",
    b"dx",
    b"nodata_value",
)
_SUFFIX = {".tif": "geotiff", ".tiff": "geotiff", ".png": "png", ".npy": "npy", ".npz": "npz", ".asc": "ascii"}


def read_heightmap(
    source: str | Path | bytes,
    *,
    filename: str | None = None,
    resolution_m: float | None = None,
    west_m: float = 0.0,
    north_m: float | None = None,
    crs: str | None = None,
    scale_m: float | None = None,
    offset_m: float = 0.0,
    nodata: float | None = None,
    band: int | None = None,
    max_cells: int = MAX_CELLS,
) -> Heightmap:
    """The heightmap in `source`, a path or the bytes of a file; the format is known by content, then by name.

    filename : the name of `source` where it is bytes. resolution_m : side of a cell [m], required where the file does
    not say and refused where it contradicts the file by more than 0.1 %. west_m, north_m : outer corner [m], used where
    the file does not say; north_m defaults to the value that puts the south-west corner at y = 0. crs : likewise,
    "EPSG:n" or WKT. scale_m, offset_m : height = stored value * scale_m + offset_m; PNG needs scale_m. nodata : stored
    value of unknown cells beside those the file declares. band : 1-based, of a GeoTIFF with several.

    Row 0 of the answer is north and unknown cells are NaN, whatever the file's own way. Raises HeightmapError when it
    cannot be read, is no heightmap, is not in metres on a north-up square grid or holds no known cell; TooLargeError,
    before anything is allocated, when it declares more than `max_cells` cells.
    """
    scaling = Scaling(scale_m, offset_m, nodata)
    if isinstance(source, bytes):
        name, length = filename or "bytes", len(source)
        opened: AbstractContextManager[BinaryIO] = io.BytesIO(source)
        place: Path | bytes = source
    else:
        place = Path(source).resolve()
        if not place.is_file():
            raise HeightmapError(f"there is no file {source}", path=str(source))
        name, length = filename or place.name, place.stat().st_size
        try:
            opened = place.open("rb")
        except OSError as error:
            raise HeightmapError(f"the file {source} cannot be read: {error.strerror}", path=str(source)) from error
    with opened as stream:
        head = stream.read(512)
        stream.seek(0)
        kind = _format_of(head, name)
        if kind == "geotiff":
            decoded = decode_geotiff(place, scaling, max_cells, band=band)
        elif kind == "png":
            decoded = decode_png(place, head, scaling, max_cells)
        elif kind == "npy":
            decoded = decode_npy(stream, length, scaling, max_cells)
        elif kind == "npz":
            decoded = decode_npz(stream, scaling, max_cells)
        else:
            decoded = decode_ascii(stream.read(), scaling, max_cells)
    return Heightmap(decoded.heights, _frame(decoded, resolution_m, west_m, north_m, crs), source=name)


def open_ground(
    path: str | Path,
    *,
    filename: str | None = None,
    resolution_m: float | None = None,
    west_m: float = 0.0,
    north_m: float | None = None,
    crs: str | None = None,
    scale_m: float | None = None,
    offset_m: float = 0.0,
    nodata: float | None = None,
    band: int | None = None,
) -> Ground:
    """The heightmap in a file, of any size where it is a GeoTIFF: that is read by windows, any other format whole.

    Settings and refusals as `read_heightmap`; what only the heights tell is found when they are read.
    """
    place = Path(path).resolve()
    head = b""
    if place.is_file():
        with place.open("rb") as stream:
            head = stream.read(512)
    if not head.startswith(dict(_MAGIC)["geotiff"]):
        return read_heightmap(
            path,
            filename=filename,
            resolution_m=resolution_m,
            west_m=west_m,
            north_m=north_m,
            crs=crs,
            scale_m=scale_m,
            offset_m=offset_m,
            nodata=nodata,
            band=band,
        )
    header = geotiff_header(place, sys.maxsize, band=band)
    unread = np.broadcast_to(np.float32(np.nan), header.shape)
    said = Decoded(unread, header.west_m, header.north_m, header.resolution_m, header.crs)
    frame = _frame(said, resolution_m, west_m, north_m, crs)
    return HeightmapFile(place, header, Scaling(scale_m, offset_m, nodata), frame, filename or place.name)


def _format_of(head: bytes, name: str) -> str:
    if not head:
        raise HeightmapError(f"{name} is empty", name=name)
    for kind, magics in _MAGIC:
        if head.startswith(magics):
            return kind
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    if text.startswith(_ASC_WORDS):
        return "ascii"
    claimed = _SUFFIX.get(Path(name).suffix.lower())
    if claimed is not None:
        raise HeightmapError(f"{name} is not what its name says: its content is no {claimed} file ({FORMATS} are read)")
    raise HeightmapError(f"{name} is not a heightmap: {FORMATS} are read", name=name)


def _frame(
    decoded: Decoded, resolution_m: float | None, west_m: float, north_m: float | None, crs: str | None
) -> GridFrame:
    """The file's own position where it has one, the caller's where it has none; what contradicts is refused."""
    if resolution_m is not None and not (math.isfinite(resolution_m) and resolution_m > 0):
        raise HeightmapError(
            f"resolution_m must be a positive number of metres, got {resolution_m}", resolution_m=str(resolution_m)
        )
    rows, cols = decoded.heights.shape
    own = decoded.resolution_m
    if own is None and resolution_m is None:
        raise HeightmapError(
            "the file does not say how large a cell is: give resolution_m, the side of a cell in metres (or send a "
            "GeoTIFF with a transform)"
        )
    if own is not None and resolution_m is not None and abs(own - resolution_m) > SQUARE_TOLERANCE * abs(own):
        raise HeightmapError(
            f"resolution_m = {resolution_m:g} m was given, but the file's cells are {own:g} m: leave it out, or "
            "resample the file",
            resolution_m=resolution_m,
            file_resolution_m=own,
        )
    resolution = own if own is not None else resolution_m
    assert resolution is not None
    given_crs = crs_name(crs) if crs is not None else None
    own_crs = crs_name(decoded.crs) if decoded.crs is not None else None
    if own_crs is not None and given_crs is not None and own_crs != given_crs:
        raise HeightmapError(
            f"crs = {given_crs[:80]} was given, but the file says {own_crs[:80]}: leave it out, or reproject the file",
            crs=given_crs[:80],
            file_crs=own_crs[:80],
        )
    north = decoded.north_m if decoded.north_m is not None else north_m
    return GridFrame(
        west_m=decoded.west_m if decoded.west_m is not None else west_m,
        north_m=north if north is not None else rows * resolution,
        resolution_m=resolution,
        rows=rows,
        cols=cols,
        crs=own_crs if own_crs is not None else given_crs,
    )
