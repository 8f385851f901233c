"""Bilinear heights at whole rows of places: how passes over a map sample it, much faster than place by place."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

ON_CENTRE = 1e-6
"""Cells from a centre within which a place is on it: northings are rounded to 1e-9 m, which is 1e-7 cells of 1 cm."""


@njit(cache=True, nogil=True)
def share_of(at, low):
    """Return the share of the upper one of two cells, 0 or 1 on a centre."""
    share = at - low
    if abs(share) < ON_CENTRE:
        return 0.0
    if abs(share - 1.0) < ON_CENTRE:
        return 1.0
    return share


@njit(cache=True, nogil=True)
def between(at, size):
    """Return the two cells around a fractional index, weighted as `heightmap.bilinear` does.

    In the outer half cell the nearest two are continued linearly; beyond it the share is NaN.
    """
    edge = 0.5 + 1e-6
    if not -edge <= at <= size - 1 + edge:
        end = 0 if at < 0.0 else size - 1
        return end, end, math.nan
    low = min(max(math.floor(at), 0), size - 2)
    share = share_of(at, low)
    if share == 0.0:
        return low, low, 0.0
    if share == 1.0:
        return low + 1, low + 1, 0.0
    return low, low + 1, share


@njit(cache=True, nogil=True)
def columns_between(at, size):
    """Return `between` of many fractional columns.

    `at` is (n,). Result (n,): lower and upper index (uint32, which index without a check of the sign) and share of the
    upper one (float64).
    """
    left, right = np.empty(at.size, dtype=np.uint32), np.empty(at.size, dtype=np.uint32)
    share = np.empty(at.size)
    for j in range(at.size):
        left[j], right[j], share[j] = between(at[j], size)
    return left, right, share


@njit(cache=True, nogil=True)
def sample_row(values, row, columns, line, out):
    """Sample one fractional row, bilinear.

    `values` (rows, cols): values at the cell centres, NaN where unknown; `columns` (n,): from `columns_between`, of
    columns that increase; `line` (cols,): working memory; `out` (n,): is filled with the values, NaN beyond the map and
    wherever a value with non-zero weight is NaN.
    """
    left, right, share = columns
    up, down, low = between(row, values.shape[0])
    upper, lower = values[up], values[down]
    for c in range(left[0], right[-1] + 1):
        line[c] = upper[c] + low * (np.float64(lower[c]) - upper[c])
    for j in range(out.size):
        at_left = line[left[j]]
        out[j] = at_left + share[j] * (line[right[j]] - at_left)
