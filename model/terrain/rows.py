"""Bilinear heights at whole rows of places: how passes over a map sample it, much faster than place by place."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def between(at, size):
    """(lower index, upper index, share of the upper) of a fractional index, as `heightmap.bilinear` weighs it.

    A share of (nearly) nothing asks one of them alone; in the outer half cell the nearest two are continued linearly;
    beyond it the share is NaN.
    """
    edge = 0.5 + 1e-6
    if not -edge <= at <= size - 1 + edge:
        end = 0 if at < 0.0 else size - 1
        return end, end, math.nan
    low = min(max(math.floor(at), 0), size - 2)
    share = at - low
    if abs(share) < 1e-9:
        return low, low, 0.0
    if abs(share - 1.0) < 1e-9:
        return low + 1, low + 1, 0.0
    return low, low + 1, share


@njit(cache=True, nogil=True)
def columns_between(at, size):
    """`between` of fractional columns (n,): lower and upper (n,) uint32 (they index without a check of the sign), and
    share (n,) float64.
    """
    left, right = np.empty(at.size, dtype=np.uint32), np.empty(at.size, dtype=np.uint32)
    share = np.empty(at.size)
    for j in range(at.size):
        left[j], right[j], share[j] = between(at[j], size)
    return left, right, share


@njit(cache=True, nogil=True)
def sample_row(values, row, columns, line, out):
    """Bilinear values (n,) of one fractional row at columns as from `columns_between`, the first the least and the last
    the greatest; NaN beyond the map and wherever a value with non-zero weight is. line : scratch, a float64 per column
    of `values`.
    """
    left, right, share = columns
    up, down, low = between(row, values.shape[0])
    upper, lower = values[up], values[down]
    for c in range(left[0], right[-1] + 1):
        line[c] = upper[c] + low * (np.float64(lower[c]) - upper[c])
    for j in range(out.size):
        at_left = line[left[j]]
        out[j] = at_left + share[j] * (line[right[j]] - at_left)
