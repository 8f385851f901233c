"""Coefficients of the chosen effects: weighted, robust least squares, with intervals from left-out runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from joulemap.model.loop.doubt import Equations, bends, found_in_base, of_others, other_judgements, otherwise_bent
from joulemap.model.loop.effects import Term
from joulemap.model.loop.residual import Residuals

FloatArray = NDArray[np.float64]

_HUBER = 2.0  # robust standard deviations beyond which a segment counts less
_FIELD_RIDGE = 5.0
_STEPS = 12


@dataclass(frozen=True)
class Fit:
    """Fitted terms, with one array per term each.

    Attributes
    ----------
    terms : tuple of Term
        With coefficients.
    own : tuple of ndarray of float
        Part of the coefficients that the baseline runs show as well: the base model's error, and not new.
    low, high : tuple of ndarray of float
        95 % confidence intervals of what is new.
    held_out : ndarray of float, (n,)
        Energy that the terms add to each row, fitted without its fold [J, or A s].
    """

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
    """Fit terms together.

    Parameters
    ----------
    residuals : Residuals
        Of the runs.
    terms : sequence of Term
        With or without coefficients, which are replaced.
    level_doubt : float
        Relative uncertainty of the base model's scale; half of it is one standard deviation.
    base : Residuals, optional
        Of the baseline runs.
    others : sequence of sequence of Term
        Terms that do as well in the place of these.

    Returns
    -------
    Fit
        With 95 % confidence intervals.

    Notes
    -----
    The noise is a share of the energy (`Residuals.scale`); outliers weigh less. The intervals are those of the
    jackknife over runs with Student's t of as many degrees of freedom, so that correlation within runs widens them.
    Where runs have coefficients of their own, a third of every run is left out at a time.

    What the same formulas find in the baseline runs, where the effects are not at work, is the base model's own error
    along them and no part of an effect (a negative control), as far as it is more than noise there. Further
    uncertainties are added, see `joulemap.model.loop.doubt`: of that error, of the form of an effect, of the
    load-dependent response of forces, of alternative terms, and of the base model's scale.

    References
    ----------
    Huber 1964; Cameron & Miller 2015, section VI (few clusters); Lipsitch et al. 2010 (negative controls).
    """
    by_run = any(t.formula == "by_run" for t in terms)
    scale, fold, moving = residuals.scale, residuals.block if by_run else residuals.fold, residuals.moving
    counts = [t.columns(residuals.drive).shape[1] for t in terms]
    x = np.concatenate([t.columns(residuals.drive) for t in terms], axis=1) if terms else np.zeros((len(residuals), 0))
    size = np.sqrt(np.mean((x / scale[:, None]) ** 2, axis=0))
    size[size == 0] = 1.0
    a, z = x / scale[:, None] / size, residuals.residual / scale
    ridges = [_FIELD_RIDGE if t.formula == "place" else 1e-6 * len(z) for t in terms]
    equations = Equations(a, z, np.ones_like(z), np.repeat(ridges, counts), fold)
    for _ in range(_STEPS):
        rest = z - a @ equations.solved
        spread = max(1.4826 * float(np.median(np.abs(rest[moving] - np.median(rest[moving])))), 1e-12)
        equations = replace(equations, weight=1.0 / np.maximum(np.abs(rest) / (_HUBER * spread), 1.0))
    found = equations.solved / size
    level = replace(equations, z=np.where(moving, residuals.predicted, 0.0) / scale).solved / size
    own, own_doubt = found_in_base(base, terms, size, counts)
    doubts = [
        equations.errors / size,
        other_judgements(equations, residuals, terms, counts) / size,
        bends(equations, terms, counts) / size,
        of_others(equations, found, residuals, others),
        of_others(equations, found, residuals, otherwise_bent(residuals, terms)),
        0.5 * level_doubt * level,
        own_doubt,
    ]
    reach = float(student.ppf(0.975, len(equations.each) - 1)) * np.sqrt(np.sum(np.square(doubts), axis=0))
    held = np.sum(a * equations.each[np.searchsorted(np.unique(fold), fold)], axis=1) * scale
    edges = np.cumsum(counts)[:-1]
    new = found - own
    values, owns, low, high = (tuple(np.split(v, edges)) for v in (found, own, new - reach, new + reach))
    return Fit(tuple(t.fitted(v) for t, v in zip(terms, values, strict=False)), owns, low, high, held)
