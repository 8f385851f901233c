"""Where the robot can be at all: slope, steps and unknown ground, from the heightmap around every cell."""

from __future__ import annotations

import math
from typing import NamedTuple

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
from joulemap.planner.lattice.obstacles import (
    Obstacles,
    any_closed,
    close_at_any_heading,
    closed_ground,
    reach_m,
    room_east,
)
from joulemap.planner.lattice.steps import SQUARE_M, obstacles_under, obstructed

STEP_IN_NOISE = 7.5
"""A step of so many standard deviations of the noise is found in all cells where it lies between two pixels, however
short it is; one that is nine pixels long from five on, as `tests/bench/survey_steps.py` makes them."""

_ROWS_AT_ONCE = 32
_OUTSIDE, _UNKNOWN, _STEP = int(Blocked.OUTSIDE), int(Blocked.UNKNOWN), int(Blocked.STEP)


class _Ground(NamedTuple):
    """What is known of the ground."""

    heights: NDArray[np.float32]  # [m]; NaN where unknown
    room: NDArray[np.uint8]  # as of `Obstacles`, one square to the height; (0, 0) without obstacles
    resolution_m: float


class _Square(NamedTuple):
    """What of the ground around a cell is judged, and for whom."""

    side_m: float
    samples: int  # along its side
    wheel_m: float  # radius of a wheel
    reaches_beyond: bool  # whether the robot does: unknown ground is an obstacle then


class _Limits(NamedTuple):
    """What `ground_limits` finds, of some rows."""

    elevation: NDArray[np.float32]
    gradient: NDArray[np.float32]
    blocked: NDArray[np.uint8]
    beside: NDArray[np.bool_]


def ground_limits(
    heightmap: Heightmap, frame: GridFrame, robot: Robot
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8], Obstacles | None, NDArray[np.bool_]]:
    """Return elevation, gradient, the blocked codes that hold for every heading, obstacles, and the cells beside them.

    Returns `elevation` (rows, cols): at the cell centre [m]; `gradient` (rows, cols, 2): rise per metre to east and
    north of the least-squares plane through the square around the cell, of the ground that is joined to its middle
    without an obstacle between; `blocked` (rows, cols): `Blocked` codes; `obstacles`: what the outline must not meet,
    None where there is nothing of that kind; `beside` (rows, cols): whether one lies in the square around the cell.

    The square is a metre wide, or as wide as a wider robot. Ground in it that departs from the plane by more than the
    wheel diameter is a boulder, a post or a hole, which the robot cannot have between its wheels.
    """
    side_m = max(SQUARE_M, robot.width_m)
    samples = int(np.clip(round(side_m / heightmap.resolution_m) + 1, 9, 21))
    x, y = frame.centres()
    row, _ = heightmap.frame.rowcol(0.0, y)
    _, col = heightmap.frame.rowcol(x, 0.0)
    elevation = np.empty(frame.shape, dtype=np.float32)
    gradient = np.full((*frame.shape, 2), np.nan, dtype=np.float32)
    blocked = np.zeros(frame.shape, dtype=np.uint8)
    beside = np.zeros(frame.shape, dtype=np.bool_)
    steps = obstructed(heightmap, robot)
    room = np.zeros((0, 0), np.uint8) if steps is None else room_east(steps)
    ground = _Ground(heightmap.heights, room, heightmap.resolution_m)
    square = _Square(side_m, samples, robot.wheel_radius_m, reach_m(robot) > 0.5 * SQUARE_M)
    share_out(
        lambda rows: _ground_limits(
            ground, square, row[rows], col, _Limits(elevation[rows], gradient[rows], blocked[rows], beside[rows])
        ),
        pieces(frame.rows, _ROWS_AT_ONCE),
    )
    obstacles = obstacles_under(frame, steps, heightmap)
    if obstacles is not None:
        closed = closed_ground(blocked, obstacles, frame, robot)
        close_at_any_heading(closed, robot.width_m / 2.0 + robot.clearance_m, frame.resolution_m, blocked)
    return elevation, gradient, blocked, obstacles, beside


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


def size_warnings(ground: GridFrame, robot: Robot) -> list[str]:
    """Return whether the map is too coarse for the robot's outline."""
    if reach_m(robot) <= 0.5 * SQUARE_M or robot.width_m > ground.resolution_m:
        return []
    return [
        f"the map's cells of {ground.resolution_m:g} m are not smaller than {robot.name}, {robot.width_m:g} m wide: "
        f"its outline is not judged on them, only the {SQUARE_M:g} m square around its reference point"
    ]


