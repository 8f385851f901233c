"""How well predicted energies say what measured segments cost."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from model.energy.uncertainty import LEVELS, Spread
from model.errors import InputError


def errors(predicted_j: ArrayLike, energy_j: ArrayLike, run: ArrayLike) -> dict[str, Any]:
    """Errors of predicted against measured energies [J] of n segments.

    segments; mean_relative_error and median_relative_error of |e_hat - e| / e (the paper's eq. 3); rmse_j; bias_j, the
    mean of measured - predicted; route_relative_error, |sum e_hat - sum e| / sum e of every whole run (mean over runs),
    and route_relative_errors of each. Raises InputError without a segment.
    """
    predicted, energy = np.asarray(predicted_j, dtype=np.float64), np.asarray(energy_j, dtype=np.float64)
    if energy.size == 0:
        raise InputError("there is no segment to judge by")
    relative = np.abs(predicted - energy) / np.maximum(np.abs(energy), 1e-9)
    residual = energy - predicted
    by_run = {}
    for one in np.unique(run):
        mine = np.asarray(run) == one
        by_run[str(one)] = float(abs(residual[mine].sum()) / max(abs(energy[mine].sum()), 1e-9))
    return {
        "segments": int(energy.size),
        "mean_relative_error": float(relative.mean()),
        "median_relative_error": float(np.median(relative)),
        "rmse_j": float(np.sqrt(np.mean(residual**2))),
        "bias_j": float(residual.mean()),
        "route_relative_error": float(np.mean(list(by_run.values()))),
        "route_relative_errors": by_run,
    }


def coverage(energy_j: ArrayLike, predicted_j: ArrayLike, std_j: ArrayLike, spread: Spread) -> dict[str, float]:
    """Share of measured segments inside the predicted intervals, by level in percent: {"50": ..., "80": ..., ...}."""
    energy = np.asarray(energy_j, dtype=np.float64)
    inside = {}
    for level in LEVELS:
        low, high = spread.interval(predicted_j, std_j, level)
        inside[f"{100 * level:.0f}"] = float(np.mean((low <= energy) & (energy <= high)))
    return inside
