"""Where a robot points, from all that a log has: its track, compass, the yaw of an IMU, gyro and wheel speeds.

One smoother (`joulemap.model.runs.kalman`) joins them. The direction of travel is a measurement of the heading, as good
as the velocity is known. A compass and a yaw say how much it turned from row to row: their zero and their drift do not
matter, and a jump is one spike. A gyro says the rate, and so do wheel speeds. The sense and the scale of a column are
those that agree best with the track. A column that explains the track's turns less well than none is not used.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.frames import heading_of, wrap_angle
from joulemap.model.runs.held_readings import between_readings
from joulemap.model.runs.kalman import Sensors, Smoothed, likeliest, smooth
from joulemap.model.runs.reckoning import sides_of
from joulemap.model.runs.run import Run

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

ANGLES = ("heading", "yaw")
"""Columns of angles [deg]; `yaw` has no stated zero or sense."""
RATES = ("yaw_rate", "gyro_z", "gyr_z", "angular_velocity_z", "wz", "turn_rate")
"""Columns of the rate of turning, in rad/s or deg/s, to either side."""

_SLIP_MPS = 0.02  # to begin with: across where the robot points
_LAG_S = 2.0  # over which turns are compared with the track: long beside its noise, short beside a manoeuvre
_LESS_COSINE = 0.05  # a column of noise of 18 degrees is not worse than none on a straight way
_BLANK_S = 1.0  # longest blank of a column that is bridged, or two and a half of its usual intervals
_LEAST_RATE = 1e-4  # rad/s, of rounding
_LEAST_NOISE_M = 1e-3  # of positions that are rounded to millimetres


@dataclass(frozen=True)
class Headings:
    """Where the robot points.

    Attributes
    ----------
    smoothed : Smoothed
        Heading [rad], not wrapped, and its rate [rad/s], at every row.
    columns : tuple of str
        Which were used beside the positions.
    """

    smoothed: Smoothed
    columns: tuple[str, ...]

    def turn_sd(self, ends: FloatArray) -> FloatArray:
        """Return the standard deviation of turned angles.

        `ends` (n, 2): fractional positions of both ends. Result (n,): in radians; errors at both ends covary.
        """
        rows = np.rint(ends).astype(np.int64)
        return np.sqrt(_turn_var(self.smoothed.covariance, self.smoothed.gain, rows[:, 0], rows[:, 1]))


@dataclass(frozen=True)
class Velocity:
    """Of smoothed positions.

    Attributes
    ----------
    east, north : ndarray of float, (m,)
        At every row of a track [m/s].
    noise_m : float
        Standard deviation of single positions.
    smoothing_s : float
        Over which they were smoothed, and over twice which errors are alike.
    """

    east: FloatArray
    north: FloatArray
    noise_m: float
    smoothing_s: float


def headings(run: Run, rows: NDArray[np.int64], begins: BoolArray, velocity: Velocity, active: BoolArray) -> Headings:
    """Return where the robot points at every row of its track.

    `run`: the run; `rows` (m,): rows of the run on its track; `begins` (m,): true where a piece begins; `velocity`: at
    these rows; `active` (m,): where the robot drives or turns: rest says nothing of the noise of motion. Result: at
    these rows.
    """
    t = run.t[rows]
    square = velocity.east**2 + velocity.north**2
    direction = heading_of(velocity.east, velocity.north)
    # as of two fixes so far apart: those of a receiver err alike over seconds, and averaging them gains nothing
    known_var = (max(velocity.noise_m, _LEAST_NOISE_M) / velocity.smoothing_s) ** 2
    clear = square > 4.0 * known_var  # two standard deviations from rest
    names, rates, variances = [], [], []
    for name, rate, known in _rates(run, rows, begins, direction, clear):
        names.append(name)
        rates.append(rate)
        variances.append(known)
    alike = np.maximum(
        2.0 * velocity.smoothing_s / np.maximum(np.diff(t, prepend=t[0]), 1e-6), 1.0
    )  # rows that share an error
    alike = np.where(begins, 1.0, alike)
    per = alike / np.where(clear, square, 1.0)
    ones = np.ones((len(rates), t.size))
    sensors = Sensors(
        t,
        begins,
        np.stack([np.where(clear, direction, np.nan), *rates]),
        np.vstack([known_var * per, ones * np.array(variances)[:, None]]),
        np.vstack([per, ones]),
        np.array([False] + [True] * len(rates)),
        math.pi if rates else 2.0 * math.pi,  # a robot that reverses points against its way
    )
    start = np.array([_SLIP_MPS, *(max(_jitter(rate), _LEAST_RATE) for rate in rates)])
    least = np.array([1e-3] + [_LEAST_RATE] * len(rates))
    noise, density = likeliest(sensors, active, start, least, 0.1)
    return Headings(smooth(sensors, noise, density), tuple(names))


def _rates(
    run: Run, rows: NDArray[np.int64], begins: BoolArray, direction: FloatArray, clear: BoolArray
) -> Iterator[tuple[str, FloatArray, float]]:
    """Columns that say how fast the robot turns, as rates [rad/s] clockwise."""
    t = run.t[rows]
    reference, known = direction, clear
    for name in ANGLES:
        if name in run.extras and (turned := _unwrapped(run, name, rows)) is not None:
            scale = _scale(t, turned, direction, clear, (1.0,) if name == "heading" else (1.0, -1.0))
            if scale is not None:
                yield name, scale * _central(t, turned, begins), 0.0
                if reference is direction:
                    reference, known = scale * turned, np.isfinite(turned)
    for name in RATES:
        column = run.extras.get(name)
        if column is not None and np.isfinite(column[rows]).mean() > 0.5:
            rate = np.interp(t, t[np.isfinite(column[rows])], column[rows][np.isfinite(column[rows])])
            rate = rate - _bias(rate, clear)
            scale = _scale(t, _summed(t, rate), reference, known, (1.0, -1.0, math.pi / 180.0, -math.pi / 180.0))
            if scale is not None:
                yield name, scale * rate, _drift_var(t, scale * _summed(t, rate), reference, known)
    sides = sides_of(run.extras)
    if sides is not None:
        differ = (sides[0] - sides[1])[rows]
        turned = _summed(t, differ)
        first, last = _spans(t, known)
        if first.size:
            way, rolled = wrap_angle(reference[last] - reference[first]), turned[last] - turned[first]
            if (rolled**2).sum() > 0:
                scale = float((way * rolled).sum() / (rolled**2).sum())
                if _scale(t, turned, reference, known, (scale,)) is not None:
                    yield "wheel speeds", scale * differ, _drift_var(t, scale * turned, reference, known)


def _bias(rate: FloatArray, clear: BoolArray) -> float:
    """What a gyro shows at rest; 0 where the robot never rests."""
    return float(np.median(rate[~clear])) if (~clear).sum() > 20 else 0.0


def _unwrapped(run: Run, name: str, rows: NDArray[np.int64]) -> FloatArray | None:
    """A column of angles [rad] at these rows, NaN in long blanks; None if it does not change."""
    known = np.flatnonzero(np.isfinite(run.extras[name]))
    if known.size < 3:
        return None
    angle = np.unwrap(np.radians(run.extras[name][known]))
    if np.ptp(angle) == 0:
        return None
    at, angle = run.t[known], between_readings(run.t[known], angle)[0]
    t = run.t[rows]
    step = np.diff(at)
    blank = step > max(_BLANK_S, 2.5 * float(np.median(step)))
    after = np.clip(np.searchsorted(at, t), 1, at.size - 1)
    lost = (blank[after - 1] & (t != at[after]) & (t != at[after - 1])) | (t < at[0]) | (t > at[-1])
    return np.where(lost, np.nan, np.interp(t, at, angle))


def _central(t: FloatArray, turned: FloatArray, begins: BoolArray) -> FloatArray:
    """The rate at each row, between the rows before and after; of one side at both ends of a piece."""
    n = t.size
    index = np.arange(n)
    before = np.where(begins, index, index - 1)
    after = np.where(np.append(begins[1:], True), index, index + 1)
    dt = t[after] - t[before]
    return np.where(dt > 0, (turned[after] - turned[before]) / np.where(dt > 0, dt, 1.0), np.nan)


def _summed(t: FloatArray, rate: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])


def _spans(t: FloatArray, clear: BoolArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last rows of spans of about `_LAG_S` at both ends of which the direction of travel is known."""
    first = np.arange(t.size)
    last = np.clip(np.searchsorted(t, t + _LAG_S), 0, t.size - 1)
    both = clear[first] & clear[last] & (last > first)
    return first[both], last[both]


