"""What a raster must be to be heights: the band, the grid, and all of its blocks."""

from __future__ import annotations

import math
import threading
import warnings
from typing import Any, cast

import numpy as np
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import DatasetReader
from rasterio.transform import Affine, array_bounds

from joulemap.model.errors import HeightmapError
from joulemap.model.terrain.coordinate_systems import crs_name, warp_command
from joulemap.model.terrain.decoded import SAME_LENGTH

HEIGHTS = ("elevation", "z", "height", "dem", "topo", "altitude", "band1", "heights")
"""What bands and variables with heights are called."""

_MAX_BLOCK_BYTES = 1 << 30
_ONE_AT_A_TIME = threading.Lock()


def transform_of(dataset: DatasetReader) -> Affine:
    """Return the transform from (column, row) to x, y; the identity where the file states none.

    For a picture without a place, PGM for one, rasterio warns and returns memory that GDAL did not write.
    """
    nowhere: set[int] = set()  # threads for which rasterio said so

    def _seen(message: Warning | str, category: type[Warning], *where: Any) -> None:
        if issubclass(category, NotGeoreferencedWarning):
            nowhere.add(threading.get_ident())
        else:
            usual(message, category, *where)

    with _ONE_AT_A_TIME, warnings.catch_warnings():  # which exchanges the filters of all threads
        warnings.simplefilter("always", NotGeoreferencedWarning)
        usual, warnings.showwarning = warnings.showwarning, cast("Any", _seen)
        terms = dataset.read_transform()
    return Affine.identity() if threading.get_ident() in nowhere else Affine.from_gdal(*terms)


def check_grid(
    transform: Affine, shape: tuple[int, int], own: str | None, what: str, nodata_declared: bool
) -> str | None:
    """Refuse a grid that is not north-up and square in true metres. Result: "EPSG:n" or WKT of its CRS."""
    crs = None
    if own:
        placed = transform.is_rectilinear and not transform.is_identity
        bounds = array_bounds(*shape, transform) if placed else None
        crs = crs_name(own, bounds, nodata_declared=nodata_declared)
    if transform.is_identity:
        return crs
    if transform.b or transform.d:
        target = crs if crs is not None and crs.startswith("EPSG:") else "CRS"
        options = f"--dst-crs {target} --res {math.hypot(transform.a, transform.d):g}"
        raise HeightmapError(
            f"{what} is rotated (transform terms {transform.b:g}, {transform.d:g}): give `reproject` as auto, "
            f"or turn it north-up with {warp_command(options, nodata_declared=nodata_declared)}",
            transform=list(transform)[:6],
        )
    if transform.a <= 0:
        raise HeightmapError(f"{what} is mirrored: its columns run west (pixel width {transform.a:g} m)")
    width, height = transform.a, abs(transform.e)
    if abs(width - height) > SAME_LENGTH * max(width, height):
        command = warp_command(f"--res {max(width, height):g}", nodata_declared=nodata_declared)
        raise HeightmapError(
            f"cells must be square, but those of {what} are {width:g} x {height:g} m: give `reproject` as auto, or "
            f"resample it with {command}",
            width_m=width,
            height_m=height,
        )
    return crs


def checked_band(dataset: DatasetReader, band: int | None, what: str) -> int:
    """Return the number of the band with the heights."""
    kinds = dataset.colorinterp
    if band is None and dataset.count == 2 and kinds[1] == ColorInterp.alpha:
        band = 1
    if band is None:
        described = [k for k, words in enumerate(dataset.descriptions, 1) if (words or "").lower() in HEIGHTS]
        band = described[0] if len(described) == 1 else None
    if dataset.count != 1 and band is None:
        raise HeightmapError(
            f"{what} has {dataset.count} bands: give `band`, the number of the one with the heights "
            f"(1 to {dataset.count})",
            bands=dataset.count,
        )
    band = 1 if band is None else band
    if not 1 <= band <= dataset.count:
        raise HeightmapError(
            f"{what} has bands 1 to {dataset.count}, not {band}: give another `band`", bands=dataset.count
        )
    name = dataset.dtypes[band - 1]
    kind = "c" if "complex" in name else np.dtype(name).kind
    whose = what if dataset.count == 1 else f"`band` {band} of {what}"
    if kind not in "fiu":
        raise HeightmapError(f"{whose} holds {name}, not real numbers")
    if kinds[band - 1] == ColorInterp.palette:
        raise HeightmapError(f"{whose} is a picture with a colour table, not heights")
    block_rows, block_cols = dataset.block_shapes[band - 1]
    cell_bytes = np.dtype(name).itemsize * dataset.count
    if block_rows * block_cols * cell_bytes > max(_MAX_BLOCK_BYTES, dataset.height * dataset.width * cell_bytes):
        raise HeightmapError(f"{what} declares blocks of {block_rows} x {block_cols} cells around a small map: corrupt")
    return band


def check_blocks(dataset: DatasetReader, band: int) -> None:
    """Refuse a GeoTIFF with blocks that were never written, unless it declares a no-data value, which GDAL returns."""
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
