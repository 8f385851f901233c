"""What the dense passes read of the ground: heights at the working pixels of a tile's cells, and their slopes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.energy.architectures.compact.tracks import PIXEL_M, SQUARE
from joulemap.model.energy.architectures.compact.weights import STRIDE
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.rows import columns_between, sample_row

FloatArray = NDArray[np.float64]

_MIDDLE = (SQUARE - 1) // 2


@dataclass(frozen=True)
class Buffers:
    """Memory for what `read_cells` reads of a tile: fresh memory costs more than the reading."""

    heights: FloatArray  # Flat
    slopes: NDArray[np.float32]  # Flat

    @classmethod
    def of(cls, rows: int, cols: int, *, joined: bool) -> Buffers:
        """Reserve memory for tiles."""
        if joined:
            high, wide = STRIDE * rows + SQUARE, STRIDE * cols + SQUARE
        else:
            high, wide = SQUARE * rows, SQUARE * cols
        return cls(np.empty(high * (wide + STRIDE)), np.zeros(3 * high * (wide + STRIDE), dtype=np.float32))


def read_cells(
    heightmap: Heightmap, x: FloatArray, y: FloatArray, buffers: Buffers, *, joined: bool
) -> tuple[FloatArray, NDArray[np.float32]]:
    """Read the heights around cells, and their slopes.

    The map is continued by odd reflection (a plane stays a plane).

    `x` (cols,): cell centres, ascending [m]; `y` (rows,): cell centres, descending [m]. Returns `heights` (R, planes,
    slots): heights [m], float32 could not hold tenths of a millimetre a kilometre above the sea, pixel (r, c) of the
    square around cell (i, j) is at [planes i + r, c % planes, j + c // planes], with 8 planes (joined) or 17, so that
    heights of neighbouring cells are neighbours in memory; `slopes` (rasters, h, planes, 3, slots): slope to the east,
    slope to the north and twist of every 2 x 2 heights, joined: one raster of 8 planes and two slots more than there
    are cells, of which the last is undefined.
    """
    if joined:
        pixels_down, pixels_right = (np.arange(STRIDE * (n - 1) + SQUARE) - _MIDDLE for n in (y.size, x.size))
        down, right = y[0] - pixels_down * PIXEL_M, x[0] + pixels_right * PIXEL_M
        planes, high = STRIDE, down.size
    else:
        pixels = (np.arange(SQUARE) - _MIDDLE) * PIXEL_M
        down, right = (y[:, None] - pixels).ravel(), (x[:, None] + pixels).ravel()
        planes, high = SQUARE, SQUARE
    row, col = heightmap.frame.rowcol(0.0, down)[0], heightmap.frame.rowcol(right, 0.0)[1]
    (rows, row, pad_rows), (cols, col, pad_cols) = (
        _cover(at, n) for at, n in zip((row, col), heightmap.heights.shape, strict=True)
    )
    known = heightmap.heights[rows, cols]
    if any((*pad_rows, *pad_cols)):
        known = np.pad(known, (pad_rows, pad_cols), mode="reflect", reflect_type="odd")
    slots = -(-right.size // planes)
    heights = buffers.heights[: down.size * planes * slots].reshape(down.size, planes, slots)
    shape = down.size // high, high - 1, STRIDE if joined else SQUARE - 1, 3, slots
    slopes = buffers.slopes[: math.prod(shape)].reshape(shape)
    _read(np.ascontiguousarray(known), row, col, heights, slopes)
    return heights, slopes


def _cover(at: FloatArray, size: int) -> tuple[slice, FloatArray, tuple[int, int]]:
    """The cells that samples at fractional indices need: (slice of the map, indices inside it, cells to pad)."""
    low, high = math.floor(at[0]) - 1, math.ceil(at[-1]) + 2
    before, after = max(-low, 0), max(high - size, 0)
    start, stop = max(low, 0), min(high, size)
    if before:
        stop = max(stop, min(before + 2, size))  # the mirror image of what is padded
    if after:
        start = min(start, max(size - after - 2, 0))
    return slice(start, stop), at - start + before, (before, after)


@njit(cache=True, nogil=True)
def _read(known, row, col, heights, slopes):
    columns, line, of_row = columns_between(col, known.shape[1]), np.empty(known.shape[1]), np.empty(col.size)
    planes, high = heights.shape[1], slopes.shape[1] + 1
    for r in range(row.size):
        sample_row(known, row[r], columns, line, of_row)
        for plane in range(planes):
            of, out = of_row[plane:], heights[r, plane]
            for slot in range((of.size + planes - 1) // planes):
                out[slot] = of[slot * planes]
        if r % high:
            _slopes(heights[r - 1], heights[r], slopes[r // high, r % high - 1])


@njit(cache=True, nogil=True)
def _slopes(north, south, out):
    """Rise to the east and to the north and the twist of every 2 x 2 heights [m] of two rows, (planes, slots)."""
    scale = 0.5 / PIXEL_M
    for plane in range(out.shape[0]):
        ahead, lane = (plane + 1) % north.shape[0], (plane + 1) // north.shape[0]
        nw, ne, sw, se = north[plane], north[ahead, lane:], south[plane], south[ahead, lane:]
        east, up, twist = out[plane, 0], out[plane, 1], out[plane, 2]
        for slot in range(min(nw.size, ne.size)):
            above, below = ne[slot] - nw[slot], se[slot] - sw[slot]
            east[slot] = (above + below) * scale
            up[slot] = ((nw[slot] - sw[slot]) + (ne[slot] - se[slot])) * scale
            twist[slot] = (above - below) * scale
