"""Are the odds of routes right? They are checked on runs that had no part in them before they are shown."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.route_errors import LEVELS, stretches_of
from joulemap.model.energy.uncertainty import FEWEST, Spread, fit_spread

FloatArray = NDArray[np.float64]

_SAID = (0.05, 0.25, 0.5, 0.75, 0.95)  # probabilities of the curve
_MOST_FOLDS = 10  # a spread takes a second to fit


@dataclass(frozen=True, eq=False)
class Reliability:
    """Odds beside what happened."""

    # (n,): Probability that was given to no more energy than each stretch took: uniform where the odds are right
    below: FloatArray = field(repr=False)
    group: NDArray[np.int64] = field(repr=False)  # (n,): What each stretch was left out with
    factor: float  # By which scales are multiplied: 1 where the 80 % interval holds 80 % within the error of that share

    def as_dict(self) -> dict[str, Any]:
        """Return the curve and the coverage of intervals, JSON-able."""
        inside = {f"{100 * level:.0f}": float(np.mean(np.abs(self.below - 0.5) <= level / 2.0)) for level in LEVELS}
        curve = [[said, float(np.mean(self.below <= said))] for said in _SAID]
        return {"routes": int(self.below.size), "inside": inside, "curve": curve, "factor": self.factor}


def checked_spread(
    energy: FloatArray, predicted: FloatArray, std: FloatArray, run: NDArray[np.int64], group: NDArray[np.int64]
) -> tuple[Spread, Reliability | None]:
    """Fit a spread to held-out segments, and check it on groups of runs that had no part in it.

    `energy`, `predicted`, `std` (n,): measured and predicted energy of each segment, and its standard deviation by the
    model [J]; `run` (n,): of each segment, those of a run are in driving order; `group` (n,): what was left out
    together. Result: the spread of all of them, as wide as the check says; and the check, None where three groups are
    not there.

    Reference: Gneiting, Balabdaoui & Raftery 2007, "Probabilistic forecasts, calibration and sharpness".
    """
    spread = fit_spread(energy, predicted, std, run, group=group)
    names, number = np.unique(group, return_inverse=True)
    if names.size < 3:
        return spread, None
    fold, below, of = number % min(names.size, _MOST_FOLDS), [], []  # names that are neighbours are often alike
    for k in range(int(fold.max()) + 1):
        out = fold == k
        if (~out).sum() < FEWEST:
            continue
        other = fit_spread(energy[~out], predicted[~out], std[~out], run[~out], group=group[~out])
        for one in np.unique(run[out]):
            for stretch in stretches_of(np.flatnonzero(run == one)):
                below.append(_probability(other, energy[stretch], predicted[stretch], std[stretch]))
                of.append(number[stretch[0]])
    if not below:
        return spread, None
    probabilities, groups = np.array(below), np.array(of)
    factor = _widened(probabilities, groups)
    return spread.widened(factor), Reliability(probabilities, groups, factor)


def _probability(spread: Spread, energy: FloatArray, predicted: FloatArray, std: FloatArray) -> float:
    """Of no more energy than a stretch took."""
    from scipy.special import ndtr, stdtr

    scale, freedom = spread.along(predicted, spread.factor * std)
    away = float(energy.sum() - predicted.sum() - spread.bias * abs(predicted.sum()))
    steps = away / (float(scale[-1]) * np.sqrt(spread.skew if away > 0.0 else 1.0 / spread.skew))
    return float(ndtr(steps) if freedom is None else stdtr(freedom[-1], steps))


def _widened(below: FloatArray, group: NDArray[np.int64]) -> float:
    """By how much scales are too small, from the 80 % interval; 1 where it holds as much as it says."""
    from scipy.special import ndtri
    from scipy.stats import t as student

    names, number = np.unique(group, return_inverse=True)
    level = LEVELS[1]
    shares = np.bincount(number, weights=np.abs(below - 0.5) <= level / 2.0) / np.bincount(number)
    error = float(student.ppf(0.975, names.size - 1)) * float(shares.std(ddof=1)) / np.sqrt(names.size)
    if abs(float(shares.mean()) - level) <= error:
        return 1.0
    steps = np.abs(ndtri(np.clip(below, 1e-6, 1.0 - 1e-6)))
    weight = 1.0 / np.bincount(number)[number]  # groups count alike
    order = np.argsort(steps)
    at = np.searchsorted(np.cumsum(weight[order]), level * weight.sum())
    return float(steps[order][min(at, steps.size - 1)] / ndtri(0.5 + level / 2.0))
