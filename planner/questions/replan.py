"""Planning again when a part of the map has changed, or the robot has moved: only what depends on it is searched again.

The energy field towards the goals is a tree. A price that rose, or a move that is gone, takes the branch behind it out
of the tree; the search then goes on from the ground around the gap, and from the moves that became cheaper (Ramalingam
& Reps 1996; the same idea as D* Lite of Koenig & Likhachev 2002, with a field that answers every start). For a robot
that has moved, the path is read from the field.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.planner.grid.fields import EnergyField, field_towards
from joulemap.planner.grid.heuristics import guide_everywhere
from joulemap.planner.grid.search import GridPath, terminals
from joulemap.planner.grid.states import run_search
from joulemap.planner.grid.traces import CODE, state_before
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points
from joulemap.planner.pricing.moves import move_table, repriced

Window = tuple[int, int, int, int]


class Replanner:
    """The cheapest paths to some goals on a map that changes; its answers are those of a new field.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    goals : ndarray of float, (k, 2)
        Fractional (row, col).
    neighbours : {16, 8, 32}
        Moves per cell.

    Raises
    ------
    BlockedError
        If no leg reaches one of the goals.
    """

    def __init__(self, lattice: CostLattice, goals: Points, *, neighbours: int = 16) -> None:
        self.field: EnergyField = field_towards(lattice, move_table(lattice, neighbours=neighbours), goals)

    def path_from(self, start: Points) -> GridPath:
        """Return the cheapest path from a place to the nearest goal.

        Parameters
        ----------
        start : ndarray of float, (2,)
            Fractional (row, col).

        Returns
        -------
        GridPath
            The path and its energy [J].

        Raises
        ------
        NoRouteError
            If no goal can be reached.
        """
        return self.field.path_from(start)

    def change(self, lattice: CostLattice, *, window: Window | None = None) -> int:
        """Change to another lattice of the same frame, robot and headings.

        Parameters
        ----------
        lattice : CostLattice
            Prices and limits now.
        window : tuple of int, optional
            (row0, row1, col0, col1) that holds every changed cell; found by comparing the lattices where None.

        Returns
        -------
        int
            Number of states whose path was lost and searched again.

        Raises
        ------
        BlockedError
            If no leg reaches one of the goals any more.
        NegativeCycleError
            If driving in a circle would fill the battery now.
        """
        field = self.field
        window = changed_window(field.lattice, lattice) if window is None else window
        if window is None:
            return 0
        search, goals = field.search, field.places
        layers = search.layers
        before = [terminals(field.lattice, field.table, goal, layers, outward=False) for goal in goals]
        around = _widened(window, field.table.reach, lattice.frame.shape)
        old = field.table.energy[around].copy()
        table = repriced(field.table, lattice, window)
        after = [terminals(lattice, table, goal, layers, outward=False) for goal in goals]
        if table.energy is not field.table.energy or not _same(before, after):
            self.field = field_towards(lattice, table, goals)
            return search.energy_j.size
        changed: NDArray[np.uint8] = np.zeros(table.energy.shape, dtype=np.uint8)  # 1: cheaper, 2: dearer or gone
        new = table.energy[around]
        changed[around] = np.where(
            new == old, 0, np.where(new < old, 1, np.where(np.isnan(old), np.where(np.isnan(new), 0, 1), 2))
        )
        changed = changed.reshape(-1, len(table.offsets))
        lost = _cut_off(search.energy_j, search.pred, changed, table.jump, layers)
        search.energy_j[lost] = np.inf
        search.pred[lost] = 0
        first = _around(lost, changed, table.jump, layers)
        for cells, cost in after:  # a goal's own cells may have been reached at less by way of another's
            search.seed(cells, cost)
            first[cells] = True
        first &= np.isfinite(search.energy_j.reshape(-1, layers)).any(axis=1)
        run_search(search, table, np.flatnonzero(first), guide_everywhere(table, backward=True))
        self.field = EnergyField(lattice, table, goals, search)
        return int(np.count_nonzero(lost))


def changed_window(before: CostLattice, after: CostLattice) -> Window | None:
    """Return the smallest window outside which two lattices of one frame are the same.

    Parameters
    ----------
    before, after : CostLattice
        The lattices.

    Returns
    -------
    tuple of int or None
        (row0, row1, col0, col1); None where they are the same everywhere.
    """
    differs = before.blocked != after.blocked
    for name in ("traction_per_m", "gradient", "elevation_m"):
        a, b = getattr(before, name), getattr(after, name)
        unequal = (a != b) & ~(np.isnan(a) & np.isnan(b))
        differs |= unequal if unequal.ndim == 2 else unequal.any(axis=2)
    rows, cols = np.flatnonzero(differs.any(axis=1)), np.flatnonzero(differs.any(axis=0))
    if rows.size == 0:
        return None
    return int(rows[0]), int(rows[-1]) + 1, int(cols[0]), int(cols[-1]) + 1


def _widened(window: Window, margin: int, shape: tuple[int, int]) -> tuple[slice, slice]:
    row0, row1, col0, col1 = window
    return (
        slice(max(row0 - margin, 0), min(row1 + margin, shape[0])),
        slice(max(col0 - margin, 0), min(col1 + margin, shape[1])),
    )


def _same(before: list, after: list) -> bool:
    return all(np.array_equal(a, c) and np.array_equal(b, d) for (a, b), (c, d) in zip(before, after, strict=True))


@njit(cache=True, nogil=True)
def _cut_off(energy, pred, changed, jump, layers):
    """(states,) bool: whose path to the goals uses a dearer move. changed : (cells, N) 1 cheaper, 2 dearer or gone."""
    fate = np.zeros(energy.size, dtype=np.uint8)  # 1: stays, 2: goes
    way = np.empty(energy.size, dtype=np.int64)
    for state in range(energy.size):
        if energy[state] == np.inf:
            fate[state] = 1
        depth = 0
        at = state
        while fate[at] == 0:
            code, following = np.int64(pred[at]) & CODE, state_before(pred, at, jump, layers, True)
            if following < 0:
                fate[at] = 1
            elif code <= jump.size and changed[at // layers, code - 1] == 2:
                fate[at] = 2
            else:
                way[depth] = at
                depth += 1
                at = following
        for k in range(depth):
            fate[way[k]] = fate[at]
    return fate == 2


@njit(cache=True, nogil=True)
def _around(lost, changed, jump, layers):
    """(cells,) bool: cells from which lost states may be reached again, or others at less."""
    cells = changed.shape[0]
    first = np.zeros(cells, dtype=np.bool_)
    for cell in range(cells):
        gone = 0
        for k in range(layers):
            gone += lost[cell * layers + k]
        if gone > 0:
            first[cell] = True
        for n in range(jump.size):
            ahead = cell + jump[n]
            if 0 <= ahead < cells and (gone > 0 or changed[cell, n] == 1):
                first[ahead] = True
    return first
