"""A linear mixed model of scaled rows: fits, tests and left-out errors of any choice of columns.

Fixed effects, a random level of every unit (a run), and errors as `Variation` describes them (Pinheiro & Bates 2000,
chapter 2). All fits come from the cross products of every unit, so that leaving one out costs a subtraction. Every
coefficient has a normal prior around nothing that is worth some rows of data, one for an effect (the unit information
prior of Kass & Wasserman 1995), which settles what the rows do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, minimize_scalar
from scipy.stats import f as fisher
from scipy.stats import t as student

from joulemap.model.loop._variation import Variation
from joulemap.model.runs.features import FloatArray

IntArray = NDArray[np.int64]

_COLLINEAR = 1e-3
"""Share of a column's sum of squares that must be left beside the other columns for a test: with less, the standard
error is over thirty times that of the column alone."""

RUN_SPREAD = 0.25
"""Setting: share of the energy by which runs of one robot usually differ at most for unknown reasons; those of the
shipped model differ by 19 %."""
CERTAINLY_NOT = 0.1
"""p-value of a single test, above which nobody asks how much above."""
_ROUNDING = 1e-9
_POOLING = tuple(np.geomspace(1e-4, 1e2, 25))
"""What the prior of classes is worth, over what the rows say of them: from nothing to all, four steps to a decade."""
_LARGE = 1e6  # variance between units over that of the noise: as good as fixed levels
_ROUNDS = 3  # the variance between units follows the coefficients and the coefficients the variance


@dataclass(frozen=True)
class Estimate:
    """Coefficients of a choice of columns."""

    coefficients: FloatArray  # (q,), within their limits
    left_out: FloatArray  # (units, q), without limits, by the other units
    freedom: FloatArray  # (q,) degrees of freedom
    tau2: float  # variance between units over that of the noise

    def interval(self, level: float = 0.95) -> tuple[FloatArray, FloatArray]:
        """Lower and upper ends of confidence intervals, (q,), of the given coverage: Student's t with the variance of
        the jackknife over units, which assumes nothing of what is within a unit (MacKinnon, Nielsen & Webb 2023).
        """
        variance = (len(self.left_out) - 1) * self.left_out.var(axis=0)
        reach = student.ppf(0.5 + 0.5 * level, np.maximum(self.freedom, 1.0)) * np.sqrt(variance)
        return self.coefficients - reach, self.coefficients + reach


@dataclass(frozen=True)
class _ByUnit:
    """Cross products of every unit, of columns and, last, of the residual."""

    gram: FloatArray  # (units, q + 1, q + 1)
    level: FloatArray  # (units, q + 1), with the level of the unit
    size: FloatArray  # (units,), of the level with itself

    def at(self, tau2: float) -> FloatArray:
        """Those under random levels of so many variances of the noise, whose sum generalised least squares needs."""
        share = tau2 / (1.0 + tau2 * self.size)
        return self.gram - share[:, None, None] * self.level[:, :, None] * self.level[:, None, :]


class MixedModel:
    """Cross products of scaled columns, by unit. Columns in the model are given by their numbers, (q,)."""

    def __init__(
        self,
        variation: Variation,  # around the model
        columns: FloatArray,  # (n, k), all terms that may be chosen [J, or A s per unit of their coefficients]
        residual: FloatArray,  # (n,), measured minus predicted
        level: FloatArray,  # (n,), predicted energy, with its sign: the level of a unit is a share of it. It is a
        # combination of columns that are in every model: no choice of levels explains what a column could.
        unit: IntArray,  # (n,), what is left out together and has a level of its own; its rows follow each other
        prior_rows: FloatArray,  # (k,), rows of data that the prior of each coefficient is worth
        *,
        whole_runs: bool,  # units are whole runs, so that differences between them can be tested
    ) -> None:
        energies = np.column_stack([columns, level, residual])
        every = variation.scaled(energies)
        self.size = np.sqrt(np.einsum("ij,ij->j", every, every)[:-2] / len(every))
        self.size[self.size == 0.0] = 1.0
        every[:, :-2] /= self.size  # a prior of one row then has precision 1 for every column
        self.variation, self.rows, self.prior_rows, self.whole_runs = variation, every, prior_rows, whole_runs
        self._pooling = np.zeros((0, 0))
        borders = np.flatnonzero(np.diff(unit, prepend=-1, append=-1))
        parts = [slice(a, b) for a, b in pairwise(borders)]
        self.units = len(parts)
        self._h = np.stack([every[part, -2] @ every[part] for part in parts])  # (U, k + 2), levels with columns
        self._gamma = np.maximum(self._h[:, -2], 1e-12)
        self._energies, self._parts = energies, parts
        carried = 2.0 * variation.serial_share * every[:, -2:-1] * variation.carried(every[:, -2:-1])
        more = np.bincount(unit, weights=carried[:, 0], minlength=self.units)
        self._level_variance = (self._gamma + more) / self._gamma**2  # of the units' levels, for noise of variance 1
        flat = variation.weight >= 1.0
        self.efficiency = float(variation.weight.mean() / max(float(flat.mean()), 1e-3))  # Huber 1973, eq. 6.5

    @cached_property
    def _white(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Independent rows without the levels of units, for tests; the squares of the rows with the levels, (k + 2,);
        and the cross products of the rows, (k + 2, k + 2).
        """
        white = self.variation.whitened(self._energies)
        white[:, :-2] /= self.size
        rows, squares = self._without_levels(white), np.einsum("ij,ij->j", white, white)
        return rows, squares, rows.T @ rows

    @cached_property
    def _products(self) -> FloatArray:
        """Cross products of the rows of every unit, (units, k + 2, k + 2)."""
        return np.stack([self.rows[part].T @ self.rows[part] for part in self._parts])

    @cached_property
    def _inner(self) -> FloatArray:
        """Cross products of scaled columns without the levels of units, (k + 2, k + 2)."""
        rows = self._without_levels(self.rows)
        return np.asarray(rows.T @ rows)

    def _without_levels(self, every: FloatArray) -> FloatArray:
        rows = np.empty_like(every)
        for part in self._parts:
            own, level = every[part], every[part, -2]
            rows[part] = own - np.outer(level, level @ own / max(float(level @ level), 1e-12))
        return rows

    def tau2(self, chosen: IntArray) -> float:
        """Variance between units over that of the noise: that of the largest restricted likelihood (Harville 1977),
        with a half-normal prior on the standard deviation, of scale `RUN_SPREAD` (Gelman 2006); 0 for fewer than
        three units.

        The likelihood of four or five runs may be flat. Without a prior it may prefer runs that all differ, by the same
        multiple, from a prediction that is as many times too large.
        """
        if self.units < 3:
            return 0.0
        freedom, units = len(self.rows) - len(chosen), self._by_unit(chosen)

        def _loss(ratio: float) -> float:
            gram = units.at(ratio).sum(axis=0)
            normal = self._with_prior(gram[:-1, :-1], chosen)
            rest = gram[-1, -1] - gram[:-1, -1] @ np.linalg.solve(normal, gram[:-1, -1])
            levels = float(np.log1p(ratio * self._gamma).sum()) + ratio * rest / freedom / RUN_SPREAD**2
            return levels + float(np.linalg.slogdet(normal)[1]) + freedom * float(np.log(max(rest, 1e-300)))

        tried = np.log(self._level_variance.mean()) + np.linspace(-4.0, 16.0, 21)
        losses = [_loss(float(np.exp(t))) for t in tried]
        k = int(np.argmin(losses))
        found = minimize_scalar(
            lambda t: _loss(float(np.exp(t))),
            bounds=(tried[max(k - 1, 0)], tried[min(k + 1, len(tried) - 1)]),
            method="bounded",
            options={"xatol": 0.05},
        )
        return float(np.exp(found.x)) if float(found.fun) < _loss(0.0) else 0.0

    def sigma2(self, chosen: IntArray) -> float:
        """Variance of the noise beside some columns, with n - q - units in the denominator."""
        gram = self._inside(np.append(chosen, -1))
        c = np.append(-np.linalg.solve(self._with_prior(gram[:-1, :-1], chosen), gram[:-1, -1]), 1.0)
        rest = float(c @ gram @ c)
        return max(rest / max(len(self.rows) - len(chosen) - self.units, 1), 1e-300)

    def _with_prior(self, gram: FloatArray, chosen: IntArray) -> FloatArray:
        """Cross products of columns, (..., q, q), with those of the prior: of every column what its rows of these data
        say. The level of the runs is known as far as there are runs, and so is its prior.
        """
        diagonal = np.einsum("...ii->...i", gram) / len(self.rows)
        diagonal = np.where(diagonal > _ROUNDING, diagonal, 1.0)
        with_rows = gram + (self.prior_rows[chosen] * diagonal)[..., None] * np.eye(gram.shape[-1])
        return with_rows + self._pooling[np.ix_(chosen, chosen)] if self._pooling.size else with_rows

    def pooled(self, groups: Sequence[IntArray], chosen: IntArray, always: IntArray) -> MixedModel:
        """The same with partial pooling of the coefficients of classes: normal around their mean, with a variance by
        restricted likelihood (Gelman & Hill 2007, section 12.8).

        groups : columns of each group of classes; a class without a column has the coefficient 0. chosen, always : as
        of `estimate`.
        """
        found, tau2 = copy(self), min(self.tau2(chosen), self.tau2(always))
        gram, freedom = self._by_unit(chosen).at(tau2).sum(axis=0), len(self.rows) - len(chosen)
        for group in groups:
            shape, size = np.zeros((len(self.size), len(self.size))), self.size[group]
            shape[np.ix_(group, group)] = (np.eye(len(group)) - 1.0 / (len(group) + 1.0)) / np.outer(size, size)
            shape *= gram.diagonal()[:-1][np.isin(chosen, group)].sum() / np.trace(shape)
            others = found._pooling if found._pooling.size else np.zeros_like(shape)
            losses = []
            for worth in _POOLING:
                found._pooling = others + worth * shape
                normal = found._with_prior(gram[:-1, :-1], chosen)
                rest = gram[-1, -1] - gram[:-1, -1] @ np.linalg.solve(normal, gram[:-1, -1])
                loss = freedom * np.log(max(rest, 1e-300)) + np.linalg.slogdet(normal)[1]
                losses.append(float(loss - len(group) * np.log(worth)))
            found._pooling = others + _POOLING[int(np.argmin(losses))] * shape
        return found

    def _by_unit(self, chosen: IntArray) -> _ByUnit:
        index = np.append(chosen, -1)
        return _ByUnit(self._products[:, index[:, None], index], self._h[:, index], self._gamma)

    def _inside(self, index: IntArray) -> FloatArray:
        """The same of some columns."""
        return np.asarray(self._inner[np.ix_(index, index)])

    def coefficients(self, chosen: IntArray, low: FloatArray, high: FloatArray) -> FloatArray:
        """Coefficients (q,) by generalised least squares within limits, (q,)."""
        return self._within_limits(*self._normal(chosen, self.tau2(chosen)), chosen, low, high)

    def _normal(self, chosen: IntArray, tau2: float) -> tuple[FloatArray, FloatArray]:
        """Normal equations of generalised least squares, (q, q) and (q,)."""
        gram = self._by_unit(chosen).at(tau2).sum(axis=0)
        return self._with_prior(gram[:-1, :-1], chosen), gram[:-1, -1]

    def _within_limits(
        self, normal: FloatArray, target: FloatArray, chosen: IntArray, low: FloatArray, high: FloatArray
    ) -> FloatArray:
        """Least squares by normal equations, within limits that nothing always keeps."""
        factor, size = np.linalg.cholesky(normal), self.size[chosen]
        bounds = np.minimum(low * size, 0.0) - 1e-12, np.maximum(high * size, 0.0) + 1e-12
        found = lsq_linear(factor.T, np.linalg.solve(factor, target), bounds=bounds).x / size
        return np.clip(found, np.minimum(low, 0.0), np.maximum(high, 0.0))

    def left_out(self, chosen: IntArray, tau2: float, *, whole: bool = False) -> FloatArray:
        """Error of every unit by a fit to the others, (units,), in variances of the noise, beside random levels of
        variance `tau2` over that of the noise: minus two log likelihoods of the unit.

        whole : squared error of predictions of the rows instead, with what differs between units in it.
        """
        units = self._by_unit(chosen)
        part = units.at(tau2)
        c = np.concatenate([-self._by_others(part, chosen), np.ones((self.units, 1, 1))], axis=1)
        judged = units.gram if whole else part
        return np.asarray((np.swapaxes(c, 1, 2) @ judged @ c)[:, 0, 0])

    def _by_others(self, part: FloatArray, chosen: IntArray) -> FloatArray:
        """Coefficients without each unit, (units, q, 1), by the cross products of every unit."""
        total, q = part.sum(axis=0), part.shape[1] - 1
        others = total - part
        prior = self._with_prior(total[:q, :q], chosen) - total[:q, :q]  # of all rows, whatever is left out
        others[:, :q, :q] += prior
        return np.asarray(np.linalg.solve(others[:, :q, :q], others[:, :q, q:]))

    def test_within(self, tested: IntArray, beside: IntArray) -> float:
        """p-value of columns by their course inside units, with a free level of every unit: Wald's test by generalised
        least squares; 1 where there is nothing to test.

        The variance is the larger of the model's and of the one that is robust against unequal spread (HC3: MacKinnon &
        White 1985), with the mean over the columns of the degrees of freedom of Bell & McCaffrey 2002.
        """
        rows, squares, products = self._white
        last = np.append(tested, -1)
        within, across = self._with_prior(products[np.ix_(beside, beside)], beside), products[np.ix_(beside, last)]
        others = np.linalg.solve(within, across)
        left = (
            products[np.ix_(last, last)]
            - 2.0 * across.T @ others
            + others.T @ products[np.ix_(beside, beside)] @ others
        )
        turned = _directions(left[:-1, :-1], squares[tested])  # (k, r)
        if turned.shape[1] == 0:
            return 1.0
        inverse, target = np.linalg.inv(turned.T @ left[:-1, :-1] @ turned), turned.T @ left[:-1, -1]
        beta = inverse @ target
        noise = float(left[-1, -1] - target @ beta) / max(len(rows) - len(beside) - len(tested) - self.units, 1)
        model = inverse * noise
        if (least := _p_value(beta, model * self.efficiency**2, float(len(rows)))) > CERTAINLY_NOT:
            return least  # with fewer degrees of freedom, or a larger variance, it is larger still
        rest = rows[:, last] - rows[:, beside] @ others
        a, z = rest[:, :-1] @ turned, rest[:, -1]
        lever = np.einsum("ij,jk,ik->i", a, inverse, a)
        away = z - a @ beta
        spread = a * (away / np.maximum(1.0 - lever, 0.05))[:, None]
        robust = inverse @ (spread.T @ spread) @ inverse
        variance = max((robust, model), key=lambda v: -_wald(beta, v))
        freedom = float(np.mean(np.sum(a**2, axis=0) ** 2 / np.sum(a**4, axis=0)))
        return _p_value(beta, variance * self.efficiency**2, freedom)

    def test_between(self, tested: IntArray, beside: IntArray, levels: IntArray) -> float:
        """p-value of columns by the levels of units, with the degrees of freedom that units give: a random-effects
        meta-regression (DerSimonian & Laird 1986; Knapp & Hartung 2003; within and between: Mundlak 1978); 1 where
        there is nothing to test.

        beside : columns in the model, whose coefficients follow from all rows by generalised least squares. levels :
        those of them that are fitted to the levels alone. Degrees of freedom are lost to the other columns as far as
        these are fitted to the levels too.
        """
        k, fixed = len(tested), np.setdiff1d(beside, levels)
        x = np.column_stack([np.ones(self.units), self._h[:, np.append(levels, tested)] / self._gamma[:, None]])
        if not self.whole_runs or self.units <= x.shape[1]:
            return 1.0
        if _directions(x.T @ x, np.diag(x.T @ x)).shape[1] < x.shape[1]:
            return 1.0
        every = np.concatenate([fixed, levels, tested])
        sigma2, units = self.sigma2(every), self._by_unit(every)
        noise = sigma2 * self.efficiency**2 * self._level_variance
        between = _LARGE * sigma2
        for _ in range(_ROUNDS):
            gram = units.at(between / sigma2).sum(axis=0)
            normal = self._with_prior(gram[:-1, :-1], every)
            beta = np.linalg.solve(normal, gram[:-1, -1])[: len(fixed)]
            away = (self._h[:, -1] - self._h[:, fixed] @ beta) / self._gamma
            between = _between(away, noise, x)
        own = np.arange(len(fixed))
        more = gram[np.ix_(own, own)] - self._inside(fixed)
        used = float(np.trace(np.linalg.solve(normal[np.ix_(own, own)], more)))  # levels that the others have used up
        freedom = self.units - x.shape[1] - used
        if freedom < 1.0:
            return 1.0
        inverse, coefficients, misfit = _of_levels(away, 1.0 / (noise + between), x)
        return _p_value(coefficients[-k:], (inverse * max(misfit / freedom, 1.0))[-k:, -k:], freedom)

    def estimate(self, chosen: IntArray, low: FloatArray, high: FloatArray, always: IntArray) -> Estimate:
        """Coefficients by generalised least squares within limits, (q,).

        always : columns that are in every model. Units differ no more beside effects than without them: more is an
        error of an effect, which levels would hide. Degrees of freedom are the effective number of units minus one
        (Carter, Schnepel & Steigerwald 2017).
        """
        tau2, size = min(self.tau2(chosen), self.tau2(always)), self.size[chosen]
        normal, target = self._normal(chosen, tau2)
        part, inverse = self._by_unit(chosen).at(tau2), np.linalg.inv(normal)
        own = np.einsum("ik,uij,jk->uk", inverse, part[:, :-1, :-1], inverse, optimize=True)
        freedom = own.sum(axis=0) ** 2 / np.maximum((own**2).sum(axis=0), 1e-300) - 1.0
        left_out = self._by_others(part, chosen)[:, :, 0] / size
        return Estimate(self._within_limits(normal, target, chosen, low, high), left_out, freedom, tau2)


