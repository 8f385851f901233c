"""What a route is judged by where its energy is a distribution, and the search for the best by linear prices.

The mean and the variance of a route add up piece by piece. The objectives here grow with both, and are quasi-concave in
them: over all routes they are least at a corner of the lower hull of (mean, variance), and each such corner is the
cheapest route at a price mean + lambda variance. Every price that was searched says that no route lies below a line.
Where the objective is least above all these lines is a bound of it, and says which price to search next.

References
----------
Nikolova, Kelner, Brand & Mitzenmacher 2006, "Stochastic shortest paths via quasi-convex maximization". Horst & Tuy
1996, "Global optimization", chapter 6 (outer approximation).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

Ways = TypeVar("Ways")

MOST_SEARCHES = 8
"""Prices that are searched at most; four are usual."""
CLOSE = 1e-3
"""A route that is so near to the bound is not improved any more: as a share of an energy, or in standard deviations."""
_BETWEEN = 8  # places between two corners of the bound: where an objective is not quasi-concave, it is least on an edge
_LEAST_SHARE = 0.01  # of the variance of the best route, at which the price of variance is still finite


class Aim(Protocol):
    """An objective: a number of the mean and the variance of a route's energy, the smaller the better."""

    def value(self, mean_j: float, variance_j2: float) -> float:
        """Return the objective.

        `mean_j`: expected energy [J]; `variance_j2`: variance of what is no share of the energy [J2]. Result: the
        smaller the better.
        """

    def price(self, mean_j: float, variance_j2: float) -> float:
        """Return what a unit of variance is worth in mean energy.

        `mean_j`: expected energy [J]; `variance_j2`: variance [J2]. Result: ratio of the derivatives of the objective
        [1/J], at least 0.
        """

    def is_close(self, found: float, bound: float) -> bool:
        """Return whether a value is near enough to its bound.

        `found`: of a route; `bound`: below which no route is. Result: whether the search may end.
        """


@dataclass(frozen=True)
class LeastQuantile:
    """The energy that a share of drives does not exceed: mean (1 + bias) + steps sqrt((run_share mean)^2 + variance).

    Attributes
    ----------
    steps : float
        How many scales the quantile lies above the median, at least 0.
    run_share : float
        Scale of the relative error of a whole run.
    bias : float
        By which share of the mean the median lies above it.
    """

    steps: float
    run_share: float = 0.0
    bias: float = 0.0

    def value(self, mean_j: float, variance_j2: float) -> float:
        """Return the quantile, see `Aim`.

        `mean_j`, `variance_j2`: as there. Result: energy [J].
        """
        return mean_j + self.bias * abs(mean_j) + self.steps * math.hypot(self.run_share * mean_j, variance_j2**0.5)

    def price(self, mean_j: float, variance_j2: float) -> float:
        """Return the price of variance, see `Aim`.

        `mean_j`, `variance_j2`: as there. Result: [1/J].
        """
        scale = math.hypot(self.run_share * mean_j, variance_j2**0.5)
        slope = 1.0 + self.bias + self.steps * self.run_share**2 * mean_j / max(scale, 1e-12)
        return self.steps / (2.0 * max(scale, 1e-12) * max(slope, 1e-3))

    def is_close(self, found: float, bound: float) -> bool:
        """Return whether a quantile is near its bound, see `Aim`.

        `found`, `bound`: as there. Result: whether the search may end.
        """
        return found - bound <= CLOSE * abs(found)


@dataclass(frozen=True)
class MostLikely:
    """Minus the number of scales by which the median lies below what there is: least where arriving is most likely.

    Attributes
    ----------
    available_j : float
        Energy that may be used [J].
    run_share : float
        Scale of the relative error of a whole run.
    bias : float
        By which share of the mean the median lies above it.
    """

    available_j: float
    run_share: float = 0.0
    bias: float = 0.0

    def value(self, mean_j: float, variance_j2: float) -> float:
        """Return the number of scales that are missing, see `Aim`.

        `mean_j`, `variance_j2`: as there. Result: negative where there is enough.
        """
        spare = self.available_j - mean_j - self.bias * abs(mean_j)
        return -spare / max(math.hypot(self.run_share * mean_j, variance_j2**0.5), 1e-9 * abs(mean_j), 1e-12)

    def price(self, mean_j: float, variance_j2: float) -> float:
        """Return the price of variance, see `Aim`.

        `mean_j`, `variance_j2`: as there. Result: [1/J]; 0 where the median takes more than there is: luck is no plan.
        """
        spare = self.available_j - mean_j * (1.0 + self.bias)
        level = (1.0 + self.bias) * variance_j2 + self.available_j * self.run_share**2 * mean_j
        return spare / (2.0 * level) if spare > 0.0 and level > 0.0 else 0.0

    def is_close(self, found: float, bound: float) -> bool:
        """Return whether a number of scales is near its bound, see `Aim`.

        `found`, `bound`: as there. Result: whether the search may end.
        """
        return found - bound <= CLOSE


