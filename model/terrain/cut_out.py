"""Cuts a window out of a map, so that of a large file only that part is read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rasterio.transform import Affine

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.crs_text import known_crs
from joulemap.model.terrain.decoded import Scaling
from joulemap.model.terrain.formats.contract import WindowReader
from joulemap.model.terrain.target_grid import moved

WindowLike = str | Sequence[float]
"""Two opposite corners: four numbers, or a text of them such as "366990,4064300,367080,4064400"."""

_DEGREES = "EPSG:4326"
_EDGE_POINTS = 21
_LEAST_CELLS = 2


@dataclass(frozen=True)
class Cells:
    """The cells of a map that a window holds."""

    row0: int  # Rows [row0, row1) and columns [col0, col1)
    row1: int
    col0: int
    col1: int

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return self.row1 - self.row0, self.col1 - self.col0


def corners_of(window: WindowLike) -> tuple[float, float, float, float]:
    """Return the four numbers of a window."""
    try:
        numbers = [float(part) for part in (window.split(",") if isinstance(window, str) else window)]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != 4 or not all(map(math.isfinite, numbers)):
        raise HeightmapError(
            f"`window` is {str(window)[:80]!r}: give two opposite corners, such as 366990,4064300,367080,4064400 (x,y "
            "of the map's CRS) or 36.714,-4.490,36.716,-4.488 (latitude,longitude)"
        )
    first, second, third, fourth = numbers
    return first, second, third, fourth


def cells_of(window: WindowLike, crs: str | None, transform: Affine, shape: tuple[int, int]) -> Cells:
    """Return the cells of a grid that a window holds, as a whole or in part."""
    a, b, c, d = corners_of(window)
    if crs is None or not known_crs(crs).is_geographic:
        found = _cells(transform, shape, *_rim(min(a, c), min(b, d), max(a, c), max(b, d)))
        if found is not None:
            return found
    if crs is not None and max(abs(a), abs(c)) <= 90.0 and max(abs(b), abs(d)) <= 180.0:
        lon, lat = _rim(min(b, d), min(a, c), max(b, d), max(a, c))
        found = _cells(transform, shape, *moved(_DEGREES, crs, Affine.identity(), lon, lat))
        if found is not None:
            return found
    raise HeightmapError(
        f"`window` {a:g},{b:g},{c:g},{d:g} holds no 2 x 2 cells of the map, which spans {_span(crs, transform, shape)}",
        window=[a, b, c, d],
    )


def _rim(west: float, south: float, east: float, north: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points along the four sides of a box."""
    along = np.linspace(0.0, 1.0, _EDGE_POINTS)
    x = west + (east - west) * np.concatenate([along, along, 0 * along, 0 * along + 1])
    y = south + (north - south) * np.concatenate([0 * along, 0 * along + 1, along, along])
    return x, y


def _cells(transform: Affine, shape: tuple[int, int], x: NDArray[np.float64], y: NDArray[np.float64]) -> Cells | None:
    there = ~transform
    col, row = there.a * x + there.b * y + there.c, there.d * x + there.e * y + there.f
    if not (np.isfinite(col).all() and np.isfinite(row).all()):
        return None
    tiny = 1e-6  # of a cell, so that an edge on a line between cells takes none of the next
    row0, row1 = max(0.0, math.floor(row.min() + tiny)), min(shape[0], math.ceil(row.max() - tiny))
    col0, col1 = max(0.0, math.floor(col.min() + tiny)), min(shape[1], math.ceil(col.max() - tiny))
    if row1 - row0 < _LEAST_CELLS or col1 - col0 < _LEAST_CELLS:
        return None
    return Cells(int(row0), int(row1), int(col0), int(col1))


def _span(crs: str | None, transform: Affine, shape: tuple[int, int]) -> str:
    rows, cols = shape
    col, row = np.array([0.0, cols, 0.0, cols]), np.array([0.0, 0.0, rows, rows])
    x, y = moved(None, None, transform, col, row)
    plain = f"x {x.min():.6g}..{x.max():.6g}, y {y.min():.6g}..{y.max():.6g}"
    if crs is None:
        return plain
    lon, lat = moved(crs, _DEGREES, transform, col, row)
    return f"{plain} (latitude {lat.min():.5f}..{lat.max():.5f}, longitude {lon.min():.5f}..{lon.max():.5f})"


def transform_of(frame: GridFrame) -> Affine:
    """Return the transform of a north-up grid of square cells. Result: from (column, row) to x, y."""
    side = frame.resolution_m
    return Affine(side, 0.0, frame.west_m, 0.0, -side, frame.north_m)


@dataclass(frozen=True)
class PartReader:
    """A part of a file that is read by windows."""

    whole: WindowReader  # The file
    cells: Cells  # The part

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return self.cells.shape

    @property
    def resolution_m(self) -> float | None:
        """Side of a cell [m]."""
        return self.whole.resolution_m

    @property
    def west_m(self) -> float | None:
        """Western edge [m], None where the file does not say."""
        west, side = self.whole.west_m, self.whole.resolution_m
        return None if west is None or side is None else west + self.cells.col0 * side

    @property
    def north_m(self) -> float | None:
        """Northern edge [m], None where the file does not say."""
        north, side = self.whole.north_m, self.whole.resolution_m
        return None if north is None or side is None else north - self.cells.row0 * side

    @property
    def crs(self) -> str | None:
        """Coordinate reference system."""
        return self.whole.crs

    @property
    def notes(self) -> tuple[str, ...]:
        """What is to be known of the file."""
        return self.whole.notes

    def read(self, scaling: Scaling, rows: slice, cols: slice) -> NDArray[np.float32]:
        """Return the heights of a window of the part. Result (rows, cols): heights [m], NaN where unknown."""
        down, right = self.cells.row0, self.cells.col0
        return self.whole.read(
            scaling, slice(rows.start + down, rows.stop + down), slice(cols.start + right, cols.stop + right)
        )
