"""Runs without a map: the ground is a straight strip to the north with the heights of the log, or level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from joulemap.model.errors import InputError, RunsError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.runs.arcs import segment_length
from joulemap.model.runs.held_readings import between_readings
from joulemap.model.runs.logs import read_log
from joulemap.model.runs.odometry import Odometry, flat_heightmap
from joulemap.model.runs.reader import run_of_table
from joulemap.model.runs.run import Run
from joulemap.model.runs.sites import Site
from joulemap.model.terrain.heightmap import Heightmap

_RESOLUTION_M = 1.0
_HALF_WIDTH_M = 4.0  # the square of 2 m of the widest network, turned, with room
_LEAST_SMOOTHING_M = 2.0
_STEP_SLOPE = 0.02  # a step of one unit of a rounded height is spread so far that it makes no steeper slope
_LONGEST_M = 2_000_000.0
_UNIFORM = 1.0 / math.sqrt(12.0)  # standard deviation of a uniform distribution over its width
MOST_SEGMENTS = 10_000
"""Setting: of long drives segments are as long as it takes for so many. A calibration takes some seconds for each of
its repetitions then, and the memory of its columns is 100 MB."""


def sites_without_map(
    files: Sequence[Path],
    robot: Robot,
    *,
    baseline_files: Sequence[Path] = (),
    test_files: Sequence[Path] = (),
    odometry: Odometry | None = None,
) -> list[Site]:
    """Return a site for each run without positions: the ground that its log describes.

    `files`: with a speed or a distance, `z` has the heights [m], and without it the ground is level.
    """
    tests = {file.resolve() for file in test_files}
    learned, baseline = ([f for f in some if f.resolve() not in tests] for some in (files, baseline_files))
    named = [*learned, *baseline, *test_files]
    kinds = np.repeat(np.arange(3), [len(learned), len(baseline), len(test_files)])
    runs = [_read(file, odometry) for file in named]
    length_m = None
    if odometry is None:
        total_m = sum(float(np.nanmax(run.y) - np.nanmin(run.y)) for run in runs)
        length_m = max([total_m / MOST_SEGMENTS, *map(segment_length, runs)], default=None)
    sites = []
    for kind, file, run in zip(kinds, named, runs, strict=True):
        ground = flat_heightmap([run]) if odometry is not None else ground_of_profile(run, length_m=length_m or 1.0)
        mine = [(file,) if kind == of else () for of in range(3)]
        sites.append(Site(ground, mine[0], robot, mine[1], mine[2], placed=False, odometry=odometry, length_m=length_m))
    return sites


def _read(file: Path, odometry: Odometry | None) -> Run:
    table = read_log(file, file.name, {})
    if odometry is None and ({"x", "y"} <= table.numbers.keys() or {"lat", "lon"} <= table.numbers.keys()):
        raise InputError(f"the run {file.name} has positions: give the heightmap on which it was driven")
    return run_of_table(table, name=file.name, odometry=odometry)


def ground_of_profile(run: Run, *, length_m: float = 1.0) -> Heightmap:
    """Return the strip on which a run without positions was driven.

    `run`: with a distance as its `y`, the column `z` has its heights [m].

    Heights that are rounded to a step dz are smoothed over dz / 0.02 along the way, so that a step of the number is no
    step of the ground; and over the length of a segment, whose slope is that in its middle.
    """
    if run.placed:
        raise RunsError.of_run(run.name, " has positions: give the heightmap on which it was driven")
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
        rounded_m = float(np.median(steps)) / _STEP_SLOPE if steps.size else 0.0
        sigma = max(_LEAST_SMOOTHING_M, rounded_m, _UNIFORM * length_m)
        from scipy.ndimage import gaussian_filter1d

        heights = gaussian_filter1d(heights, sigma / _RESOLUTION_M, mode="nearest")
    strip = np.repeat(heights[:, None], frame.cols, axis=1).astype(np.float32)
    return Heightmap(strip, frame, f"the heights of {run.name}" if heights.any() else f"level ground for {run.name}")


def _rising(at: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of rows at one place the mean."""
    places, inverse = np.unique(at, return_inverse=True)
    return places, np.bincount(inverse, values) / np.bincount(inverse)
