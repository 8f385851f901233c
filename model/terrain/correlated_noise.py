"""Noise that is alike over some cells: how large it is, how far it is alike, and whether it may be ground.

The variance of twists of squares grows with their side. That of self-affine ground goes with a power of the side. That
of noise with a Gaussian correlation grows with its fourth power up to the correlation length, and is constant beyond
twice of it. Both together are fitted to the variances of one map, on their logarithmic scale.

Bumps of one size have the same variances as noise. So what fits is noise with a probability: it is ground where twists
have heavier tails than a normal distribution, as those of bumps have, and else the likelier noise the rougher ground
would have to be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_GROWTHS = np.linspace(1.0, 4.0, 13)
"""Powers of the side: 1 is the ground of ISO 8608 (density as wavelength squared), 2 random slopes, 4 smooth ground."""
_SHORTEST_CELLS, _LENGTHS = 0.65, 33
"""Shorter noise counts as independent from cell to cell."""
_LONGEST_M = 1.2
"""What is longer is relief to a robot of a metre, and hills may be steeper than any class of roughness."""
_SIDES_PER_LENGTH = 4.0
"""Twice the length must be seen to be beyond it."""
_MISFIT = 0.1
"""Relative error of the variance of twists that a power law has for ground: set by simulated grounds, with and without
noise."""
_MEDIAN_VARIANCE = 5.44
"""Variance of the logarithm of a variance by the median absolute deviation, times the number of values (4 x 1.36)."""
_LIKELIER = 3.84
"""By how much the fit must be better than without a length: 95 % of chi-square with one degree of freedom."""
_HEAVY, _HEAVY_ERROR = 1.05, 1.98
"""Ninth decile over median of the size of twists, over that of a normal distribution, above which they are no noise;
and its error of one in twenty, times the square root of their number. The first was set as `_MISFIT`."""
_NORMAL_TAIL = 2.439
_USUAL_M = 2048e-6 * 0.1**2
"""Spectral density of heights times squared wavenumber [m] between classes D and E of ISO 8608:2016 (of A to H)."""
_USUAL_NOISE_M = 0.03
"""Standard deviation that surveys usually have: robots 10 to 30 mm, drones 20 to 50, national models 50 to 150."""
_NOISY_MAPS = 0.2
"""Share of maps that have such noise: an assumption, chosen by `tests.bench.survey_noise` among 1/2, 1/3 and 1/5."""
_CLASS = math.log(4.0)
"""Standard deviation of the logarithm of a variance: that from one class to the next. Assumptions: unpaved ground is of
classes C to F in 95 of 100 cases, and 95 of 100 such surveys have noise of 8 to 120 mm."""
_TWIST_OF_DENSITY = 2.0 * math.pi**2 * (1.0 - math.sqrt(0.5))
"""Variance of a twist of ground of such a density, over density and side: structure function 2 pi^2 G r, isotropic."""


@dataclass(frozen=True, slots=True)
class PossibleNoise:
    """Bumps of a map that are noise or ground."""

    std_m: float  # Their standard deviation [m]
    length_m: float  # Their correlation is exp(-d^2 / 2 l^2) at distance d [m]
    probability: float  # That they are noise


def correlated_noise(
    sides: FloatArray, variances: FloatArray, squares: FloatArray, tails: FloatArray, cells_m: float
) -> PossibleNoise | None:
    """Return what explains how twists grow; None where nothing that is alike over some cells does.

    `sides` (n,): of the squares [cells]; `variances` (n,): of half their twists [m2]; `squares` (n,): how many there
    are; `tails` (n,): ninth decile of their size over its median; `cells_m`: side of a cell [m].
    """
    longest = min(sides[-1] / _SIDES_PER_LENGTH, _LONGEST_M / cells_m)
    if longest <= _SHORTEST_CELLS or not np.all(variances > 0.0):
        return None
    weights = 1.0 / np.sqrt(_MISFIT**2 + _MEDIAN_VARIANCE * sides**2 / squares)
    lengths = np.geomspace(_SHORTEST_CELLS, longest, _LENGTHS)
    with_length = np.square(1.0 - np.exp(-0.5 * np.square(sides / lengths[:, None])))  # (lengths, n)
    of_noise = np.concatenate([np.ones((1, sides.size)), with_length])
    of_ground = sides ** _GROWTHS[:, None]  # (growths, n)
    misfit, noise, ground = _fitted(of_ground / variances * weights, of_noise / variances * weights, weights)
    growth, at = np.unravel_index(misfit.argmin(), misfit.shape)
    best = misfit[growth, at]
    if not 1 < at < _LENGTHS or best > min(misfit[:, 0].min() - _LIKELIER, sides.size):
        return None
    length, variance = float(lengths[at - 1]), float(noise[growth, at])
    place = max(length, 1.0)
    share_of_noise = variance * (1.0 - math.exp(-0.5 * (place / length) ** 2)) ** 2
    if share_of_noise < ground[growth, at] * place ** _GROWTHS[growth]:
        return None
    near = min(int(np.searchsorted(sides, 1.5 * length)), sides.size - 1)
    heavy = tails[near] > _NORMAL_TAIL * (_HEAVY + _HEAVY_ERROR * sides[near] / math.sqrt(squares[near]))
    probability = 0.0 if heavy else _probability_of_noise(variance, length * cells_m)
    return PossibleNoise(math.sqrt(variance), length * cells_m, probability)


def _probability_of_noise(variance: float, length_m: float) -> float:
    """Return the probability that bumps are noise.

    `variance`: of the bumps [m2]; `length_m`: over which they are alike. Both that of noise and that of ground have a
    log-normal distribution over maps.
    """
    usual_ground = _TWIST_OF_DENSITY * _USUAL_M * 2.0 * length_m
    of_ground, of_noise = (math.log(variance / usual) / _CLASS for usual in (usual_ground, _USUAL_NOISE_M**2))
    return 1.0 / (1.0 + (1.0 / _NOISY_MAPS - 1.0) * math.exp(0.5 * (of_noise**2 - of_ground**2)))


def _fitted(ground: FloatArray, noise: FloatArray, aim: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Least squares of one of `ground` (g, n) and one of `noise` (m, n) to `aim` (n,), no factor negative.

    Result: sums of squares, factors of noise, factors of ground (g, m).
    """
    gg, nn = np.square(ground).sum(axis=1)[:, None], np.square(noise).sum(axis=1)
    gn, ga, na = ground @ noise.T, (ground @ aim)[:, None], noise @ aim
    rest = np.maximum(gg * nn - gn**2, 1e-12 * gg * nn)
    of_ground, of_noise = (ga * nn - gn * na) / rest, (gg * na - gn * ga) / rest
    of_ground, of_noise = (
        np.where(of_noise < 0.0, ga / gg, np.maximum(of_ground, 0.0)),
        np.where(of_ground < 0.0, na / nn, np.maximum(of_noise, 0.0)),
    )
    misfit = aim @ aim - 2.0 * (of_ground * ga + of_noise * na)
    misfit = misfit + of_ground**2 * gg + 2.0 * of_ground * of_noise * gn + of_noise**2 * nn
    return misfit, of_noise, of_ground
