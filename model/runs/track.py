"""Of a track: turns between two places, the speed of the robot, and the integral of a power."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import wrap_angle
from joulemap.model.runs.run import Run
from joulemap.model.runs.smoothing import SMOOTHING_S, smooth

FloatArray = NDArray[np.float64]


def turns_between(heading: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the heading change of segments, followed through every sample.

    `heading` (m,): of every sample [rad]; `ends` (n, 2): fractional positions of p and q. Result: signed [rad],
    positive to the right, (n,); and absolute, (n,).
    """
    step = wrap_angle(np.diff(heading))
    station = np.arange(heading.size, dtype=np.float64)

    def _between(steps: FloatArray) -> FloatArray:
        total = np.concatenate([[0.0], np.cumsum(steps)])
        return np.interp(ends[:, 1], station, total) - np.interp(ends[:, 0], station, total)

    return _between(step), _between(np.abs(step))


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
