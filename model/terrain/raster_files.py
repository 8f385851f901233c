"""Decoders of heightmaps through GDAL: GeoTIFF and PNG, cut off from the network and from files beside them."""

from __future__ import annotations

import re
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio._err import CPLE_BaseError
from rasterio.crs import CRS
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.errors import CRSError, NotGeoreferencedWarning, RasterioError
from rasterio.io import DatasetReader, MemoryFile
from rasterio.windows import Window

from joulemap.model.errors import HeightmapError
from joulemap.model.terrain.decoded import Decoded, Scaling, check_cells

SQUARE_TOLERANCE = 1e-3
"""Relative difference of two lengths that still count as the same."""

_STRIPE_CELLS = 4_000_000  # decoded at a time, so that a big map needs no second copy of itself
_MAX_BLOCK_BYTES = 1 << 30
_ENV = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",  # no .aux.xml, .ovr, .msk, world files
    "GDAL_PAM_ENABLED": "NO",
    "PROJ_NETWORK": "OFF",
    "GDAL_CACHEMAX": 256,
}
_CRS_TEXT = re.compile(r"\s*(?:[A-Za-z]+:\d{1,9}\s*$|[A-Za-z_]+\[)")
_FOOT_UNITS = ("ft", "foot", "feet", "us survey foot", "us-ft", "ftus")


@contextmanager
def _opened(source: Path | bytes, driver: str) -> Iterator[DatasetReader]:
    """The dataset, decoded by this driver alone; rasterio's failures, also those at reading, as HeightmapError."""
    name = {"GTiff": "GeoTIFF", "PNG": "PNG image"}[driver]
    with warnings.catch_warnings(), rasterio.Env(**_ENV):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            if isinstance(source, bytes):
                with MemoryFile(source) as memory, memory.open(driver=driver) as dataset:
                    yield dataset
            else:
                with rasterio.open(str(source), driver=driver) as dataset:
                    yield dataset
        except (RasterioError, CPLE_BaseError, UnicodeDecodeError, OSError) as error:
            raise HeightmapError(f"the {name} is truncated or corrupt: {error.__cause__ or error}") from error


def decode_png(source: Path | bytes, head: bytes, scaling: Scaling, max_cells: int) -> Decoded:
    """A greyscale PNG of 8 or 16 bits; height = count * scale_m + offset_m. head : its first bytes, 26 at least.

    Raises HeightmapError without a scale, or where the image is in colour; TooLargeError.
    """
    if len(head) < 26 or head[12:16] != b"IHDR":
        raise HeightmapError("the PNG image is truncated or corrupt: it has no header")
    cols, rows, bits, colour = struct.unpack(">IIBB", head[16:26])
    check_cells(rows, cols, max_cells, what="the PNG image")
    if colour != 0 or bits not in (8, 16):
        kinds = {
            0: "greyscale",
            2: "colour",
            3: "palette",
            4: "greyscale with transparency",
            6: "colour with transparency",
        }
        raise HeightmapError(
            f"a PNG heightmap is greyscale with 8 or 16 bits; this one is {kinds.get(colour, 'unknown')} "
            f"with {bits} bits"
        )
    if scaling.scale_m is None:
        raise HeightmapError(
            "a PNG image holds counts, not metres: give scale_m, the metres per count (and offset_m, the height of "
            "count 0)"
        )
    with _opened(source, "PNG") as dataset:
        heights = _read_band(dataset, 1, scaling, slice(0, dataset.height), slice(0, dataset.width))
    return Decoded(heights)


@dataclass(frozen=True)
class GeoTiffHeader:
    """What a GeoTIFF says of one band without its heights. west_m, north_m, resolution_m : None where it has no
    transform; flip : its first row is the southern one.
    """

    band: int
    shape: tuple[int, int]
    west_m: float | None
    north_m: float | None
    resolution_m: float | None
    crs: str | None
    flip: bool


def geotiff_header(source: Path | bytes, max_cells: int, *, band: int | None = None) -> GeoTiffHeader:
    """band : 1-based; needed where there is more than one. Raises as `decode_geotiff`, but for what only its heights
    tell.
    """
    with _opened(source, "GTiff") as dataset:
        return _header(dataset, max_cells, band)


