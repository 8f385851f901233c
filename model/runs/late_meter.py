"""What a meter says that is late, by what was drawn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from joulemap.model.runs.features import Features, FloatArray
from joulemap.model.runs.run import STOP_S


def read_late(rows: Features, energy: FloatArray, lag_s: float) -> FloatArray:
    """Return what a late meter says of each row.

    `energy` (n,): that each row took [J, or A s]. Result (n,): energy by a cubic spline, from one stop to the next,
    through what was drawn until the end of each row. In a stop the robot draws what it does in stationary intervals,
    which have their own energy.
    """
    out, still = energy.copy(), rows.standing
    took, stood = np.maximum(rows.duration_s, 1e-6), float(rows.duration_s[still].sum())
    idle = float(energy[still].sum()) / stood if stood > 0.0 else rows.robot.idle_power_w / rows.unit_j
    for run in np.unique(rows.run[~still]):
        driven = np.flatnonzero((rows.run == run) & ~still)
        for part in _between_stops(rows, driven):
            before, after = (
                energy[end] / took[end] if end == outermost else idle
                for end, outermost in ((part[0], driven[0]), (part[-1], driven[-1]))
            )
            out[part] = _late(took[part], energy[part], lag_s, before, after)
    return out


def _between_stops(rows: Features, driven: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Driven rows of one run, divided at its stops. Where the next row is further than it can be, rows are missing and
    the robot did not stop.
    """
    before, after = driven[:-1], driven[1:]
    pause_s = rows.clock_s[after] - rows.clock_s[before] - rows.duration_s[before]
    distance_m = np.hypot(rows.x[after] - rows.x[before], rows.y[after] - rows.y[before])
    stopped = (pause_s >= STOP_S) & (distance_m <= rows.length_m[before] + rows.length_m[after])
    return np.split(driven, np.flatnonzero(stopped) + 1)


def _late(took: FloatArray, energy: FloatArray, lag_s: float, before: float, after: float) -> FloatArray:
    """The same of rows that follow each other, (n,). before, after : power beyond their ends."""
    longer = [0, *range(took.size), -1]  # level at both ends
    ends, until = (np.append(0.0, np.cumsum(values[longer])) for values in (took, energy))
    drawn, first, last = CubicSpline(ends, until), ends[1], ends[-2]
    at = ends[1:-1] - lag_s
    beyond = before * np.minimum(at - first, 0.0) + after * np.maximum(at - last, 0.0)
    return np.diff(drawn(np.clip(at, first, last)) + beyond)
