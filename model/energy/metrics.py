"""The error that every figure of this project means by "mean relative error"."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

LEAST_J = 1.0
"""Energy of a 1 m segment [J] that relative errors are at least relative to: loggers do not resolve less. It only keeps
a segment without any energy (downhill, with no idle power or with regeneration) from dividing by zero."""


def relative_errors(predicted_j: ArrayLike, energy_j: ArrayLike) -> NDArray[np.float64]:
    """Return the relative error of every segment, |e_hat - e| / |e|.

    Parameters
    ----------
    predicted_j : array_like, (n,)
        Predicted energies e_hat [J].
    energy_j : array_like, (n,)
        Measured energies e [J].

    Returns
    -------
    ndarray of float64, (n,)
        Relative errors; |e| counts as `LEAST_J` where it is less.

    References
    ----------
    Wei & Isler 2022, eq. 3.
    """
    predicted, energy = np.asarray(predicted_j, dtype=np.float64), np.asarray(energy_j, dtype=np.float64)
    return np.asarray(np.abs(predicted - energy) / np.maximum(np.abs(energy), LEAST_J))


def mean_relative_error(predicted_j: ArrayLike, energy_j: ArrayLike) -> float:
    """Return the mean of `relative_errors` over the segments: the paper's eq. 3.

    Parameters
    ----------
    predicted_j, energy_j : array_like, (n,)
        As `relative_errors`.

    Returns
    -------
    float
        0.1 means 10 %.
    """
    return float(relative_errors(predicted_j, energy_j).mean())
