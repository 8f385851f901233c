"""The error that every figure of this project means by "mean relative error"."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from joulemap.model.runs.residuals import Residuals

LEAST_J = 1.0
"""Energy of a 1 m segment [J] that relative errors are at least relative to: loggers do not resolve less. It only keeps
a segment without any energy (downhill, with no idle power or with regeneration) from dividing by zero."""


def relative_errors(predicted_j: ArrayLike, energy_j: ArrayLike) -> NDArray[np.float64]:
    """Return the relative error of every segment, |e_hat - e| / |e|.

    `predicted_j` (n,): predicted energies e_hat [J]; `energy_j` (n,): measured energies e [J]. The result is (n,).

    Reference: Wei & Isler 2022, eq. 3.
    """
    predicted, energy = np.asarray(predicted_j, dtype=np.float64), np.asarray(energy_j, dtype=np.float64)
    return np.asarray(np.abs(predicted - energy) / np.maximum(np.abs(energy), LEAST_J))


def mean_relative_error(predicted_j: ArrayLike, energy_j: ArrayLike) -> float:
    """Return the mean of `relative_errors` over the segments: the paper's eq. 3. `predicted_j`, `energy_j` are (n,)."""
    return float(relative_errors(predicted_j, energy_j).mean())


def errors_of(measured: Residuals, predicted: NDArray[np.float64]) -> dict[str, Any]:
    """Return the errors of a prediction over all driven metres.

    `predicted` (n,): energy [J], or charge [A s]. Result: `mean_relative` (Wei & Isler 2022, eq. 3, over segments whose
    energy is positive), `absolute_share` (sum of the magnitudes of the errors over the energy), `rmse`, `bias`
    (measured minus predicted), `by_run`, the mean relative error of each run, and `run_energy_rms`, the root mean
    square relative error of the energy of a whole run with its stops.
    """
    moving = measured.moving
    energy, away = measured.measured[moving], (measured.measured - predicted)[moving]
    run, unit_j = measured.run[moving], measured.features.unit_j
    positive = energy > 0.0
    relative = np.where(positive, relative_errors(unit_j * (energy - away), unit_j * energy), np.nan)
    return {
        "mean_relative": float(np.nanmean(relative)),
        "absolute_share": float(np.abs(away).sum() / max(float(np.abs(energy).sum()), 1e-12)),
        "rmse": float(np.sqrt(np.mean(away**2))),
        "bias": float(away.mean()),
        "by_run": {
            measured.runs[k]: float(np.nanmean(relative[run == k])) for k in np.unique(run) if positive[run == k].any()
        },
        "run_energy_rms": _rms_of_runs(measured, predicted),
    }


def _rms_of_runs(measured: Residuals, predicted: NDArray[np.float64]) -> float | None:
    """None where no run took energy."""
    drawn, away = (np.bincount(measured.run, v) for v in (measured.measured, measured.measured - predicted))
    took = drawn > 0.0
    return float(np.sqrt(np.mean((away[took] / drawn[took]) ** 2))) if took.any() else None
