"""How measured energies vary around a model: spread, serial correlation and outliers within runs.

    energy_i = mean_i + g_i u_run + s_i (a_i + e_i),   a_i = phi a_(i-1) + noise,   e_i heavy-tailed

`s_i` is a standard deviation that grows with the predicted energy, `a` an autoregression along a run, `e` noise whose
outliers get Huber's weights, and `u_run` the level of a run in shares of the predicted energy `g`. The likelihood of
the autoregression has a free level of every run, so that runs that differ do not look like serial correlation. Tests
take it out of the rows (`whitened`); coefficients are fitted to rows that are scaled only (Liang & Zeger 1986).

Reference: Pinheiro & Bates 2000, "Mixed-Effects Models in S and S-PLUS", chapter 5 (variance functions, correlation
structures). Harvey 1989, "Forecasting, Structural Time Series Models and the Kalman Filter", chapter 3. Huber 1964.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.optimize import minimize, nnls

from joulemap.model.runs.features import FloatArray

BoolArray = NDArray[np.bool_]

HUBER = 1.345
"""Standard deviations beyond which an error counts less: 95 % efficiency under a normal distribution (Huber 1964)."""
_COLLINEAR = 1e-6  # of a column's size is left beside the others: rounding
_ROUNDING = 1e-10
_BANDS = 10  # of the prediction, for the spread within each
_ROUNDS = 2  # weights follow the correlation and the correlation the weights
_LEAST_GAIN = 0.01  # of minus two log likelihoods: nothing that a test or an interval would show
_GRID = 7  # correlation lengths, and as many variances over that of the noise, are tried first


@njit(cache=True)
def _filtered(
    columns: FloatArray, fresh: BoolArray, noise: FloatArray, process: FloatArray, phi: float
) -> tuple[FloatArray, float]:
    """Standardised innovations (n, k) of every column under one autoregression plus noise, and the log determinant."""
    n, k = columns.shape
    out = np.empty((n, k))
    state = np.zeros(k)
    variance, log_det = 0.0, 0.0
    for i in range(n):
        if fresh[i]:
            state[:] = 0.0
            variance = process[i]
        total = variance + noise[i]
        gain, size = variance / total, 1.0 / np.sqrt(total)
        for j in range(k):
            away = columns[i, j] - state[j]
            out[i, j] = away * size
            state[j] = phi * (state[j] + gain * away)
        variance = phi * phi * variance * (1.0 - gain) + (1.0 - phi * phi) * process[i]
        log_det += np.log(total)
    return out, log_det


@njit(cache=True)
def _carried(columns: FloatArray, fresh: BoolArray, phi: float) -> FloatArray:
    n, k = columns.shape
    out = np.zeros((n, k))
    for i in range(1, n):
        if not fresh[i]:
            for j in range(k):
                out[i, j] = phi * (out[i - 1, j] + columns[i - 1, j])
    return out


@dataclass(frozen=True, eq=False)
class Variation:
    """The variation of n rows around a model."""

    run: NDArray[np.int64]  # number of the run
    moving: BoolArray  # False for stationary intervals, which are correlated with nothing
    scale: FloatArray  # `s_i` [J, or A s]
    weight: FloatArray  # less than 1 of an outlier
    length_rows: float = 1.0  # over which the correlation falls to 1/e
    process: float = 0.0  # variance of the autoregression over that of the noise

    @cached_property
    def fresh(self) -> BoolArray:
        """Whether a row has no predecessor with which it is correlated, (n,): first rows, and stationary intervals."""
        first = np.ones(self.run.size, dtype=bool)
        first[1:] = (np.diff(self.run) != 0) | ~self.moving[1:] | ~self.moving[:-1]
        return first

    def scaled(self, columns: FloatArray) -> FloatArray:
        """Columns (n, k) [J, or A s] for least squares: in standard deviations of their rows, with weights."""
        return np.ascontiguousarray(columns * (np.sqrt(self.weight) / self.scale)[:, None])

    def whitened(self, columns: FloatArray) -> FloatArray:
        """Columns (n, k) [J, or A s] for generalised least squares: independent rows, by the noise."""
        return self._filtered(columns / self.scale[:, None])[0]

    @property
    def phi(self) -> float:
        """Correlation of the autoregression from row to row."""
        return float(np.exp(-1.0 / self.length_rows))

    @property
    def serial_share(self) -> float:
        """Share of the variance that is serially correlated."""
        return self.process / (1.0 + self.process)

    def carried(self, columns: FloatArray) -> FloatArray:
        """Sum of all earlier rows of the run, each times its correlation with the row, (n, k), of columns as `scaled`
        returns them: the variance of a sum of correlated rows is that of independent ones and twice the product with
        this.
        """
        weighted = np.ascontiguousarray(columns * np.sqrt(self.weight)[:, None])
        return _carried(weighted, self.fresh, self.phi) * np.sqrt(self.weight)[:, None]

    def _filtered(self, scaled: FloatArray) -> tuple[FloatArray, float]:
        process = np.where(self.moving, self.process, 0.0)
        out, log_det = _filtered(np.ascontiguousarray(scaled), self.fresh, 1.0 / self.weight, process, self.phi)
        return out, float(log_det)


def spread_of(predicted: FloatArray, residual: FloatArray, moving: BoolArray) -> FloatArray:
    """Standard deviation of each row, (n,): a constant and a part proportional to the prediction, fitted to the spread
    in ten bands of the prediction. A stationary interval varies in proportion to its energy.
    """
    p, r = np.maximum(predicted[moving], 0.0), residual[moving]
    bands = [b for b in np.array_split(np.argsort(p), min(_BANDS, max(1, p.size // _BANDS))) if b.size]
    level = np.array([p[b].mean() for b in bands])
    spread = np.array([1.4826 * np.median(np.abs(r[b] - np.median(r[b]))) for b in bands])  # of a normal variable
    (constant, share), _ = nnls(np.stack([np.ones_like(level), level], axis=1), spread)
    floor = max(float(np.median(spread)), 1e-9 * max(float(np.median(p)), 1e-12), 1e-12)
    if constant + share * float(np.median(p)) <= 0.0:
        constant = floor
    out = constant + share * np.maximum(predicted, 0.0)
    still = np.maximum(predicted, 0.05 * float(np.median(p))) * max(share, 0.02)
    return np.maximum(np.where(moving, out, still), np.where(moving, 0.1, 1e-3) * floor)


def fit_variation(start: Variation, predicted: FloatArray, residual: FloatArray, fixed: FloatArray) -> Variation:
    """Fit spread, serial correlation and weights to the residuals of a model.

    start : an earlier fit to the same rows, or one without correlation. predicted, residual : fitted energy, and
    measured minus fitted, (n,) [J, or A s]. fixed : columns of the fit, (n, k); the restricted likelihood leaves out
    what they could explain.
    """
    run, moving = start.run, start.moving
    scale = spread_of(predicted, residual, moving)
    found = replace(start, scale=scale)
    levels = np.stack([np.where(run == k, np.maximum(predicted, 0.0), 0.0) for k in np.unique(run)], axis=1)
    design = _independent(np.concatenate([levels, fixed], axis=1) / scale[:, None])
    z = (residual / scale)[:, None]
    for _ in range(_ROUNDS):
        found = _correlated(found, design, z)
        both, _log_det = found._filtered(np.concatenate([z, design], axis=1))
        rest = both[:, 0] - both[:, 1:] @ np.linalg.lstsq(both[:, 1:], both[:, 0], rcond=None)[0]
        away = np.abs(rest) / np.sqrt(found.weight)  # whitening made outliers smaller by the root of their weight
        size = away / max(1.4826 * float(np.median(np.abs(rest))), 1e-12)
        weight = np.minimum(1.0, HUBER / np.maximum(size, 1e-12))
        found = replace(found, weight=weight)
    return found


def _independent(design: FloatArray) -> FloatArray:
    """The columns that are no combination of others."""
    size = np.sqrt((design**2).sum(axis=0))
    scaled = design[:, size > 0] / size[size > 0]
    _, r, order = qr(scaled, mode="economic", pivoting=True)
    return scaled[:, order[: int((np.abs(np.diag(r)) > _COLLINEAR).sum())]]


def _correlated(found: Variation, design: FloatArray, z: FloatArray) -> Variation:
    """With the length and the variance of the autoregression that maximise the restricted likelihood.

    The likelihood often has two maxima, a short and a long correlation: a first search starts at the best point of a
    grid, a later one where the earlier one ended.
    """
    columns = np.concatenate([design, z], axis=1)
    limits = np.log([(0.3, np.bincount(found.run).max()), (1e-4, 1e4)])  # beyond, nothing changes

    def at(x: FloatArray) -> Variation:
        return replace(found, length_rows=float(np.exp(x[0])), process=float(np.exp(x[1])))

    def loss(candidate: Variation) -> float:
        both, log_det = candidate._filtered(columns)
        size = np.sqrt(np.maximum(np.einsum("ij,ij->j", both, both), 1e-300))
        both /= size
        factor = np.linalg.cholesky(both.T @ both + _ROUNDING * np.eye(len(size)))
        free = np.log(np.diag(factor) * size)
        return float(log_det + 2.0 * free[:-1].sum() + 2.0 * max(len(both) - len(size) + 1, 1) * free[-1])

    if found.process > 0.0:
        start = np.clip(np.log([found.length_rows, found.process]), *limits.T)
    else:
        tried = np.linspace(limits[:, 0], limits[:, 1], _GRID + 2)[1:-1]
        start = min(map(np.array, product(*tried.T)), key=lambda x: loss(at(x)))
    precise = {"eps": 1e-4, "ftol": _LEAST_GAIN / max(len(z), 1)}  # the loss is about as large as there are rows
    best = at(minimize(lambda x: loss(at(x)), start, method="L-BFGS-B", bounds=limits, options=precise).x)
    white = replace(found, length_rows=1.0, process=0.0)
    return best if loss(best) < loss(white) else white
