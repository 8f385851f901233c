"""Moves that are priced tile by tile, when a search reaches them: of a map that is on disk or was not priced yet.

Prices, labels and bounds have the size of the whole map in address space alone: the system gives memory to the pages
that are written, and takes it back when tiles are dropped. So all that reads a `MoveTable` reads a tiled one too.
"""

from __future__ import annotations

import math
import mmap
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import TooLargeError
from joulemap.model.threads import share_out
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.margin_moves import beside_moves, near_closed
from joulemap.planner.pricing.move_prices import MovePrices

TILE_CELLS = 128
"""Side of a tile, a power of two; a fourth of a chunk on disk, so that little is priced in vain."""
_LEAST_TILES = 18
"""Fewest whose prices are kept: the nine around a tile, which a search backward reads, and the nine around the next."""
_PRICES_SHARE = 0.5
"""Share of the memory for prices; the rest is for labels and bounds."""
_LABEL_BYTES = 17 + 9
"""Label, bound and move of a cell of the search forward, label and move of that backward [bytes]."""


Fill = Callable[[NDArray[np.float64], int, int], None]
"""Fills lower bounds [J] of some cells, given the (row, col) of the first one."""


class Reserved(NamedTuple):
    """An array that takes no memory until it is written, and its memory."""

    array: NDArray[Any]
    memory: mmap.mmap

    def drop_rows(self, rows: slice, cols: slice) -> None:
        """Give the memory of a part back, but for the pages at its edges; the part may read as zeros then."""
        across = self.array.strides[0]
        per_cell = self.array.strides[1]
        for row in range(rows.start, rows.stop):
            begin = -(-(row * across + cols.start * per_cell) // mmap.PAGESIZE) * mmap.PAGESIZE
            end = (row * across + cols.stop * per_cell) // mmap.PAGESIZE * mmap.PAGESIZE
            if end > begin:
                self.memory.madvise(mmap.MADV_DONTNEED, begin, end - begin)


def reserved(shape: tuple[int, ...], dtype: np.dtype[Any]) -> Reserved:
    """Return an array of zeros that takes no memory yet, whatever its size.

    The system gives it memory page by page, as they are written, and never in huge pages: these would take several
    times what is written.
    """
    size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | getattr(mmap, "MAP_NORESERVE", 0)
    memory = mmap.mmap(-1, size, flags=flags)
    if hasattr(mmap, "MADV_NOHUGEPAGE"):
        with suppress(OSError):  # a system without huge pages
            memory.madvise(mmap.MADV_NOHUGEPAGE)
    return Reserved(np.frombuffer(memory, dtype=dtype).reshape(shape), memory)


class Tiles:
    """The tiles of one question's moves.

    Parameters
    ----------
    read : callable
        Returns the lattice of rows and columns from, to; what lies beyond the map is blocked.
    shape : tuple of int
        Its rows and columns.
    moves : MovePrices
        Its moves.
    margin : float
        How far beside a move the same move must be open [cells], see `integrator.margin_cells`.
    memory_bytes : int
        Most memory for prices and labels.
    side : int, optional
        Cells along a tile, a power of two above the longest move and the margin.
    surface : callable, optional
        Returns what a rise is counted on [J] in rows and columns from, to; needed where prices may be negative.

    Attributes
    ----------
    energy, near, surface : ndarray
        As of a `MoveTable`, where tiles were priced.
    priced : int
        Number of tiles that were priced; one that was dropped and priced again counts twice.
    """

    def __init__(
        self,
        read: Callable[[int, int, int, int], CostLattice],
        shape: tuple[int, int],
        moves: MovePrices,
        margin: float,
        *,
        memory_bytes: int,
        side: int = TILE_CELLS,
        surface: Callable[[int, int, int, int], NDArray[np.float32]] | None = None,
    ) -> None:
        self._read, self._moves, self._memory, self._read_surface = read, moves, memory_bytes, surface
        self.shape, self.side, self.shift = shape, side, side.bit_length() - 1
        self.down, self.across = (-(-size // side) for size in shape)
        count = len(moves.offsets)
        self._energy = reserved((*shape, count), np.dtype(np.float32))
        self.energy = self._energy.array
        self.surface = reserved(shape, np.dtype(np.float64)).array
        self._beside = beside_moves(moves.offsets, margin)
        self._margin = moves.reach + int(np.abs(self._beside).max(initial=0))
        self.near, self.narrow = np.zeros((2, 0), np.uint32)
        if margin > 0.0:
            self.near, self.narrow = reserved((2, shape[0] * shape[1]), np.dtype(np.uint32)).array
        self._most = max(int(_PRICES_SHARE * memory_bytes) // (4 * side**2 * count), _LEAST_TILES)
        self.there = np.zeros(self.count, dtype=np.bool_)
        self.used = np.zeros(self.count, dtype=np.int64)
        self._opened, self._bounded = np.zeros((2, self.count), dtype=np.bool_)
        self._fill: Fill | None = None
        self.progress: Callable[[float], None] | None = None
        self._whole = self._nearest = 0.0
        self.priced = 0

    @property
    def count(self) -> int:
        """Number of tiles."""
        return self.down * self.across

    @property
    def full(self) -> bool:
        """Whether a further tile's prices take the place of another's."""
        return int(self.there.sum()) >= self._most

    def window(self, tile: int) -> tuple[slice, slice]:
        """Return the rows and the columns of a tile.

        Parameters
        ----------
        tile : int
            Its number.

        Returns
        -------
        tuple of slice
            Rows and columns.
        """
        row, col = (at * self.side for at in divmod(tile, self.across))
        return slice(row, min(row + self.side, self.shape[0])), slice(col, min(col + self.side, self.shape[1]))

    def around(self, tile: int) -> list[int]:
        """Return a tile and those beside it.

        Parameters
        ----------
        tile : int
            Its number.

        Returns
        -------
        list of int
            Up to nine numbers.
        """
        down, right = divmod(tile, self.across)
        rows, cols = (
            range(max(down - 1, 0), min(down + 2, self.down)),
            range(max(right - 1, 0), min(right + 2, self.across)),
        )
        return [r * self.across + c for r in rows for c in cols]

    def tile_of(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the tile of each of some cells.

        Parameters
        ----------
        cells : ndarray of int, (n,)
            Flat indices.

        Returns
        -------
        ndarray of int, (n,)
            Numbers of tiles.
        """
        row, col = np.divmod(cells, self.shape[1])
        return (row >> self.shift) * self.across + (col >> self.shift)

    def bounds(self, fill: Fill) -> NDArray[np.float64]:
        """Return an array of bounds to a new goal, made as tiles are opened.

        Parameters
        ----------
        fill : callable
            Makes them.

        Returns
        -------
        ndarray of float64, (cells,)
            Bounds [J].
        """
        self._fill, self._nearest, self._whole = fill, math.inf, 0.0
        self._bounded[:] = False
        return reserved((self.shape[0] * self.shape[1],), np.dtype(np.float64)).array

    def open_bounds(self, known: NDArray[np.float64], tile: int) -> None:
        """Fill the bounds of a tile, once, and tell the progress.

        Parameters
        ----------
        known : ndarray of float64, (cells,)
            From `bounds`.
        tile : int
            Its number.
        """
        if self._bounded[tile] or self._fill is None:
            return
        self._bounded[tile] = True
        rows, cols = self.window(tile)
        here = known.reshape(self.shape)[rows, cols]
        self._fill(here, rows.start, cols.start)
        least = float(here.min())
        self._whole, self._nearest = self._whole or float(here.max()), min(self._nearest, least)
        if self.progress is not None and self._whole > 0.0:
            self.progress(min(max(1.0 - self._nearest / self._whole, 0.0), 1.0))

    def count_label(self, tile: int) -> None:
        """Count the labels of a tile, once.

        Parameters
        ----------
        tile : int
            Its number.

        Raises
        ------
        TooLargeError
            If the memory does not suffice.
        """
        self._opened[tile] = True
        needed = int(self._opened.sum()) * _LABEL_BYTES * self.side**2
        needed += (
            min(int(self.there.sum()) + 1, self._most) * self.energy.itemsize * self.side**2 * self.energy.shape[2]
        )
        if needed > self._memory:
            raise TooLargeError(
                f"the search needs more than the {self._memory / 1e9:.2g} GB that it may use: allow it more memory, or "
                "ask for a nearer goal",
                limit=self._memory,
            )

    def price(self, wanted: list[int]) -> list[int]:
        """Price tiles that are not there, each on a thread.

        Parameters
        ----------
        wanted : list of int
            Their numbers.

        Returns
        -------
        list of int
            Tiles that were dropped for them.
        """
        missing = [tile for tile in wanted if not self.there[tile]]
        dropped: list[int] = []
        over = int(self.there.sum()) + len(missing) - self._most
        if over > 0:
            held = np.flatnonzero(self.there)
            held = held[~np.isin(held, wanted)]
            dropped = held[np.argsort(self.used[held], kind="stable")][: max(over, len(held) // 16)].tolist()
            for tile in dropped:
                self._energy.drop_rows(*self.window(tile))
                self.there[tile] = False
        share_out(self._price, missing)
        self.there[missing] = True
        self.priced += len(missing)
        return dropped

    def _price(self, tile: int) -> None:
        """Write the prices of a tile."""
        rows, cols = self.window(tile)
        margin, reach = self._margin, self._moves.reach
        part = self._read(rows.start - margin, rows.stop + margin, cols.start - margin, cols.stop + margin)
        planes = self._moves.energies(part)[:, reach : part.frame.rows - reach, reach : part.frame.cols - reach]
        energy = np.ascontiguousarray(planes.transpose(1, 2, 0))
        beyond = margin - reach  # cells around the tile that are left
        inner = slice(beyond, beyond + rows.stop - rows.start), slice(beyond, beyond + cols.stop - cols.start)
        self.energy[rows, cols] = energy[inner]
        if self.near.size:
            first = rows.start - beyond, cols.start - beyond
            found = near_closed(energy, self._moves.offsets, self._beside, *first, *self.shape)
            for bits, of_tile in zip((self.near, self.narrow), found, strict=True):
                bits.reshape(self.shape)[rows, cols] = of_tile[inner]
        if self._read_surface is not None:
            self.surface[rows, cols] = self._read_surface(rows.start, rows.stop, cols.start, cols.stop)
