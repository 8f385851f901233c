"""Formulas of effects that differ from place to place, and of fitted curves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.drive import Drive
from joulemap.model.loop.formulas_of_motion import friction, level
from joulemap.model.loop.quantities import driven_heights, quantity

FloatArray = NDArray[np.float64]


def disk(drive: Drive, *, x: float, y: float, radius_m: float) -> FloatArray:
    """Rolling resistance in addition to the declared one within a circle.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    x, y : float
        Centre [m].
    radius_m : float
        Of the circle [m].

    Returns
    -------
    ndarray of float, (n, 1)
        Per unit of the coefficient of rolling resistance.
    """
    return friction(drive) * (np.hypot(drive.x - x, drive.y - y) <= radius_m)[:, None]


def place(drive: Drive, *, centres: list[list[float]], width_m: float, of_all: bool) -> FloatArray:
    """Rolling resistance in addition, or a share of everything, as a smooth field: Gaussian functions around centres.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    centres : list of list of float
        x, y [m] of each.
    width_m : float
        Standard deviation of the functions [m].
    of_all : bool
        A share of everything instead of rolling resistance.

    Returns
    -------
    ndarray of float, (n, centres)
        Per 1.
    """
    at = np.asarray(centres, dtype=np.float64)
    far = (drive.x[:, None] - at[:, 0]) ** 2 + (drive.y[:, None] - at[:, 1]) ** 2
    amount = level(drive) if of_all else friction(drive)
    return amount * np.exp(-0.5 * far / width_m**2)


def smooth(drive: Drive, *, over: str, knots: list[float], of: str, level: bool = False) -> FloatArray:
    """A piecewise linear curve over a quantity.

    It is constant beyond its outer knots. Where the quantity is unknown, and at heights outside `driven_heights`, it
    has its value at the middle knot.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    over : str
        The quantity.
    knots : list of float
        Values of the quantity.
    of : str
        `length` for energy per metre, `all` for a share of the prediction, `motion` for one of the energy of motion.
    level : bool
        Give the middle knot a coefficient too; otherwise the curve is 0 there.

    Returns
    -------
    ndarray of float, (n, knots - 1 + level)
        Per J/m, or per 1.
    """
    values = quantity(drive, over)
    if over == "elevation":
        low, high = driven_heights(knots)
        values = np.where((values >= low) & (values <= high), values, np.nan)
    amount = {
        "length": drive.length_m,
        "all": np.where(drive.standing, 0.0, drive.predicted),
        "motion": drive.motion_part,
    }[of]
    middle = len(knots) // 2
    filled = np.where(np.isfinite(values), values, knots[middle])
    hats = [np.interp(filled, knots, row) for k, row in enumerate(np.eye(len(knots))) if level or k != middle]
    return np.stack(hats, axis=1) * amount[:, None]
