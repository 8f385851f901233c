"""What the dense passes read of the ground: heights at the working pixels of a tile's cells, and their slopes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.energy.architectures.compact.net import STRIDE
from joulemap.model.energy.architectures.compact.tracks import PIXEL_M, SQUARE
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.rows import columns_between, sample_row

FloatArray = NDArray[np.float64]

_MIDDLE = (SQUARE - 1) // 2


@dataclass(frozen=True)
class Buffers:
    """Memory for what `read_cells` reads of a tile: fresh memory costs more than the reading.

    Attributes
    ----------
    heights : ndarray of float64
        Flat.
    slopes : ndarray of float32
        Flat.
    """

    heights: FloatArray
    slopes: NDArray[np.float32]

    @classmethod
    def of(cls, rows: int, cols: int, *, joined: bool) -> Buffers:
        """Reserve memory for tiles.

        Parameters
        ----------
        rows, cols : int
            Greatest number of cells of a tile.
        joined : bool
            As in `read_cells`.

        Returns
        -------
        Buffers
            Uninitialised.
        """
        if joined:
            high, wide = STRIDE * rows + SQUARE, STRIDE * cols + SQUARE
        else:
            high, wide = SQUARE * rows, SQUARE * cols
        return cls(np.empty(high * (wide + STRIDE)), np.empty(3 * high * wide, dtype=np.float32))


def read_cells(
    heightmap: Heightmap, x: FloatArray, y: FloatArray, buffers: Buffers, *, joined: bool
) -> tuple[FloatArray, NDArray[np.float32]]:
    """Read the heights around cells, and their slopes.

    The map is continued by odd reflection (a plane stays a plane).

    Parameters
    ----------
    heightmap : Heightmap
        The ground.
    x : ndarray of float64, (cols,)
        Cell centres, ascending [m].
    y : ndarray of float64, (rows,)
        Cell centres, descending [m].
    buffers : Buffers
        Memory for the answer.
    joined : bool
        Whether the cells have a spacing of 1 m and share their pixels; otherwise each has a square of its own.

    Returns
    -------
    heights : ndarray of float64, (R, planes, slots)
        Heights [m]; float32 could not hold tenths of a millimetre a kilometre above the sea. Pixel (r, c) of the square
        around cell (i, j) is at [planes i + r, c % planes, j + c // planes], with 8 planes (joined) or 17, so that
        heights of neighbouring cells are neighbours in memory.
    slopes : ndarray of float32, (B, h, w, 3)
        As from `slopes_of_squares`: of one raster (joined), or of rows * cols squares.
    """
    if joined:
        pixels_down, pixels_right = (np.arange(STRIDE * (n - 1) + SQUARE) - _MIDDLE for n in (y.size, x.size))
        down, right = y[0] - pixels_down * PIXEL_M, x[0] + pixels_right * PIXEL_M
        planes, high, wide = STRIDE, down.size, right.size
    else:
        pixels = (np.arange(SQUARE) - _MIDDLE) * PIXEL_M
        down, right = (y[:, None] - pixels).ravel(), (x[:, None] + pixels).ravel()
        planes, high, wide = SQUARE, SQUARE, SQUARE
    row, col = heightmap.frame.rowcol(0.0, down)[0], heightmap.frame.rowcol(right, 0.0)[1]
    (rows, row, pad_rows), (cols, col, pad_cols) = (
        _cover(at, n) for at, n in zip((row, col), heightmap.heights.shape, strict=True)
    )
    known = heightmap.heights[rows, cols]
    if any((*pad_rows, *pad_cols)):
        known = np.pad(known, (pad_rows, pad_cols), mode="reflect", reflect_type="odd")
    shape = down.size, planes, -(-right.size // planes)
    heights = buffers.heights[: math.prod(shape)].reshape(shape)
    squares = (down.size // high) * (right.size // wide), high - 1, wide - 1, 3
    slopes = buffers.slopes[: math.prod(squares)]
    _read(np.ascontiguousarray(known), row, col, high, wide, heights, slopes)
    return heights, slopes.reshape(squares)


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
def _read(known, row, col, high, wide, heights, slopes):
    columns, line = columns_between(col, known.shape[1]), np.empty(known.shape[1])
    north, south = np.empty(col.size), np.empty(col.size)
    planes, blocks, length = heights.shape[1], col.size // wide, 3 * (wide - 1)
    for r in range(row.size):
        sample_row(known, row[r], columns, line, south)
        for plane in range(planes):
            of, out = south[plane:], heights[r, plane]
            for slot in range((of.size + planes - 1) // planes):
                out[slot] = of[slot * planes]
        if r % high:
            for n in range(blocks):
                at = ((r // high * blocks + n) * (high - 1) + r % high - 1) * length
                _slopes(north[n * wide :], south[n * wide :], slopes[at : at + length])
        north, south = south, north


@njit(cache=True, nogil=True)
def _slopes(north, south, out):
    """Rise to the east and to the north and the twist of every 2 x 2 heights [m] of two rows, one after another."""
    scale = 0.5 / PIXEL_M
    for j in range(out.size // 3):
        above, below = north[j + 1] - north[j], south[j + 1] - south[j]
        out[3 * j] = (above + below) * scale
        out[3 * j + 1] = ((north[j] - south[j]) + (north[j + 1] - south[j + 1])) * scale
        out[3 * j + 2] = (above - below) * scale
