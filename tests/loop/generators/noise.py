"""Unexplained variation: a factor on the power that is constant over each metre of the track."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tests.loop.generators.config import NoiseConfig
from tests.loop.generators.site import Site

FloatArray = NDArray[np.float64]

LEAST = 0.1
"""A factor is never smaller: no disturbance pushes the robot."""


def region_of(site: Site, rng: np.random.Generator) -> FloatArray:
    """A straight line through the site's middle region as (a, b, c): the region is where a x + b y > c."""
    west, south, east, north = site.bounds
    direction = rng.uniform(0.0, 2 * np.pi)
    a, b = np.sin(direction), np.cos(direction)
    return np.array([a, b, a * rng.uniform(0.6 * west + 0.4 * east, 0.4 * west + 0.6 * east) + b * (south + north) / 2])


def factor_along(
    driven_m: FloatArray,
    x: FloatArray,
    y: FloatArray,
    config: NoiseConfig,
    region: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Draw the factor on the power of one run.

    Parameters
    ----------
    driven_m : ndarray of float, (n,)
        Length of the track so far.
    x, y : ndarray of float, (n,)
        True position [m].
    config : NoiseConfig
        Kinds and sizes of variation.
    region : ndarray of float, (3,)
        As `region_of`.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    ndarray of float, (n,)
        With mean 1, but for one-off disturbances, and at least `LEAST`.
    """
    metre = np.floor(driven_m).astype(np.int64)
    count = int(metre[-1]) + 1
    white = rng.standard_normal(count)
    if np.isfinite(config.freedom):
        white = rng.standard_t(config.freedom, count) * np.sqrt((config.freedom - 2.0) / config.freedom)
    first = np.searchsorted(metre, np.arange(count))
    inside = region[0] * x[first] + region[1] * y[first] > region[2]
    total = config.white_sd * white * np.where(inside, config.region_factor, 1.0)
    total += config.run_sd * rng.standard_normal()
    fresh = rng.standard_normal(count) * np.sqrt(1.0 - config.serial**2)
    fresh[0] = rng.standard_normal()
    total += config.serial_sd * lfilter([1.0], [1.0, -config.serial], fresh)
    total += config.walk_sd * np.cumsum(rng.standard_normal(count))
    total += np.where(rng.random(count) < config.hit_share, rng.uniform(*config.hit, count), 0.0)
    return np.maximum(1.0 + total, LEAST)[metre]
