"""Whether power and movement of a log have one clock: what is drawn follows the speed and the acceleration."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from joulemap.model.runs.agreement import speed_of
from joulemap.model.runs.run import Run
from joulemap.model.runs.table import LEAST_ROWS

FloatArray = NDArray[np.float64]

_STEP_S, _LONGEST_S = 1.0, 3600.0
_LATER_S = 10.0  # a meter that is late is later by less
_APART_S = 600  # at most
_PARTS, _LEAST_ROWS = 6, 120
_CLEAR, _UNCLEAR = 0.3, 0.1  # share of the power that movement explains at another time, and at the same time at most


def of_clocks(run: Run) -> list[str]:
    """Return a sentence where power goes with the movement at another time than its own; else nothing."""
    known = np.isfinite(run.x) & np.isfinite(run.y)
    if run.whole_j is not None or known.sum() < LEAST_ROWS or np.ptp(run.t) < 2 * _LEAST_ROWS * _STEP_S:
        return []
    speed = run.extras.get("speed")
    place = {"x": run.x[known], "y": run.y[known]}
    moved = speed_of(run.t[known], place) if run.placed or speed is None else speed[known]
    if moved is None:
        return []
    t = np.arange(run.t[0], run.t[0] + min(float(np.ptp(run.t)), _LONGEST_S), _STEP_S)
    drawn = np.interp(t, run.t, run.drawn(charge=not run.has_energy))
    v = np.interp(t, run.t[known][np.isfinite(moved)], moved[np.isfinite(moved)])
    forms = np.stack([v, np.gradient(0.5 * v**2, _STEP_S)])
    ends = np.linspace(0, t.size, min(_PARTS, t.size // _LEAST_ROWS) + 1).astype(int)
    lags = [_lag(drawn, forms, begin, end) for begin, end in pairwise(ends.tolist())]
    found = [lag for lag in lags if lag is not None]
    if 2 * len(found) <= len(lags) or np.abs(np.diff(found)).max(initial=0.0) > _LATER_S:  # by chance they differ
        return []
    first, last = found[0], found[-1]
    between = f"about {first:.0f} s" + (f" at first and {last:.0f} s at last" if abs(last - first) > _LATER_S else "")
    return [
        f"its power goes with its movement only where its clock is changed by {between}: were its parts logged by two "
        "clocks? Set them alike before they are joined"
    ]


def _lag(drawn: FloatArray, forms: FloatArray, begin: int, end: int) -> float | None:
    """By how much the power of some rows is later than the movement that explains it [s]; None where it is explained
    at once, or not clearly at any time.
    """

    def _shares(most: int) -> tuple[NDArray[np.int64], FloatArray]:
        lags = np.arange(max(-most, end - drawn.size), min(most, begin) + 1)
        shares = [_explained(drawn[begin:end], forms[:, begin - lag : end - lag]) for lag in lags]
        return lags, np.array(shares)

    if _shares(int(_LATER_S))[1].max() >= _UNCLEAR:
        return None
    lags, shares = _shares(_APART_S)
    return float(lags[shares.argmax()]) * _STEP_S if shares.max() > _CLEAR else None


def _explained(y: FloatArray, x: FloatArray) -> float:
    """Share of the variance of a power (n,) that the forms of a movement (k, n) explain."""
    y, x = y - y.mean(), x - x.mean(axis=1, keepdims=True)
    c = x @ y
    return float(c @ np.linalg.lstsq(x @ x.T, c, rcond=None)[0]) / max(float(y @ y), 1e-12)
