"""Energy fields: the least energy from one place to every cell, or from every cell to the nearest of some goals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import BlockedError, NoRouteError
from joulemap.planner.grid.heuristics import guide_everywhere
from joulemap.planner.grid.search import GridPath, direct_energy, joined_points, terminals
from joulemap.planner.grid.states import Search, layer_count, new_search, run_search
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, path_price
from joulemap.planner.pricing.moves import MoveTable

_NONE = -1


@dataclass(frozen=True, eq=False, repr=False)
class EnergyField:
    """Least energies over grid moves between some places and every cell, and the moves that achieve them.

    Attributes
    ----------
    lattice : CostLattice
        Prices and limits.
    table : MoveTable
        Its priced moves.
    places : ndarray of float, (k, 2)
        Fractional (row, col) of the start, or of the goals.
    search : Search
        Energies for every heading that the robot may have there, with the moves.
    """

    lattice: CostLattice
    table: MoveTable
    places: Points
    search: Search

    @cached_property
    def energy_j(self) -> NDArray[np.float64]:
        """Least energy [J] over all headings of the robot: float64, (rows, cols); inf where there is no path."""
        states = self.search.energy_j.reshape(*self.lattice.frame.shape, self.search.layers)
        return states[..., 0] if self.search.layers == 1 else states.min(axis=2)

    def path_from(self, start: Points) -> GridPath:
        """Return the cheapest path from a place to the nearest goal, of a field towards goals.

        It is read from the field along the path, without a search.

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
        return self._path(start)

    def path_to(self, goal: Points) -> GridPath:
        """Return the cheapest path to a place, of a field from a start.

        Parameters
        ----------
        goal : ndarray of float, (2,)
            Fractional (row, col).

        Returns
        -------
        GridPath
            The path and its energy [J].

        Raises
        ------
        NoRouteError
            If the goal cannot be reached.
        """
        return self._path(goal)

    def _path(self, place: Points) -> GridPath:
        """The path between a place and the start of the field, or the nearest of its goals."""
        lattice, layers, onward = self.lattice, self.search.layers, self.search.backward
        cells, cost = terminals(lattice, self.table, place, layers, outward=onward)
        total = (cost + self.search.energy_j.reshape(-1, layers)[cells]).ravel()
        first = int(np.argmin(total)) if total.size else _NONE
        least = float(total[first]) if total.size else np.inf
        ends = [(place, other) if onward else (other, place) for other in self.places]
        shortest = min((self._without_moves(*pair) for pair in ends), key=lambda path: path.energy_j)
        if shortest.energy_j <= least and shortest.energy_j < np.inf:
            return shortest
        if not np.isfinite(least):
            raise NoRouteError("no route: none of the goals can be reached from the start within the robot's limits")
        path = self.search.trace(self.table, int(cells[first // layers]) * layers + first % layers) // layers
        here = np.array(divmod(int(path[-1]), lattice.frame.cols), dtype=np.float64)
        near = [pair for pair, other in zip(ends, self.places, strict=True) if np.abs(other - here).max() <= 1.0]
        ways = [joined_points(lattice, pair[0], path if onward else path[::-1], pair[1]) for pair in near]
        prices = [path_price(lattice, points) for points in ways]  # which of them it was
        return GridPath(ways[int(np.nanargmin(prices))], least, 0)

    def _without_moves(self, start: Points, goal: Points) -> GridPath:
        """The best path to a goal so near that no grid move is needed; inf where there is none."""
        best = GridPath(np.vstack([start, goal]), direct_energy(self.lattice, start, goal), 0)
        if np.abs(start - goal).max() < 2.0:
            cells, cost = terminals(self.lattice, self.table, start, self.search.layers, outward=True)
            ends, rest = terminals(self.lattice, self.table, goal, self.search.layers, outward=False)
            for cell in np.intersect1d(cells, ends):
                energy = float((cost[cells == cell] + rest[ends == cell]).min())
                if energy < best.energy_j:
                    best = GridPath(joined_points(self.lattice, start, np.array([cell]), goal), energy, 0)
        return best


def field_from(lattice: CostLattice, table: MoveTable, start: Points) -> EnergyField:
    """Return the least energy from one place to every cell.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    table : MoveTable
        Priced moves of the lattice.
    start : ndarray of float, (2,)
        Fractional (row, col).

    Returns
    -------
    EnergyField
        Its `energy_j` is (rows, cols) [J].
    """
    cells, cost = terminals(lattice, table, start, layer_count(lattice, table), outward=True)
    return _field(lattice, table, start[None], cells, cost, backward=False)


def field_towards(lattice: CostLattice, table: MoveTable, goals: Points) -> EnergyField:
    """Return the least energy from every cell to the nearest (in energy) of some goals, by one search.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    table : MoveTable
        Priced moves of the lattice.
    goals : ndarray of float, (k, 2)
        Fractional (row, col).

    Returns
    -------
    EnergyField
        Its `energy_j` is (rows, cols) [J], and `path_from` answers every start.

    Raises
    ------
    BlockedError
        If no leg reaches one of the goals.
    """
    joints = [terminals(lattice, table, goal, layer_count(lattice, table), outward=False) for goal in goals]
    if any(cells.size == 0 for cells, _ in joints):
        raise BlockedError("a goal is next to blocked ground: no leg reaches it", which="goal")
    cells, costs = zip(*joints, strict=True)
    return _field(lattice, table, goals, np.concatenate(cells), np.concatenate(costs), backward=True)


def field_beyond(
    lattice: CostLattice, table: MoveTable, cells: NDArray[np.int64], rest_j: NDArray[np.float64]
) -> EnergyField:
    """Return the least energy from every cell to something that some cells lead to.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    table : MoveTable
        Priced moves of the lattice.
    cells : ndarray of int, (n,)
        Flat indices.
    rest_j : ndarray of float, (n,)
        Energy from each of them on, whatever the heading [J].

    Returns
    -------
    EnergyField
        Towards it.
    """
    cost = np.repeat(rest_j[:, None], layer_count(lattice, table), axis=1)
    places = np.column_stack(np.divmod(cells, lattice.frame.cols)).astype(np.float64)
    return _field(lattice, table, places, cells, cost, backward=True)


def _field(
    lattice: CostLattice,
    table: MoveTable,
    places: Points,
    cells: NDArray[np.int64],
    cost: NDArray[np.float64],
    *,
    backward: bool,
) -> EnergyField:
    search = new_search(table, layer_count(lattice, table), cells, cost, backward=backward)
    run_search(search, table, np.unique(cells), guide_everywhere(table, backward=backward))
    return EnergyField(lattice, table, places, search)
