"""A lattice of which only some parts are in memory, so that what works on a whole lattice works along a path.

Its arrays have the size of the whole map in address space alone: the system gives memory to the pages that are written.
What was not read counts as blocked, so no leg can lead there unseen.
"""

from __future__ import annotations

import mmap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.edges import Points
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.stored_lattice import StoredLattice

BLOCK_CELLS = 32
"""Side of what is read at once."""


class Strip:
    """The part of a stored lattice that was read so far.

    Parameters
    ----------
    stored : StoredLattice
        The whole lattice.

    Attributes
    ----------
    lattice : CostLattice
        Of the size of the map; blocked as unknown where nothing was read.
    """

    def __init__(self, stored: StoredLattice) -> None:
        self._stored = stored
        rows, cols = stored.frame.shape
        self._read = np.zeros((-(-rows // BLOCK_CELLS), -(-cols // BLOCK_CELLS)), dtype=np.bool_)
        arrays: dict[str, Any] = {
            name: _reserved((rows, cols, *more), dtype) for name, (more, dtype) in stored.arrays.items()
        }
        arrays["blocked"][:] = int(Blocked.UNKNOWN)
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
        """Read what lies near a polyline.

        Parameters
        ----------
        points : ndarray of float, (n, 2)
            Fractional (row, col).
        cells : int
            How far from it the lattice is wanted, at least [cells]; 1 or more.
        """
        wanted = np.zeros_like(self._read)
        for (row0, col0), (row1, col1) in zip(points[:-1], points[1:], strict=True):
            count = int(max(abs(row1 - row0), abs(col1 - col0)) / min(2 * cells, BLOCK_CELLS)) + 2
            for row, col in np.linspace((row0, col0), (row1, col1), count):
                wanted[self._near(row, cells), self._near(col, cells)] = True
        if len(points) == 1:
            wanted[self._near(points[0, 0], cells), self._near(points[0, 1], cells)] = True
        rows, cols = self._stored.frame.shape
        for i, j in np.argwhere(wanted & ~self._read):
            row, col = int(i) * BLOCK_CELLS, int(j) * BLOCK_CELLS
            row1, col1 = min(row + BLOCK_CELLS, rows), min(col + BLOCK_CELLS, cols)
            part = self._stored.window(row, row1, col, col1)
            for name in self._stored.arrays:
                getattr(self.lattice, name)[row:row1, col:col1] = getattr(part, name)
            self._read[i, j] = True

    @staticmethod
    def _near(place: float, cells: int) -> slice:
        return slice(max(int(place - cells) // BLOCK_CELLS, 0), int(place + cells) // BLOCK_CELLS + 1)


def _reserved(shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """An array of zeros that takes no memory yet, whatever its size."""
    size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | getattr(mmap, "MAP_NORESERVE", 0)
    return np.frombuffer(mmap.mmap(-1, size, flags=flags), dtype=dtype).reshape(shape)
