"""The coarse level of a lattice on disk: what every move of a block of cells costs at least, by direction.

It lies beside the lattice's arrays, is made once, and serves every question. From the energy of a move the rise of a
surface is taken first (the height potential of `heuristics`, here the average of `potential` without its lowering):
what is left is nearly the same for all cells of a block, so its least value says much. A block has no mask: it is
closed only where no move touches it.
"""

from __future__ import annotations

import shutil
import tempfile
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

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
from joulemap.planner.pricing.moves import EVERY
from joulemap.planner.pricing.potential import SWEEPS, levelled

BLOCK_CELLS = 32
"""Side of a block: fine enough to follow hills, coarse enough that a map of 10,000 x 10,000 cells has 100,000."""
SHARES = (1.0, 0.5, 0.0)
"""Shares of the rise that are taken from the energies; where prices are low on descents a smaller one says more."""
_VERSION = 3
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
    typical_j : float
        Mean size of a price, as `MoveTable.typical_j` [J].
    surface : zarr array of float32, (rows, cols)
        What a rise is counted on [J]; on disk.
    """

    least_per_m: NDArray[np.float32]
    shares: NDArray[np.float64]
    block_cells: int
    typical_j: float
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

    `stored`: the lattice; `moves`: its moves; `block_cells`: side of a block; `progress`: called with the share that is
    done, 0..1; an exception that it raises ends the work. Result: the coarse level.
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
    block_cells, typical_j = int(str(group.attrs["block_cells"])), float(str(group.attrs["typical_j"]))
    return CoarseLevel(np.asarray(least[:]), shares, block_cells, typical_j, surface)


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

    sampled, joining = np.zeros(2), threading.Lock()

    def _add(corner: tuple[int, int]) -> None:
        row, col = corner
        row1, col1 = min(row + side, rows), min(col + side, cols)
        around = row - margin, row1 + margin, col - margin, col1 + margin
        part = stored.window(*around, what=("traction_per_m", "gradient", "blocked", "elevation_m"))
        energy = moves.energies(part)
        height = stored.robot.weight_n * np.nan_to_num(part.elevation_m.astype(np.float64))
        level = levelled(np.ascontiguousarray(energy.transpose(1, 2, 0)), moves.offsets, height).astype(np.float32)
        surface[row:row1, col:col1] = level[margin:-margin, margin:-margin]
        i, j = max(row // block - 1, 0), max(col // block - 1, 0)
        i1, j1 = (min((end + moves.reach) // block + 1, size) for end, size in zip((row1, col1), blocks, strict=True))
        own = np.full((len(SHARES), i1 - i, j1 - j, len(moves.offsets)), np.inf, dtype=np.float32)
        tile = _Tile(row - i * block, col - j * block, row1 - row, col1 - col, margin)
        _least_of_blocks(energy, level, tile, moves.offsets, length_m, shares, block, own)
        sample = energy[:, margin + -row % EVERY : -margin : EVERY, margin + -col % EVERY : -margin : EVERY]
        sample = sample[np.isfinite(sample)]
        with joining:
            np.minimum(least[:, i:i1, j:j1], own, out=least[:, i:i1, j:j1])
            sampled[:] += np.abs(sample).sum(dtype=np.float64), sample.size

    with ThreadPoolExecutor(_THREADS) as pool:
        for number, _ in enumerate(pool.map(_add, tiles), 1):
            if progress is not None:
                progress(number / len(tiles))
    group.create_array("least_per_m", data=least, compressors=_COMPRESSOR)
    typical_j = float(sampled[0] / sampled[1]) if sampled[0] > 0.0 else 1.0
    group.attrs.update({"version": _VERSION, "shares": list(SHARES), "block_cells": block, "typical_j": typical_j})


class _Tile(NamedTuple):
    """Cells of which moves start."""

    row: int  # of its corner, as seen from the corner of the blocks around it
    col: int
    height: int
    width: int
    margin: int  # further cells around it


@njit(cache=True, nogil=True)
def _least_of_blocks(energy, surface, tile, offsets, length_m, shares, block, least):
    """Fill `least` (S, blocks, blocks, N) with the least energies of the moves that start in a tile.

    energy : (N, ...) and surface have the tile's margin around it. A move touches the blocks within reach of its start.
    """
    row, col, height, width, margin = tile
    moves, reach = offsets.shape[0], np.abs(offsets).max()
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
