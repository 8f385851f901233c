"""GeoTIFF: one band as heights, whole or by windows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.io import DatasetReader

from joulemap.model.errors import HeightmapError
from joulemap.model.source_file import SourceFile
from joulemap.model.terrain.coordinate_systems import crs_name, warp_command
from joulemap.model.terrain.decoded import SAME_LENGTH, Decoded, Scaling, check_cells
from joulemap.model.terrain.formats.gdal import opened, read_band

_MAX_BLOCK_BYTES = 1 << 30
_FOOT_UNITS = ("ft", "foot", "feet", "us survey foot", "us-ft", "ftus")


def recognise(head: bytes, name: str) -> bool:
    """Decide by the signature of TIFF and BigTIFF files.

    Parameters
    ----------
    head : bytes
        First bytes of the file.
    name : str
        Not used.

    Returns
    -------
    bool
        True for a TIFF file.
    """
    return head.startswith((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"))


def decode(source: SourceFile, scaling: Scaling, *, max_cells: int, band: int | None = None) -> Decoded:
    """Read one band: mask, no-data value, scale and offset are honoured, south-up rasters are turned.

    Parameters
    ----------
    source : SourceFile
        The GeoTIFF.
    scaling : Scaling
        How values become metres, after the file's own scale and offset.
    max_cells : int
        Largest number of cells.
    band : int, optional
        The band with the heights, from 1; needed where there are several.

    Returns
    -------
    Decoded
        Heights, and the file's place.

    Raises
    ------
    HeightmapError
        On rotated or non-square pixels, a CRS that is not in true metres, blocks that were never written, a truncated
        or corrupt file.
    TooLargeError
        If it declares more than `max_cells` cells.
    """
    with opened(source.place, "GTiff") as dataset:
        check_cells(dataset.height, dataset.width, max_cells, what="the GeoTIFF")
        header = _header(dataset, source.place, band)
        heights = header.read_from(dataset, scaling, slice(0, dataset.height), slice(0, dataset.width))
    return Decoded(
        heights, west_m=header.west_m, north_m=header.north_m, resolution_m=header.resolution_m, crs=header.crs
    )


def open_windows(path: Path, *, band: int | None = None) -> GeoTiffWindows:
    """Open a GeoTIFF of any size for reading by windows.

    Parameters
    ----------
    path : Path
        The file. A tiled one is read fastest.
    band : int, optional
        The band with the heights, from 1; needed where there are several.

    Returns
    -------
    GeoTiffWindows
        Its place, and its heights window by window.

    Raises
    ------
    HeightmapError
        As `decode`, except for what only the heights show.
    """
    with opened(path, "GTiff") as dataset:
        check_cells(dataset.height, dataset.width, dataset.height * dataset.width, what="the GeoTIFF")
        return _header(dataset, path, band)


@dataclass(frozen=True)
class GeoTiffWindows:
    """One band of a GeoTIFF: what the file states without its heights, and the heights of any window.

    Attributes
    ----------
    place : Path or bytes
        The file, or its bytes.
    band : int
        Number of the band, from 1.
    shape : tuple of int
        Rows and columns.
    west_m, north_m, resolution_m : float or None
        Place [m], None where the file has no transform.
    crs : str or None
        "EPSG:n" or WKT, None where the file has none.
    flip : bool
        Whether the file's first row is the southern one.
    """

    place: Path | bytes
    band: int
    shape: tuple[int, int]
    west_m: float | None
    north_m: float | None
    resolution_m: float | None
    crs: str | None
    flip: bool

    def read(self, scaling: Scaling, rows: slice, cols: slice) -> NDArray[np.float32]:
        """Return the heights of a window, the same as `decode` has there.

        Parameters
        ----------
        scaling : Scaling
            How values become metres.
        rows, cols : slice
            The window; row 0 is the northern one.

        Returns
        -------
        ndarray of float32, (rows, cols)
            Heights [m], NaN where unknown.

        Raises
        ------
        HeightmapError
            If the window cannot be read.
        """
        with opened(self.place, "GTiff") as dataset:
            return self.read_from(dataset, scaling, rows, cols)

    def read_from(self, dataset: DatasetReader, scaling: Scaling, rows: slice, cols: slice) -> NDArray[np.float32]:
        """Return the heights of a window of the open file.

        Parameters
        ----------
        dataset : DatasetReader
            The file, open.
        scaling : Scaling
            How values become metres.
        rows, cols : slice
            The window; row 0 is the northern one.

        Returns
        -------
        ndarray of float32, (rows, cols)
            Heights [m], NaN where unknown.
        """
        if self.flip:
            rows = slice(dataset.height - rows.stop, dataset.height - rows.start)
        heights = read_band(dataset, self.band, scaling, rows, cols)
        return np.ascontiguousarray(heights[::-1]) if self.flip else heights


def _header(dataset: DatasetReader, place: Path | bytes, band: int | None) -> GeoTiffWindows:
    band, _ = checked_band(dataset, band)
    transform = dataset.transform
    nodata_declared = dataset.nodatavals[band - 1] is not None
    crs = None
    if dataset.crs:
        placed = transform.is_rectilinear and not transform.is_identity
        bounds = tuple(dataset.bounds) if placed else None
        crs = crs_name(dataset.crs, bounds, nodata_declared=nodata_declared)
    if transform.is_identity:
        resolution = west = north = None
        flip = False
    else:
        if transform.b or transform.d:
            target = crs if crs is not None and crs.startswith("EPSG:") else "CRS"
            options = f"--dst-crs {target} --res {math.hypot(transform.a, transform.d):g}"
            raise HeightmapError(
                f"the GeoTIFF is rotated (transform terms {transform.b:g}, {transform.d:g}): give `reproject` as auto, "
                f"or turn it north-up with {warp_command(options, nodata_declared=nodata_declared)}",
                transform=list(transform)[:6],
            )
        if transform.a <= 0:
            raise HeightmapError(f"the GeoTIFF is mirrored: its columns run west (pixel width {transform.a:g} m)")
        resolution, height = transform.a, abs(transform.e)
        if abs(resolution - height) > SAME_LENGTH * max(resolution, height):
            command = warp_command(f"--res {max(resolution, height):g}", nodata_declared=nodata_declared)
            raise HeightmapError(
                f"cells must be square, but the GeoTIFF's are {resolution:g} x {height:g} m: give `reproject` as "
                f"auto, or resample it with {command}",
                width_m=resolution,
                height_m=height,
            )
        flip = transform.e > 0
        west = transform.c
        north = transform.f + (dataset.height * transform.e if flip else 0.0)
    check_blocks(dataset, band)
    return GeoTiffWindows(place, band, dataset.shape, west, north, resolution, crs, flip)


def checked_band(
    dataset: DatasetReader, band: int | None, *, feet: Mapping[str, float] | None = None
) -> tuple[int, float]:
    """Return the band with the heights.

    Parameters
    ----------
    dataset : DatasetReader
        An open GeoTIFF.
    band : int or None
        Its number, from 1, as the user gave it.
    feet : mapping of str to float, optional
        Metres by the name of a unit that is not the metre; without it such units are refused.

    Returns
    -------
    tuple of (int, float)
        Its number, and metres per unit of its heights.

    Raises
    ------
    HeightmapError
        If it is not said which band, there is no such band, or it holds no heights in metres.
    """
    if dataset.count != 1 and band is None:
        raise HeightmapError(
            f"the GeoTIFF has {dataset.count} bands: give `band`, the number of the one with the heights "
            f"(1 to {dataset.count})",
            bands=dataset.count,
        )
    band = 1 if band is None else band
    if not 1 <= band <= dataset.count:
        raise HeightmapError(
            f"the GeoTIFF has bands 1 to {dataset.count}, not {band}: give another `band`", bands=dataset.count
        )
    dtype = np.dtype(dataset.dtypes[band - 1]) if "complex" not in dataset.dtypes[band - 1] else np.dtype(complex)
    what = "the GeoTIFF" if dataset.count == 1 else f"`band` {band} of the GeoTIFF"
    if dtype.kind not in "fiu":
        raise HeightmapError(f"{what} holds {dataset.dtypes[band - 1]}, not real numbers")
    if dataset.colorinterp[band - 1] == ColorInterp.palette:
        raise HeightmapError(f"{what} is a picture with a colour table, not heights")
    unit = dataset.units[band - 1]
    factor = (feet or {}).get(unit.strip().lower(), 1.0) if unit else 1.0
    if unit and unit.strip().lower() in _FOOT_UNITS and factor == 1.0:
        raise HeightmapError(
            f"the GeoTIFF's heights are in {unit}, not in metres: `reproject` as auto converts them", unit=unit
        )
    block_rows, block_cols = dataset.block_shapes[band - 1]
    block_bytes = block_rows * block_cols * dtype.itemsize * dataset.count
    if block_bytes > max(_MAX_BLOCK_BYTES, dataset.height * dataset.width * dtype.itemsize * dataset.count):
        raise HeightmapError(
            f"the GeoTIFF declares blocks of {block_rows} x {block_cols} cells around a small map: corrupt"
        )
    return band, factor


def check_blocks(dataset: DatasetReader, band: int) -> None:
    """Refuse a file with blocks that were never written, unless it declares a no-data value, which GDAL then returns.

    Parameters
    ----------
    dataset : DatasetReader
        An open GeoTIFF.
    band : int
        Number of the band, from 1.

    Raises
    ------
    HeightmapError
        If GDAL would fill them with 0.
    """
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
