"""Where the robot can stand at all: slope, steps and unknown ground, read off the heightmap around every cell."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from model.frames import GridFrame
from model.robot import Robot
from model.terrain.heightmap import Heightmap, bilinear
from planner.lattice import Blocked

SQUARE_M = 1.0
"""Side of the square around a cell that is judged: the paper's patch."""


def ground_limits(
    heightmap: Heightmap, frame: GridFrame, robot: Robot
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Elevation, gradient and heading-free blocked codes of every cell of `frame`.

    elevation : (rows, cols) float32 [m] at the centre. gradient : (rows, cols, 2) float32, the least-squares plane
    through the square metre around the cell, rise per metre to east and north. blocked : (rows, cols) uint8.
    A step is a height jump over at most one wheel radius, after the plane is taken out, that exceeds the wheel radius
    (a wheel meets a wall higher than its own axle).
    """
    samples = int(np.clip(round(SQUARE_M / heightmap.resolution_m) + 1, 9, 21))
    pitch_m = SQUARE_M / (samples - 1)
    x, y = frame.centres()
    row, _ = heightmap.frame.rowcol(0.0, y)
    _, col = heightmap.frame.rowcol(x, 0.0)
    lag = max(1, int(robot.wheel_radius_m / pitch_m))
    return _ground_limits(
        heightmap.heights, row, col, heightmap.resolution_m, samples, lag, pitch_m, robot.wheel_radius_m,
        int(Blocked.OUTSIDE), int(Blocked.UNKNOWN), int(Blocked.STEP),
    )  # fmt: skip


@njit(cache=True, parallel=True)
def _ground_limits(
    heights, row, col, resolution_m, samples, lag, pitch_m, max_step_m, outside, unknown, step
):  # fmt: skip
    rows, cols = row.size, col.size
    elevation = np.full((rows, cols), np.nan, dtype=np.float32)
    gradient = np.full((rows, cols, 2), np.nan, dtype=np.float32)
    blocked = np.zeros((rows, cols), dtype=np.uint8)
    half = 0.5 * (samples - 1)
    pixel = pitch_m / resolution_m
    reach = half * pixel
    spread = 0.0  # sum of squared offsets along one axis, over the whole square [m2]
    for a in range(samples):
        spread += ((a - half) * pitch_m) ** 2 * samples
    edge = 0.5 + 1e-6
    for i in prange(rows):
        z = np.empty((samples, samples))
        for j in range(cols):
            elevation[i, j] = bilinear(heights, row[i], col[j])
            if (
                row[i] - reach < -edge or row[i] + reach > heights.shape[0] - 1 + edge
                or col[j] - reach < -edge or col[j] + reach > heights.shape[1] - 1 + edge
            ):  # fmt: skip
                blocked[i, j] = outside
                continue
            rise_east = 0.0
            rise_north = 0.0
            for a in range(samples):  # a grows to the south
                for b in range(samples):
                    h = bilinear(heights, row[i] + (a - half) * pixel, col[j] + (b - half) * pixel)
                    z[a, b] = h
                    rise_east += h * (b - half) * pitch_m
                    rise_north -= h * (a - half) * pitch_m
            rise_east /= spread
            rise_north /= spread
            if math.isnan(rise_east):
                blocked[i, j] = unknown
                continue
            gradient[i, j, 0] = rise_east
            gradient[i, j, 1] = rise_north
            highest = 0.0
            for a in range(samples):
                for b in range(samples):
                    for k in range(1, lag + 1):
                        if b + k < samples:
                            highest = max(highest, abs(z[a, b + k] - z[a, b] - rise_east * k * pitch_m))
                        if a + k < samples:
                            highest = max(highest, abs(z[a + k, b] - z[a, b] + rise_north * k * pitch_m))
            if highest > max_step_m:
                blocked[i, j] = step
    return elevation, gradient, blocked
