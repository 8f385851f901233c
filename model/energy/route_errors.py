"""How the errors of held-out runs add up along a route: run-to-run offset, correlation within runs, and tails.

    error of n segments = E (bias + u_run) + S v_run + sum of n correlated errors,      all with Student's t

where E is their energy and S the sum of their standard deviations: what differs between runs is a share of the energy,
or more where the model says that it knows less. The median is the bias, and errors above it may be larger than those
below (a two-piece distribution). The parameters maximise the likelihood of the summed errors of stretches of 20, 40,
80 and 160 segments (a composite marginal likelihood): what a verdict needs is the spread of sums, and neighbouring
segments say little of it.

Reference: Varin, Reid & Firth 2011, "An overview of composite likelihood methods". Lange, Little & Taylor 1989, "Robust
statistical modeling using the t distribution". Wallis 2014, "The two-piece normal, binormal, or double Gaussian
distribution". Schwarz 1978 (the criterion by which v_run, and a bias with unequal sides, are accepted).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

STRETCHES = (20, 40, 80, 160)
"""Segments of the stretches whose sums are fitted: routes are of 20 to 300 m."""
LEVELS = (0.5, 0.8, 0.9)
"""Shares of errors that intervals are made for."""
LEAST_FREEDOM = 2.5
"""Fewest degrees of freedom: with 2 or less there is no variance."""
NORMAL_FREEDOM = 100.0
"""More degrees of freedom than these are a normal distribution: their 95 % point differs by less than 1 %."""
_STARTS = ((0.02, 4.0, 20.0), (0.1, 1.0, 20.0), (0.3, 0.5, 5.0))  # offset of a run, correlation length, freedom
ENOUGH = 20
"""Fewest groups for further parameters: ten for each (Peduzzi et al. 1996)."""
_FURTHER = {(3,): (0.3,), (4, 5): (0.01, 0.1)}  # where the search starts: v_run; bias and logarithm of the skew
_LEAST_CORRELATION, _MOST_CORRELATION = 1.0 / 3.0, 1e6
"""Of neighbours -1/2 at least, that of the differences of independent errors; below 1 they make up for each other."""
_MOST_SKEW = math.log(10.0)
_FEWEST = 4  # segments of a run that is shorter than every stretch


@dataclass(frozen=True)
class RouteErrors:
    """How errors add up."""

    run_share: float  # Scale of the relative error of a whole run
    # Sum of the correlations of the remaining errors, as of a first-order autoregression [segments]; below 1 where
    # the errors of neighbours make up for each other
    correlation_m: float
    freedom: float  # Degrees of freedom of Student's t of the sums
    bias: float  # Median of the relative error
    skew: float  # Scale above the median over that below it
    groups: int  # Number of runs, or campaigns, that differ from each other
    # Scale of the error of a whole run over the sum of the standard deviations of its segments
    run_std_share: float = 0.0


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over stretches, one entry each: errors, predictions, standard deviations [J], variances [J2], segments, and
    weight; and the least correlation length.
    """

    error: FloatArray
    energy: FloatArray
    std: FloatArray
    variance: FloatArray
    count: FloatArray
    weight: FloatArray
    least: float


def correlated_variance(variance: FloatArray, count: FloatArray, correlation_m: float) -> FloatArray:
    """Return the variance of sums of correlated errors.

    `variance` (n,): sum of the variances of the parts of each; `count` (n,): number of its parts. Result (n,): of a
    first-order autoregression of parts of equal variance.
    """
    phi = (correlation_m - 1.0) / (correlation_m + 1.0)
    ends = 2.0 * phi * (1.0 - phi**count) / ((1.0 - phi) ** 2 * np.maximum(count, 1.0))
    return np.asarray(variance * (correlation_m - ends))


def fit_route_errors(
    error_j: FloatArray, energy_j: FloatArray, std_j: FloatArray, run: NDArray[np.int64], group: NDArray[np.int64]
) -> RouteErrors:
    """Fit how the errors of held-out segments add up.

    `error_j` (n,): measured minus predicted [J]; `energy_j` (n,): predicted [J]; `std_j` (n,): standard deviation of
    each segment [J]; `run` (n,): of each segment, those of a run are in driving order; `group` (n,): what was left out
    together: the run, or its campaign. Result: every group and every length of stretch counts alike.

    An error of whole runs that grows with the standard deviations, and then a bias and unequal sides, are accepted
    where there are `ENOUGH` groups and the criterion of Schwarz (1978), with as many observations as there are groups,
    says so: a few runs show neither, nor that errors of neighbours make up for each other. With so many groups scales
    and degrees of freedom are those at which the intervals of `LEVELS` hold what they say.
    """
    sums = _sums(error_j, energy_j, std_j, run, group)
    groups = int(np.unique(group).size)
    free = [0, 1, 2]
    loss, x = min((_least(sums, groups, _coordinates(*start), free) for start in _STARTS), key=lambda found: found[0])
    if groups < ENOUGH:
        share, correlation, freedom, _ = _parameters(x, sums)
        return RouteErrors(share, correlation, freedom, 0.0, 1.0, groups)
    for more, start in _FURTHER.items():
        tried = x.copy()
        tried[list(more)] = start
        less, found = _least(sums, groups, tried, [*free, *more])
        if groups * (loss - less) > 0.5 * len(more) * math.log(groups):
            loss, x, free = less, found, [*free, *more]
    share, correlation, _, std_share = _parameters(x, sums)
    wider, freedom = _matched(x, sums)
    skew = math.exp(_log_skew(x))
    return RouteErrors(
        share * wider, correlation * wider**2, freedom, float(x[4]), skew, groups, run_std_share=std_share * wider
    )


