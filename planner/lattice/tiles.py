"""How a cost lattice is cut into tiles, and what of the heightmap each of them needs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.model.ranges import HEADINGS
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.windows import Ground, window_without_noise

TILE_CELLS = 256
"""Side of a tile [cells] unless its heights would be too many; a lattice on disk has one chunk per tile."""

_TILE_HEIGHTS = 64_000_000
_LEAST_CELLS = 16
MODEL_REACH_M = 2.0
"""A model reads the square of at most 2 m around a place, turned by any heading."""
_REACH_PIXELS = 4  # and interpolates


@dataclass(frozen=True)
class Tiling:
    """The cells of a lattice in square tiles, row by row from the north-west.

    Attributes
    ----------
    frame : GridFrame
        Of the whole lattice.
    headings : int
        Number of heading bins.
    side : int
        Cells along a tile; fewer at the southern and eastern edge.
    """

    frame: GridFrame
    headings: int
    side: int

    @classmethod
    def of(cls, ground: GridFrame, *, spacing_m: float, headings: int, side: int | None = None) -> Tiling:
        """Return the tiles of a lattice over a heightmap; the same on every machine.

        `side`: cells along a tile, chosen from the heightmap's resolution where None.
        """
        low, high = int(HEADINGS.low), int(HEADINGS.high)
        if headings not in HEADINGS:
            raise InputError(
                f"headings must lie in {low}..{high}, got {headings}", headings=headings, limit=[low, high]
            )
        frame = ground.respaced(spacing_m)
        if side is None:
            side, pixels = TILE_CELLS, spacing_m / ground.resolution_m
            while (side * pixels) ** 2 > _TILE_HEIGHTS and side > _LEAST_CELLS:
                side //= 2
        return cls(frame, headings, side)

    def __len__(self) -> int:
        return -(-self.frame.rows // self.side) * -(-self.frame.cols // self.side)

    def __iter__(self) -> Iterator[tuple[slice, slice]]:
        return (self[number] for number in range(len(self)))

    @property
    def values(self) -> int:
        """Number of values of the lattice: rows * cols * headings."""
        return self.frame.rows * self.frame.cols * self.headings

    def __getitem__(self, number: int) -> tuple[slice, slice]:
        """Return (rows, cols) of a tile."""
        if not 0 <= number < len(self):
            raise IndexError(number)
        down, right = divmod(number, -(-self.frame.cols // self.side))
        return (
            slice(down * self.side, min((down + 1) * self.side, self.frame.rows)),
            slice(right * self.side, min((right + 1) * self.side, self.frame.cols)),
        )


def ground_of(ground: Ground, cells: GridFrame, robot: Robot) -> Heightmap:
    """Return the heights that some cells of a lattice depend on.

    Result: the expected heights of the cells and of a margin around them, without the noise of the survey.

    A model reads the square around a place and what lies under the robot there; limits reach as far as a wheel rolls
    beyond the square.
    """
    reach = MODEL_REACH_M + robot.length_m + robot.width_m + 6.0 * robot.wheel_radius_m
    reach += 2.0 * robot.clearance_m + abs(robot.centre_ahead_m)
    more = reach / ground.frame.resolution_m + _REACH_PIXELS
    west, south, east, north = cells.bounds
    (row0, row1), (col0, col1) = ground.frame.rowcol([west, east], [north, south])
    rows = _inside(row0 - more, row1 + more, ground.frame.rows)
    return window_without_noise(ground, *rows, *_inside(col0 - more, col1 + more, ground.frame.cols))


def _inside(low: float, high: float, size: int) -> tuple[int, int]:
    return max(math.floor(low), 0), min(math.ceil(high) + 1, size)
