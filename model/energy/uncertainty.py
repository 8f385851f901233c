"""The uncertainty of predictions: standard deviations of segments, calibrated intervals, and the spread of a route."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.energy.route_errors import LEVELS, NORMAL_FREEDOM, fit_route_errors
from joulemap.model.errors import InputError, ModelError

FloatArray = NDArray[np.float64]

USUAL_SPREAD = 0.1
"""Assumed standard deviation over the energy where a network gives none."""
LEAST_SHARE = 0.2
"""Errors are relative to the energy, but at least to this share of that of level ground."""
FEWEST = 20
"""Held-out segments that a spread needs."""
_FEWEST_FREEDOM = 3
"""Degrees of freedom of the error of a run that are assumed at least: with two or fewer it would have no variance."""
_NORMAL_99 = 0.9248
"""Mean square of a standard normal variable, given that it is among the 99 % smallest in size."""


@dataclass(frozen=True)
class Spread:
    """The errors of a model on held-out runs."""

    factor: float = 1.0  # The standard deviation of a segment over the network's own estimate of it
    # Half widths of the intervals in standard deviations, by level of `LEVELS`; wider than those of a normal
    # distribution where the errors have heavier tails
    quantiles: tuple[float, ...] = (0.674, 1.282, 1.645)
    # Scale of the relative error of a whole run (weather, load, mud, and what the model itself does not know), which
    # does not average out along a route
    run_share: float = 0.05
    # Driven distance over which the remaining errors of neighbouring segments are correlated [m]
    correlation_m: float = 1.0
    segments: int = 0  # Number of held-out segments; 0 where the values are assumed
    # Degrees of freedom of Student's t of the remaining errors; None for a normal distribution
    freedom: float | None = None
    # The same of the error of a whole run: few runs, or campaigns, leave its scale uncertain
    run_freedom: float | None = None
    bias: float = 0.0  # Median of the relative error of routes: what a route is expected to take beyond the prediction
    skew: float = 1.0  # Scale of the errors of routes above that median over the scale below it
    # Scale of a second error of a whole run, as a share of the sum of the standard deviations of its segments: where
    # the model says that it knows less, it is more off on the whole run
    run_std_share: float = 0.0

    def __post_init__(self) -> None:
        for name in ("factor", "correlation_m", "skew"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError(f"{name} of a spread must be positive, got {getattr(self, name)}")
        for name in ("freedom", "run_freedom"):
            if (given := getattr(self, name)) is not None and not 2.0 < given < math.inf:
                raise InputError(f"{name} of a spread must be above 2, or none for a normal distribution, got {given}")
        if len(self.quantiles) != len(LEVELS):
            raise InputError(f"a spread needs {len(LEVELS)} quantiles, got {len(self.quantiles)}")

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers, JSON-able."""
        return asdict(self) | {"quantiles": list(self.quantiles)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Spread:
        """Make a spread of what `as_dict` wrote."""
        try:
            return cls(**{**values, "quantiles": tuple(float(q) for q in values["quantiles"])})
        except (TypeError, KeyError, ValueError) as error:
            raise ModelError(f"the model has no valid spread of its errors: {error!r}") from error

    def interval(self, energy_j: ArrayLike, std_j: ArrayLike, level: float) -> tuple[FloatArray, FloatArray]:
        """Return intervals that hold a given share of new segments.

        `energy_j` (n,): predicted energies [J]; `std_j` (n,): their standard deviations [J]. Result (n,): ends of the
        intervals [J].
        """
        if level not in LEVELS:
            raise InputError(f"there are intervals for {LEVELS}, not for {level}", level=level)
        half = self.quantiles[LEVELS.index(level)] * np.asarray(std_j, dtype=np.float64)
        energy = np.asarray(energy_j, dtype=np.float64)
        return energy - half, energy + half

    def along(self, energy_j: ArrayLike, std_j: ArrayLike) -> tuple[FloatArray, FloatArray | None]:
        """Return the distribution of the energy up to the end of each segment of a route.

        `energy_j` (n,): predicted energies of the 1 m segments, in driving order [J]; `std_j` (n,): their standard
        deviations [J]. Returns `scale_j` (n,): scale of the cumulative energy [J], as `route_std`; `freedom` (n,):
        degrees of freedom of Student's t, by Satterthwaite (1946) that of a sum of two variances, None for a normal
        distribution.
        """
        scale = self.route_std(energy_j, std_j)
        energy, std = (np.cumsum(np.asarray(values, dtype=np.float64)) for values in (energy_j, std_j))
        of_run = self.run_variance(energy, std)
        return scale, self.freedom_of(of_run, np.maximum(scale**2 - of_run, 0.0))

    def run_variance(self, energy_j: ArrayLike, sum_std_j: ArrayLike) -> FloatArray:
        """Return the squared scale of the error that a whole run has in common.

        `energy_j` (n,): of routes [J]; `sum_std_j` (n,): sums of the standard deviations of their segments [J]. Result
        (n,): [J2].
        """
        of_energy = self.run_share * np.asarray(energy_j, dtype=np.float64)
        return np.asarray(of_energy**2 + (self.run_std_share * np.asarray(sum_std_j, dtype=np.float64)) ** 2)

    def widened(self, factor: float) -> Spread:
        """Return this spread with the scales of long routes multiplied by a factor."""
        return replace(
            self,
            run_share=self.run_share * factor,
            run_std_share=self.run_std_share * factor,
            correlation_m=self.correlation_m * factor**2,
        )

    def freedom_of(self, of_run: FloatArray, rest: FloatArray) -> FloatArray | None:
        """Return the degrees of freedom of energies.

        `of_run` (n,): squared scale of the error that a whole run has in common [J2]; `rest` (n,): squared scale of the
        remaining errors [J2]. Result (n,): of Student's t of their sum; None for a normal distribution.
        """
        if self.freedom is None and self.run_freedom is None:
            return None
        within, between = ((given or NORMAL_FREEDOM) for given in (self.freedom, self.run_freedom))
        parts = of_run**2 / between + rest**2 / within
        return np.where(parts > 0.0, (of_run + rest) ** 2 / np.where(parts > 0.0, parts, 1.0), within)

    def route_std(self, energy_j: ArrayLike, std_j: ArrayLike) -> FloatArray:
        """Return the scale of the energy up to the end of each segment of a route.

        `energy_j` (n,): predicted energies of the 1 m segments, in driving order [J]; `std_j` (n,): their standard
        deviations [J]. Result (n,): scale of the cumulative energy [J]: the standard deviation where the distribution
        is normal.

        Two independent parts: the errors of the whole run, and the remaining errors, correlated between neighbours as
        in a first-order autoregression whose correlations sum to `correlation_m`.
        """
        energy, std = np.asarray(energy_j, dtype=np.float64), np.asarray(std_j, dtype=np.float64)
        neighbour = (self.correlation_m - 1.0) / (self.correlation_m + 1.0)
        summed = accumulate(std.tolist(), lambda before, own: neighbour * before + own)
        carried = np.fromiter(summed, dtype=np.float64, count=std.size)  # (n,) sums of neighbour^(k - i) std_i
        rest = np.cumsum(std * (2.0 * carried - std))
        return np.sqrt(self.run_variance(np.cumsum(energy), np.cumsum(std)) + np.maximum(rest, 0.0))


def segment_std(price_j: ArrayLike, relative: ArrayLike, level_j: ArrayLike, *, factor: float) -> FloatArray:
    """Return the standard deviation of 1 m segments.

    It is relative to the price, but at least to a share of the energy of level ground: a braking segment costs nothing
    and is still uncertain.

    `price_j` (n,): predicted energies [J]; `relative` (n,): standard deviations over the energy; `level_j` (n,). Result
    (n,): standard deviations [J].
    """
    return np.asarray(factor * np.asarray(relative) * np.maximum(price_j, LEAST_SHARE * np.asarray(level_j)))


def fit_spread(
    energy_j: ArrayLike,
    predicted_j: ArrayLike,
    std_j: ArrayLike,
    run: ArrayLike,
    *,
    group: ArrayLike | None = None,
) -> Spread:
    """Fit a spread to held-out segments.

    `energy_j` (n,): measured energies [J]; `predicted_j` (n,): predicted energies [J]; `std_j` (n,): the network's own
    standard deviations [J]; `run` (n,): the run of each segment, segments of a run are in driving order; `group` (n,):
    what was left out together, such as campaigns.

    The factor makes the mean square of the standardised errors, without their largest hundredth, that of a normal
    distribution truncated at the same place. The quantiles are those of the standardised errors, with the finite-sample
    correction. How errors add up along a route is fitted by `fit_route_errors`. The usual `run_share` counts as one
    group more where it is larger: one run that happens to be well predicted says little of the next. The error of a run
    has one degree of freedom less than there are groups, or fewer where the sums have fatter tails.

    Reference: Lei et al. 2018, "Distribution-free predictive inference for regression" (split conformal prediction).
    """
    energy, predicted = np.asarray(energy_j, dtype=np.float64), np.asarray(predicted_j, dtype=np.float64)
    std = np.asarray(std_j, dtype=np.float64)
    runs = np.unique(np.asarray(run), return_inverse=True)[1]
    groups = runs if group is None else np.unique(np.asarray(group), return_inverse=True)[1]
    if energy.size < FEWEST:
        raise InputError(f"{energy.size} held-out segments are too few for a spread, {FEWEST} are needed")
    error = (energy - predicted) / std
    size = np.sort(np.abs(error))
    kept = size[: max(1, math.ceil(0.99 * size.size))]
    factor = max(math.sqrt(float(np.mean(kept**2)) / _NORMAL_99), 1e-3)
    places = [min(size.size - 1, math.ceil((size.size + 1) * level) - 1) for level in LEVELS]
    quantiles = tuple(float(size[k]) / factor for k in places)
    found = fit_route_errors(energy - predicted, predicted, factor * std, runs, groups)
    more = max(Spread.run_share, found.run_share)
    run_share = math.sqrt((found.groups * found.run_share**2 + more**2) / (found.groups + 1))
    freedom, of_run = found.freedom, min(found.freedom, float(max(found.groups - 1, _FEWEST_FREEDOM)))
    return Spread(
        factor,
        quantiles,
        run_share,
        found.correlation_m,
        int(energy.size),
        freedom if freedom < NORMAL_FREEDOM else None,
        of_run if of_run < NORMAL_FREEDOM else None,
        found.bias,
        found.skew,
        found.run_std_share,
    )
