"""Coefficients of the chosen effects: weighted, robust least squares, with intervals from whole runs left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from model.loop.effects import Term
from model.loop.residual import Residuals

FloatArray = NDArray[np.float64]

_HUBER = 2.0  # robust standard deviations beyond which a segment counts less
_FIELD_RIDGE = 5.0
_STEPS = 12
_AS_MUCH = 0.5
_OF_THESE_RUNS = frozenset({"by_run", "place", "disk"})


@dataclass(frozen=True)
class Fit:
    """terms : with coefficients. low, high : 95 % intervals, one array per term. held_out : (n,) energy that the terms
    add to each row, fitted without its fold [J, or A s]."""

    terms: tuple[Term, ...]
    low: tuple[FloatArray, ...]
    high: tuple[FloatArray, ...]
    held_out: FloatArray


def fit_terms(
    residuals: Residuals, terms: Sequence[Term], *, level_doubt: float = 0.0, base: Residuals | None = None
) -> Fit:
    """Fit terms together to residuals (n,).

    The noise is a share of the energy (`Residuals.scale`); far segments weigh less (Huber 1964). Intervals are those of
    the jackknife over runs with Student's t of as many degrees of freedom (Cameron & Miller 2015, section VI: few
    clusters), so that what makes the segments of a run alike widens them; where runs have coefficients of their own, a
    third of every run is left out at a time. Three doubts are added: how far a coefficient moves when the noise is
    judged otherwise (a right formula gives the same whatever counts more: White 1980), and when the base model's level
    is off by half of `level_doubt`, a share of the energy; and what the same formula finds where it is not at work, on
    the runs of `base`: the base model's own error along it (a negative control: Lipsitch et al. 2010).
    """
    own = any(t.formula == "by_run" for t in terms)
    scale, fold = residuals.scale, residuals.block if own else residuals.fold
    counts = [t.columns(residuals.drive).shape[1] for t in terms]
    x = np.concatenate([t.columns(residuals.drive) for t in terms], axis=1) if terms else np.zeros((len(residuals), 0))
    size = np.sqrt(np.mean((x / scale[:, None]) ** 2, axis=0))
    size[size == 0] = 1.0
    a, z = x / scale[:, None] / size, residuals.residual / scale
    ridges = [_FIELD_RIDGE if t.formula == "place" else 1e-6 * len(z) for t in terms]
    ridge = np.repeat(ridges, counts)
    moving = residuals.moving
    weight = np.ones_like(z)
    beta = np.zeros(a.shape[1])
    for _ in range(_STEPS):
        beta = _solve(a, z, weight, ridge)
        rest = z - a @ beta
        spread = max(1.4826 * float(np.median(np.abs(rest[moving] - np.median(rest[moving])))), 1e-12)
        weight = 1.0 / np.maximum(np.abs(rest) / (_HUBER * spread), 1.0)
    folds = np.unique(fold)
    each = np.stack([_solve(a[fold != f], z[fold != f], weight[fold != f], ridge) for f in folds])
    error = np.sqrt((folds.size - 1) / folds.size * ((each - each.mean(axis=0)) ** 2).sum(axis=0))
    plain, even = _solve(a, z, np.ones_like(z), ridge), _solve(a, z, (scale / scale[moving].mean()) ** 2, ridge)
    form = np.std([beta, plain, even], axis=0, ddof=1)
    level = _solve(a, np.where(moving, residuals.predicted, 0.0) / scale, np.ones_like(z), ridge)
    error = np.sqrt(
        error**2 + form**2 + (0.5 * level_doubt * level) ** 2 + (_placebo(base, terms, size, counts) * size) ** 2
    )
    reach = float(student.ppf(0.975, folds.size - 1)) * error
    held = np.sum(a * each[np.searchsorted(folds, fold)], axis=1) * scale
    edges = np.cumsum(counts)[:-1]
    parts = [np.split(v, edges) for v in (beta / size, (beta - reach) / size, (beta + reach) / size)]
    fitted = tuple(t.fitted(v) for t, v in zip(terms, parts[0], strict=False))
    return Fit(fitted, tuple(parts[1]), tuple(parts[2]), held)


def _placebo(base: Residuals | None, terms: Sequence[Term], usual: FloatArray, counts: Sequence[int]) -> FloatArray:
    """How far coefficients (so many per term) are from 0 on runs without the effects, and how uncertain that is; 0
    where these runs vary a column much less than `usual` (as large as it is where the effects are)."""
    found = [np.zeros(count) for count in counts]
    shared = [k for k, t in enumerate(terms) if t.formula not in _OF_THESE_RUNS and "runs" not in t.where]
    if base is None or not shared:
        return np.concatenate([*found, np.zeros(0)])
    x = np.concatenate([terms[k].columns(base.drive) for k in shared], axis=1) / base.scale[:, None]
    size = np.sqrt(np.mean(x**2, axis=0))
    shown = size > _AS_MUCH * np.concatenate([np.split(usual, np.cumsum(counts)[:-1])[k] for k in shared])
    a = x[:, shown] / size[shown]
    beta = np.zeros(size.size)
    z, ridge, folds = base.residual / base.scale, np.full(a.shape[1], 1e-3 * len(base)), np.unique(base.fold)
    each = [_solve(a[use], z[use], np.ones(use.sum()), ridge) for use in (base.fold != f for f in folds)]
    beta[shown] = np.hypot(np.mean(each, axis=0), np.std(each, axis=0) * np.sqrt(folds.size - 1)) / size[shown]
    for k, part in zip(shared, np.split(beta, np.cumsum([counts[k] for k in shared])[:-1]), strict=True):
        found[k] = part
    return np.concatenate(found)


def _solve(a: FloatArray, z: FloatArray, weight: FloatArray, ridge: FloatArray) -> FloatArray:
    weighted = a * weight[:, None]
    return np.asarray(np.linalg.solve(weighted.T @ a + np.diag(ridge), weighted.T @ z))
