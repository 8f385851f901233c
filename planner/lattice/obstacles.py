"""Obstacles: ground that no part of the robot may be over, and whether its rectangle meets them on a straight leg.

They are kept on squares of a whole number to the cell, as small as those of the heightmap, so that a passage is judged
by the survey and not by the cells of the lattice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from joulemap.model.compiling import bare_njit
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot

MEETS = 8
"""`Blocked.OBSTACLE`: the one code of a cell that closes no leg by itself: the leg's own rectangle is judged."""
_LONGEST_MOVE_CELLS = 5
"""A grid move of three rows and three columns, and what is left of the cell in which it begins."""
_TOUCHING = 1e-6
"""Part of a square [squares] by which the rectangle is smaller, so that what only touches it does not stop it."""


class Closed(NamedTuple):
    """What closes legs beside slopes, as the pricing kernels take it.

    Attributes
    ----------
    codes : ndarray of uint8, (rows, cols)
        `Blocked` codes that hold for every heading.
    near : ndarray of bool, (rows, cols)
        Where the rectangle may meet an obstacle; (0, 0) where it may anywhere.
    room : ndarray of uint8, (R, C)
        As of `Obstacles`; (0, 0) where there are none.
    body : ndarray of float64, (6,)
        Squares to the cell, row and column of the first cell's corner, half of the width, and how far the rectangle
        reaches ahead of and behind the reference point [squares].
    """

    codes: NDArray[np.uint8]
    near: NDArray[np.bool_]
    room: NDArray[np.uint8]
    body: NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Obstacles:
    """The obstacles under a lattice or a window of it.

    Attributes
    ----------
    room : ndarray of uint8, (R, C)
        Number of squares, from this one to the east, that are known to be free: 0 on an obstacle.
    per_cell : int
        Squares along the side of a cell.
    row, col : int
        The square in the north-west corner of the lattice.
    growing : bool
        Whether `room` is still being read, so that nobody knows yet where no obstacle is near.
    """

    room: NDArray[np.uint8]
    per_cell: int
    row: int = 0
    col: int = 0
    growing: bool = False

    @classmethod
    def none(cls, frame: GridFrame, per_cell: int) -> Obstacles:
        """Those of a lattice without any.

        Parameters
        ----------
        frame : GridFrame
            Cells of the lattice.
        per_cell : int
            Squares along the side of a cell.

        Returns
        -------
        Obstacles
            With memory of its own.
        """
        return cls(room_east(np.zeros((frame.rows * per_cell, frame.cols * per_cell), dtype=np.bool_)), per_cell)

    def under(self, rows: int, cols: int) -> NDArray[np.uint8]:
        """The squares of a lattice of so many cells that begins here: a view.

        Parameters
        ----------
        rows, cols : int
            Cells of the lattice.

        Returns
        -------
        ndarray of uint8
            A part of `room`.
        """
        n = self.per_cell
        return self.room[self.row : self.row + rows * n, self.col : self.col + cols * n]

    def place(self, part: Obstacles, rows: slice, cols: slice) -> None:
        """Put in those of a part of the lattice.

        Parameters
        ----------
        part : Obstacles
            Of these cells alone, and perhaps of what lies around them.
        rows, cols : slice
            Where they lie in the lattice.
        """
        n, high, wide = self.per_cell, rows.stop - rows.start, cols.stop - cols.start
        self.room[rows.start * n : rows.stop * n, cols.start * n : cols.stop * n] = part.under(high, wide)

    def window(self, row0: int, col0: int) -> Obstacles:
        """Those under the lattice that begins at a cell.

        Parameters
        ----------
        row0, col0 : int
            The cell.

        Returns
        -------
        Obstacles
            It shares the room.
        """
        return replace(self, row=self.row + row0 * self.per_cell, col=self.col + col0 * self.per_cell)

    def near(self, shape: tuple[int, int], reach_cells: float) -> NDArray[np.bool_]:
        """The cells from which something that reaches so far may meet an obstacle or leave the map.

        Parameters
        ----------
        shape : tuple of int
            Rows and columns of cells.
        reach_cells : float
            How far it reaches from a place in the cell [cells].

        Returns
        -------
        ndarray of bool, (rows, cols)
            More cells than needed, never fewer.
        """
        n, margin = self.per_cell, math.ceil(reach_cells) + _LONGEST_MOVE_CELLS
        found = np.ones((shape[0] + 2 * margin, shape[1] + 2 * margin), dtype=np.bool_)
        row0, col0 = margin - self.row // n, margin - self.col // n  # of the first whole cell that is known
        rows, cols = self.room.shape[0] // n, self.room.shape[1] // n
        top, left = max(row0, 0), max(col0, 0)
        down, right = min(row0 + rows, found.shape[0]), min(col0 + cols, found.shape[1])
        if down > top and right > left:
            part = self.room[(top - row0) * n : (down - row0) * n, (left - col0) * n : (right - col0) * n]
            found[top:down, left:right] = (part == 0).reshape(down - top, n, right - left, n).any(axis=(1, 3))
        wide = maximum_filter(found, size=2 * margin + 1, mode="constant", cval=0)
        return np.ascontiguousarray(wide[margin : margin + shape[0], margin : margin + shape[1]])