def geotiff_window(
    source: Path, header: GeoTiffHeader, scaling: Scaling, rows: slice, cols: slice
) -> NDArray[np.float32]:
    """Heights [m] of a window (row 0 north) of one band, NaN unknown: what `decode_geotiff` has there."""
    with _opened(source, "GTiff") as dataset:
        return _read_north_up(dataset, header, scaling, rows, cols)


def decode_geotiff(source: Path | bytes, scaling: Scaling, max_cells: int, *, band: int | None = None) -> Decoded:
    """One band of a GeoTIFF: mask, nodata, scale and offset honoured, south-up rasters turned.

    band : 1-based; needed where there is more than one. Raises HeightmapError on rotated or non-square pixels, a CRS in
    degrees or feet, blocks that were never written, truncation; TooLargeError.
    """
    with _opened(source, "GTiff") as dataset:
        header = _header(dataset, max_cells, band)
        heights = _read_north_up(dataset, header, scaling, slice(0, dataset.height), slice(0, dataset.width))
    return Decoded(
        heights, west_m=header.west_m, north_m=header.north_m, resolution_m=header.resolution_m, crs=header.crs
    )


def _header(dataset: DatasetReader, max_cells: int, band: int | None) -> GeoTiffHeader:
    check_cells(dataset.height, dataset.width, max_cells, what="the GeoTIFF")
    band = _checked_band(dataset, band)
    crs = crs_name(dataset.crs) if dataset.crs else None
    transform = dataset.transform
    if transform.is_identity:
        resolution = west = north = None
        flip = False
    else:
        if transform.b or transform.d:
            raise HeightmapError(
                f"the GeoTIFF is rotated (transform terms {transform.b:g}, {transform.d:g}): "
                "make it north-up first, e.g. with `gdalwarp`",
                transform=list(transform)[:6],
            )
        if transform.a <= 0:
            raise HeightmapError(f"the GeoTIFF is mirrored: its columns run west (pixel width {transform.a:g} m)")
        resolution, height = transform.a, abs(transform.e)
        if abs(resolution - height) > SQUARE_TOLERANCE * max(resolution, height):
            raise HeightmapError(
                f"cells must be square, but the GeoTIFF's are {resolution:g} x {height:g} m: resample it, "
                f"e.g. `gdalwarp -tr {resolution:g} {resolution:g}`",
                width_m=resolution,
                height_m=height,
            )
        flip = transform.e > 0
        west = transform.c
        north = transform.f + (dataset.height * transform.e if flip else 0.0)
    _check_blocks(dataset, band)
    return GeoTiffHeader(band, dataset.shape, west, north, resolution, crs, flip)


def _read_north_up(
    dataset: DatasetReader, header: GeoTiffHeader, scaling: Scaling, rows: slice, cols: slice
) -> NDArray[np.float32]:
    if header.flip:
        rows = slice(dataset.height - rows.stop, dataset.height - rows.start)
    heights = _read_band(dataset, header.band, scaling, rows, cols)
    return np.ascontiguousarray(heights[::-1]) if header.flip else heights


def crs_name(crs: CRS | str) -> str:
    """The CRS as "EPSG:n" where it has such a code, else as WKT; a text may be either.

    Raises HeightmapError unless it is a plane in metres.
    """
    try:
        with rasterio.Env(**_ENV):
            if isinstance(crs, str):
                if not _CRS_TEXT.match(crs):  # GDAL would also take file names and addresses
                    raise ValueError(crs)
                crs = CRS.from_string(crs)
            code, wkt = crs.to_epsg(), crs.to_wkt()
    except (CRSError, CPLE_BaseError, ValueError, OverflowError) as error:
        raise HeightmapError(
            f"the coordinate reference system {str(crs)[:80]!r} is not known: give EPSG:n or its WKT", crs=str(crs)[:80]
        ) from error
    name = f"EPSG:{code}" if code else wkt
    if crs.is_geographic:
        raise HeightmapError(
            f"the map is in degrees ({name[:80]}), not in metres: project it first, e.g. "
            "`gdalwarp -t_srs EPSG:326xx IN.tif OUT.tif` with xx its UTM zone (327xx in the south)",
            crs=name[:80],
        )
    if crs.is_projected:
        unit, metres = crs.linear_units_factor
        if abs(metres - 1.0) > 1e-9:
            raise HeightmapError(
                f"the map is in {unit} ({metres:g} m), not in metres ({name[:80]}): project it first, e.g. "
                "`gdalwarp -t_srs EPSG:326xx IN.tif OUT.tif`",
                crs=name[:80],
                unit=unit,
            )
    elif not wkt.upper().startswith(("LOCAL_CS", "ENGCRS", "ENGINEERINGCRS")) or "FOOT" in wkt.upper():
        raise HeightmapError(f"the map's coordinate reference system is no plane in metres: {name[:80]}", crs=name[:80])
    return name


