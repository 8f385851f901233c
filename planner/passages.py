"""The cheapest paths through passages that are too narrow for moves between cell centres.

A move touches up to ten cells, and is closed where one of them is blocked or too steep in its heading. A shorter piece
of the same heading touches fewer. So around closed moves, the cells that a nearly best path may use are searched once
more, among points at half the spacing (`passage_search`); and along the path that is found, among those at a quarter of
it. Elsewhere the moves between centres stay.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.planner.edges import Points, interpolation_matrix, price_arrays
from joulemap.planner.lattice import CostLattice
from joulemap.planner.moves import MoveTable
from joulemap.planner.passage_search import PER_CELL, Region, cheapest_way, short_legs
from joulemap.planner.states import Search

AROUND = 6
"""How far beside the cells of nearly best grid paths, and beside closed moves, the points lie [cells]. With 2, nine of
100 random tasks on a real hillside cost over 0.1 % more than with the best of 2, 3, 4 and 6, by up to 3.3 %; with 9 or
12 the mean energy is no lower than with 6."""
BESIDE = 4
"""How far beside the first path the points at a quarter of the spacing lie [cells]. Of 220 random tasks on a real
hillside they made 20 cheaper by over 0.1 %, by up to 1 %, and three dearer, for a tenth of the time of an answer; with
2, 17 and four. Instead of the first path, and beside all nearly best ones: 26 and seven, for two tenths."""

Ends = tuple[NDArray[np.int64], NDArray[np.float64]]


def paths_through_passages(
    lattice: CostLattice, table: MoveTable, ahead: Search, usual: NDArray[np.int64], seeds: Ends, targets: Ends
) -> list[Points]:
    """Return the cheapest paths among cell centres and points between them near closed moves.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    table : MoveTable
        Priced moves of the lattice.
    ahead : Search
        Over those moves, from the seeds.
    usual : ndarray of int64, (n,)
        Flat indices of the cells of nearly best grid paths.
    seeds, targets : tuple of (ndarray of int64, (S,), ndarray of float64, (S,))
        Flat cells that are joined to the start and to the goal, and the energy of joining each [J].

    Returns
    -------
    list of ndarray of float, (k, 2)
        (row, col) of paths from a seed to a target: the best among points at half the spacing, and the best that has
        those at a quarter of it too, each only where it is cheaper than moves between centres alone. Empty where no
        move is closed near those cells.

    Notes
    -----
    Where turning costs nothing, only what becomes cheaper than in the search over moves is searched once more, from the
    cells with points between them on. Points that are settled stay settled, so with negative prices the paths may not
    be the cheapest. A leg that cannot make its end cheaper is not priced and counts as open; one that touches a cell
    which takes no part counts as closed.
    """
    rows, cols = lattice.frame.shape
    near = _around(usual, near=AROUND, shape=(rows, cols))
    closed = _closed(table.energy, table.offsets, np.flatnonzero(near))
    if not closed.size:
        return []
    beside = np.zeros((rows, cols), dtype=np.bool_)
    beside.ravel()[closed] = True
    halved = _around(closed, near=AROUND, shape=(rows, cols))
    least = max(float(table.bound_per_m[0]), 0.0) if table.never_pays else -math.inf
    legs = short_legs()
    weights = interpolation_matrix(legs.heading_rad, lattice.headings)

    known_j = ahead.energy_j if ahead.layers == 1 else np.full(rows * cols, np.inf)
    if ahead.layers > 1:  # its energies count turns
        np.minimum.at(known_j, *seeds)

    def _search(near: NDArray[np.bool_], *, quarters: bool) -> tuple[Points, bool]:
        """The cheapest path, and whether it is cheaper than over moves between centres alone."""
        cells = np.flatnonzero(near)
        slot = np.full(rows * cols, -1, dtype=np.int32)
        slot[cells] = np.arange(cells.size)
        own, fine = beside.ravel()[cells], halved.ravel()[cells]
        begins = np.flatnonzero(fine) if ahead.layers == 1 else slot[seeds[0]]
        ends, rest = slot[targets[0]], targets[1]
        found = cheapest_way(
            *price_arrays(lattice), table.energy, table.offsets, legs, weights,
            Region(slot.reshape(rows, cols), cells, fine, own, own & quarters),
            known_j[cells], begins[begins >= 0], ends[ends >= 0], rest[ends >= 0], least * lattice.frame.resolution_m,
        )  # fmt: skip
        path = found / PER_CELL
        if len(found) and ahead.layers == 1:
            cell = int(np.rint(path[0]) @ [cols, 1])
            path = np.vstack([np.column_stack(np.divmod(ahead.trace(table, cell)[:0:-1], cols)), path])
        return path, len(found) > 1

    first, cheaper = _search(near, quarters=False)
    if not len(first):
        return []
    along = np.unique(np.rint(first).astype(np.int64) @ np.array([cols, 1]))
    second, still_cheaper = _search(near & _around(along, near=BESIDE, shape=(rows, cols)), quarters=True)
    return [way for way, gains in ((first, cheaper), (second, still_cheaper)) if gains]


def beside_closed_moves(table: MoveTable, cells: NDArray[np.int64]) -> bool:
    """Return whether moves are closed near some cells.

    Parameters
    ----------
    table : MoveTable
        Priced moves.
    cells : ndarray of int64, (n,)
        Flat indices.

    Returns
    -------
    bool
        True where a move from a cell within `AROUND` of them is closed that does not leave the map.
    """
    near = np.flatnonzero(_around(cells, near=AROUND, shape=table.energy.shape[:2]))
    return bool(_closed(table.energy, table.offsets, near).size)


def _around(cells: NDArray[np.int64], *, near: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
    out = np.zeros(shape, dtype=np.bool_)
    mark_around(out, cells, shape[1], near)
    return out


@njit(cache=True, nogil=True)
def mark_around(taken, way, cols, half_side):
    """Mark the squares around the cells of a path.

    Parameters
    ----------
    taken : ndarray of bool, (rows, cols)
        Is set there.
    way : ndarray of int64, (n,)
        Flat cell indices, row * cols + col.
    cols : int
        Columns of the map.
    half_side : int
        Half the side of a square [cells].
    """
    rows = taken.shape[0]
    k = 0
    while k < way.size:
        first = way[k]
        while k + 1 < way.size and way[k + 1] == way[k] + 1 and way[k + 1] % cols > 0:
            k += 1  # cells side by side are marked together
        i, j, end = first // cols, first % cols, way[k] % cols + 1
        taken[
            max(i - half_side, 0) : min(i + half_side + 1, rows), max(j - half_side, 0) : min(end + half_side, cols)
        ] = True
        k += 1


@njit(cache=True, nogil=True)
def _closed(energy, offsets, cells):
    """Those of some flat cells of which a move is closed that does not leave the map."""
    rows, cols, moves = energy.shape
    reach = np.abs(offsets).max()
    out = np.empty(cells.size, dtype=np.int64)
    count = 0
    for cell in cells:
        i, j = cell // cols, cell % cols
        closed = 0
        if reach <= i < rows - reach and reach <= j < cols - reach:
            for n in range(moves):  # without a branch, so that the compiler uses vectors
                closed += math.isnan(energy[i, j, n])
        else:
            for n in range(moves):
                inside = 0 <= i + offsets[n, 0] < rows and 0 <= j + offsets[n, 1] < cols
                closed += inside and math.isnan(energy[i, j, n])
        if closed > 0:
            out[count] = cell
            count += 1
    return out[:count]
