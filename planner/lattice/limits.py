"""Where the robot can be at all: slope, steps and unknown ground, from the heightmap around every cell."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.denoising import LEAST_NOISE_M
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.rows import columns_between, sample_row
from joulemap.model.threads import pieces, share_out
from joulemap.planner.lattice import Blocked

SQUARE_M = 1.0
"""Side of the square around a cell that is judged: the paper's patch."""

STEP_IN_NOISE = 7.5
"""A step of so many standard deviations of the noise is found in 75 to 100 % of the cells that it crosses: measured on
kerbs of 0.19 m and maps of 0.1 to 0.25 m (`tests/unit/test_denoising.py` has those of 0.1 m)."""

_ROWS_AT_ONCE = 32


def ground_limits(
    heightmap: Heightmap, frame: GridFrame, robot: Robot
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Return elevation, gradient and the blocked codes that hold for every heading.

    Returns `elevation` (rows, cols): at the cell centre [m]; `gradient` (rows, cols, 2): rise per metre to east and
    north of the least-squares plane through the square metre around the cell; `blocked` (rows, cols): `Blocked` codes.

    A step is what a wheel or the underside of the robot hits, either of

    - a rise within one wheel diameter (to whole pixels, so only maps finer than a wheel show it), along a row or a
      column of the heightmap, that exceeds the wheel radius and that neither the run before it nor the one after
      shares: a kerb, a wall or a ditch, but not a steep slope, which is limited by the grade;
    - ground that departs from the plane by more than the wheel diameter: a boulder, a post or a hole.
    """
    samples = int(np.clip(round(SQUARE_M / heightmap.resolution_m) + 1, 9, 21))
    x, y = frame.centres()
    row, _ = heightmap.frame.rowcol(0.0, y)
    _, col = heightmap.frame.rowcol(x, 0.0)
    diameter = 2.0 * robot.wheel_radius_m / heightmap.resolution_m
    elevation = np.empty(frame.shape, dtype=np.float32)
    gradient = np.full((*frame.shape, 2), np.nan, dtype=np.float32)
    blocked = np.zeros(frame.shape, dtype=np.uint8)
    codes = int(Blocked.OUTSIDE), int(Blocked.UNKNOWN), int(Blocked.STEP)
    share_out(
        lambda rows: _ground_limits(
            heightmap.heights,
            row[rows],
            col,
            heightmap.resolution_m,
            samples,
            int(diameter),
            robot.wheel_radius_m,
            codes,
            elevation[rows],
            gradient[rows],
            blocked[rows],
        ),
        pieces(frame.rows, _ROWS_AT_ONCE),
    )
    return elevation, gradient, blocked


def noise_warnings(noise_m: float, robot: Robot) -> list[str]:
    """Return what noise of a survey can hide from the limits."""
    if noise_m < LEAST_NOISE_M:
        return []
    said = (
        f"the map's heights are uncertain by about {1000.0 * noise_m:.0f} mm (standard deviation): they were smoothed, "
        "and bumps that this hides are not in the energies"
    )
    if STEP_IN_NOISE * noise_m > robot.wheel_radius_m:
        said += (
            f". Steps of up to {STEP_IN_NOISE * noise_m:.2g} m may be hidden, more than the wheel radius of "
            f"{robot.wheel_radius_m:g} m that {robot.name} can climb"
        )
    return [said]


@njit(cache=True, nogil=True)
def _ground_limits(heights, row, col, resolution_m, samples, run, max_step_m, codes, elevation, gradient, blocked):
    outside, unknown, step = codes
    rows, cols = row.size, col.size
    half = 0.5 * (samples - 1)
    pitch_m = SQUARE_M / (samples - 1)
    pixel = pitch_m / resolution_m
    reach = half * pixel
    offsets = (np.arange(samples) - half) * pitch_m  # to the east, or to the south [m]
    spread = (offsets**2).sum() * samples  # over the whole square [m2]
    edge = 0.5 + 1e-6
    centre = columns_between(col, heights.shape[1])
    squares = columns_between((col.reshape(-1, 1) + (np.arange(samples) - half) * pixel).ravel(), heights.shape[1])
    line, middle = np.empty(heights.shape[1]), np.empty(cols)
    z = np.empty((samples, cols * samples))
    for i in range(rows):
        sample_row(heights, row[i], centre, line, middle)
        for a in range(samples):  # a grows to the south
            sample_row(heights, row[i] + (a - half) * pixel, squares, line, z[a])
        for j in range(cols):
            elevation[i, j] = middle[j]
            if (
                row[i] - reach < -edge
                or row[i] + reach > heights.shape[0] - 1 + edge
                or col[j] - reach < -edge
                or col[j] + reach > heights.shape[1] - 1 + edge
            ):
                blocked[i, j] = outside
                continue
            mean, rise_east, rise_north = 0.0, 0.0, 0.0
            for a in range(samples):
                of = z[a, j * samples : (j + 1) * samples]
                total = 0.0
                for b in range(samples):
                    total += of[b]
                    rise_east += of[b] * offsets[b]
                mean += total
                rise_north -= total * offsets[a]
            rise_east /= spread
            rise_north /= spread
            mean /= samples * samples
            if math.isnan(rise_east):
                blocked[i, j] = unknown
                continue
            gradient[i, j, 0] = rise_east
            gradient[i, j, 1] = rise_north
            if run > 0 and _has_step(heights, row[i], col[j], reach, run, max_step_m):
                blocked[i, j] = step
                continue
            furthest = 0.0
            for a in range(samples):
                of = z[a, j * samples : (j + 1) * samples]
                for b in range(samples):
                    plane = mean + offsets[b] * rise_east - offsets[a] * rise_north
                    furthest = max(furthest, abs(of[b] - plane))
            if furthest > 2.0 * max_step_m:
                blocked[i, j] = step


@njit(cache=True)
def _has_step(heights, row, col, reach, run, max_step_m):
    """Whether some run of `run` pixels whose middle lies in the square around (row, col) is a step."""
    rows, cols = heights.shape
    middle = 0.5 * run
    slack = reach + 1e-6
    for axis in range(2):
        down, right = (run, 0) if axis == 0 else (0, run)
        first_row = max(int(math.ceil(row - slack - (middle if axis == 0 else 0.0))), 0)
        last_row = min(int(math.floor(row + slack - (middle if axis == 0 else 0.0))), rows - 1 - down)
        first_col = max(int(math.ceil(col - slack - (middle if axis == 1 else 0.0))), 0)
        last_col = min(int(math.floor(col + slack - (middle if axis == 1 else 0.0))), cols - 1 - right)
        for r in range(first_row, last_row + 1):
            for c in range(first_col, last_col + 1):
                rise = heights[r + down, c + right] - heights[r, c]
                if not abs(rise) > max_step_m:  # cheap, and false where a height is unknown
                    continue
                jump = abs(rise)
                if r - down >= 0 and c - right >= 0:
                    before = heights[r, c] - heights[r - down, c - right]
                    if not math.isnan(before):
                        jump = min(jump, abs(rise - before))
                if r + 2 * down < rows and c + 2 * right < cols:
                    after = heights[r + 2 * down, c + 2 * right] - heights[r + down, c + right]
                    if not math.isnan(after):
                        jump = min(jump, abs(rise - after))
                if jump > max_step_m:
                    return True
    return False
