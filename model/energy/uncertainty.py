"""The uncertainty of predictions: standard deviations of segments, calibrated intervals, and the spread of a route."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError, ModelError

FloatArray = NDArray[np.float64]

LEVELS = (0.5, 0.8, 0.9)
"""Shares of segments that the intervals are made for."""
USUAL_SPREAD = 0.1
"""Assumed standard deviation over the energy where a network gives none."""
LEAST_SHARE = 0.2
"""Errors are relative to the energy, but at least to this share of that of level ground."""
FEWEST = 20
"""Held-out segments that a spread needs."""
_NORMAL_99 = 0.9248
"""Mean square of a standard normal variable, given that it is among the 99 % smallest in size."""


@dataclass(frozen=True)
class Spread:
    """The errors of a model on held-out runs.

    Attributes
    ----------
    factor : float
        The standard deviation of a segment over the network's own estimate of it.
    quantiles : tuple of float
        Half widths of the intervals in standard deviations, by level of `LEVELS`; wider than those of a normal
        distribution where the errors have heavier tails.
    run_share : float
        Standard deviation of the relative error of a whole run (weather, load, mud), which does not average out along a
        route.
    correlation_m : float
        Driven distance over which the remaining errors of neighbouring segments are correlated [m].
    segments : int
        Number of held-out segments; 0 where the values are assumed.
    """

    factor: float = 1.0
    quantiles: tuple[float, ...] = (0.674, 1.282, 1.645)
    run_share: float = 0.05
    correlation_m: float = 1.0
    segments: int = 0

    def __post_init__(self) -> None:
        for name in ("factor", "correlation_m"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError(f"{name} of a spread must be positive, got {getattr(self, name)}")
        if len(self.quantiles) != len(LEVELS):
            raise InputError(f"a spread needs {len(LEVELS)} quantiles, got {len(self.quantiles)}")

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers, JSON-able."""
        return asdict(self) | {"quantiles": list(self.quantiles)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Spread:
        """Make a spread of what `as_dict` wrote.

        Parameters
        ----------
        values : mapping
            The numbers by name.

        Returns
        -------
        Spread
            The spread.

        Raises
        ------
        ModelError
            If the values are no spread.
        """
        try:
            return cls(**{**values, "quantiles": tuple(float(q) for q in values["quantiles"])})
        except (TypeError, KeyError, ValueError) as error:
            raise ModelError(f"the model has no valid spread of its errors: {error!r}") from error

    def interval(self, energy_j: ArrayLike, std_j: ArrayLike, level: float) -> tuple[FloatArray, FloatArray]:
        """Return intervals that hold a given share of new segments.

        Parameters
        ----------
        energy_j : array_like, (n,)
            Predicted energies [J].
        std_j : array_like, (n,)
            Their standard deviations [J].
        level : float
            The share, one of `LEVELS`.

        Returns
        -------
        low, high : ndarray of float64, (n,)
            Ends of the intervals [J].

        Raises
        ------
        InputError
            If there is no quantile for the level.
        """
        if level not in LEVELS:
            raise InputError(f"there are intervals for {LEVELS}, not for {level}", level=level)
        half = self.quantiles[LEVELS.index(level)] * np.asarray(std_j, dtype=np.float64)
        energy = np.asarray(energy_j, dtype=np.float64)
        return energy - half, energy + half

    def route_std(self, energy_j: ArrayLike, std_j: ArrayLike) -> FloatArray:
        """Return the standard deviation of the energy up to the end of each segment of a route.

        Parameters
        ----------
        energy_j : array_like, (n,)
            Predicted energies of the 1 m segments, in driving order [J].
        std_j : array_like, (n,)
            Their standard deviations [J].

        Returns
        -------
        ndarray of float64, (n,)
            Standard deviation of the cumulative energy [J].

        Notes
        -----
        Two independent parts: the relative error of the whole run, and the remaining errors, correlated between
        neighbours as in a first-order autoregression whose correlations sum to `correlation_m`.
        """
        energy, std = np.asarray(energy_j, dtype=np.float64), np.asarray(std_j, dtype=np.float64)
        neighbour = (self.correlation_m - 1.0) / (self.correlation_m + 1.0)
        summed = accumulate(std.tolist(), lambda before, own: neighbour * before + own)
        carried = np.fromiter(summed, dtype=np.float64, count=std.size)  # (n,) sums of neighbour^(k - i) std_i
        rest = np.cumsum(std * (2.0 * carried - std))
        return np.hypot(self.run_share * np.cumsum(energy), np.sqrt(np.maximum(rest, 0.0)))


def segment_std(price_j: ArrayLike, relative: ArrayLike, level_j: ArrayLike, *, factor: float) -> FloatArray:
    """Return the standard deviation of 1 m segments.

    It is relative to the price, but at least to a share of the energy of level ground: a braking segment costs nothing
    and is still uncertain.

    Parameters
    ----------
    price_j : array_like, (n,)
        Predicted energies [J].
    relative : array_like, (n,)
        Standard deviations over the energy.
    level_j : array_like, (n,)
        Energy of level ground [J].
    factor : float
        `Spread.factor`.

    Returns
    -------
    ndarray, (n,)
        Standard deviations [J].
    """
    return np.asarray(factor * np.asarray(relative) * np.maximum(price_j, LEAST_SHARE * np.asarray(level_j)))


def fit_spread(energy_j: ArrayLike, predicted_j: ArrayLike, std_j: ArrayLike, run: ArrayLike) -> Spread:
    """Fit a spread to held-out segments.

    Parameters
    ----------
    energy_j : array_like, (n,)
        Measured energies [J].
    predicted_j : array_like, (n,)
        Predicted energies [J].
    std_j : array_like, (n,)
        The network's own standard deviations [J].
    run : array_like, (n,)
        The run of each segment; segments of a run are in driving order.

    Returns
    -------
    Spread
        With the number of segments.

    Raises
    ------
    InputError
        If there are fewer than 20 segments.

    Notes
    -----
    The factor makes the mean square of the standardised errors, without their largest hundredth, that of a normal
    distribution truncated at the same place. The quantiles are those of the standardised errors, with the finite-sample
    correction. The usual `run_share` counts as one run more: one run that happens to be well predicted says little of
    the next.

    References
    ----------
    Lei et al. 2018, "Distribution-free predictive inference for regression" (split conformal prediction).
    """
    energy, predicted = np.asarray(energy_j, dtype=np.float64), np.asarray(predicted_j, dtype=np.float64)
    std, runs = np.asarray(std_j, dtype=np.float64), np.asarray(run)
    if energy.size < FEWEST:
        raise InputError(f"{energy.size} held-out segments are too few for a spread, {FEWEST} are needed")
    error = (energy - predicted) / std
    size = np.sort(np.abs(error))
    kept = size[: max(1, math.ceil(0.99 * size.size))]
    factor = max(math.sqrt(float(np.mean(kept**2)) / _NORMAL_99), 1e-3)
    places = [min(size.size - 1, math.ceil((size.size + 1) * level) - 1) for level in LEVELS]
    quantiles = tuple(float(size[k]) / factor for k in places)
    shares, products, squares = [], 0.0, 0.0
    for one in np.unique(runs):
        mine = runs == one
        if mine.sum() < 2:
            continue
        share = energy[mine].sum() / predicted[mine].sum()
        shares.append(share - 1.0)
        rest = np.clip((energy[mine] - share * predicted[mine]) / std[mine], -4.0 * factor, 4.0 * factor)
        rest -= rest.mean()
        products += float((rest[1:] * rest[:-1]).sum())
        squares += float((rest**2).sum())
    neighbour = min(max(products / squares if squares else 0.0, 0.0), 0.9)
    correlation = (1.0 + neighbour) / (1.0 - neighbour)  # of a first-order autoregression: sum of its correlations
    run_share = math.sqrt(float(np.mean(np.square([*shares, Spread.run_share]))))
    return Spread(factor, quantiles, run_share, correlation, int(energy.size))
