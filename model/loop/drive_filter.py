"""A Kalman filter that learns while driving: what differs between runs, for the whole of a run and for a stretch of it.

    energy_i = predicted_i + x_i u + predicted_i a_i + s_i e_i,    a_i = phi a_(i-1) + noise

`x` are columns of causes [J], `u` their coefficients in this run: a random level and random slopes as in the
calibration's mixed model, with the variances of `DrivePrior`; `a` a level that passes with the place; `s` the standard
deviation of a metre. The estimate of `u` after all rows is generalised least squares with that prior.

Reference: Harvey 1989, "Forecasting, Structural Time Series Models and the Kalman Filter", chapter 3. Huber 1964.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import ModelError

FloatArray = NDArray[np.float64]

CAUSES = ("level", "ground", "slope", "power")
"""What may differ in a whole run, each as a share: of all energy, of the rolling resistance, of the weight that is
lifted, and of the power at rest."""
OUTLIER = 3.0
"""Standard deviations beyond which a metre counts less (Huber's weights): 1 in 370 of a normal variable."""
_LIMIT, _LIMITED_STD = 1.345, 0.8426
"""Of Huber (1964), and the standard deviation of a normal variable that is limited so."""


@dataclass(frozen=True)
class DrivePrior:
    """What is known of a run before it is driven.

    Attributes
    ----------
    causes : tuple of float
        Standard deviation between runs of the coefficient of each of `CAUSES`.
    passing : float
        Standard deviation of the level of a stretch, as a share of the energy.
    passing_m : float
        Distance over which that level loses its correlation [m].
    noise : float
        Factor on the standard deviations of metres.
    freedom : float or None
        Degrees of freedom of Student's t of forecasts; None for a normal distribution.
    width : float
        Factor on the scale of forecasts, so that intervals hold what they say.
    change_std : float
        By which limited innovations are measured, so that alarms are as rare on runs without a change as stated.
    """

    causes: tuple[float, ...]
    passing: float = 0.0
    passing_m: float = 20.0
    noise: float = 1.0
    freedom: float | None = None
    width: float = 1.0
    change_std: float = 1.0

    def __post_init__(self) -> None:
        sizes = (*self.causes, self.passing)
        if len(self.causes) != len(CAUSES) or not all(math.isfinite(size) and size >= 0.0 for size in sizes):
            raise ModelError(f"a drive needs {len(CAUSES) + 1} standard deviations of at least 0, got {sizes}")
        for name in ("passing_m", "noise", "width", "change_std"):
            if not getattr(self, name) > 0.0:
                raise ModelError(f"{name} of a drive must be positive, got {getattr(self, name)}")

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers, JSON-able."""
        return asdict(self) | {"causes": list(self.causes)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> DrivePrior:
        """Make a prior of what `as_dict` wrote."""
        try:
            return cls(**{**values, "causes": tuple(values["causes"])})
        except (TypeError, KeyError) as error:
            raise ModelError(f"the model has no valid prior of drives: {error!r}") from error

    @property
    def variances(self) -> FloatArray:
        """Of the coefficients and, last, of the level of a stretch, (q,)."""
        return np.square(np.array([*self.causes, self.passing]))

    @property
    def kept(self) -> FloatArray:
        """Share of each of these that remains after a metre, (q,)."""
        return np.array([*[1.0] * len(CAUSES), math.exp(-1.0 / self.passing_m)])

    def rows(self, columns: FloatArray) -> FloatArray:
        """Return what the energy of metres is of these, (n, q) [J], of columns (n, k) [J]; the first is the energy."""
        return np.column_stack([columns, columns[:, 0]])


class DriveFilter:
    """What is known of a run after some metres of it: mean (q,) and covariance (q, q) of the coefficients."""

    def __init__(self, prior: DrivePrior) -> None:
        self.prior = prior
        self._variances, self._kept = prior.variances, prior.kept
        self.mean, self.covariance = np.zeros(self._kept.size), np.diag(self._variances)

    def learn(
        self, columns: FloatArray, measured_j: FloatArray, std_j: FloatArray, length_m: FloatArray | None = None
    ) -> FloatArray:
        """Learn from rows in driving order: columns (n, k), measured energy (n,), standard deviations (n,) [J], and
        lengths (n,), a metre each by default.

        Result (n,): standardised innovations, independent and of variance 1 where the model holds.
        """
        return _learn(
            self.prior.rows(columns),
            measured_j - columns[:, 0],
            np.square(self.prior.noise * std_j),
            self._variances,
            self._kept,
            np.ones(len(columns)) if length_m is None else length_m,
            self.mean,
            self.covariance,
        )

    def widen(self) -> None:
        """Forget how sure the estimate is, but not the estimate: after a change everything may be as different as
        between runs.
        """
        self.covariance = np.diag(np.maximum(np.diag(self.covariance), self._variances))


def limited(steps: FloatArray) -> FloatArray:
    """Return innovations (n,) that are limited by Huber's function, so that one wild reading is no change; of variance
    1 where they were normal.
    """
    return np.clip(steps, -_LIMIT, _LIMIT) / _LIMITED_STD


@njit(cache=True)
def _learn(
    rows: FloatArray,
    away_j: FloatArray,
    noise_j2: FloatArray,
    variances: FloatArray,
    kept_per_m: FloatArray,
    length_m: FloatArray,
    mean: FloatArray,
    covariance: FloatArray,
) -> FloatArray:
    """Innovations (n,); `mean` and `covariance` change in place."""
    n, q = rows.shape
    steps, gain = np.empty(n), np.empty(q)
    for i in range(n):
        kept = kept_per_m ** length_m[i]
        for a in range(q):
            mean[a] *= kept[a]
            for b in range(q):
                covariance[a, b] *= kept[a] * kept[b]
            covariance[a, a] += (1.0 - kept[a] * kept[a]) * variances[a]
        variance, expected = noise_j2[i] + 1e-300, 0.0
        for a in range(q):
            expected += rows[i, a] * mean[a]
            gain[a] = 0.0
            for b in range(q):
                gain[a] += covariance[a, b] * rows[i, b]
            variance += rows[i, a] * gain[a]
        away = away_j[i] - expected
        steps[i] = away / math.sqrt(variance)
        weight = min(1.0, OUTLIER / max(abs(steps[i]), 1e-300))  # as if its variance were larger by the inverse
        for a in range(q):
            mean[a] += weight * gain[a] * away / variance
            for b in range(q):
                covariance[a, b] -= weight * gain[a] * gain[b] / variance
    return steps


@dataclass(frozen=True, eq=False)
class Ahead:
    """What the energy of the rest of n metres depends on, at the start of each of them and at the end.

    Attributes
    ----------
    predicted_j : ndarray of float, (n + 1,)
        Predicted energy [J].
    of_state : ndarray of float, (n + 1, q)
        Of the coefficients and of the level of the stretch that was just driven [J].
    later_j2 : ndarray of float, (n + 1,)
        Variance of what no metre before has seen [J2].
    """

    predicted_j: FloatArray
    of_state: FloatArray
    later_j2: FloatArray

    @classmethod
    def of(cls, prior: DrivePrior, columns: FloatArray, std_j: FloatArray) -> Ahead:
        """Sum up metres: columns (n, k) and standard deviations (n,) [J]."""
        noise = np.square(prior.noise * std_j)
        of_state, later = _summed(prior.rows(columns), noise, prior.variances, prior.kept)
        return cls(np.append(np.cumsum(columns[::-1, 0])[::-1], 0.0), of_state, later)

    def energy(self, at: float, known: DriveFilter) -> tuple[float, float]:
        """Return the energy from a place, in metres from the start, to the end [J], and its scale [J]."""
        k = min(int(at), len(self.later_j2) - 1)
        share, after = at - k, min(k + 1, len(self.later_j2) - 1)

        def _between(values: FloatArray) -> FloatArray:
            return np.asarray((1.0 - share) * values[k] + share * values[after])

        of = _between(self.of_state)
        mean = float(_between(self.predicted_j) + of @ known.mean)
        variance = float(of @ known.covariance @ of + _between(self.later_j2))
        return mean, known.prior.width * math.sqrt(max(variance, 0.0))


@njit(cache=True)
def _summed(
    rows: FloatArray, noise_j2: FloatArray, variances: FloatArray, kept: FloatArray
) -> tuple[FloatArray, FloatArray]:
    n, q = rows.shape
    of_state, later, carried = np.zeros((n + 1, q)), np.zeros(n + 1), np.zeros(q)
    for i in range(n - 1, -1, -1):
        later[i] = later[i + 1] + noise_j2[i]
        for a in range(q):
            carried[a] = rows[i, a] + kept[a] * carried[a]
            of_state[i, a] = kept[a] * carried[a]
            later[i] += carried[a] * carried[a] * (1.0 - kept[a] * kept[a]) * variances[a]
    return of_state, later
