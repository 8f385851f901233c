"""Steps that a survey's noise hides from a local filter: a kerb or a ledge is long, so heights along it say the same.

Heights are averaged along straight lines of nine cells in eight directions. A step is where such means rise across the
line by more than noise makes them, and more than the ground before and behind it does (a matched filter, as Canny 1986
for edges of images), and where the rise differs along the line by no more than noise: tussocks are no step. There the
mean along the line of what the local filter took away is given back.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.threads import pieces, share_out

FloatArray = NDArray[np.float32]

_HALF = 4  # cells of a line on either side of its middle: kerbs of a metre and more on cells of 0.1 to 0.25 m
_RUN = 2  # cells over which a step rises: one that lies inside a cell is two rises
_SURE = 4.0
"""Standard deviations by which a step exceeds noise: in independent noise 1 of 16,000 lines does, in either sign."""
_MOST_RAGGED = 26.1
"""Of the squares of the nine rises along a straight step about their mean, over the variance of one: by noise one step
of a thousand has more (chi-square of eight degrees of freedom)."""
_ROWS_AT_ONCE, _COLS_AT_ONCE = 64, 64
REACH_CELLS = _HALF + 2 * _RUN
"""How far a height depends on others."""


def _lines() -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Offsets of the cells of lines (8, 9, 2), and whether steps across a line rise along a column of cells (8,)."""
    along = np.arange(-_HALF, _HALF + 1)
    steep = [
        np.stack([along, np.rint(slope * along).astype(np.int64)], axis=1) for slope in (-1.0, -0.5, 0.0, 0.5, 1.0)
    ]
    flat = [line[:, ::-1] for line in steep[1:4]]
    return np.array([*steep, *flat]), np.arange(8) >= len(steep)


def given_back(heights: FloatArray, removed: FloatArray, noise_m: float, correlation: FloatArray) -> FloatArray:
    """Return what of `removed` belongs to steps (rows, cols) [m].

    `heights`: as surveyed, NaN where unknown; `removed`: what a filter took away of them; `correlation`: of the noise
    of two cells, by their distance in cells (at least 2 `_HALF` + 1).
    """
    offsets, down = _lines()
    count = 2 * _HALF + 1
    alike = lambda at: correlation[np.abs(np.subtract.outer(at, at))]  # noqa: E731
    across = np.array([1.0, -2.0, 1.0])  # the rise less that before it
    variance = alike(np.arange(count)).sum() / count**2 * (across @ alike(_RUN * np.arange(3)) @ across)
    least = np.float32(_SURE * noise_m * math.sqrt(variance) * count)
    ragged = np.float32(_MOST_RAGGED * noise_m**2 * 2.0 * (1.0 - correlation[_RUN]))
    best, found = np.zeros_like(removed), np.zeros_like(removed)
    share_out(
        lambda rows: _find(heights, removed, offsets, down, least, ragged, best, found, rows.start, rows.stop),
        pieces(heights.shape[0], _ROWS_AT_ONCE),
    )
    return found


# Slices, unsigned columns and three rows at a time: so the loops over a row are compiled to vector instructions.
@njit(cache=True, nogil=True, fastmath={"contract"})
def _sum_lines(heights, at_rows, at_cols, first, sums):
    """Fill `sums` with those of the heights on a line around each cell, for rows from `first` on; NaN at the rim."""
    rows, cols = heights.shape
    west, east = max(-at_cols.min(), 0), cols - max(at_cols.max(), 0)
    for i in range(sums.shape[0]):
        sums[i] = np.float32(np.nan)
        r = first + i
        if r + at_rows.min() < 0 or r + at_rows.max() >= rows or west >= east:
            continue
        line = sums[i, west:east]
        line[:] = np.float32(0.0)
        for k in range(0, at_rows.size, 3):
            a = heights[r + at_rows[k], west + at_cols[k] : east + at_cols[k]]
            b = heights[r + at_rows[k + 1], west + at_cols[k + 1] : east + at_cols[k + 1]]
            c = heights[r + at_rows[k + 2], west + at_cols[k + 2] : east + at_cols[k + 2]]
            for j in range(np.uint64(line.size)):
                line[j] += a[j] + b[j] + c[j]


@njit(cache=True, nogil=True)
def _any_beyond(low, high, least):
    count = 0
    for j in range(np.uint64(low.size)):
        count += abs(high[j] - low[j]) > least
    return count > 0


@njit(cache=True, nogil=True)
def _raggedness(heights, offsets, row, col, to_row, to_col):
    """Sum of the squares of the rises from a line to the next, about their mean."""
    total = squares = np.float32(0.0)
    for k in range(len(offsets)):
        r, c = row + offsets[k, 0], col + offsets[k, 1]
        rise = heights[r + to_row, c + to_col] - heights[r, c]
        total += rise
        squares += rise * rise
    return squares - total * total / np.float32(len(offsets))


@njit(cache=True, nogil=True)
def _find(heights, removed, offsets, down, least, ragged, best, found, first, end):
    rows, cols = heights.shape
    count = offsets.shape[1]
    top = max(first - 2 * _RUN, 0)
    sums = np.empty((min(end + 2 * _RUN, rows) - top, cols), dtype=np.float32)
    for d in range(offsets.shape[0]):
        _sum_lines(heights, offsets[d, :, 0], offsets[d, :, 1], top, sums)
        to_row, to_col = (_RUN, 0) if down[d] else (0, _RUN)
        for i in range(max(first - to_row, top + to_row) - top, min(end - top, sums.shape[0] - 2 * to_row)):
            for start in range(to_col, cols - 2 * to_col, _COLS_AT_ONCE):
                stop = min(start + _COLS_AT_ONCE, cols - 2 * to_col)
                low, high = sums[i, start:stop], sums[i + to_row, start + to_col : stop + to_col]
                if not _any_beyond(low, high, least):  # as nearly everywhere
                    continue
                for j in range(start, stop):
                    rise = sums[i + to_row, j + to_col] - sums[i, j]
                    before = sums[i, j] - sums[i - to_row, j - to_col]
                    after = sums[i + 2 * to_row, j + 2 * to_col] - sums[i + to_row, j + to_col]
                    if not (abs(rise) > least and abs(rise - before) > least and abs(rise - after) > least):
                        continue  # also where a height is unknown
                    if _raggedness(heights, offsets[d], top + i, j, to_row, to_col) > ragged:
                        continue
                    more = min(abs(rise), abs(rise - before), abs(rise - after))
                    for step in range(_RUN + 1):
                        r, c = (top + i + step, j) if down[d] else (top + i, j + step)
                        if first <= r < end and more > best[r, c] and not math.isnan(sums[r - top, c]):
                            best[r, c] = more
                            total = np.float32(0.0)
                            for k in range(count):
                                total += removed[r + offsets[d, k, 0], c + offsets[d, k, 1]]
                            found[r, c] = total / np.float32(count)
