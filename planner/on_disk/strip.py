"""A lattice of which only some parts are in memory, so that what works on a whole lattice works along a path.

Its arrays have the size of the whole map in address space alone: the system gives memory to the pages that are written.
What was not read counts as blocked, so no leg can lead there unseen.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.obstacles import Obstacles, reach_m
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.planner.pricing.integrator import Points
from joulemap.planner.pricing.tiles import reserved

BLOCK_CELLS = 32
"""Side of what is read at once."""


class Strip:
    """The part of a stored lattice that was read so far."""

    def __init__(self, stored: StoredLattice) -> None:
        self._stored = stored
        rows, cols = stored.frame.shape
        self._read = np.zeros((-(-rows // BLOCK_CELLS), -(-cols // BLOCK_CELLS)), dtype=np.bool_)
        arrays: dict[str, Any] = {
            name: reserved((rows, cols, *more), dtype).array for name, (more, dtype) in stored.arrays.items()
        }
        arrays["blocked"][:] = int(Blocked.UNKNOWN)
        n = stored.squares_per_cell
        self._reach = math.ceil(reach_m(stored.robot) / stored.frame.resolution_m) + 1 if n else 0
        if n:  # unread squares are obstacles
            arrays["obstacles"] = Obstacles(reserved((n * rows, n * cols), np.dtype(np.uint8)).array, n, growing=True)
        self.lattice = CostLattice(stored.frame, stored.robot, provenance=stored.provenance, **arrays)

    @property
    def bytes_read(self) -> int:
        """Memory of what was read [bytes]."""
        per_cell = sum(
            int(np.prod(more, dtype=np.int64)) * np.dtype(dtype).itemsize
            for more, dtype in self._stored.arrays.values()
        )
        return int(self._read.sum()) * BLOCK_CELLS**2 * per_cell

    def read_along(self, points: Points, *, cells: int) -> None:
        """Read what lies near a polyline. `points` (n, 2): fractional (row, col)."""
        wanted = np.zeros_like(self._read)
        cells += self._reach
        for (row0, col0), (row1, col1) in zip(points[:-1], points[1:], strict=True):
            count = int(max(abs(row1 - row0), abs(col1 - col0)) / min(2 * cells, BLOCK_CELLS)) + 2
            for row, col in np.linspace((row0, col0), (row1, col1), count):
                wanted[self._near(row, cells), self._near(col, cells)] = True
        if len(points) == 1:
            wanted[self._near(points[0, 0], cells), self._near(points[0, 1], cells)] = True
        self._read_new(wanted & ~self._read)

    def read_around(self, cells: NDArray[np.int64], *, beside: int) -> None:
        """Read what lies within `beside` cells, less than a block, of some flat cells."""
        wanted = np.zeros_like(self._read)
        places = np.column_stack(np.divmod(cells, self.lattice.frame.cols))
        for down in (-beside, beside):
            for right in (-beside, beside):
                corners = np.clip(places + np.array([down, right]), 0, np.array(self.lattice.frame.shape) - 1)
                wanted[tuple((corners // BLOCK_CELLS).T)] = True
        self._read_new(wanted & ~self._read)

    def _read_new(self, new: NDArray[np.bool_]) -> None:
        """Read blocks, those of a chunk at once."""
        blocks = max(self._stored.chunk // BLOCK_CELLS, 1)
        for i in range(0, new.shape[0], blocks):
            for j in range(0, new.shape[1], blocks):
                if new[i : i + blocks, j : j + blocks].any():
                    self._read_blocks(np.argwhere(new[i : i + blocks, j : j + blocks]) + np.array([i, j]))

    def _read_blocks(self, places: NDArray[np.int64]) -> None:
        """Read blocks that lie near each other; places : (n, 2)."""
        row, col = places.min(axis=0) * BLOCK_CELLS
        row1, col1 = np.minimum((places.max(axis=0) + 1) * BLOCK_CELLS, self._stored.frame.shape)
        part = self._stored.window(row, row1, col, col1)
        for name in self._stored.arrays:
            values, to = getattr(part, name), getattr(self.lattice, name)
            for i, j in places * BLOCK_CELLS:
                to[i : i + BLOCK_CELLS, j : j + BLOCK_CELLS] = values[
                    i - row : i - row + BLOCK_CELLS, j - col : j - col + BLOCK_CELLS
                ]
        if self.lattice.obstacles is not None:
            for i, j in places * BLOCK_CELLS:
                part_of = slice(i, min(i + BLOCK_CELLS, row1)), slice(j, min(j + BLOCK_CELLS, col1))
                self.lattice.obstacles.room[self._squares(part_of)] = self._stored.room(*part_of)
        self._read[tuple(places.T)] = True

    def _squares(self, part: tuple[slice, slice]) -> tuple[slice, slice]:
        n, (rows, cols) = self._stored.squares_per_cell, part
        return slice(rows.start * n, rows.stop * n), slice(cols.start * n, cols.stop * n)

    @staticmethod
    def _near(place: float, cells: int) -> slice:
        return slice(max(int(place - cells) // BLOCK_CELLS, 0), int(place + cells) // BLOCK_CELLS + 1)
