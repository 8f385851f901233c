"""The grade of 1 m segments, of single ones and of whole lattices."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from joulemap.model.frames import GridFrame, heading_vector, wrap_angle
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.rows import columns_between, sample_row
from joulemap.model.threads import pieces, share_out

FloatArray = NDArray[np.float64]

SEGMENT_M = 1.0
"""Horizontal length of a segment [m]: the paper's d. Source: Wei & Isler 2022, section V-D."""

_ROWS_AT_ONCE = 32


def tan_grade(heightmap: Heightmap, x: ArrayLike, y: ArrayLike, heading_rad: ArrayLike) -> FloatArray:
    """Return the grade of 1 m segments. Shapes broadcast.

    Heights are sampled bilinearly half a metre behind and ahead, so that the answer is exact on planes.

    `x`, `y`: centres of the segments [m]. Result: tangent of the pitch, positive uphill; NaN where the map is unknown.
    """
    dx, dy = heading_vector(heading_rad)
    half = 0.5 * SEGMENT_M
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    ahead = heightmap.sample(x + half * dx, y + half * dy)
    behind = heightmap.sample(x - half * dx, y - half * dy)
    return np.asarray((ahead - behind) / SEGMENT_M)


def tan_grade_lattice(heightmap: Heightmap, frame: GridFrame, headings_rad: FloatArray) -> NDArray[np.float32]:
    """Return `tan_grade` at the cell centres of a lattice.

    `headings_rad` is (K,). Result (rows, cols, K): tangent of the pitch; NaN where the map is unknown.
    """
    headings = np.ascontiguousarray(headings_rad, dtype=np.float64)
    own, sign = antipodes(headings)
    x, y = frame.centres()
    row, _ = heightmap.frame.rowcol(0.0, y)
    _, col = heightmap.frame.rowcol(x, 0.0)
    dx, dy = heading_vector(headings)
    half_pixels = 0.5 * SEGMENT_M / heightmap.resolution_m
    out = np.empty((frame.rows, frame.cols, headings.size), dtype=np.float32)
    down, right = -dy * half_pixels, dx * half_pixels
    share_out(
        lambda rows: _grades(heightmap.heights, row[rows], col, down, right, own, sign, SEGMENT_M, out[rows]),
        pieces(frame.rows, _ROWS_AT_ONCE),
    )
    return out


def antipodes(headings: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Find for each heading the earlier one that has the opposite direction.

    `headings` (K,): headings [rad]. Returns `own` (K,): index of the opposite heading, or the heading's own; `sign`
    (K,): -1 where it is the opposite, else +1.
    """
    own = np.arange(headings.size)
    sign = np.ones(headings.size)
    for k in range(1, headings.size):
        opposite = np.flatnonzero(np.abs(wrap_angle(headings[:k] - headings[k] - math.pi)) < 1e-12)
        if opposite.size and sign[opposite[0]] > 0:
            own[k], sign[k] = opposite[0], -1.0
    return own, sign


@njit(cache=True, nogil=True)
def _grades(heights, row, col, drow, dcol, own, sign, length_m, out):
    ahead = [columns_between(col + right, heights.shape[1]) for right in dcol]
    behind = [columns_between(col - right, heights.shape[1]) for right in dcol]
    line, high, low = np.empty(heights.shape[1]), np.empty(col.size), np.empty(col.size)
    grades = np.empty((drow.size, col.size), dtype=np.float32)
    for i in range(row.size):
        for k in range(drow.size):
            if sign[k] < 0.0:
                grades[k] = -grades[own[k]]
            else:
                sample_row(heights, row[i] + drow[k], ahead[k], line, high)
                sample_row(heights, row[i] - drow[k], behind[k], line, low)
                grades[k] = (high - low) / length_m
        for j in range(col.size):
            for k in range(drow.size):
                out[i, j, k] = grades[k, j]