def _least(sums: _Sums, groups: int, start: FloatArray, free: list[int]) -> tuple[float, FloatArray]:
    """The least loss over the free ones of six coordinates, and where it is."""
    from scipy.optimize import minimize  # loads slowly, and only fits need it
    from scipy.special import gammaln

    x = start.copy()

    def _loss(values: FloatArray) -> float:
        x[free] = values
        freedom = _parameters(x, sums)[2]
        away, variance = _steps(x, sums)
        tails = (freedom + 1.0) / 2.0 * np.log1p(away**2 / variance / freedom) + 0.5 * np.log(variance)
        norm = gammaln((freedom + 1.0) / 2.0) - gammaln(freedom / 2.0) - 0.5 * math.log(freedom)
        return float(sums.weight @ (tails - norm)) / groups + 1e-6 * float(x @ x)  # flat directions have an end

    options = {"maxiter": 800, "xatol": 1e-3, "fatol": 1e-6}
    found = minimize(_loss, start[free], method="Nelder-Mead", options=options)
    x[free] = found.x
    return float(found.fun), x


def _steps(x: FloatArray, sums: _Sums) -> tuple[FloatArray, FloatArray]:
    """Distances from the median [J] and their squared scales [J2], (n,)."""
    share, correlation, _, std_share = _parameters(x, sums)
    variance = (share * sums.energy) ** 2 + (std_share * sums.std) ** 2
    variance += correlated_variance(sums.variance, sums.count, correlation)
    away = sums.error - x[4] * sums.energy
    return away, np.maximum(variance, 1e-300) * np.exp(np.sign(away) * _log_skew(x))


def _log_skew(x: FloatArray) -> float:
    return float(np.clip(x[5], -_MOST_SKEW, _MOST_SKEW))


def _matched(x: FloatArray, sums: _Sums) -> tuple[float, float]:
    """By how much the scales must be widened, and the degrees of freedom, so that intervals hold what they say: those
    whose quantiles, in logarithms, come nearest to the quantiles found. A single run that went wholly wrong decides the
    likelihood, and the quantiles hardly see it.
    """
    from scipy.special import stdtrit

    away, variance = _steps(x, sums)
    size = np.abs(away) / np.sqrt(variance)
    order = np.argsort(size)
    share = np.cumsum(sums.weight[order]) / sums.weight.sum()
    found = np.log(np.maximum(size[order][np.searchsorted(share, LEVELS)], 1e-12))
    tried = np.geomspace(LEAST_FREEDOM, NORMAL_FREEDOM, 60)
    apart = found - np.log(stdtrit(tried[:, None], 0.5 + 0.5 * np.array(LEVELS)))  # (tried, levels)
    best = int(np.argmin(apart.var(axis=1)))
    return float(np.exp(apart[best].mean())), float(tried[best])


def _coordinates(share: float, correlation: float, freedom: float) -> FloatArray:
    return np.array([*np.log([share, correlation, freedom - LEAST_FREEDOM]), 0.0, 0.0, 0.0])


def _parameters(x: FloatArray, sums: _Sums) -> tuple[float, float, float, float]:
    share, correlation, freedom = np.exp(np.clip(x[:3], -30.0, 30.0)).tolist()
    return (
        share,
        min(max(correlation, sums.least), _MOST_CORRELATION),
        min(LEAST_FREEDOM + freedom, NORMAL_FREEDOM),
        abs(float(x[3])),
    )


def _sums(
    error: FloatArray, energy: FloatArray, std: FloatArray, run: NDArray[np.int64], group: NDArray[np.int64]
) -> _Sums:
    found: list[tuple[float, ...]] = []
    of: list[tuple[int, int]] = []
    for one in np.unique(run):
        mine = np.flatnonzero(run == one)
        for stretch in stretches_of(mine):
            parts = (error, energy, std, std**2)
            found.append((*(part[stretch].sum() for part in parts), stretch.size))
            of.append((int(group[stretch[0]]), stretch.size if stretch.size in STRETCHES else 0))
    cells, cell, count = np.unique(np.array(of), axis=0, return_inverse=True, return_counts=True)
    lengths = np.bincount(np.unique(cells[:, 0], return_inverse=True)[1])  # of each group
    per_group = lengths[np.unique(cells[:, 0], return_inverse=True)[1]]
    weight = (1.0 / (count * per_group))[cell.ravel()]
    errors, energies, stds, variances, segments = np.array(found, dtype=np.float64).T
    least = _LEAST_CORRELATION if np.unique(group).size >= ENOUGH else 1.0
    return _Sums(errors, energies, stds, variances, segments, weight, least)


def stretches_of(mine: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Return the stretches whose sums are judged.

    `mine` (n,): segments of a run, in driving order. Yields: stretches of every length that do not overlap; the whole
    run where it is shorter than the longest, so that what differs between runs is seen in them too.
    """
    for length in STRETCHES:
        parts = mine.size // length
        first = (mine.size - parts * length) // 2
        yield from (mine[first + k * length : first + (k + 1) * length] for k in range(parts))
    if _FEWEST <= mine.size < STRETCHES[-1] and mine.size not in STRETCHES:
        yield mine
