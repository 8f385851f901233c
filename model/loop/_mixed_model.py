"""A linear mixed model of scaled rows: fits, tests and left-out errors of any choice of columns.

Fixed effects, a random level of every unit (a run), and errors as `Variation` describes them. All fits come from the
cross products of every unit, so that leaving one out costs a subtraction. Every coefficient has a normal prior around
nothing that is worth one row of data (the unit information prior of Kass & Wasserman 1995), which settles what the rows
do not.

References
----------
Pinheiro & Bates 2000, chapter 2.
"""

from __future__ import annotations

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
_ROUNDING = 1e-9
_LARGE = 1e6  # variance between units over that of the noise: as good as fixed levels
_ROUNDS = 3  # the variance between units follows the coefficients and the coefficients the variance


@dataclass(frozen=True)
class Estimate:
    """Coefficients of a choice of columns."""

    coefficients: FloatArray  # (q,), within their limits
    variance: FloatArray  # (q, q), with between-unit variation in it
    freedom: FloatArray  # (q,) degrees of freedom
    between: float  # variance between units, as shares of their levels

    def interval(self, level: float = 0.95) -> tuple[FloatArray, FloatArray]:
        """Lower and upper ends of confidence intervals, (q,), of the given coverage."""
        reach = student.ppf(0.5 + 0.5 * level, np.maximum(self.freedom, 1.0)) * np.sqrt(np.diag(self.variance))
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
        *,
        whole_runs: bool,  # units are whole runs, so that differences between them can be tested
    ) -> None:
        energies = np.column_stack([columns, level, residual])
        every = variation.scaled(energies)
        self.size = np.sqrt(np.einsum("ij,ij->j", every, every)[:-2] / len(every))
        self.size[self.size == 0.0] = 1.0
        every[:, :-2] /= self.size  # a prior of one row then has precision 1 for every column
        self.variation, self.rows, self.unit, self.whole_runs = variation, every, unit, whole_runs
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
    def _scaled(self) -> tuple[FloatArray, FloatArray]:
        """Scaled rows without the levels of units, for estimates, and the squares of the rows with them, (k + 2,)."""
        return self._without_levels(self.rows)

    @cached_property
    def _white(self) -> tuple[FloatArray, FloatArray]:
        """The same of independent rows, for tests."""
        white = self.variation.whitened(self._energies)
        white[:, :-2] /= self.size
        return self._without_levels(white)

    def _without_levels(self, every: FloatArray) -> tuple[FloatArray, FloatArray]:
        rows = np.empty_like(every)
        for part in self._parts:
            own, level = every[part], every[part, -2]
            rows[part] = own - np.outer(level, level @ own / max(float(level @ level), 1e-12))
        return rows, np.einsum("ij,ij->j", every, every)

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
            normal = self._with_prior(gram[:-1, :-1])
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
        c = np.append(-np.linalg.solve(self._with_prior(gram[:-1, :-1]), gram[:-1, -1]), 1.0)
        rest = float(c @ gram @ c)
        return max(rest / max(len(self.rows) - len(chosen) - self.units, 1), 1e-300)

    def _with_prior(self, gram: FloatArray) -> FloatArray:
        """Cross products of columns, (..., q, q), with those of the prior: of every column what one row of these data
        says. The level of the runs is known as far as there are runs, and so is its prior.
        """
        diagonal = np.einsum("...ii->...i", gram) / len(self.rows)
        diagonal = np.where(diagonal > _ROUNDING, diagonal, 1.0)
        return gram + diagonal[..., None] * np.eye(gram.shape[-1])

    def _by_unit(self, chosen: IntArray) -> _ByUnit:
        index = np.append(chosen, -1)
        rows = self.rows[:, index]
        gram = np.stack([rows[part].T @ rows[part] for part in self._parts])
        return _ByUnit(gram, self._h[:, index], self._gamma)

    def _inside(self, index: IntArray) -> FloatArray:
        """Cross products of scaled columns without the levels of units."""
        rows = self._scaled[0][:, index]
        return np.asarray(rows.T @ rows)

    def coefficients(self, chosen: IntArray, low: FloatArray, high: FloatArray) -> FloatArray:
        """Coefficients (q,) by generalised least squares within limits, (q,)."""
        return self._within_limits(*self._normal(chosen, self.tau2(chosen)), chosen, low, high)

    def _normal(self, chosen: IntArray, tau2: float) -> tuple[FloatArray, FloatArray]:
        """Normal equations of generalised least squares, (q, q) and (q,)."""
        gram = self._by_unit(chosen).at(tau2).sum(axis=0)
        return self._with_prior(gram[:-1, :-1]), gram[:-1, -1]

    def _within_limits(
        self, normal: FloatArray, target: FloatArray, chosen: IntArray, low: FloatArray, high: FloatArray
    ) -> FloatArray:
        """Least squares by normal equations, within limits that nothing always keeps."""
        factor, size = np.linalg.cholesky(normal), self.size[chosen]
        bounds = np.minimum(low * size, 0.0) - 1e-12, np.maximum(high * size, 0.0) + 1e-12
        return np.asarray(lsq_linear(factor.T, np.linalg.solve(factor, target), bounds=bounds).x / size)

    def left_out(self, chosen: IntArray, tau2: float, *, whole: bool = False) -> FloatArray:
        """Error of every unit by a fit to the others, (units,), in variances of the noise, beside random levels of
        variance `tau2` over that of the noise: minus two log likelihoods of the unit.

        whole : squared error of predictions of the rows instead, with what differs between units in it.
        """
        units = self._by_unit(chosen)
        part = units.at(tau2)
        total, q = part.sum(axis=0), len(chosen)
        others = total - part
        others[:, :q, :q] += self._with_prior(total[:q, :q]) - total[:q, :q]  # that of all rows, whatever is left out
        beta = np.linalg.solve(others[:, :q, :q], others[:, :q, q:])  # (U, q, 1)
        c = np.concatenate([-beta, np.ones((self.units, 1, 1))], axis=1)
        judged = units.gram if whole else part
        return np.asarray((np.swapaxes(c, 1, 2) @ judged @ c)[:, 0, 0])

    def test_within(self, tested: IntArray, beside: IntArray) -> float:
        """p-value of columns by their course inside units, with a free level of every unit: Wald's test by generalised
        least squares; 1 where there is nothing to test.

        The variance is the larger of the model's and of the one that is robust against unequal spread (HC3: MacKinnon &
        White 1985), with the mean over the columns of the degrees of freedom of Bell & McCaffrey 2002.
        """
        found = self._fit(self._white, tested, beside)
        return 1.0 if found is None else _p_value(*found[:3])

    def _fit(
        self, within: tuple[FloatArray, FloatArray], tested: IntArray, beside: IntArray, *, serial: bool = False
    ) -> tuple[FloatArray, FloatArray, float, FloatArray] | None:
        """Coefficients of combinations of columns beside other columns, their robust variance, its degrees of freedom
        and the combinations, (k, r); None where the others say what they say.

        serial : add what serial correlation does to the variance.
        """
        rows, squares = within
        rest, other = rows[:, np.append(tested, -1)], rows[:, beside]
        rest -= other @ np.linalg.solve(self._with_prior(other.T @ other), other.T @ rest)
        a, z = rest[:, :-1], rest[:, -1]
        turned = _directions(a.T @ a, squares[tested])  # (k, r)
        if turned.shape[1] == 0:
            return None
        a = a @ turned
        inverse = np.linalg.inv(a.T @ a)
        beta = inverse @ (a.T @ z)
        lever = np.einsum("ij,jk,ik->i", a, inverse, a)
        away = z - a @ beta
        spread = a * (away / np.maximum(1.0 - lever, 0.05))[:, None]
        noise = float(away @ away) / max(len(z) - len(beside) - len(tested) - self.units, 1)
        robust, model = inverse @ (spread.T @ spread) @ inverse, inverse * noise
        variance = max((robust, model), key=lambda v: -_wald(beta, v))
        freedom = float(np.mean(np.sum(a**2, axis=0) ** 2 / np.sum(a**4, axis=0)))
        if serial:
            cross = a.T @ self.variation.carried(a) * (noise * self.variation.serial_share)
            more = inverse @ _positive(cross + cross.T) @ inverse
            share = float(np.max(np.diag(more) / np.diag(variance + more)))
            stretches = max(len(z) * (1.0 - self.variation.phi) / (1.0 + self.variation.phi), float(self.units))
            variance = variance + more
            freedom = 1.0 / ((1.0 - share) ** 2 / freedom + share**2 / stretches)
        return beta, variance * self.efficiency**2, freedom, turned

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
            normal = self._with_prior(gram[:-1, :-1])
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

    def estimate(self, chosen: IntArray, low: FloatArray, high: FloatArray, levels: IntArray) -> Estimate:
        """Coefficients by generalised least squares within limits, (q,).

        levels : columns whose effect was found in the levels of units. Degrees of freedom follow Satterthwaite (1946):
        information inside units counts rows, or independent stretches of an autoregression (Bartlett 1946); information
        between them counts units.
        """
        sigma2, tau2, size = self.sigma2(chosen), self.tau2(chosen), self.size[chosen]
        normal, target = self._normal(chosen, tau2)
        found = self._within_limits(normal, target, chosen, low, high)
        variance = np.linalg.inv(normal) * sigma2
        inside = np.linalg.inv(self._with_prior(self._inside(chosen))) * sigma2
        freedom = np.empty(len(chosen))
        for k, column in enumerate(chosen):
            alone = self._fit(self._scaled, np.array([column]), np.delete(chosen, k), serial=True)
            share, rows, units = 0.0, 1.0, max(self.units - 1.0 - len(levels), 1.0)
            if alone is not None:  # robust against unequal spread and serial correlation
                share = float(np.clip(variance[k, k] / max(inside[k, k], 1e-300), 0.0, 1.0))
                own = float(alone[1][0, 0] * alone[3][0, 0] ** 2)
                ratio = max(own / float(inside[k, k]), 1.0)
                variance[k, :] *= np.sqrt(ratio)
                variance[:, k] *= np.sqrt(ratio)
                rows = max(alone[2], 1.0)
            freedom[k] = 1.0 / (share**2 / rows + (1.0 - share) ** 2 / units)
        return Estimate(found, variance / np.outer(size, size), freedom, tau2 * sigma2)


def _positive(matrix: FloatArray) -> FloatArray:
    """The matrix without negative eigenvalues: serial correlation is credited with no precision."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


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
