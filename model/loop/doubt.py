"""Uncertainty of coefficients beyond what left-out runs show: about their form, and about the base model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from joulemap.model.loop.effects import Term
from joulemap.model.loop.residual import Residuals

FloatArray = NDArray[np.float64]

_AS_MUCH = 0.5
_SPREADS = (0.5, 2.0)
_FIELDS = frozenset({"by_run", "place", "disk"})


@dataclass(frozen=True, eq=False)
class Equations:
    """Weighted least squares with a ridge.

    Attributes
    ----------
    a : ndarray of float, (n, K)
        Columns [scaled].
    z : ndarray of float, (n,)
        What they are fitted to.
    weight : ndarray of float, (n,)
        Of each row.
    ridge : ndarray of float, (K,)
        Penalty of each coefficient.
    fold : ndarray of int, (n,)
        What is left out together.
    """

    a: FloatArray
    z: FloatArray
    weight: FloatArray
    ridge: FloatArray
    fold: NDArray[np.int64]

    @cached_property
    def solved(self) -> FloatArray:
        """The coefficients, (K,)."""
        return self._solve(np.ones(self.z.size, dtype=bool))

    @cached_property
    def each(self) -> FloatArray:
        """The coefficients without each fold, (folds, K)."""
        return np.stack([self._solve(self.fold != f) for f in np.unique(self.fold)])

    @property
    def errors(self) -> FloatArray:
        """Standard errors of the coefficients, (K,), by the jackknife over folds."""
        count = len(self.each)
        return np.sqrt((count - 1) / count * ((self.each - self.each.mean(axis=0)) ** 2).sum(axis=0))

    def beside(self, columns: FloatArray, ridge: FloatArray) -> Equations:
        """Return the equations with more columns.

        Parameters
        ----------
        columns : ndarray of float, (n, k)
            To append.
        ridge : ndarray of float, (k,)
            Their penalties.

        Returns
        -------
        Equations
            With K + k coefficients.
        """
        return replace(self, a=np.concatenate([self.a, columns], axis=1), ridge=np.append(self.ridge, ridge))

    def _solve(self, rows: NDArray[np.bool_]) -> FloatArray:
        a = self.a[rows]
        weighted = a * self.weight[rows, None]
        return np.asarray(np.linalg.solve(weighted.T @ a + np.diag(self.ridge), weighted.T @ self.z[rows]))


def other_judgements(
    equations: Equations, residuals: Residuals, terms: Sequence[Term], counts: list[int]
) -> FloatArray:
    """Return how much coefficients change under other assumptions about noise and base model.

    Parameters
    ----------
    equations : Equations
        As fitted.
    residuals : Residuals
        Of the runs.
    terms : sequence of Term
        In the order of the columns.
    counts : list of int
        Columns of each term.

    Returns
    -------
    ndarray of float, (K,)
        Standard deviation over the assumptions: as fitted; all noise equal; noise a share of the energy without
        outliers (a right formula gives the same under any weights); effects that do not depend on the slope may be
        stronger uphill than downhill; and the base model's scale is right.

    References
    ----------
    White 1980.
    """
    scale, moving, grade = residuals.scale, residuals.moving, residuals.drive.grade
    blind = np.repeat([not (t.reads_ground or t.formula in _FIELDS) for t in terms], counts).astype(bool)
    slope = np.where(moving, (grade - grade[moving].mean()) / max(float(grade[moving].std()), 1e-12), 0.0)
    level = np.repeat([t.formula == "level" for t in terms], counts).astype(bool)
    found = [
        equations,
        replace(equations, weight=np.ones_like(scale)),
        replace(equations, weight=(scale / scale[moving].mean()) ** 2),
        equations.beside(equations.a[:, blind] * slope[:, None], equations.ridge[blind]),
        replace(equations, ridge=np.where(level, 1e12, equations.ridge)),
    ]
    return np.std([each.solved[: blind.size] for each in found], axis=0, ddof=1)


def bends(equations: Equations, terms: Sequence[Term], counts: list[int]) -> FloatArray:
    """Return how far the coefficient of small amounts differs from that of large ones.

    If a law is no straight line, its one coefficient lies anywhere between them: a rectangular distribution, as far as
    the difference is more than noise.

    Parameters
    ----------
    equations : Equations
        As fitted.
    terms : sequence of Term
        In the order of the columns.
    counts : list of int
        Columns of each term.

    Returns
    -------
    ndarray of float, (K,)
        Standard deviation; 0 for terms with several coefficients.

    References
    ----------
    JCGM 100:2008, 4.3.7.
    """
    out = np.zeros(sum(counts))
    for k, (term, count) in enumerate(zip(terms, counts, strict=True)):
        if count > 1 or term.formula == "level":
            continue
        first = sum(counts[:k])
        amount = equations.a[:, first]
        order = np.argsort(amount)
        grown = np.cumsum(amount[order] ** 2)
        large = np.zeros(amount.size)
        large[order[grown > 0.5 * grown[-1]]] = 1.0
        both = equations.beside((amount * large)[:, None], equations.ridge[first])
        out[first] = np.sqrt(max(both.solved[-1] ** 2 - both.errors[-1] ** 2, 0.0) / 12.0)
    return out


def of_others(
    equations: Equations, found: FloatArray, residuals: Residuals, others: Sequence[Sequence[Term]]
) -> FloatArray:
    """Return how far the coefficients of alternative terms are from those found, root mean square.

    Parameters
    ----------
    equations : Equations
        As fitted.
    found : ndarray of float, (K,)
        The coefficients.
    residuals : Residuals
        Of the runs.
    others : sequence of sequence of Term
        Alternatives with the same coefficients.

    Returns
    -------
    ndarray of float, (K,)
        Uncertainty due to the choice of the model.

    References
    ----------
    Buckland et al. 1997.
    """
    squares = np.zeros_like(found)
    for terms in others:
        a = np.concatenate([t.columns(residuals.drive) for t in terms], axis=1) / residuals.scale[:, None]
        size = np.maximum(np.sqrt(np.mean(a**2, axis=0)), 1e-12)
        squares += (replace(equations, a=a / size).solved / size - found) ** 2
    return np.sqrt(squares / max(len(others), 1))


def otherwise_bent(residuals: Residuals, terms: Sequence[Term]) -> list[list[Term]]:
    """Return the terms again with forces that vary half and twice as much within a metre.

    Parameters
    ----------
    residuals : Residuals
        Of the runs.
    terms : sequence of Term
        As fitted.

    Returns
    -------
    list of list of Term
        Empty where no term has a load-dependent response.
    """
    if not any(t.bend for t in terms):
        return []
    return [[t.bent(residuals, times * t.bend.spread_n) if t.bend else t for t in terms] for times in _SPREADS]


def found_in_base(
    base: Residuals | None, terms: Sequence[Term], usual: FloatArray, counts: list[int]
) -> tuple[FloatArray, FloatArray]:
    """Fit the same terms to the baseline runs, where the effects are not at work.

    Parameters
    ----------
    base : Residuals, optional
        Of the baseline runs.
    terms : sequence of Term
        As fitted to the new runs.
    usual : ndarray of float, (K,)
        Root mean square of each column in the new runs.
    counts : list of int
        Columns of each term.

    Returns
    -------
    tuple of ndarray of float, (K,)
        Coefficients, shrunk by what may be noise, and their standard errors. 0 where the baseline runs vary a column
        much less than `usual`.
    """
    own, doubt = np.zeros((2, sum(counts)))
    shared = np.repeat([t.formula != "by_run" and "runs" not in t.where for t in terms], counts).astype(bool)
    if base is None or not shared.any():
        return own, doubt
    x = np.concatenate([t.columns(base.drive) for t in terms], axis=1) / base.scale[:, None]
    size = np.sqrt(np.mean(x**2, axis=0))
    shown = shared & (size > _AS_MUCH * usual)
    ridge = np.full(int(shown.sum()), 1e-3 * len(base))
    there = Equations(x[:, shown] / size[shown], base.residual / base.scale, np.ones(len(base)), ridge, base.fold)
    mean, error = there.each.mean(axis=0), there.errors
    own[shown] = mean**3 / np.maximum(mean**2 + error**2, 1e-300) / size[shown]
    doubt[shown] = error / size[shown]
    return own, doubt