def _checked_band(dataset: DatasetReader, band: int | None) -> int:
    if dataset.count != 1 and band is None:
        raise HeightmapError(
            f"the GeoTIFF has {dataset.count} bands: say which holds the heights (band)", bands=dataset.count
        )
    band = 1 if band is None else band
    if not 1 <= band <= dataset.count:
        raise HeightmapError(f"the GeoTIFF has bands 1 to {dataset.count}, not {band}", bands=dataset.count)
    dtype = np.dtype(dataset.dtypes[band - 1]) if "complex" not in dataset.dtypes[band - 1] else np.dtype(complex)
    if dtype.kind not in "fiu":
        raise HeightmapError(f"band {band} of the GeoTIFF holds {dataset.dtypes[band - 1]}, not real numbers")
    if dataset.colorinterp[band - 1] == ColorInterp.palette:
        raise HeightmapError(f"band {band} of the GeoTIFF is a picture with a colour table, not heights")
    unit = dataset.units[band - 1]
    if unit and unit.strip().lower() in _FOOT_UNITS:
        raise HeightmapError(f"the GeoTIFF's heights are in {unit}, not in metres: convert them first", unit=unit)
    block_rows, block_cols = dataset.block_shapes[band - 1]
    block_bytes = block_rows * block_cols * dtype.itemsize * dataset.count
    if block_bytes > max(_MAX_BLOCK_BYTES, dataset.height * dataset.width * dtype.itemsize * dataset.count):
        raise HeightmapError(
            f"the GeoTIFF declares blocks of {block_rows} x {block_cols} cells around a small map: corrupt"
        )
    return band


def _check_blocks(dataset: DatasetReader, band: int) -> None:
    """GDAL fills blocks that were never written with nodata, or with 0 where none is declared: refuse the latter."""
    if dataset.nodatavals[band - 1] is not None:
        return
    block_rows, block_cols = dataset.block_shapes[band - 1]
    down, across = -(-dataset.height // block_rows), -(-dataset.width // block_cols)
    missing = sum(
        dataset.get_tag_item(f"BLOCK_OFFSET_{j}_{i}", "TIFF", bidx=band) is None
        for i in range(down)
        for j in range(across)
    )
    if missing:
        raise HeightmapError(
            f"{missing} of the GeoTIFF's {down * across} blocks were never written: the file is incomplete",
            missing=missing,
        )


def _read_band(dataset: DatasetReader, band: int, scaling: Scaling, rows: slice, cols: slice) -> NDArray[np.float32]:
    masked = MaskFlags.all_valid not in dataset.mask_flag_enums[band - 1]
    wide = cols.stop - cols.start
    heights = np.empty((rows.stop - rows.start, wide), dtype=np.float32)
    block_rows = dataset.block_shapes[band - 1][0]
    step = max(1, _STRIPE_CELLS // (wide * block_rows)) * block_rows
    for row in range(rows.start, rows.stop, step):
        window = Window(cols.start, row, wide, min(step, rows.stop - row))
        values = dataset.read(band, window=window)
        known = dataset.read_masks(band, window=window) != 0 if masked else None
        heights[row - rows.start : row - rows.start + step] = scaling.to_metres(
            values, band_scale=dataset.scales[band - 1], band_offset=dataset.offsets[band - 1], known=known
        )
    return heights
