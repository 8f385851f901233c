"""Of a track: turns between two places, the speed of the robot, and the integral of a power."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import wrap_angle
from joulemap.model.runs.reader import Run
from joulemap.model.runs.smoothing import SMOOTHING_S, smooth

FloatArray = NDArray[np.float64]

TURN_LIMITS_RADPS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.8)
"""Limits up to which a gentle turn counts how fast a robot turns."""


def turns_between(t: FloatArray, heading: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the heading change of segments, followed through every sample.

    `t` (m,): stamps [s]; `heading` (m,): at these stamps [rad]; `ends` (n, 2): fractional positions of p and q. Result:
    signed [rad], positive to the right, (n,); absolute, (n,); and absolute, where a rate counts only up to each of
    `TURN_LIMITS_RADPS`, (n, limits).
    """
    step, dt = wrap_angle(np.diff(heading)), np.diff(t)
    station = np.arange(t.size, dtype=np.float64)

    def _between(steps: FloatArray) -> FloatArray:
        total = np.concatenate([[0.0], np.cumsum(steps)])
        return np.interp(ends[:, 1], station, total) - np.interp(ends[:, 0], station, total)

    gentle = [_between(np.minimum(np.abs(step), limit * dt)) for limit in TURN_LIMITS_RADPS]
    return _between(step), _between(np.abs(step)), np.stack(gentle, axis=1)


def track_speeds(
    run: Run, good: NDArray[np.int64], piece: NDArray[np.int64], interval: float, track: FloatArray
) -> FloatArray:
    """Return the speed of the robot.

    `good` (m,): its rows with a usable fix; `piece` (m,): number of the piece between gaps; `interval`: the usual time
    between fixes [s]; `track` (m,): speed of the track [m/s]. Result (m,): speed [m/s]: the column `speed`, smoothed,
    where it agrees with the track; otherwise that of the track.
    """
    logged = run.extras.get("speed")
    if logged is None or np.isfinite(logged[good]).mean() < 0.8:
        return track
    known = np.isfinite(logged)
    recorded = np.interp(run.t[good], run.t[known], logged[known])
    if np.median(np.abs(recorded - track)) > 0.2 * float(np.median(track)):
        return track
    return smooth(run.t[good], recorded, recorded, piece, max(SMOOTHING_S, interval))[0]


def integral(t: FloatArray, power: FloatArray, at: FloatArray) -> FloatArray:
    """Integrate a piecewise linear power from the first stamp, exactly.

    `t`, `power` (n,): stamps [s] and values; `at` (m,): stamps to integrate to [s]. The result is (m,).
    """
    total = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(t))])
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
    there = np.interp(at, t, power)
    return total[k] + 0.5 * (power[k] + there) * (at - t[k])
