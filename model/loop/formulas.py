"""The registry of the formulas of effects: what each would add to the energy of a segment.

A formula reads the features of segments and returns columns (n, k) in joules (ampere seconds for charge) per unit of k
coefficients, so that effects add up and their coefficients follow from least squares.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop import formulas_of_conditions as conditions
from joulemap.model.loop import formulas_of_motion as motion
from joulemap.model.loop import formulas_of_place as places
from joulemap.model.loop.drive import Drive

FloatArray = NDArray[np.float64]
Formula = Callable[..., FloatArray]


def by_run(drive: Drive, *, of: str, runs: list[str]) -> FloatArray:
    """Another formula with coefficients of its own in every run.

    Parameters
    ----------
    drive : Drive
        Features of the segments.
    of : str
        Name of the other formula.
    runs : list of str
        The runs. In any other run the mean of all applies (of a payload), or nothing (of a wind, which differs every
        day).

    Returns
    -------
    ndarray of float, (n, runs x columns)
        In the units of the other formula.
    """
    columns = FORMULAS[of](drive)
    numbers = {name: k for k, name in enumerate(runs)}
    which = np.array([numbers.get(name, -1) for name in drive.runs] or [-1])[drive.run]
    elsewhere = 0.0 if of == "wind_constant" else 1.0 / len(runs)
    share = np.where(which[:, None] < 0, elsewhere, which[:, None] == np.arange(len(runs)))  # (n, runs)
    return (share[:, :, None] * columns[:, None, :]).reshape(len(drive), -1)


FORMULAS: dict[str, Formula] = {
    formula.__name__: formula
    for formula in (
        motion.turning,
        motion.turning_both,
        motion.turning_sides,
        motion.hotel_load,
        motion.sensor_gain,
        motion.level,
        motion.standing,
        motion.plane,
        motion.friction,
        conditions.payload,
        conditions.temperature,
        motion.speed,
        motion.acceleration,
        motion.cross_slope,
        motion.roughness,
        motion.reversing,
        motion.braking,
        motion.climbing,
        conditions.wind_measured,
        conditions.wind_constant,
        conditions.heading,
        by_run,
        conditions.drift,
        conditions.battery,
        conditions.words,
        conditions.turning_words,
        places.disk,
        places.place,
        places.smooth,
    )
}
"""By the name that a Term keeps."""

GROUND = frozenset({"grade", "cross_slope", "roughness", "elevation", "hollow", "braking", "climbing"})
"""Formulas and quantities that depend on the ground."""

FORCES = frozenset(
    {
        "friction",
        "cross_slope",
        "roughness",
        "wind_measured",
        "wind_constant",
        "heading",
        "speed",
        "temperature",
        "drift",
        "words",
        "disk",
        "place",
        "reversing",
        "acceleration",
        "length",
    }
)
"""Formulas of forces against the motion, and curves per metre."""