@dataclass(frozen=True)
class Priced(Generic[Ways]):
    """The cheapest ways at one price.

    Attributes
    ----------
    ways : Ways
        What was found.
    mean_j : float
        Its expected energy [J].
    variance_j2 : float
        Its variance [J2].
    least_j : float or None
        No ways have less of mean + price variance than this [J]; None where it is that of these ways.
    """

    ways: Ways
    mean_j: float
    variance_j2: float
    least_j: float | None = None


@dataclass(frozen=True)
class Outcome(Generic[Ways]):
    """The best ways by an objective.

    Attributes
    ----------
    best : Priced
        The best.
    mean : Priced
        Those of least mean energy.
    value : float
        The objective of the best.
    bound : float
        No ways have less of it, as far as every search found its cheapest ones.
    searches : int
        Number of prices that were searched.
    """

    best: Priced[Ways]
    mean: Priced[Ways]
    value: float
    bound: float
    searches: int

    def joined(self, other: Outcome[Ways], worth: Callable[[Priced[Ways]], float]) -> Outcome[Ways]:
        """Return the better of two outcomes of one objective, with what both say of all ways.

        `other`: of other searches; `worth`: what the better is chosen by. Result: with the larger bound of both.
        """
        better = min((self, other), key=lambda one: worth(one.best))
        bound = min(max(self.bound, other.bound), better.value)
        return replace(better, bound=bound, searches=self.searches + other.searches)


def least(
    aim: Aim, solve: Callable[[float], Priced[Ways]], *, worth: Callable[[Priced[Ways]], float] | None = None
) -> Outcome[Ways]:
    """Return the ways for which an objective is least.

    `aim`: the objective; `solve`: returns the cheapest ways at a price of variance [1/J]; `worth`: what the best of the
    ways found is chosen by; the objective itself by default. The first, those of least mean, win ties. Result: with its
    bound.
    """

    def _value(one: Priced[Ways]) -> float:
        return aim.value(one.mean_j, one.variance_j2)

    mean = solve(0.0)
    found, lines = [mean], [(0.0, _least_j(mean, 0.0))]
    while True:
        best = min(found, key=_value)
        bound, at = _bound(aim, lines, max(one.variance_j2 for one in found))
        if aim.is_close(_value(best), bound) or len(found) == MOST_SEARCHES:
            break
        price = aim.price(at[0], max(at[1], _LEAST_SHARE * best.variance_j2))
        if any(math.isclose(price, known, rel_tol=1e-3, abs_tol=1e-12) for known, _ in lines):
            break
        found.append(solve(price))
        lines.append((price, _least_j(found[-1], price)))
    chosen = min(found, key=worth or _value)
    return Outcome(chosen, mean, _value(chosen), min(bound, _value(chosen)), len(found))


def _least_j(one: Priced[Ways], price: float) -> float:
    return one.mean_j + price * one.variance_j2 if one.least_j is None else one.least_j


def _bound(aim: Aim, lines: list[tuple[float, float]], most_j2: float) -> tuple[float, tuple[float, float]]:
    """The least objective above all lines mean + price variance = least, and where that is."""
    price, least_j = np.array(lines).T
    crossing = [
        (least_j[i] - least_j[k]) / (price[i] - price[k])
        for i in range(len(lines))
        for k in range(i)
        if price[i] != price[k]
    ]
    corners = np.unique([0.0, most_j2, *(v for v in crossing if 0.0 < v < most_j2)])
    shares = np.linspace(0.0, 1.0, _BETWEEN, endpoint=False)
    tried = np.append((corners[:-1, None] + shares * np.diff(corners)[:, None]).ravel(), corners[-1])
    lowest = (least_j[:, None] - price[:, None] * tried).max(axis=0)  # (tried,) least mean at each variance
    values = [aim.value(float(m), float(v)) for m, v in zip(lowest, tried, strict=True)]
    k = int(np.argmin(values))
    return values[k], (float(lowest[k]), float(tried[k]))
