"""The ground of a drive without positions: a straight strip to the north with the heights that the log has."""

from __future__ import annotations

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.frames import GridFrame
from joulemap.model.runs.held_readings import between_readings
from joulemap.model.runs.reader import Run
from joulemap.model.terrain.heightmap import Heightmap

_RESOLUTION_M = 1.0
_HALF_WIDTH_M = 4.0  # the square of 2 m of the widest network, turned, with room
_LEAST_SMOOTHING_M = 2.0
_STEP_SLOPE = 0.02  # a step of one unit of a rounded height is spread so far that it makes no steeper slope
_LONGEST_M = 2_000_000.0


def ground_of_profile(run: Run) -> Heightmap:
    """Return the strip on which a run without positions was driven.

    Parameters
    ----------
    run : Run
        With a distance as its `y`; the column `z` has its heights [m]. Without them the ground is level.

    Returns
    -------
    Heightmap
        Of cells of 1 m.

    Raises
    ------
    RunsError
        If the run has positions, or is too long.

    Notes
    -----
    Heights that are rounded to a step dz are smoothed over dz / 0.02 along the way, so that a step of the number is no
    step of the ground.
    """
    if run.placed:
        raise RunsError(f"run {run.name} has positions: give the heightmap on which it was driven", run=run.name)
    known = np.flatnonzero(np.isfinite(run.y))
    at = run.y[known]
    if np.ptp(at) > _LONGEST_M:
        raise RunsError(f"run {run.name} is {np.ptp(at) / 1e3:,.0f} km long, the limit is {_LONGEST_M / 1e3:,.0f} km")
    south, north = np.floor(at.min()) - _HALF_WIDTH_M, np.ceil(at.max()) + _HALF_WIDTH_M
    frame = GridFrame(-_HALF_WIDTH_M, float(north), _RESOLUTION_M, int(north - south), int(2 * _HALF_WIDTH_M))
    along = north - _RESOLUTION_M * (np.arange(frame.rows) + 0.5)
    heights = np.zeros(frame.rows)
    z = run.extras.get("z")
    if z is not None and np.isfinite(z[known]).sum() > 1:
        read = np.isfinite(z[known])
        heights = np.interp(along, *_rising(at[read], between_readings(run.t[known][read], z[known][read])[0]))
        steps = np.abs(np.diff(np.unique(z[known][read])))
        sigma = max(_LEAST_SMOOTHING_M, float(np.median(steps)) / _STEP_SLOPE if steps.size else 0.0)
        from scipy.ndimage import gaussian_filter1d

        heights = gaussian_filter1d(heights, sigma / _RESOLUTION_M, mode="nearest")
    strip = np.repeat(heights[:, None], frame.cols, axis=1).astype(np.float32)
    return Heightmap(strip, frame, f"the heights of {run.name}" if heights.any() else f"level ground for {run.name}")


def _rising(at: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of rows at one place the mean."""
    places, inverse = np.unique(at, return_inverse=True)
    return places, np.bincount(inverse, values) / np.bincount(inverse)
