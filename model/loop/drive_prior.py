"""What is known of a run before it is driven: from runs that had no part in a calibration, or from a model's spread.

A prior of few numbers that maximises the predictive likelihood of what is asked while driving: at every tenth of each
of these runs, the energy of its rest. So its scores are those of sums over long distances, as in `route_errors`, and
errors that the model of metres does not know count as they matter.

References: Gneiting & Raftery 2007, "Strictly proper scoring rules, prediction, and estimation" (logarithmic score).
Vovk, Gammerman & Shafer 2005, "Algorithmic Learning in a Random World" (conformal prediction).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.uncertainty import Spread
from joulemap.model.loop.drive_alarms import FALSE_ALARMS, Cusum, threshold_of
from joulemap.model.loop.drive_filter import Ahead, DriveFilter, DrivePrior, limited
from joulemap.model.runs.features import Features

FloatArray = NDArray[np.float64]

FREEDOM = 6.0
"""Setting: degrees of freedom of forecasts where a spread gives none; those of the shipped network."""
PASSING_M = 20.0
"""Setting: distance over which a passing level is thought to last before runs show it: the shortest of
`route_errors.STRETCHES` [m]."""
UNKNOWN = Spread(run_share=0.5)
"""Assumed where a model has seen no runs: the error of a whole route of `energy_distribution.UNSEEN_SHARE`."""
UNFITTED = {"causes": 5.6, "passing": 0.54, "passing_m": 0.73, "noise": 1.65, "width": 1.09, "change_std": 1.66}
"""Factors on the prior of a spread where no runs were fitted. Source: `python -m tests.loop.driving fit --count 60`,
simulated drives of the shipped network."""
_TENTHS = np.arange(10) / 10.0
_CHANGE_STDS = np.geomspace(0.5, 5.0, 24).tolist()  # a tenth from one to the next
_LEVEL = 0.9  # of the intervals that must hold


def cause_columns(
    predicted_j: FloatArray, resistance_j: FloatArray, lifted_j: FloatArray, at_rest_j: FloatArray
) -> FloatArray:
    """Return the columns of `CAUSES`, (n, k).

    Each (n,) [J]: predicted energy; declared rolling resistance times weight and length, and weight times rise, both
    as far as the drives pull; and the power at rest over the duration.
    """
    return np.column_stack([predicted_j, resistance_j, lifted_j, at_rest_j])


def prior_of_spread(spread: Spread, columns: FloatArray, std_j: FloatArray) -> DrivePrior:
    """Return the prior that a model's spread gives: columns (n, k) and standard deviations (n,) are of a route [J].

    Half of the variance between runs is of the level, and each other cause that the route has an equal part of the
    rest. What passes varies as much as all of them.
    """
    energy, size = max(float(columns[:, 0].sum()), 1e-9), np.abs(columns).sum(axis=0)
    share = math.sqrt(0.5 * float(spread.run_variance(energy, float(std_j.sum())))) / energy
    there = size > 1e-6 * energy
    parts = np.where(np.arange(there.size) == 0, 0.5, there / max(2.0 * there[1:].sum(), 1.0))
    causes = share * np.sqrt(parts) * energy / np.where(there, size, 1.0)
    freedom = min((f for f in (spread.freedom, spread.run_freedom) if f is not None), default=FREEDOM)
    noise = math.sqrt(max(spread.correlation_m, 1.0))  # of sums of correlated metres
    return DrivePrior(tuple(causes.tolist()), share, PASSING_M, noise, freedom)


def unfitted(start: DrivePrior) -> DrivePrior:
    """Return the prior of a model whose spread is all that is known: `UNFITTED` times that."""
    causes = tuple(UNFITTED["causes"] * cause for cause in start.causes)
    return replace(start, causes=causes, **{n: f * getattr(start, n) for n, f in UNFITTED.items() if n != "causes"})


def columns_of_rows(rows: Features, predicted_j: FloatArray) -> FloatArray:
    """Return the columns of `CAUSES` of measured rows, (n, k) [J]; `predicted_j` (n,) [J]."""
    level = rows.unit_j * rows.weight_length * rows.pulling
    at_rest = rows.robot.idle_power_w * rows.duration_s
    return cause_columns(predicted_j, rows.robot.rolling_resistance * level, rows.grade * level, at_rest)


def fit_drive_prior(
    measured_j: FloatArray, columns: FloatArray, std_j: FloatArray, run: NDArray[np.int64], start: DrivePrior
) -> DrivePrior:
    """Return the prior that runs show which had no part in the prediction.

    `measured_j` (n,); `columns` (n, k), of `cause_columns`; `std_j` (n,) [J]; `run` (n,): its rows are in driving
    order; `start`: what is thought before. Four numbers are fitted: factors on all causes, on what passes, on its
    length and on the noise. A standard normal prior of their logarithms holds them where few runs show nothing.
    """
    from scipy.optimize import minimize  # loads slowly, and only fits need it
    from scipy.stats import t as student

    runs = [np.flatnonzero(run == one) for one in np.unique(run)]
    parts = [(columns[mine], measured_j[mine], std_j[mine]) for mine in runs]

    def _prior(x: FloatArray) -> DrivePrior:
        causes, passing, length, noise = np.exp(np.clip(x, -6.0, 6.0)).tolist()
        return replace(
            start,
            causes=tuple(causes * cause for cause in start.causes),
            passing=passing * start.passing,
            passing_m=length * start.passing_m,
            noise=noise * start.noise,
        )

    def _loss(x: FloatArray) -> float:
        steps, scales = _forecasts(_prior(x), parts)
        freedom = start.freedom or FREEDOM
        scores = 2.0 * np.log(scales) + (freedom + 1.0) * np.log1p(steps**2 / freedom)
        return float(scores.sum()) / _TENTHS.size + 0.5 * float(x @ x)

    simplex = np.vstack([np.zeros(4), np.eye(4)])  # a standard deviation to each side
    options = {"xatol": 0.02, "fatol": 1e-3, "maxiter": 300, "initial_simplex": simplex}
    found = _prior(minimize(_loss, np.zeros(4), method="Nelder-Mead", options=options).x)
    held = _conformal(np.abs(_forecasts(found, parts)[0]), _LEVEL)
    width = max(1.0, held / float(student.ppf(0.5 + 0.5 * _LEVEL, start.freedom or FREEDOM)))
    return replace(found, width=width, change_std=change_std(DriveFilter(found).learn(*part) for part in parts))


def change_std(innovations: Iterable[FloatArray]) -> float:
    """Return the measure by which another run without a change raises an alarm with `FALSE_ALARMS` at most, of the
    standardised innovations of runs, each (n,).
    """
    return _conformal(np.array([_least_std(limited(steps)) for steps in innovations]), 1.0 - FALSE_ALARMS)


def _least_std(steps: FloatArray) -> float:
    """The least measure by which a run raises no alarm."""
    threshold = threshold_of(float(len(steps)))
    for std in _CHANGE_STDS:
        sums = Cusum()
        if not any(sums.add(step, 0.0, threshold) for step in (steps / std).tolist()):
            return std
    return _CHANGE_STDS[-1]


def _conformal(values: FloatArray, level: float) -> float:
    """What another value of the same distribution does not exceed with the given probability (conformal prediction);
    the largest where they are too few to say.
    """
    return float(np.sort(values)[min(values.size, math.ceil((values.size + 1) * level)) - 1])


def _forecasts(
    prior: DrivePrior, parts: list[tuple[FloatArray, FloatArray, FloatArray]]
) -> tuple[FloatArray, FloatArray]:
    """Errors in scales, and scales [J], of the energy of the rest at every tenth of every run."""
    found = []
    for columns, measured, std in parts:
        known, ahead, at = DriveFilter(prior), Ahead.of(prior, columns, std), 0
        rest = np.append(np.cumsum(measured[::-1])[::-1], 0.0)
        for mark in np.unique(np.round(_TENTHS * len(measured)).astype(np.int64)).tolist():
            known.learn(columns[at:mark], measured[at:mark], std[at:mark])
            at = mark
            mean, scale = ahead.energy(float(mark), known)
            found.append(((rest[mark] - mean) / max(scale, 1e-12), max(scale, 1e-12)))
    return tuple(np.array(found).T)
