"""Could chance do it? p-values that allow for everything that was tried.

Of what varies within runs, the residual is shifted circularly along every run by random amounts: that keeps what makes
neighbours alike in it and in the effect, and the largest statistic over all terms in each shifting is what a find must
exceed. What differs between runs alone has only as many witnesses as there are runs: how far they are usually apart is
known from the base model's own runs as well.
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

_LEAST_RUNS = 3  # for each coefficient that is told between runs
_LEAST_LEVEL = 3e-3  # of the energy: runs that differ by less in an effect do not vary it


def by_shifts(
    z: FloatArray, run: IntArray, basis: FloatArray, tried: Mapping[int, FloatArray], *, seed: int = 0
) -> dict[int, float]:
    """p of terms that vary within runs: the share of shiftings in which any of them does as well.

    z, run : (n,) residual [scaled] without the span of `basis` (n, k) orthonormal, and number of the run, in driving
    order. tried : orthonormal columns (n, q) of each term, without that span too.
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
    """p of terms that differ between runs alone; those are left out that need more runs than there are.

    levels : (R,) by how much each run is off, a share of its energy. tried : columns (R, q) of each term, likewise.
    usual : standard deviation of the levels of runs without an effect, known with so many degrees of `freedom` (0: not
    known). taken : effects told from runs already.

    A term's share in the levels is held against what it leaves and what is usual, together (a moderated F: Smyth 2004);
    what counts is how rare the rarest find over all terms is in runs that differ by chance (Westfall & Young 1993).
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
    """p of levels (R,) that are no further from each other than `usual`, their standard deviation."""
    away = (levels - levels.mean()) / usual
    return float(chi2.sf(float((away**2).sum()), max(levels.size - 1, 1)))


def orthonormal(columns: FloatArray, *, least: float = 1e-6) -> FloatArray:
    """An orthonormal basis of columns (n, k); directions shorter than `least` times sqrt(n) do not count."""
    if columns.shape[1] == 0:
        return columns
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.ascontiguousarray(u[:, s > least * np.sqrt(columns.shape[0])])
