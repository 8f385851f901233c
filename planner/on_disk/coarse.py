"""The coarse level of a lattice on disk: what every move of a block of cells costs at least, by direction.

It lies beside the lattice's arrays, is made once, and serves every question. From the energy of a move the rise of a
surface is taken first (the height potential of `heuristics`, here the average of `potential` without its lowering):
what is left is nearly the same for all cells of a block, so its least value says much. A block has no mask: it is
closed only where no move touches it.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numba import njit
from numpy.typing import NDArray
from zarr.codecs import BloscCodec

from joulemap.model.errors import DamagedError
from joulemap.planner.lattice.checked_store import CheckedStore
from joulemap.planner.lattice.checksums import MADE_FROM_IT, Checksums
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.planner.pricing.move_prices import MovePrices
from joulemap.planner.pricing.potential import SWEEPS

BLOCK_CELLS = 32
"""Side of a block: fine enough to follow hills, coarse enough that a map of 10,000 x 10,000 cells has 100,000."""
SHARES = (1.0, 0.5, 0.0)
"""Shares of the rise that are taken from the energies; where prices are low on descents a smaller one says more."""
_VERSION = 2
_THREADS = 2
_COMPRESSOR = BloscCodec(cname="lz4", clevel=1, shuffle="shuffle")


@dataclass(frozen=True, eq=False, repr=False)
class CoarseLevel:
    """What moves cost at least, block by block.

    Attributes
    ----------
    least_per_m : ndarray of float32, (S, block rows, block cols, N)
        The least energy per metre [J/m] beyond a share of the rise, over all moves of a direction that touch the
        block; infinite where there is none. Block (i, j) spans the centres of cells i B .. (i + 1) B, both included.
    shares : ndarray of float64, (S,)
        Shares of the rise.
    block_cells : int
        Side of a block B.
    surface : zarr array of float32, (rows, cols)
        What a rise is counted on [J]; on disk.
    """

    least_per_m: NDArray[np.float32]
    shares: NDArray[np.float64]
    block_cells: int
    surface: zarr.Array[Any]


def coarse_level(
    stored: StoredLattice,
    moves: MovePrices,
    *,
    block_cells: int = BLOCK_CELLS,
    progress: Callable[[float], None] | None = None,
) -> CoarseLevel:
    """Return the coarse level of a stored lattice; it is made and kept beside the lattice where it is not there yet.

    Where the folder cannot be written, it is kept in a temporary folder of this process.

    Parameters
    ----------
    stored : StoredLattice
        The lattice.
    moves : MovePrices
        Its moves.
    block_cells : int, optional
        Side of a block.
    progress : callable, optional
        Called with the share that is done, 0..1; an exception that it raises ends the work.

    Returns
    -------
    CoarseLevel
        The coarse level.
    """
    name = f"{MADE_FROM_IT}{len(moves.offsets)}"
    place = stored.path / name
    made = _opened(place)
    if made is not None and made.block_cells == block_cells:
        return made
    try:
        partial = Path(tempfile.mkdtemp(prefix=f".{name}-", dir=stored.path))
    except OSError:
        partial = place = Path(tempfile.mkdtemp(prefix="joulemap-coarse-"))
    try:
        _make(partial, stored, moves, block_cells, progress)
        Checksums.take(partial).write()
        if place != partial:
            partial.chmod(stored.path.stat().st_mode & 0o777)  # a temporary folder is its owner's alone
            if made is not None:
                shutil.rmtree(place)
            try:
                partial.rename(place)
            except OSError:  # another process was quicker
                shutil.rmtree(partial, ignore_errors=True)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise
    made = _opened(place)
    assert made is not None
    return made


def _opened(place: Path) -> CoarseLevel | None:
    """The coarse level that is there; one that is damaged, or of an older version, is removed: it is made again."""
    try:
        sums = Checksums.read(place)
        if sums is not None:
            sums.verify()
    except DamagedError:
        sums = None
    if sums is None:
        shutil.rmtree(place, ignore_errors=True)
        return None
    group = zarr.open_group(CheckedStore(sums), mode="r", use_consolidated=False)
    if group.attrs.get("version") != _VERSION:
        shutil.rmtree(place, ignore_errors=True)
        return None
    surface = group["surface_j"]
    least = group["least_per_m"]
    assert isinstance(surface, zarr.Array)
    assert isinstance(least, zarr.Array)
    shares = np.array(group.attrs["shares"], dtype=np.float64)
    return CoarseLevel(np.asarray(least[:]), shares, int(str(group.attrs["block_cells"])), surface)


def _make(
    place: Path, stored: StoredLattice, moves: MovePrices, block: int, progress: Callable[[float], None] | None
) -> None:
    rows, cols = stored.frame.shape
    side = stored.chunk
    group = zarr.open_group(place, mode="w")
    surface = group.create_array(
        "surface_j",
        shape=(rows, cols),
        chunks=(min(side, rows), min(side, cols)),
        dtype="float32",
        fill_value=0.0,
        compressors=_COMPRESSOR,
    )
    blocks = (-(-rows // block), -(-cols // block))
    least = np.full((len(SHARES), *blocks, len(moves.offsets)), np.inf, dtype=np.float32)
    shares, length_m = np.array(SHARES), moves.lengths_m(stored.frame.resolution_m)
    margin = (SWEEPS + 2) * moves.reach  # so the surface does not depend on how the map is cut
    tiles = [(r, c) for r in range(0, rows, side) for c in range(0, cols, side)]

    def _tile(corner: tuple[int, int]) -> tuple[tuple[int, int], NDArray[np.float32], NDArray[np.float32]]:
        row, col = corner
        row1, col1 = min(row + side, rows), min(col + side, cols)
        part = stored.window(
            row - margin,
            row1 + margin,
            col - margin,
            col1 + margin,
            what=("traction_per_m", "gradient", "blocked", "elevation_m"),
        )
        energy = moves.energies(part)
        height = stored.robot.weight_n * np.nan_to_num(part.elevation_m.astype(np.float64))
        level = _averaged(energy, moves.offsets, height, SWEEPS).astype(np.float32)
        first = max(row // block - 1, 0), max(col // block - 1, 0)
        last = min((row1 + moves.reach) // block + 1, blocks[0]), min((col1 + moves.reach) // block + 1, blocks[1])
        own = np.full(
            (len(SHARES), last[0] - first[0], last[1] - first[1], len(moves.offsets)), np.inf, dtype=np.float32
        )
        _least_of_blocks(
            energy,
            level,
            moves.offsets,
            length_m,
            shares,
            block,
            moves.reach,
            margin,
            row - first[0] * block,
            col - first[1] * block,
            row1 - row,
            col1 - col,
            own,
        )
        return first, own, np.ascontiguousarray(level[margin:-margin, margin:-margin])

    with ThreadPoolExecutor(_THREADS) as pool:
        ahead = 4 * _THREADS
        waiting = [pool.submit(_tile, corner) for corner in tiles[:ahead]]
        try:
            for number, (row, col) in enumerate(tiles):
                (i, j), own, level = waiting[number].result()
                waiting[number] = None  # type: ignore[call-overload]
                if number + ahead < len(tiles):
                    waiting.append(pool.submit(_tile, tiles[number + ahead]))
                here = least[:, i : i + own.shape[1], j : j + own.shape[2]]
                np.minimum(here, own, out=here)
                surface[row : row + level.shape[0], col : col + level.shape[1]] = level
                if progress is not None:
                    progress((number + 1) / len(tiles))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    group.create_array("least_per_m", data=least, compressors=_COMPRESSOR)
    group.attrs.update({"version": _VERSION, "shares": list(SHARES), "block_cells": block})


@njit(cache=True, nogil=True)
def _averaged(energy, offsets, surface, sweeps):
    """(rows, cols) float64 [J]: `potential._levelled`, some times, on this thread and for planes of moves."""
    moves, rows, cols = energy.shape
    half, stride = moves // 2, max(moves // 8, 1)
    excess = np.full((half, rows, cols), np.nan)  # half of what a move costs more than its way back
    count = np.zeros((rows, cols))
    for n in range(0, half, stride):
        down, right = offsets[n, 0], offsets[n, 1]
        col0, col1 = max(0, -right), min(cols, cols - right)
        for i in range(max(0, -down), min(rows, rows - down)):
            for j in range(col0, col1):
                value = 0.5 * (energy[n, i, j] - energy[n + half, i + down, j + right])
                excess[n, i, j] = value
                if value == value:
                    count[i, j] += 1.0
                    count[i + down, j + right] += 1.0
    for _ in range(sweeps):
        total = np.zeros((rows, cols))
        for n in range(0, half, stride):
            down, right = offsets[n, 0], offsets[n, 1]
            col0, col1 = max(0, -right), min(cols, cols - right)
            for i in range(max(0, -down), min(rows, rows - down)):
                for j in range(col0, col1):
                    value = excess[n, i, j]
                    if value == value:
                        total[i, j] += surface[i + down, j + right] - value
                        total[i + down, j + right] += surface[i, j] + value
        after = surface.copy()
        for i in range(rows):
            for j in range(cols):
                if count[i, j] > 0.0:
                    after[i, j] = total[i, j] / count[i, j]
        surface = after
    return surface


@njit(cache=True, nogil=True)
def _least_of_blocks(energy, surface, offsets, length_m, shares, block, reach, margin, row, col, height, width, least):
    """Fill `least` (S, blocks, blocks, N) with the least energies of the moves that start in a tile.

    energy : (N, ...) and surface have `margin` cells around the tile; (row, col) is the tile's corner as seen from the
    corner of `least`. A move touches the blocks within `reach` of its start.
    """
    moves = offsets.shape[0]
    spare = np.empty((shares.size, width), dtype=np.float32)
    for n in range(moves):
        down, right = offsets[n, 0], offsets[n, 1]
        per_m = 1.0 / length_m[n]
        for i in range(height):
            r = i + margin
            here, there = (
                surface[r, margin : margin + width],
                surface[r + down, margin + right : margin + right + width],
            )
            price = energy[n, r, margin : margin + width]
            for s in range(shares.size):
                of, share = spare[s], shares[s]
                for j in range(width):
                    of[j] = (price[j] - share * (np.float64(there[j]) - np.float64(here[j]))) * per_m
            a0 = max((row + i - reach - 1) // block, 0)
            a1 = min((row + i + reach) // block, least.shape[1] - 1)
            b0 = max((col - reach - 1) // block, 0)
            b1 = min((col + width + reach) // block, least.shape[2] - 1)
            for b in range(b0, b1 + 1):
                j0 = max(b * block - reach - col, 0)
                j1 = min((b + 1) * block + reach + 1 - col, width)
                for s in range(shares.size):
                    low = np.float32(np.inf)
                    of = spare[s]
                    for j in range(j0, j1):
                        if of[j] < low:  # false where there is no such move
                            low = of[j]
                    for a in range(a0, a1 + 1):
                        if low < least[s, a, b, n]:
                            least[s, a, b, n] = low