@njit(cache=True, nogil=True)
def _ground_limits(ground, square, row, col, found):
    """Fill the limits of the cells at some fractional rows and columns of the heights."""
    heights, room, resolution_m = ground
    side_m, samples, wheel_m, reaches_beyond = square
    elevation, gradient, blocked, beside = found
    rows, cols = row.size, col.size
    half = 0.5 * (samples - 1)
    pitch_m = side_m / (samples - 1)
    pixel = pitch_m / resolution_m
    reach, least = half * pixel, 0.5 * SQUARE_M / resolution_m
    offsets = (np.arange(samples) - half) * pitch_m  # to the east, or to the south [m]
    spread = (offsets**2).sum() * samples  # over the whole square [m2]
    edge = 0.5 + 1e-6
    last_row, last_col = heights.shape[0] - 1, heights.shape[1] - 1
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
                row[i] - least < -edge
                or row[i] + least > last_row + edge
                or col[j] - least < -edge
                or col[j] + least > last_col + edge
            ):
                blocked[i, j] = _OUTSIDE
                continue
            first_row, first_col = max(math.ceil(row[i] - reach - edge), 0), max(math.ceil(col[j] - reach - edge), 0)
            end_row = min(math.floor(row[i] + reach + edge), last_row)
            end_col = min(math.floor(col[j] + reach + edge), last_col)
            if room.size > 0 and any_closed(room, first_row, end_row, first_col, end_col):
                window = first_row, end_row, first_col, end_col
                rise_east, rise_north, furthest = _plane_between(ground, row[i], col[j], window)
                gradient[i, j, 0] = rise_east
                gradient[i, j, 1] = rise_north
                beside[i, j] = True
                if not reaches_beyond and np.isnan(heights[first_row : end_row + 1, first_col : end_col + 1]).any():
                    blocked[i, j] = _UNKNOWN
                elif furthest > 2.0 * wheel_m:
                    blocked[i, j] = _STEP
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
                blocked[i, j] = _UNKNOWN
                continue
            gradient[i, j, 0] = rise_east
            gradient[i, j, 1] = rise_north
            furthest = 0.0
            for a in range(samples):
                of = z[a, j * samples : (j + 1) * samples]
                for b in range(samples):
                    plane = mean + offsets[b] * rise_east - offsets[a] * rise_north
                    furthest = max(furthest, abs(of[b] - plane))
            if furthest > 2.0 * wheel_m:
                blocked[i, j] = _STEP


@njit(cache=True)
def _plane_between(ground, row, col, window):
    """The plane through the ground of a square that is joined to its middle without an obstacle between.

    row, col : its middle. window : its first and last row, its first and last column.
    Returns its rise per metre to east and north, and how far the ground departs from it [m]; zeros where the middle is
    an obstacle, or the ground is too little for a plane.
    """
    heights, room, resolution_m = ground
    first_row, end_row, first_col, end_col = window
    high, wide = end_row - first_row + 1, end_col - first_col + 1
    seen = np.zeros((high, wide), dtype=np.bool_)
    stack = np.empty((high * wide, 2), dtype=np.int64)
    a = min(max(math.floor(row + 0.5 + 1e-6) - first_row, 0), high - 1)
    b = min(max(math.floor(col + 0.5 + 1e-6) - first_col, 0), wide - 1)
    count = 0
    if room[first_row + a, first_col + b] > 0 and not math.isnan(heights[first_row + a, first_col + b]):
        stack[0, 0], stack[0, 1], seen[a, b], count = a, b, True, 1
    n = taken = 0
    sums = np.zeros(9)  # of x, y, z, xx, xy, yy, xz, yz; x to the east and y to the north [m]
    while taken < count:
        a, b = stack[taken, 0], stack[taken, 1]
        taken += 1
        x, y = (first_col + b - col) * resolution_m, (row - first_row - a) * resolution_m
        z = np.float64(heights[first_row + a, first_col + b])
        n += 1
        sums[0] += x
        sums[1] += y
        sums[2] += z
        sums[3] += x * x
        sums[4] += x * y
        sums[5] += y * y
        sums[6] += x * z
        sums[7] += y * z
        for k in range(4):
            to_a, to_b = a + (k == 0) - (k == 1), b + (k == 2) - (k == 3)
            if not (0 <= to_a < high and 0 <= to_b < wide) or seen[to_a, to_b]:
                continue
            seen[to_a, to_b] = True
            r, c = first_row + to_a, first_col + to_b
            if room[r, c] > 0 and not math.isnan(heights[r, c]):
                stack[count, 0], stack[count, 1] = to_a, to_b
                count += 1
    if n < 3:
        return 0.0, 0.0, 0.0
    x, y, z = sums[0] / n, sums[1] / n, sums[2] / n
    xx, xy, yy = sums[3] / n - x * x, sums[4] / n - x * y, sums[5] / n - y * y
    xz, yz = sums[6] / n - x * z, sums[7] / n - y * z
    spread = xx * yy - xy * xy
    if not spread > 1e-3 * (0.5 * resolution_m) ** 4:  # a single line of heights says nothing of the slope across it
        return 0.0, 0.0, 0.0
    rise_east, rise_north = (xz * yy - yz * xy) / spread, (yz * xx - xz * xy) / spread
    furthest = 0.0
    for k in range(count):
        r, c = first_row + stack[k, 0], first_col + stack[k, 1]
        plane = z + ((c - col) * resolution_m - x) * rise_east + ((row - r) * resolution_m - y) * rise_north
        furthest = max(furthest, abs(heights[r, c] - plane))
    return rise_east, rise_north, furthest
