"""How far off a prediction may be: a segment's standard deviation, intervals that hold, and the spread of a route."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter

from joulemap.model.errors import InputError, ModelError

FloatArray = NDArray[np.float64]

LEVELS = (0.5, 0.8, 0.9)
"""Shares of segments that the intervals are made for."""
USUAL_SPREAD = 0.1
"""Share of the energy that a network without an opinion is taken to err by."""
LEAST_SHARE = 0.2
"""Errors are relative to the energy, but at least to this share of that of level ground."""
FEWEST = 20
"""Held-out segments that a spread needs."""
_NORMAL_99 = 0.9248
"""Mean square of a standard normal variable, given that it is among the 99 % smallest in size."""


@dataclass(frozen=True)
class Spread:
    """What held-out runs say of a model's errors.

    factor : the standard deviation of a segment over what the network itself believes. quantiles : half widths of the
    intervals in standard deviations, by level of `LEVELS`; wider than a normal distribution's where the tails are.
    run_share : standard deviation of the factor that a whole run is off by (weather, load, mud: what does not average
    out along a route). correlation_m : driven metres over which neighbouring errors, apart from that factor, go
    together. segments : how many they were found on, 0 where they were assumed.
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
        return asdict(self) | {"quantiles": list(self.quantiles)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Spread:
        """Raises ModelError for values that are no spread."""
        try:
            return cls(**{**values, "quantiles": tuple(float(q) for q in values["quantiles"])})
        except (TypeError, KeyError, ValueError) as error:
            raise ModelError(f"the model does not say how far off it may be: {error!r}") from error

    def interval(self, energy_j: ArrayLike, std_j: ArrayLike, level: float) -> tuple[FloatArray, FloatArray]:
        """(low, high) [J] that hold a share `level` of new segments. Raises InputError for a level without quantile."""
        if level not in LEVELS:
            raise InputError(f"there are intervals for {LEVELS}, not for {level}", level=level)
        half = self.quantiles[LEVELS.index(level)] * np.asarray(std_j, dtype=np.float64)
        energy = np.asarray(energy_j, dtype=np.float64)
        return energy - half, energy + half

    def route_std(self, energy_j: ArrayLike, std_j: ArrayLike) -> FloatArray:
        """Standard deviation [J] of the energy up to the end of each of a route's 1 m segments, (n,): the run's own
        factor, and the rest, of which neighbours go together as in a first-order autoregression whose correlations add
        up to `correlation_m`.
        """
        energy, std = np.asarray(energy_j, dtype=np.float64), np.asarray(std_j, dtype=np.float64)
        neighbour = (self.correlation_m - 1.0) / (self.correlation_m + 1.0)
        carried = lfilter([1.0], [1.0, -neighbour], std)  # (n,) sum over i <= k of neighbour^(k - i) std_i
        rest = np.cumsum(std * (2.0 * carried - std))
        return np.hypot(self.run_share * np.cumsum(energy), np.sqrt(np.maximum(rest, 0.0)))


def segment_std(price_j: ArrayLike, relative: ArrayLike, level_j: ArrayLike, *, factor: float) -> FloatArray:
    """Standard deviation [J] of 1 m segments: relative to their price, but at least to a share of `level_j`, the energy
    of level ground (a braking segment costs nothing and is still uncertain).
    """
    return np.asarray(factor * np.asarray(relative) * np.maximum(price_j, LEAST_SHARE * np.asarray(level_j)))


def fit_spread(energy_j: ArrayLike, predicted_j: ArrayLike, std_j: ArrayLike, run: ArrayLike) -> Spread:
    """The spread that held-out segments show. (n,) each: measured, predicted, what the network believes, and the run;
    segments of a run in driving order. Raises InputError for fewer than 20 segments.

    The factor makes the mean square of the standardised errors, without their largest hundredth, that of a normal
    distribution cut at the same place; the quantiles are those of the standardised errors (split conformal
    prediction, Lei et al. 2018, with the finite-sample correction). The usual run_share counts as one run more: a
    single run, well predicted by chance, says little of the next.
    """
    energy, predicted = np.asarray(energy_j, dtype=np.float64), np.asarray(predicted_j, dtype=np.float64)
    std, runs = np.asarray(std_j, dtype=np.float64), np.asarray(run)
    if energy.size < FEWEST:
        raise InputError(f"{energy.size} held-out segments are too few to tell a spread, {FEWEST} are needed")
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
