"""Energy fields: the least energy from one place to every cell, or from every cell to the nearest of some goals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.errors import BlockedError, NoRouteError
from planner.edges import Points, path_price
from planner.heuristics import dijkstra_bounds
from planner.lattice import CostLattice
from planner.moves import MoveTable
from planner.search import GridPath, direct_energy, joined_points, layer_count, seed_states, terminals
from planner.search_kernels import search_states, trace_states


@dataclass(frozen=True, eq=False, repr=False)
class EnergyField:
    """Least energies over grid moves between some places and every cell, and the moves that achieve them.

    energy_j : (rows, cols) float64 [J]; inf where there is no way. With a turn cost the field from a start is the least
    over headings of arrival, the field towards goals the least over headings of departure.
    """

    lattice: CostLattice
    table: MoveTable
    places: Points
    energy_j: NDArray[np.float64]
    _states: NDArray[np.float64]
    _pred: NDArray[np.uint16]
    _layers: int

    def path_from(self, start: Points) -> GridPath:
        """The cheapest way from `start` (2,) (row, col) to the nearest goal of a field towards goals.

        Costs a walk along the path, no search. Raises NoRouteError.
        """
        lattice, layers = self.lattice, self._layers
        cells, cost = terminals(lattice, self.table, start, layers, outward=True)
        states = seed_states(cells, layers)
        total = np.append(cost.ravel() + self._states[states], np.inf)
        first = int(np.argmin(total))
        near = [self._without_moves(start, cells, cost, goal) for goal in self.places]
        shortest = min(near, key=lambda path: path.energy_j)
        if shortest.energy_j <= total[first] and shortest.energy_j < np.inf:
            return shortest
        if not np.isfinite(total[first]):
            raise NoRouteError("no route: none of the goals can be reached from the start within the robot's limits")
        cols = lattice.frame.cols
        way = trace_states(self._pred, self.table.offsets, int(states[first]), layers, cols, True)
        path = way // layers
        if layers > 1:  # the last state is a move still to make
            d_row, d_col = self.table.offsets[way[-1] % layers]
            path = np.append(path, path[-1] + d_row * cols + d_col)
        here = np.array(divmod(int(path[-1]), cols), dtype=np.float64)
        ways = [joined_points(lattice, start, path, goal) for goal in self.places if np.abs(goal - here).max() <= 1.0]
        prices = [path_price(lattice, points) for points in ways]  # which of them it was
        return GridPath(ways[int(np.nanargmin(prices))], float(total[first]), 0)

    def _without_moves(
        self, start: Points, cells: NDArray[np.int64], cost: NDArray[np.float64], goal: Points
    ) -> GridPath:
        """The best way to a goal so near that no grid move is needed; inf where there is none."""
        best = GridPath(np.vstack([start, goal]), direct_energy(self.lattice, start, goal), 0)
        if np.abs(start - goal).max() < 2.0:
            ends, rest = terminals(self.lattice, self.table, goal, self._layers, outward=False)
            for cell in np.intersect1d(cells, ends):
                energy = float((cost[cells == cell] + rest[ends == cell]).min())
                if energy < best.energy_j:
                    best = GridPath(joined_points(self.lattice, start, np.array([cell]), goal), energy, 0)
        return best


def field_from(lattice: CostLattice, table: MoveTable, start: Points) -> EnergyField:
    """Least energy from `start` (2,) (row, col) to every cell. Raises NegativeCycleError."""
    layers = layer_count(lattice, table)
    cells, cost = terminals(lattice, table, start, layers, outward=True)
    return _field(lattice, table, start[None], seed_states(cells, layers), cost.ravel(), layers, backward=False)


def field_towards(lattice: CostLattice, table: MoveTable, goals: Points) -> EnergyField:
    """Least energy from every cell to the nearest (in energy) of `goals` (k, 2) (row, col), by one search.

    Raises BlockedError for a goal that no leg reaches, NegativeCycleError.
    """
    layers = layer_count(lattice, table)
    rows, cols = lattice.frame.shape
    seeds, costs = [], []
    for goal in goals:
        cells, cost = terminals(lattice, table, goal, layers, outward=False)
        if cells.size == 0:
            raise BlockedError("a goal leans on blocked ground: no leg reaches it", which="goal")
        if layers == 1:
            seeds.append(cells)
            costs.append(cost[:, 0])
            continue
        for cell, rest in zip(cells, cost, strict=True):  # the state is the move still to make: the one into the cell
            row = cell // cols - table.offsets[:, 0]
            col = cell % cols - table.offsets[:, 1]
            n = np.flatnonzero((row >= 0) & (row < rows) & (col >= 0) & (col < cols))
            step = table.energy[row[n], col[n], n].astype(np.float64)
            usable = np.isfinite(step)
            seeds.append((row[n] * cols + col[n])[usable] * layers + n[usable])
            costs.append((step + rest[n])[usable])
    return _field(lattice, table, goals, np.concatenate(seeds), np.concatenate(costs), layers, backward=True)


def _field(
    lattice: CostLattice, table: MoveTable, places: Points, seeds: NDArray[np.int64], cost: NDArray[np.float64],
    layers: int, *, backward: bool,
) -> EnergyField:  # fmt: skip
    bounds = dijkstra_bounds(table) * ([[1.0, -1.0]] if backward else [[1.0, 1.0]])  # potentials change sign
    energy, pred, _, _, _ = search_states(
        table.energy, table.offsets, table.turn_j, layers, table.surface, lattice.frame.resolution_m,
        seeds, cost, np.empty(0, dtype=np.int64), np.empty((0, layers)), bounds, backward,
    )  # fmt: skip
    field = (energy.reshape(-1, layers).min(axis=1) if layers > 1 else energy).reshape(lattice.frame.shape)
    return EnergyField(lattice, table, places, field, energy, pred, layers)
