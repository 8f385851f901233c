"""Heights of points on a grid: the mean of each cell, and holes where there is no point."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError
from joulemap.model.ranges import COORDINATE_M, RESOLUTION_M
from joulemap.model.terrain.decoded import check_cells

FloatArray = NDArray[np.float64]

_POINTS_PER_CELL = 9.0
"""Of points that lie at random, exp(-9) of the cells then have none: one in eight thousand."""


class PointGrid:
    """Sums heights by cell, part by part, so that memory is taken for cells and not for points.

    `bounds`: west, south, east and north of the points.
    """

    def __init__(
        self,
        bounds: tuple[float, float, float, float],
        points: int,
        *,
        cell_m: float | None,
        max_cells: int,
        what: str,
    ) -> None:
        west, south, east, north = bounds
        for beyond in (value for value in bounds if value not in COORDINATE_M):
            raise HeightmapError(f"{what} has a point at {beyond:g}: coordinates must be {COORDINATE_M}", place=beyond)
        if not (east > west and north > south):
            raise HeightmapError(f"{what} spans x {west:g}..{east:g}, y {south:g}..{north:g}: there is no area in it")
        if cell_m is None:
            cell_m = float(f"{math.sqrt((east - west) * (north - south) * _POINTS_PER_CELL / max(points, 1)):.2g}")
        if not (cell_m > 0 and cell_m <= RESOLUTION_M.high):
            raise HeightmapError(f"`resolution_m` must be {RESOLUTION_M} metres, got {cell_m:g}", resolution_m=cell_m)
        self.cell_m = cell_m
        self.west_m = math.floor(west / cell_m) * cell_m
        self.north_m = math.ceil(north / cell_m) * cell_m
        rows = math.floor((self.north_m - south) / cell_m) + 1
        cols = math.floor((east - self.west_m) / cell_m) + 1
        check_cells(rows, cols, max_cells, what=f"{what}, in cells of {cell_m:g} m,")
        self._shape, self._what = (rows, cols), what
        self._sums = np.zeros(rows * cols)
        self._counts = np.zeros(rows * cols, dtype=np.uint32)

    def add(self, x: FloatArray, y: FloatArray, z: FloatArray) -> None:
        """Take some points. `x`, `y`, `z` (n,): places and heights."""
        rows, cols = self._shape
        col = np.floor((x - self.west_m) / self.cell_m)
        row = np.floor((self.north_m - y) / self.cell_m)
        inside = (col >= 0) & (col < cols) & (row >= 0) & (row < rows)
        if not inside.all():
            k = int(np.argmin(inside))
            raise HeightmapError(f"{self._what} is corrupt: a point at {x[k]:g}, {y[k]:g} lies outside of its bounds")
        cell = (row * cols + col).astype(np.int64)
        first, last = (int(cell.min()), int(cell.max()) + 1) if cell.size else (0, 0)
        self._sums[first:last] += np.bincount(cell - first, weights=z, minlength=last - first)
        self._counts[first:last] += np.bincount(cell - first, minlength=last - first).astype(np.uint32)

    def heights(self) -> NDArray[np.float64]:
        """Return the means. Result (rows, cols): NaN in cells without a point."""
        with np.errstate(invalid="ignore", divide="ignore"):
            found = self._sums / self._counts
        return found.reshape(self._shape)
