"""Does the residual step where a record does? A test for a record that hardly changes within a run.

A class of ground, or a payload put on halfway, may change once in all runs. Shifted along its run, such a column still
covers most of what it covered, so that shifts have little power. The place has: the residual jumps there, and nowhere
else does it jump as much.

References
----------
Box & Tiao 1975 (interrupted time series).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

WINDOW = 30  # segments on either side of a step
_LEAST = 10
_SELDOM = 40  # segments per change, on average at least


def step_chance(z: FloatArray, state: FloatArray, run: IntArray) -> float:
    """Return the p-value of a jump of the residual at the changes of a record, two-sided.

    Parameters
    ----------
    z : ndarray of float, (n,)
        Residual [scaled], in driving order.
    state : ndarray of float, (n,)
        The record.
    run : ndarray of int, (n,)
        Number of the run.

    Returns
    -------
    float
        1 where the record never changes, or so often that its course within runs can be tested instead.

    Notes
    -----
    The jump at a change is the mean of up to 30 segments after it minus that of as many before, weighted by the size of
    the change. The spread of the jumps at all other places says what is usual, with as many degrees of freedom as
    windows fit in.
    """
    changes = np.flatnonzero((np.diff(state) != 0) & (np.diff(run) == 0)) + 1
    if changes.size == 0 or changes.size * _SELDOM > z.size:
        return 1.0
    ends = np.flatnonzero(np.diff(run) != 0) + 1
    borders = np.unique(np.concatenate([[0, z.size], ends, changes]))
    here, there = _jumps(z, changes, borders), _jumps(z, np.setdiff1d(np.arange(1, z.size), borders), borders)
    size = state[changes] - state[changes - 1]
    known, usual = np.isfinite(here), there[np.isfinite(there)]
    freedom = usual.size // WINDOW
    if not known.any() or freedom < 2:
        return 1.0
    together = float(np.sum(size[known] * here[known]) / np.sqrt(np.sum(size[known] ** 2)))
    return float(2.0 * student.sf(abs(together) / max(float(np.sqrt(np.mean(usual**2))), 1e-300), freedom))


def _jumps(z: FloatArray, at: IntArray, borders: IntArray) -> FloatArray:
    """Mean after a place minus the mean before it, as far as the next borders, in standard errors of white noise of
    size one; NaN where a border is near.
    """
    total = np.concatenate([[0.0], np.cumsum(z)])
    before = np.minimum(at - borders[np.searchsorted(borders, at, side="left") - 1], WINDOW)
    after = np.minimum(borders[np.searchsorted(borders, at, side="right")] - at, WINDOW)
    near = np.minimum(before, after) < _LEAST
    before, after = np.where(near, 1, before), np.where(near, 1, after)
    jump = (total[at + after] - total[at]) / after - (total[at] - total[at - before]) / before
    return np.where(near, np.nan, jump * np.sqrt(before * after / (before + after)))
