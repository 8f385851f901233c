"""The shape of polylines of (row, col), whatever they cost: their length, and the same line with other vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]


def path_length(points: Points) -> float:
    """Return the length of a polyline. `points` (n, 2): (row, col) polyline. Result: length [cells]."""
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def distinct(points: Points) -> Points:
    """Return a polyline without vertices that repeat their predecessor; both ends stay.

    `points` (n, 2): (row, col) polyline. Result (m, 2): (row, col) polyline.
    """
    keep = np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-9)
    if not keep[-1]:
        keep[-2], keep[-1] = False, True
    keep[0] = True
    return np.ascontiguousarray(points[keep])


def subdivided(points: Points, leg_cells: float) -> Points:
    """Return the same polyline with every leg cut into equal parts, none longer than a limit.

    `points` (n, 2): (row, col) polyline. Result (m, 2): (row, col) polyline.
    """
    length = np.hypot(*np.diff(points, axis=0).T)
    parts = np.maximum(np.ceil(length / leg_cells - 1e-9), 1.0).astype(np.int64)  # no more where only rounding asks
    leg = np.repeat(np.arange(parts.size), parts)
    share = (np.arange(leg.size) - np.repeat(np.cumsum(parts) - parts, parts) + 1.0)[:, None] / parts[leg, None]
    return np.vstack([points[:1], (1.0 - share) * points[leg] + share * points[leg + 1]])  # exact at vertices
