"""Where on the map a field of bell curves, or a circle, may lie: where enough was driven to fit it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.drive import Drive

FloatArray = NDArray[np.float64]

_OFTEN = 12  # segments


def field_settings(drive: Drive, width_m: float) -> dict[str, Any]:
    """Return bell curves over all ground that was driven often enough.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    width_m : float
        Of each curve [m].

    Returns
    -------
    dict
        Settings of the formula `place`.
    """
    x, y = drive.x, drive.y
    centres = [[round(cx, 2), round(cy, 2)] for cx, cy in grid_over(x, y, 1.3 * width_m)]
    centres = [c for c in centres if (np.hypot(x - c[0], y - c[1]) <= width_m).sum() >= _OFTEN]
    return {"centres": centres, "width_m": round(width_m, 2)}


def grid_over(x: FloatArray, y: FloatArray, spacing: float) -> list[tuple[float, float]]:
    """Return a square grid over points.

    Parameters
    ----------
    x, y : ndarray of float, (n,)
        The points [m].
    spacing : float
        Of the grid [m].

    Returns
    -------
    list of tuple of float
        x, y of its nodes [m].
    """
    xs = np.arange(x.min() + 0.25 * spacing, x.max() + 0.25 * spacing, spacing)
    ys = np.arange(y.min() + 0.25 * spacing, y.max() + 0.25 * spacing, spacing)
    return [(float(a), float(b)) for a in xs for b in ys]