def reach_m(robot: Robot) -> float:
    """Return how far the robot's rectangle reaches from its reference point, clearance included [m]."""
    return math.hypot(0.5 * robot.width_m + robot.clearance_m, max(sides_m(robot)))


def sides_m(robot: Robot) -> tuple[float, float]:
    """Return how far the rectangle reaches ahead of the reference point and behind it, clearance included [m]."""
    half = 0.5 * robot.length_m + robot.clearance_m
    return half + robot.centre_ahead_m, half - robot.centre_ahead_m


def closed_ground(codes: NDArray[np.uint8], obstacles: Obstacles | None, frame: GridFrame, robot: Robot) -> Closed:
    """Return what closes legs on a lattice."""
    if obstacles is None:
        return Closed(codes, np.zeros((0, 0), np.bool_), np.zeros((0, 0), np.uint8), np.zeros(6))
    squares = obstacles.per_cell / frame.resolution_m
    ahead, behind = (side * squares - _TOUCHING for side in sides_m(robot))
    half = (0.5 * robot.width_m + robot.clearance_m) * squares - _TOUCHING
    body = np.array([obstacles.per_cell, obstacles.row, obstacles.col, half, ahead, behind], dtype=np.float64)
    near = (
        np.zeros((0, 0), np.bool_)
        if obstacles.growing
        else obstacles.near(codes.shape, reach_m(robot) / frame.resolution_m)
    )
    return Closed(codes, near, obstacles.room, body)


def squares_per_cell(spacing_m: float, resolution_m: float) -> int:
    """Return into how many squares the side of a cell is cut, for squares no larger than those of the heightmap."""
    return max(1, math.ceil(spacing_m / resolution_m - 1e-6))


@njit(cache=True, nogil=True)
def room_east(closed):
    """Return `Obstacles.room` of a mask. closed : (R, C) bool."""
    rows, cols = closed.shape
    room = np.empty((rows, cols), dtype=np.uint8)
    for i in range(rows):
        free = 0
        for j in range(cols - 1, -1, -1):
            free = 0 if closed[i, j] else min(free + 1, 255)
            room[i, j] = free
    return room


@bare_njit(cache=True, nogil=True)
def any_closed(room, row0, row1, col0, col1):
    """Whether some square of rows row0..row1 and columns col0..col1, both included, is an obstacle."""
    for i in range(row0, row1 + 1):
        j = col0
        while j <= col1:
            free = room[i, j]
            if free == 0:
                return True
            j += free
    return False