def _scale(
    t: FloatArray, turned: FloatArray, direction: FloatArray, clear: BoolArray, scales: tuple[float, ...]
) -> float | None:
    """With which of these factors a column turns as the track; None if it does worse than no turning."""
    first, last = _spans(t, clear & np.isfinite(turned))
    if not first.size:
        return scales[0]
    way, said = direction[last] - direction[first], turned[last] - turned[first]
    agree = [float(np.mean(np.cos(way - scale * said))) for scale in scales]
    best = int(np.argmax(agree))
    return scales[best] if agree[best] > float(np.mean(np.cos(way))) - _LESS_COSINE else None


def _drift_var(t: FloatArray, turned: FloatArray, reference: FloatArray, known: BoolArray) -> float:
    """Variance of white noise in a rate that would make it disagree with a reference over seconds as it does."""
    first, last = _spans(t, known)
    if not first.size:
        return 0.0
    off = wrap_angle(reference[last] - reference[first] - turned[last] + turned[first])
    each = (t[last] - t[first]) / (last - first)
    return float(np.median(np.abs(off)) / 0.6745) ** 2 / float(np.median(each * (t[last] - t[first])))


def _jitter(rate: FloatArray) -> float:
    steps = np.abs(np.diff(rate[np.isfinite(rate)]))
    return float(np.median(steps)) if steps.size else 0.0


@njit(cache=True)
def _turn_var(covariance, gain, first, last):
    """Variance of the change from row to row: P_p + P_q - 2 Cov, where Cov is the product of the gains times P_q."""
    out = np.empty(first.size)
    for k in range(first.size):
        i, j = first[k], max(last[k], first[k])
        g0, g1 = 1.0, 0.0
        for row in range(i, j):
            g = gain[row]
            g0, g1 = g0 * g[0, 0] + g1 * g[1, 0], g0 * g[0, 1] + g1 * g[1, 1]
        both = g0 * covariance[j, 0, 0] + g1 * covariance[j, 1, 0]
        out[k] = max(covariance[i, 0, 0] + covariance[j, 0, 0] - 2.0 * both, 0.0)
    return out
