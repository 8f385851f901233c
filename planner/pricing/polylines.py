"""The shape of polylines of (row, col), whatever they cost: their length, and the same line with other vertices."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.planner.pricing.integrator import Points


def path_length(points: Points) -> float:
    """Return the length of a polyline. `points` (n, 2): (row, col) polyline. Result: length [cells]."""
    return _length(np.ascontiguousarray(points, dtype=np.float64))


def distances_along(points: Points) -> NDArray[np.float64]:
    """Return how far along a polyline its vertices are.

    `points` (n, 2): (row, col) polyline. Result (n,): distance from its beginning [cells].
    """
    return np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))


def distinct(points: Points) -> Points:
    """Return a polyline without vertices that repeat their predecessor; both ends stay.

    `points` (n, 2): (row, col) polyline. Result (m, 2): (row, col) polyline.
    """
    keep = np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-9)
    if not keep[-1]:
        keep[-2], keep[-1] = False, True
    keep[0] = True
    return np.ascontiguousarray(points[keep])


def corners(points: Points) -> Points:
    """Return the same polyline without the vertices at which it does not turn; both ends stay.

    `points` (n, 2): (row, col) polyline, each vertex distinct from the one before. Result (m, 2): (row, col) polyline.
    """
    legs = np.diff(points, axis=0)
    (row, col), (next_row, next_col) = legs[:-1].T, legs[1:].T
    area, along = row * next_col - col * next_row, row * next_row + col * next_col
    turns = (np.abs(area) > 1e-9) | (along < 0.0)
    return np.ascontiguousarray(points[np.concatenate([[True], turns, [True]])])


def subdivided(points: Points, leg_cells: float) -> Points:
    """Return the same polyline with no leg longer than a limit.

    `points` (n, 2): (row, col) polyline. Result (m, 2): (row, col) polyline.
    """
    return _cut(np.ascontiguousarray(points, dtype=np.float64), leg_cells)


@njit(cache=True, nogil=True)
def _length(points):
    total = 0.0
    for k in range(points.shape[0] - 1):
        total += math.hypot(points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1])
    return total


@njit(cache=True, nogil=True)
def _cut(points, leg_cells):
    """The polyline with every leg cut into equal parts of at most `leg_cells`."""
    parts = np.empty(points.shape[0] - 1, dtype=np.int64)
    for k in range(parts.size):
        length = math.hypot(points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1])
        parts[k] = max(math.ceil(length / leg_cells - 1e-9), 1)  # not one more where only rounding asks for it
    out = np.empty((parts.sum() + 1, 2))
    out[0], at = points[0], 1
    for k in range(parts.size):
        for part in range(1, parts[k] + 1):
            share = part / parts[k]  # at the end 1, which gives exactly the vertex
            for axis in range(2):
                out[at, axis] = (1.0 - share) * points[k, axis] + share * points[k + 1, axis]
            at += 1
    return out