@bare_njit(cache=True, nogil=True, error_model="numpy")
def meets(room, body, row0, col0, row1, col1, east, north, wider):
    """Whether the rectangle meets an obstacle, or leaves the map, on a straight leg.

    row0, col0, row1, col1 : ends of the leg [cells]; they may be one point. east, north : its heading. wider : how much
    further the rectangle reaches to every side [cells].
    """
    n = body[0]
    half, ahead, behind = body[3] + wider * n, body[4] + wider * n, body[5] + wider * n
    tail_row, tail_col = body[1] + (row0 + 0.5) * n + behind * north, body[2] + (col0 + 0.5) * n - behind * east
    nose_row, nose_col = body[1] + (row1 + 0.5) * n - ahead * north, body[2] + (col1 + 0.5) * n + ahead * east
    down, right = half * east, half * north
    rows = (tail_row + down, nose_row + down, nose_row - down, tail_row - down)
    cols = (tail_col + right, nose_col + right, nose_col - right, tail_col - right)
    first, last = math.floor(min(rows)), math.floor(max(rows))
    if first < 0 or last >= room.shape[0] or min(cols) < 0.0 or max(cols) >= room.shape[1]:
        return True
    for i in range(first, last + 1):
        low, high = np.inf, -np.inf
        for k in range(4):
            a_row, a_col, b_row, b_col = rows[k - 1], cols[k - 1], rows[k], cols[k]
            above, below = max(min(a_row, b_row), float(i)), min(max(a_row, b_row), i + 1.0)
            if above > below:
                continue
            if a_row == b_row:
                low, high = min(low, a_col, b_col), max(high, a_col, b_col)
                continue
            slope = (b_col - a_col) / (b_row - a_row)
            one, other = a_col + (above - a_row) * slope, a_col + (below - a_row) * slope
            low, high = min(low, one, other), max(high, one, other)
        if low <= high and any_closed(room, i, i, math.floor(low), min(math.floor(high), room.shape[1] - 1)):
            return True
    return False


@njit(cache=True, nogil=True)
def close_at_any_heading(closed, radius_m, spacing_m, codes):
    """Give the free cells whose circle meets an obstacle their code: the robot stands on it whatever its heading.

    radius_m : of the circle that lies inside the outline at every heading. codes : (rows, cols).
    """
    n = closed.body[0]
    reach = radius_m / spacing_m * n - _TOUCHING
    for i in range(codes.shape[0]):
        for j in range(codes.shape[1]):
            if codes[i, j] != 0 or not closed.near[i, j]:
                continue
            row, col = closed.body[1] + (i + 0.5) * n, closed.body[2] + (j + 0.5) * n
            first, last = max(math.floor(row - reach), 0), min(math.floor(row + reach), closed.room.shape[0] - 1)
            for r in range(first, last + 1):
                away = max(r - row, row - r - 1.0, 0.0)
                half = math.sqrt(max(reach * reach - away * away, 0.0))
                left, right = max(math.floor(col - half), 0), min(math.floor(col + half), closed.room.shape[1] - 1)
                if any_closed(closed.room, r, r, left, right):
                    codes[i, j] = MEETS
                    break


@njit(cache=True, nogil=True)
def close_by_heading(closed, east, north, codes):
    """Give the pairs of cell and heading whose rectangle meets an obstacle their code, where they are free.

    east, north : of each heading, (K,). codes : `Blocked` codes, (rows, cols, K).
    """
    for i in range(codes.shape[0]):
        for j in range(codes.shape[1]):
            if closed.near.size > 0 and not closed.near[i, j]:
                continue
            for k in range(east.size):
                if codes[i, j, k] == 0 and meets(closed.room, closed.body, i, j, i, j, east[k], north[k], 0.0):
                    codes[i, j, k] = MEETS


@njit(cache=True, nogil=True)
def close_moves(closed, offsets, energy):
    """Give moves on which the rectangle meets an obstacle no price. offsets : (N, 2). energy : (N, rows, cols)."""
    for n in range(offsets.shape[0]):
        down, right = offsets[n, 0], offsets[n, 1]
        length = math.sqrt(down * down + right * right)
        east, north = right / length, -down / length
        for i in range(energy.shape[1]):
            for j in range(energy.shape[2]):
                if (
                    (closed.near.size == 0 or closed.near[i, j])
                    and not math.isnan(energy[n, i, j])
                    and meets(closed.room, closed.body, i, j, i + down, j + right, east, north, 0.0)
                ):
                    energy[n, i, j] = np.nan
