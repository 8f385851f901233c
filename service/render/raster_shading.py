"""Rasters made ready for drawing: averaged to the size of a screen, shaded as relief, placed in world coordinates."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import GridFrame

Image = NDArray[Any]
Extent = tuple[float, float, float, float]
"""West, east, south, north [m]."""

MAX_PIXELS = 1400
"""Longest side of a raster that is drawn; finer ones are averaged first."""


def thinned(values: Image, frame: GridFrame, *, most: int = 0) -> tuple[Image, Extent]:
    """Return a raster of at most so many pixels a side.

    `values` (rows, cols): NaN where unknown. Returns `values` (rows, cols): means over square blocks of cells, NaN
    where none of them is known; `extent`: west, east, south, north [m] of what is left: cells that fill no block are
    not drawn.
    """
    step = thinning(values.shape, most=most)
    rows, cols = (max(n // step, 1) for n in values.shape)
    west, south, east, north = frame.window(0, min(rows * step, frame.rows), 0, min(cols * step, frame.cols)).bounds
    extent = (west, east, south, north)
    return block_means(values, step), extent


def block_means(values: Image, step: int) -> Image:
    """Return the means over square blocks of cells.

    `values` (rows, cols): NaN where unknown. Result (rows // step, cols // step): NaN where no cell of a block is
    known.
    """
    if step == 1:
        return values
    rows, cols = (max(n // step, 1) for n in values.shape)
    blocks = values[: rows * step, : cols * step].reshape(rows, step, cols, step)
    known = np.isfinite(blocks)
    total = np.where(known, blocks, 0.0).sum(axis=(1, 3))
    count = known.sum(axis=(1, 3))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def thinning(shape: tuple[int, ...], *, most: int = 0) -> int:
    """Return how many cells a pixel has on a side after `thinned`."""
    return math.ceil(max(shape) / (most or MAX_PIXELS))


def steepness(heights: Image, extent: Extent) -> float:
    """Return the slope that `hillshade` shades most: most ground is less steep.

    `heights` (rows, cols): NaN where unknown; `extent`: west, east, south, north [m]. Result: 95 % quantile of the
    slopes [m/m]; 0 where none is known.
    """
    if min(heights.shape) < 2:
        return 0.0
    slope = np.hypot(*_gradient(heights, extent))
    return float(np.nanquantile(slope, 0.95)) if np.isfinite(slope).any() else 0.0


def _gradient(heights: Image, extent: Extent) -> tuple[Image, Image]:
    pixel = (extent[1] - extent[0]) / heights.shape[1]
    south, east = (np.asarray(part) for part in np.gradient(heights.astype(np.float64), pixel))
    return south, east


def hillshade(heights: Image, extent: Extent, *, steep: float | None = None) -> Image:
    """Return the brightness of ground lit from the north-west, exaggerated so that gentle slopes show.

    `heights` (rows, cols): NaN where unknown; `extent`: west, east, south, north [m]. The result is (rows, cols).
    """
    if min(heights.shape) < 2:
        return np.ones(heights.shape)
    south, east = _gradient(heights, extent)
    steep = steepness(heights, extent) if steep is None else steep
    gain = 0.7 / steep if steep > 1e-9 else 0.0
    nx, ny = -east * gain, south * gain
    light = np.array([-0.5, 0.5, math.sqrt(0.5)])
    lit = (nx * light[0] + ny * light[1] + light[2]) / np.sqrt(nx**2 + ny**2 + 1.0)
    return np.nan_to_num(np.clip(0.45 + 0.75 * lit / light[2] * 0.72, 0.45, 1.2), nan=1.0)


def centres(values: Image, extent: Extent) -> tuple[Image, Image]:
    """Return the coordinates of cell centres.

    `values` (rows, cols): any raster; `extent`: west, east, south, north [m]. Returns `x` (cols,): from west to east;
    `y` (rows,): from north to south.
    """
    west, east, south, north = extent
    rows, cols = values.shape
    x = west + (np.arange(cols) + 0.5) * (east - west) / cols
    return x, north - (np.arange(rows) + 0.5) * (north - south) / rows
