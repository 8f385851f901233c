"""What effects and thresholds may depend on, by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import ModelError
from joulemap.model.loop.drive import Drive

FloatArray = NDArray[np.float64]


def quantity(drive: Drive, name: str) -> FloatArray:
    """Return a quantity of segments.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    name : str
        One of the names below, or `column:NAME` for a logged column.

    Returns
    -------
    ndarray of float, (n,)
        NaN where it is not known.

    Raises
    ------
    ModelError
        If there is no such quantity.
    """
    if name.startswith("column:"):
        return drive.columns.get(name.removeprefix("column:"), np.full(len(drive), np.nan))
    values = {
        "grade": lambda: drive.grade,
        "cross_slope": lambda: drive.cross_abs,
        "roughness": lambda: drive.roughness_m,
        "elevation": lambda: drive.elevation_m,
        "hollow": lambda: drive.hollow_m,
        "speed": lambda: drive.speed_mps,
        "turning": lambda: drive.turned_abs_rad,
        "turn": lambda: drive.turned_rad,
        "since_start": lambda: drive.since_s,
        "driven": lambda: drive.driven_m,
        "clock": lambda: drive.clock_s,
        "odometer": lambda: drive.odometer_m,
        "x": lambda: drive.x,
        "y": lambda: drive.y,
    }
    if name not in values:
        raise ModelError(f"a model depends on {name!r}, which this version does not know", quantity=name)
    return values[name]()


def driven_heights(knots: Sequence[float]) -> tuple[float, float]:
    """Return the heights for which a curve over elevation is valid.

    Parameters
    ----------
    knots : sequence of float
        Of the curve [m], which leave out the lowest and the highest ground that was driven.

    Returns
    -------
    tuple of float
        Lowest and highest [m]: a quarter of the range beyond the outer knots. A height further away belongs to another
        place.
    """
    margin = 0.25 * (knots[-1] - knots[0])
    return knots[0] - margin, knots[-1] + margin
