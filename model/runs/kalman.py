"""A Rauch-Tung-Striebel smoother of one quantity and its rate, with the noise of each sensor by maximum likelihood.

The quantity moves with a rate that changes at random: white noise of spectral density `q`. Sensors measure the quantity
or its rate. A spike weighs little: the errors of the smoother have the density of Student's t with `FREEDOM` degrees of
freedom, and the noise has the likelihood of Huber's density, because under Student's t one sensor tends to no noise.

References
----------
Rauch, Tung & Striebel 1965. Särkkä & Svensson 2023, Bayesian Filtering and Smoothing, chapters 7 and 16. Huber 1981,
Robust Statistics.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

FREEDOM = 4.0
"""Degrees of freedom of the errors: the usual choice for robust regression (Lange, Little & Taylor 1989)."""

_HUBER = 3.0  # standard deviations beyond which an innovation counts linearly: the usual gate
_UNKNOWN = 1e6  # variance before anything is measured
_PASSES = 4  # of reweighting; weights change by less than a tenth in the last
_BLOCKS, _BLOCK_ROWS = 5, 1000  # of a long log, whose noise is estimated from so much of it


@dataclass(frozen=True)
class Smoothed:
    """A quantity and its rate at every row.

    Attributes
    ----------
    value, rate : ndarray of float, (n,)
        Means.
    gain : ndarray of float, (n, 2, 2)
        Of the smoother, from each row to the next: with it errors of different rows covary.
    covariance : ndarray of float, (n, 2, 2)
        Of value and rate.
    """

    value: FloatArray
    rate: FloatArray
    covariance: FloatArray
    gain: FloatArray


@dataclass(frozen=True)
class Sensors:
    """What is measured at every row.

    Attributes
    ----------
    t : ndarray of float, (n,)
        Stamps [s], increasing.
    begins : ndarray of bool, (n,)
        True where nothing is known of the way from the row before.
    values : ndarray of float, (m, n)
        What each sensor says; NaN where it says nothing.
    variances : ndarray of float, (m, n)
        Of its errors, as far as they are known.
    weights : ndarray of float, (m, n)
        By which the unknown variance of a sensor is multiplied.
    of_rate : ndarray of bool, (m,)
        True for a sensor of the rate.
    period : float
        After which a value comes back, such as a full turn; infinite for a length.
    """

    t: FloatArray
    begins: NDArray[np.bool_]
    values: FloatArray
    variances: FloatArray
    weights: FloatArray
    of_rate: NDArray[np.bool_]
    period: float = math.inf

    def some(self, active: NDArray[np.bool_]) -> Sensors:
        """Return the rows that are active, or blocks of them where they are many.

        `active` (n,): which. Result: at these rows; a row after one that is left out begins a piece.
        """
        rows = np.flatnonzero(active)
        if rows.size > _BLOCKS * _BLOCK_ROWS:
            first = np.linspace(0, rows.size - _BLOCK_ROWS, _BLOCKS).astype(np.int64)
            rows = rows[np.unique((first[:, None] + np.arange(_BLOCK_ROWS)).ravel())]
        begins = self.begins[rows] | (np.diff(rows, prepend=-1) > 1)
        values, variances, weights = (part[:, rows] for part in (self.values, self.variances, self.weights))
        return Sensors(self.t[rows], begins, values, variances, weights, self.of_rate, self.period)

    def scaled(self, noise_sd: FloatArray) -> FloatArray:
        """Return the variance of every measurement.

        `noise_sd` (m,): standard deviation of each sensor's errors, beside those that are known. Result (m, n):
        variances.
        """
        return self.variances + self.weights * (noise_sd**2)[:, None]


def smooth(sensors: Sensors, noise_sd: FloatArray, q: float) -> Smoothed:
    """Return the quantity and its rate from all that was measured before and after.

    `sensors`: what is measured; `noise_sd` (m,): standard deviation of each sensor's errors, beside those that are
    known; `q`: spectral density of the noise that changes the rate. Result: with the weights of Student's t.
    """
    scale = sensors.scaled(noise_sd)
    variances = scale
    for k in range(_PASSES):
        value, rate, covariance, gain, _ = _pass(
            sensors.t, sensors.begins, sensors.values, variances, sensors.of_rate, sensors.period, q, k == 0, True
        )
        off = sensors.values - np.where(sensors.of_rate[:, None], rate, value)
        if math.isfinite(sensors.period):
            off = np.where(sensors.of_rate[:, None], off, off - sensors.period * np.round(off / sensors.period))
        known = np.where(sensors.of_rate[:, None], covariance[:, 1, 1], covariance[:, 0, 0])
        variances = scale * (FREEDOM + (off**2 + known) / scale) / (FREEDOM + 1.0)
    return Smoothed(value, rate, covariance, gain)


def likeliest(
    sensors: Sensors, active: NDArray[np.bool_], start: FloatArray, least: FloatArray, q: float
) -> tuple[FloatArray, float]:
    """Return the noise under which the measured values are most likely.

    `sensors`: what is measured; `active` (n,): rows in which something moves: rest says nothing of the noise of motion;
    `start`, `least` (m,): standard deviations to begin with, and the least ones: of rounding; `q`: spectral density to
    begin with. Result (ndarray of float, float): standard deviation of each sensor, and the spectral density.
    """
    from scipy.optimize import minimize

    few = sensors.some(active if active.sum() > 10 else np.ones(active.size, dtype=bool))
    known = np.isfinite(few.values).any(axis=1)

    def _of(logs: FloatArray) -> tuple[FloatArray, float]:
        sd = start.copy()
        sd[known] = np.exp(np.clip(logs[:-1], -12.0, 12.0))
        return np.maximum(sd, least), float(np.exp(np.clip(logs[-1], -25.0, 12.0)))

    def _loss(logs: FloatArray) -> float:
        sd, density = _of(logs)
        return -_pass(few.t, few.begins, few.values, few.scaled(sd), few.of_rate, few.period, density, True, False)[4]

    logs = np.log(np.append(np.maximum(start, least)[known], q))
    simplex = np.vstack([logs, logs + np.eye(logs.size)])
    found = minimize(
        _loss,
        logs,
        method="Nelder-Mead",
        options={"xatol": 0.05, "fatol": 0.1, "maxfev": 200, "initial_simplex": simplex},
    )
    return _of(found.x)


@njit(cache=True)
def _pass(t, begins, values, variances, of_rate, period, q, robust, back):
    """Filter forwards, and smooth backwards if `back`: means, covariances, gains and the log likelihood."""
    sensors, n = values.shape
    kept = n if back else 1
    a, b = np.zeros(kept), np.zeros(kept)
    cov, gain = np.zeros((kept, 2, 2)), np.zeros((kept, 2, 2))
    s = r = dt = 0.0
    p00 = p01 = p11 = 0.0
    total = 0.0
    for k in range(n):
        if begins[k]:
            s, r, p00, p01, p11 = 0.0, 0.0, _UNKNOWN, 0.0, _UNKNOWN
            for i in range(sensors):
                if not of_rate[i]:
                    j = k
                    while j < n and (j == k or not begins[j]) and np.isnan(values[i, j]):
                        j += 1
                    if j < n and not np.isnan(values[i, j]) and (j == k or not begins[j]):
                        s = values[i, j]
        else:
            dt = t[k] - t[k - 1]
            s += r * dt
            p00 += 2.0 * dt * p01 + dt * dt * p11 + q * dt * dt * dt / 3.0
            p01 += dt * p11 + q * dt * dt / 2.0
            p11 += q * dt
        for i in range(sensors):
            z = values[i, k]
            if np.isnan(z):
                continue
            noise = variances[i, k]
            off = z - (r if of_rate[i] else s)
            if not of_rate[i] and period < 1e9:
                off -= period * np.round(off / period)
            first = p11 if of_rate[i] else p00
            spread = first + noise
            square = off * off / spread
            if first < 0.01 * _UNKNOWN:
                size = math.sqrt(square)
                total -= 0.5 * math.log(spread) + (0.5 * square if size < _HUBER else _HUBER * (size - 0.5 * _HUBER))
            if robust:
                noise *= max(math.sqrt(square) / _HUBER, 1.0)
                spread = first + noise
            if of_rate[i]:
                g0, g1 = p01 / spread, p11 / spread
                p00 -= g0 * p01
                p01 -= g0 * p11
                p11 *= noise / spread
            else:
                g0, g1 = p00 / spread, p01 / spread
                p11 -= g1 * p01
                p01 *= noise / spread
                p00 *= noise / spread
            s += g0 * off
            r += g1 * off
        if back:
            a[k], b[k] = s, r
            cov[k, 0, 0], cov[k, 0, 1], cov[k, 1, 0], cov[k, 1, 1] = p00, p01, p01, p11
    if not back:
        return a, b, cov, gain, total
    for k in range(n - 2, -1, -1):
        if begins[k + 1]:
            continue
        dt = t[k + 1] - t[k]
        p00, p01, p11 = cov[k, 0, 0], cov[k, 0, 1], cov[k, 1, 1]
        f00 = p00 + 2.0 * dt * p01 + dt * dt * p11 + q * dt * dt * dt / 3.0
        f01 = p01 + dt * p11 + q * dt * dt / 2.0
        f11 = p11 + q * dt
        det = max(f00 * f11 - f01 * f01, 1e-15 * f00 * f11)  # rounding may leave nothing of the difference
        c00, c01, c10, c11 = p00 + dt * p01, p01, p01 + dt * p11, p11  # P F'
        g00, g01 = (c00 * f11 - c01 * f01) / det, (c01 * f00 - c00 * f01) / det
        g10, g11 = (c10 * f11 - c11 * f01) / det, (c11 * f00 - c10 * f01) / det
        ds, dr = a[k + 1] - (a[k] + b[k] * dt), b[k + 1] - b[k]
        a[k] += g00 * ds + g01 * dr
        b[k] += g10 * ds + g11 * dr
        d00, d01, d11 = cov[k + 1, 0, 0] - f00, cov[k + 1, 0, 1] - f01, cov[k + 1, 1, 1] - f11
        h00, h01 = g00 * d00 + g01 * d01, g00 * d01 + g01 * d11
        h10, h11 = g10 * d00 + g11 * d01, g10 * d01 + g11 * d11
        cov[k, 0, 0] = max(p00 + h00 * g00 + h01 * g01, 0.0)
        cov[k, 0, 1] = p01 + h00 * g10 + h01 * g11
        cov[k, 1, 0] = cov[k, 0, 1]
        cov[k, 1, 1] = max(p11 + h10 * g10 + h11 * g11, 0.0)
        gain[k, 0, 0], gain[k, 0, 1], gain[k, 1, 0], gain[k, 1, 1] = g00, g01, g10, g11
    return a, b, cov, gain, total