def _directions(information: FloatArray, squares: FloatArray) -> FloatArray:
    """Combinations of columns, (k, r), of which enough is left beside the other columns."""
    size = np.sqrt(np.maximum(squares, 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    return np.asarray((vectors / size[:, None])[:, values > _COLLINEAR])


def _wald(beta: FloatArray, variance: FloatArray) -> float:
    return float(beta @ np.linalg.solve(variance, beta))


def _p_value(beta: FloatArray, variance: FloatArray, freedom: float) -> float:
    """Wald's test of k coefficients, whose variance has so many degrees of freedom."""
    return float(fisher.sf(_wald(beta, variance) / len(beta), len(beta), freedom))


def _of_levels(away: FloatArray, weight: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Weighted least squares: the inverse of the normal equations, the coefficients, and the weighted squares left."""
    inverse = np.asarray(np.linalg.inv(x.T @ (weight[:, None] * x)), dtype=np.float64)
    coefficients = inverse @ (x.T @ (weight * away))
    return inverse, coefficients, float(weight @ (away - x @ coefficients) ** 2)


def _between(away: FloatArray, noise: FloatArray, x: FloatArray) -> float:
    """Variance between units by the method of moments (DerSimonian & Laird 1986, with covariates)."""
    inverse, _, misfit = _of_levels(away, 1.0 / noise, x)
    more = float((1.0 / noise).sum() - np.trace(inverse @ (x.T @ (x / noise[:, None] ** 2))))
    return max((misfit - len(away) + x.shape[1]) / more, 0.0)
