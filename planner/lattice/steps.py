"""Which heights no part of the robot may be over: steps, and for a large robot unknown ground and walls."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.lattice.obstacles import Obstacles, reach_m, room_east, squares_per_cell

SQUARE_M = 1.0
"""Side of the square around a cell that is judged whatever the robot's outline: the paper's patch."""


def shows_obstacles(cells_m: float, robot: Robot) -> bool:
    """Return whether a map of such cells can show what the robot's outline must not meet."""
    return 2.0 * robot.wheel_radius_m >= cells_m or _is_large(cells_m, robot)


def _is_large(cells_m: float, robot: Robot) -> bool:
    """Whether the outline reaches beyond the square that is judged anyway, on a map that shows so much."""
    return reach_m(robot) > 0.5 * SQUARE_M and robot.width_m > cells_m


def obstructed(heightmap: Heightmap, robot: Robot) -> NDArray[np.bool_] | None:
    """Return which heights are obstacles to the robot: (rows, cols), or None where none is and none matters.

    A step is a rise along a row or a column of the heightmap, within one wheel diameter (to whole pixels, at least two:
    a kerb inside a cell is two rises), that exceeds the wheel radius and that neither the run before it nor the one
    after shares: not a steep slope, which the grade limits. Its obstacle is the higher pixel of its steepest rise.

    Limits are judged in the square metre around a cell whatever the outline. For a robot that reaches further, unknown
    ground is an obstacle too, and where cells are wider than its wheels, so is a rise from one to the next that is
    steeper than the greatest grade.
    """
    cells_m, radius_m = heightmap.resolution_m, robot.wheel_radius_m
    run = max(int(2.0 * radius_m / cells_m), 2) if 2.0 * radius_m >= cells_m else 0
    large = _is_large(cells_m, robot)
    least_m = radius_m
    if large and run == 0:
        run, least_m = 1, max(radius_m, cells_m * math.tan(math.radians(robot.max_grade_deg)))
    found = np.zeros(heightmap.heights.shape, dtype=np.bool_)
    if run > 0:
        _mark_steps(heightmap.heights, run, np.float32(least_m), found)
    if large:
        found |= np.isnan(heightmap.heights)
    return found if large or found.any() else None


@njit(cache=True, nogil=True)
def _mark_steps(heights, run, least_m, found):
    rows, cols = heights.shape
    for axis in range(2):
        down, right = (run, 0) if axis == 0 else (0, run)
        one_down, one_right = (1, 0) if axis == 0 else (0, 1)
        for r in range(rows - down):
            for c in range(cols - right):
                rise = heights[r + down, c + right] - heights[r, c]
                if not abs(rise) > least_m:  # false where a height is unknown
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
                if not jump > least_m:
                    continue
                steepest, at = np.float32(0.0), 0
                for k in range(run):
                    one = heights[r + (k + 1) * one_down, c + (k + 1) * one_right]
                    one -= heights[r + k * one_down, c + k * one_right]
                    if abs(one) > abs(steepest):
                        steepest, at = one, k
                if steepest > 0.0:  # the higher of the two
                    at += 1
                found[r + at * one_down, c + at * one_right] = True


def obstacles_under(cells: GridFrame, found: NDArray[np.bool_] | None, heightmap: Heightmap) -> Obstacles | None:
    """Return obstacles on the squares of a lattice's cells and of what is known around them; None where none matters.

    A square is an obstacle if a pixel of `found`, (rows, cols) of the heightmap, or a cell of a layer covers a part of
    it.
    """
    heights, layers = heightmap.frame, heightmap.layers
    if found is None and not layers.closing:
        return None
    n = squares_per_cell(cells.resolution_m, min(heights.resolution_m, layers.finest_m))
    ratio = heights.resolution_m * n / cells.resolution_m  # squares along a pixel
    north, west = (
        (heights.bounds[3] - cells.bounds[3]) / cells.resolution_m * n,
        (cells.bounds[0] - heights.bounds[0]) / cells.resolution_m * n,
    )
    row, col = (n * max(math.floor(distance / n + 1e-6), 0) for distance in (north, west))
    rows = row + n * max(math.floor((heights.rows * ratio - north) / n + 1e-6), cells.rows)
    cols = col + n * max(math.floor((heights.cols * ratio - west) / n + 1e-6), cells.cols)
    square_m = cells.resolution_m / n
    closed = layers.closed_on(
        GridFrame(cells.west_m - col * square_m, cells.north_m + row * square_m, square_m, rows, cols)
    )
    if found is None:
        pass
    elif ratio == 1.0 and north == row and west == col:
        closed |= found[:rows, :cols]
    else:
        _cover(found, row - north, col - west, ratio, closed)
    return Obstacles(room_east(closed), n, row, col)


@njit(cache=True, nogil=True)
def _cover(found, row, col, ratio, closed):
    for r in range(found.shape[0]):
        top = max(math.floor(row + r * ratio + 1e-6), 0)
        end = min(max(math.ceil(row + (r + 1) * ratio - 1e-6), 0), closed.shape[0])
        for c in range(found.shape[1]):
            if found[r, c]:
                left = max(math.floor(col + c * ratio + 1e-6), 0)
                closed[top:end, left : max(math.ceil(col + (c + 1) * ratio - 1e-6), 0)] = True
