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
    """terms : with coefficients. own : of these, what the base model's own runs show as well: its error, not what is
    new. low, high : 95 % intervals of what is new. One array per term each. held_out : (n,) energy that the terms add
    to each row, fitted without its fold [J, or A s]."""

    terms: tuple[Term, ...]
    own: tuple[FloatArray, ...]
    low: tuple[FloatArray, ...]
    high: tuple[FloatArray, ...]
    held_out: FloatArray


def fit_terms(
    residuals: Residuals,
    terms: Sequence[Term],
    *,
    level_doubt: float = 0.0,
    base: Residuals | None = None,
    others: Sequence[Sequence[Term]] = (),
) -> Fit:
    """Fit terms together to residuals (n,).

    The noise is a share of the energy (`Residuals.scale`); far segments weigh less (Huber 1964). Intervals are those of
    the jackknife over runs with Student's t of as many degrees of freedom (Cameron & Miller 2015, section VI: few
    clusters), so that what makes the segments of a run alike widens them; where runs have coefficients of their own, a
    third of every run is left out at a time.

    What the same formulas find where they are not at work, on the runs of `base`, is the base model's own error along
    them and no part of an effect (a negative control, and the difference of differences: Lipsitch et al. 2010), as far
    as it is more than noise there. Doubts are added: about that; how far a coefficient moves when the noise is judged
    otherwise (a right formula gives the same whatever counts more: White 1980), when effects may be stronger uphill
    than downhill, when the base model's level is taken as right, or off by half of `level_doubt`, a share of the
    energy, and with the `others`, terms in the place of `terms` that do as well.
    """
    by_run = any(t.formula == "by_run" for t in terms)
    scale, fold = residuals.scale, residuals.block if by_run else residuals.fold
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
    sloped = _solve(*_with_slopes(a, z, weight, ridge, residuals, terms, counts))[: beta.size]
    fixed = np.repeat([1e12 if t.formula == "level" else 0.0 for t in terms], counts)
    form = np.std([beta, plain, even, sloped, _solve(a, z, weight, ridge + fixed)], axis=0, ddof=1)
    level = _solve(a, np.where(moving, residuals.predicted, 0.0) / scale, np.ones_like(z), ridge)
    found = beta / size
    own, doubt = _found_in_base(base, terms, size, counts)
    form = np.hypot(form / size, _apart(found, residuals, others, weight, ridge))
    error = np.sqrt((error / size) ** 2 + form**2 + (0.5 * level_doubt * level / size) ** 2 + doubt**2)
    reach = float(student.ppf(0.975, folds.size - 1)) * error
    held = np.sum(a * each[np.searchsorted(folds, fold)], axis=1) * scale
    edges = np.cumsum(counts)[:-1]
    values, owns, low, high = (
        tuple(np.split(v, edges)) for v in (found, own, found - own - reach, found - own + reach)
    )
    return Fit(tuple(t.fitted(v) for t, v in zip(terms, values, strict=False)), owns, low, high, held)


def _with_slopes(
    a: FloatArray, z: FloatArray, weight: FloatArray, ridge: FloatArray, residuals: Residuals, terms: Sequence[Term],
    counts: Sequence[int],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """The same equations where every effect that does not ask for the slope may yet be stronger uphill."""
    blind = np.repeat([not (t.reads_ground or t.formula in _OF_THESE_RUNS) for t in terms], counts).astype(bool)
    grade, moving = residuals.drive.grade, residuals.moving
    slope = np.where(moving, (grade - grade[moving].mean()) / max(float(grade[moving].std()), 1e-12), 0.0)
    return np.concatenate([a, a[:, blind] * slope[:, None]], axis=1), z, weight, np.append(ridge, ridge[blind])


def _apart(
    found: FloatArray, residuals: Residuals, others: Sequence[Sequence[Term]], weight: FloatArray, ridge: FloatArray
) -> FloatArray:
    """How far other terms' coefficients are from those found, in the mean (model uncertainty: Buckland et al. 1997)."""
    squares = np.zeros_like(found)
    for terms in others:
        a = np.concatenate([t.columns(residuals.drive) for t in terms], axis=1) / residuals.scale[:, None]
        size = np.maximum(np.sqrt(np.mean(a**2, axis=0)), 1e-12)
        squares += (_solve(a / size, residuals.residual / residuals.scale, weight, ridge) / size - found) ** 2
    return np.sqrt(squares / max(len(others), 1))


def _found_in_base(
    base: Residuals | None, terms: Sequence[Term], usual: FloatArray, counts: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Coefficients (so many per term) on runs without the effects, shrunk by what may be noise, and their standard
    errors; 0 where these runs vary a column much less than `usual` (as large as it is where the effects are)."""
    own, doubt = np.zeros((2, sum(counts)))
    ends = np.cumsum([0, *counts])
    shared = [k for k, t in enumerate(terms) if t.formula not in _OF_THESE_RUNS and "runs" not in t.where]
    if base is None or not shared:
        return own, doubt
    columns = np.concatenate([np.arange(ends[k], ends[k + 1]) for k in shared])
    x = np.concatenate([terms[k].columns(base.drive) for k in shared], axis=1) / base.scale[:, None]
    size = np.sqrt(np.mean(x**2, axis=0))
    shown = size > _AS_MUCH * usual[columns]
    a = x[:, shown] / size[shown]
    z, ridge, folds = base.residual / base.scale, np.full(a.shape[1], 1e-3 * len(base)), np.unique(base.fold)
    each = [_solve(a[use], z[use], np.ones(use.sum()), ridge) for use in (base.fold != f for f in folds)]
    mean, error = np.mean(each, axis=0), np.std(each, axis=0) * np.sqrt(folds.size - 1)
    own[columns[shown]] = mean**3 / np.maximum(mean**2 + error**2, 1e-300) / size[shown]
    doubt[columns[shown]] = error / size[shown]
    return own, doubt


def _solve(a: FloatArray, z: FloatArray, weight: FloatArray, ridge: FloatArray) -> FloatArray:
    weighted = a * weight[:, None]
    return np.asarray(np.linalg.solve(weighted.T @ a + np.diag(ridge), weighted.T @ z))
