"""Ground that a question asks to avoid: polygons, whose cells are blocked for that question only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError, PointError
from joulemap.model.frames import GridFrame
from joulemap.planner.lattice import Blocked, CostLattice

Polygon = tuple[tuple[float, float], ...]
"""World x, y [m] of its corners; the last one is joined to the first."""
MOST_CORNERS = 20_000
"""Of all polygons of a question: beyond that, drawing them takes longer than planning."""


def checked_polygons(polygons: Sequence[Sequence[Sequence[float]]], frame: GridFrame) -> tuple[Polygon, ...]:
    """Return polygons whose corners are finite and that meet the map.

    `polygons` (x, y): corners [m]; `frame`: the map. Result: the same polygons. Raises InputError if one has fewer than
    three corners, or all together have more than `MOST_CORNERS`. Raises PointError if a corner is not finite, or a
    polygon lies outside the map.
    """
    count = sum(len(polygon) for polygon in polygons)
    if count > MOST_CORNERS:
        raise InputError(f"the areas to avoid have {count} corners; at most {MOST_CORNERS} can be taken", corners=count)
    west, south, east, north = frame.bounds
    out = []
    for k, polygon in enumerate(polygons):
        if len(polygon) < 3:
            raise InputError(f"avoid: area {k} has {len(polygon)} corners, at least 3 are needed", area=k)
        corners = np.array([(float(corner[0]), float(corner[1])) for corner in polygon])
        if not np.isfinite(corners).all():
            raise PointError(f"avoid: a corner of area {k} is not a finite number", area=k)
        low, high = corners.min(axis=0), corners.max(axis=0)
        if high[0] < west or low[0] > east or high[1] < south or low[1] > north:
            raise PointError(
                f"avoid: area {k} (x {low[0]:g} to {high[0]:g}, y {low[1]:g} to {high[1]:g}) lies outside the map "
                f"(x {west:g} to {east:g}, y {south:g} to {north:g})",
                area=k,
            )
        out.append(tuple((float(x), float(y)) for x, y in corners))
    return tuple(out)


def touched_cells(frame: GridFrame, polygons: Sequence[Polygon]) -> NDArray[np.bool_]:
    """Return which cells polygons touch.

    `frame`: the cells; `polygons`: where they overlap, both count. Result (rows, cols): true in every cell that has a
    part of a polygon, so that a narrow one has no gaps.
    """
    touched: NDArray[np.bool_] = np.zeros(frame.shape, dtype=np.bool_)
    west, south, east, north = frame.bounds
    for polygon in polygons:
        x, y = np.array(polygon).T
        if x.max() >= west and x.min() <= east and y.max() >= south and y.min() <= north:
            touched |= _drawn(frame, polygon)
    return touched


def _drawn(frame: GridFrame, polygon: Polygon) -> NDArray[np.bool_]:
    from rasterio.features import rasterize  # loads slowly, and few questions need it
    from rasterio.transform import from_origin

    west, _, _, north = frame.bounds
    shape: dict[str, Any] = {"type": "Polygon", "coordinates": [[*polygon, polygon[0]]]}
    transform = from_origin(west, north, frame.resolution_m, frame.resolution_m)
    drawn = rasterize([shape], out_shape=frame.shape, transform=transform, all_touched=True, dtype=np.uint8)
    return np.asarray(drawn, dtype=np.bool_)


def window_of(frame: GridFrame, polygon: Polygon) -> tuple[int, int, int, int]:
    """Return the cells that hold a polygon.

    `frame`: the map; `polygon`: it meets the map. Result: (row0, row1, col0, col1) on the map.
    """
    x, y = np.array(polygon).T
    row, col = frame.rowcol(x, y)
    rows, cols = frame.shape
    row0, row1 = int(np.floor(row.min() - 1)), int(np.ceil(row.max() + 2))
    col0, col1 = int(np.floor(col.min() - 1)), int(np.ceil(col.max() + 2))
    return max(row0, 0), min(row1, rows), max(col0, 0), min(col1, cols)


def without(lattice: CostLattice, polygons: Sequence[Polygon]) -> CostLattice:
    """Return the lattice with the cells of polygons blocked as `Blocked.AVOID`.

    `lattice`: its other arrays are shared; `polygons`: from `checked_polygons`. Result: cells that were blocked before
    keep their reason.
    """
    closed = touched_cells(lattice.frame, polygons) & (lattice.blocked == Blocked.FREE)
    return replace(lattice, blocked=np.where(closed, np.uint8(Blocked.AVOID), lattice.blocked))
