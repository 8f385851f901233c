"""Significance tests: p-values that allow for everything that was tested.

For what varies within runs, the residual is shifted circularly along every run by random amounts. This keeps the
autocorrelation of the residual and of the effect. The largest statistic over all terms in each shift is what an
effect must exceed. For what differs between runs only, there are only as many observations as runs; how much runs
usually differ is known from the baseline runs as well.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import f as f_law

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SHIFTS = 999

_LEAST_RUNS = 3  # for each coefficient that differs between runs
_LEAST_LEVEL = 3e-3  # of the energy: runs that differ by less in an effect do not vary it


def by_shifts(
    z: FloatArray, run: IntArray, basis: FloatArray, tried: Mapping[int, FloatArray], *, seed: int = 0
) -> dict[int, float]:
    """Return p-values of terms that vary within runs, from circular shifts.

    Parameters
    ----------
    z : ndarray of float, (n,)
        Residual [scaled], without the span of `basis`, in driving order.
    run : ndarray of int, (n,)
        Number of the run.
    basis : ndarray of float, (n, k)
        Orthonormal columns of what is fitted already.
    tried : mapping of int to ndarray of float, (n, q)
        Orthonormal columns of each term, without the span of `basis`.
    seed : int
        Of the shifts.

    Returns
    -------
    dict of int to float
        The share of shifts in which any of the terms does as well.

    References
    ----------
    Wilson & Hilferty 1931 for the scale on which terms are compared.
    """
    rng = np.random.default_rng(seed)
    order = np.empty((z.size, SHIFTS), dtype=np.int64)
    for one in np.unique(run):
        mine = np.flatnonzero(run == one)
        offsets = rng.integers(0, mine.size, SHIFTS)
        order[mine] = mine[(np.arange(mine.size)[:, None] + offsets) % mine.size]
    shifted = np.concatenate([z[:, None], z[order]], axis=1).astype(np.float32)  # (n, 1 + shifts)
    lean = basis.astype(np.float32)
    shifted -= lean @ (lean.T @ shifted)
    stacked = np.concatenate(list(tried.values()), axis=1).astype(np.float32)
    power = (stacked.T @ shifted) ** 2 / (shifted**2).mean(axis=0)  # (columns, 1 + shifts)
    edges = np.cumsum([0] + [columns.shape[1] for columns in tried.values()])
    stat = np.add.reduceat(power, edges[:-1], axis=0)
    mean, var = stat[:, 1:].mean(axis=1, keepdims=True), stat[:, 1:].var(axis=1, keepdims=True)
    third = var / (9.0 * mean**2)  # Wilson & Hilferty 1931: the cube root of a gamma variable is nearly normal
    surprise = (np.cbrt(stat / mean) - (1.0 - third)) / np.sqrt(third)  # comparable between terms
    largest = surprise[:, 1:].max(axis=0)
    return {k: float((1 + (largest >= its[0]).sum()) / (SHIFTS + 1)) for k, its in zip(tried, surprise, strict=True)}


def between_runs(
    levels: FloatArray, tried: Mapping[int, FloatArray], *, usual: float, freedom: int, taken: int = 0, seed: int = 0
) -> dict[int, float]:
    """Return p-values of terms that differ between runs only.

    Parameters
    ----------
    levels : ndarray of float, (R,)
        Offset of each run, a share of its energy.
    tried : mapping of int to ndarray of float, (R, q)
        Columns of each term, likewise.
    usual : float
        Standard deviation of the offsets of runs without an effect.
    freedom : int
        Degrees of freedom with which `usual` is known; 0 if it is not.
    taken : int
        Number of effects between runs that were taken already.
    seed : int
        Of the simulated offsets.

    Returns
    -------
    dict of int to float
        Without the terms that need more runs than there are.

    Notes
    -----
    What a term explains of the offsets is compared with what it leaves and with what is usual, together (a moderated F
    test). The p-value is how rare the smallest p-value over all terms is when runs differ at random.

    References
    ----------
    Smyth 2004; Westfall & Young 1993.
    """
    rng = np.random.default_rng(seed)
    scale = usual if freedom else 1.0
    drawn = scale * rng.standard_normal((levels.size, SHIFTS))
    levels_each = np.concatenate([levels[:, None], drawn], axis=1)  # (R, 1 + draws)
    levels_each -= levels_each.mean(axis=0)
    known = np.concatenate([[freedom], rng.chisquare(freedom, SHIFTS) if freedom else np.zeros(SHIFTS)]) * scale**2
    chances = {}
    for k, columns in tried.items():
        basis = orthonormal(columns - columns.mean(axis=0), least=_LEAST_LEVEL)
        count = basis.shape[1]
        if count == 0 or levels.size < _LEAST_RUNS * count + taken:
            continue
        told = ((basis.T @ levels_each) ** 2).sum(axis=0)
        rest = (levels_each**2).sum(axis=0) - told
        left = levels.size - 1 - count - taken + freedom
        chances[k] = f_law.sf(told / count / ((rest + known) / left), count, left)
    if not chances:
        return {}
    rarest = np.min(list(chances.values()), axis=0)
    return {k: float((rarest <= its[0]).mean()) for k, its in chances.items()}


def apart(levels: FloatArray, usual: float) -> float:
    """Return the p-value of the hypothesis that runs differ no more than usual.

    Parameters
    ----------
    levels : ndarray of float, (R,)
        Offset of each run.
    usual : float
        Their usual standard deviation.

    Returns
    -------
    float
        Of a chi-squared test of heterogeneity.
    """
    away = (levels - levels.mean()) / usual
    return float(chi2.sf(float((away**2).sum()), max(levels.size - 1, 1)))


def orthonormal(columns: FloatArray, *, least: float = 1e-6) -> FloatArray:
    """Return an orthonormal basis of columns.

    Parameters
    ----------
    columns : ndarray of float, (n, k)
        May be collinear.
    least : float
        Directions shorter than this times sqrt(n) do not count.

    Returns
    -------
    ndarray of float, (n, at most k)
        The basis.
    """
    if columns.shape[1] == 0:
        return columns
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.ascontiguousarray(u[:, s > least * np.sqrt(columns.shape[0])])
