"""Alternative routes from a start to a goal: each locally as good as the best, none a small variation of another.

Plateaus (Jones 2007; Abraham et al. 2013, "Alternative routes in road networks"): stretches of moves that both the
least-energy tree from the start and the one towards the goal use. The path start - plateau - goal follows least-energy
paths into the plateau, along it and out of it, so no detour shorter than the plateau makes it cheaper. Both trees are
energy fields, and all plateaus are found in them at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.any_angle.best import improved
from joulemap.planner.grid.fields import field_from, field_towards
from joulemap.planner.grid.search import GridPath, grid_search, joined_points
from joulemap.planner.grid.states import Search
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, path_price
from joulemap.planner.pricing.moves import MoveTable
from joulemap.planner.pricing.polylines import path_length, subdivided

STRETCH = 1.3
"""Most energy of an alternative, in multiples of the best path's."""
LEAST_PLATEAU = 0.1
"""Least energy of its plateau, as a share of the best path's."""
LEAST_SHARE = 0.3
"""Least share of an alternative's length that lies away from every path before it."""


def alternative_paths(
    lattice: CostLattice,
    table: MoveTable,
    start: Points,
    goal: Points,
    *,
    count: int,
) -> list[GridPath]:
    """Return the best path and good alternatives, cheapest first.

    `lattice`: prices and limits; `table`: priced moves of the lattice; `start`, `goal` (2,): fractional (row, col);
    `count`: most paths, the best one included. Result: the paths. Raises NoRouteError if the goal cannot be reached.

    Reference: Jones 2007; Abraham, Delling, Goldberg & Werneck 2013.
    """
    best = grid_search(lattice, table, start, goal)
    found = [best]
    if count == 1 or best.energy_j <= 0.0:
        return found
    separation_m = _separation_m(lattice, best.points)
    ahead, behind = field_from(lattice, table, start).search, field_towards(lattice, table, goal[None]).search
    states, length = _plateaus(ahead, behind, table, STRETCH * best.energy_j)
    long = length >= LEAST_PLATEAU * best.energy_j
    states, length = states[long], length[long]
    via = ahead.energy_j[states] + behind.energy_j[states]
    away_m = _metres_from(lattice, best.points)
    for k in np.argsort(via - length, kind="stable"):  # long plateaus first
        into = ahead.trace(table, int(states[k]))[::-1] // ahead.layers
        cells = np.append(into, behind.trace(table, int(states[k]))[1:] // behind.layers)
        cells = cells[np.append(True, np.diff(cells) != 0)]  # turns on the spot
        if np.unique(cells).size < cells.size or np.mean(away_m[cells] > separation_m) < LEAST_SHARE:
            continue
        found.append(GridPath(joined_points(lattice, start, cells, goal), float(via[k]), 0))
        if len(found) == count:
            break
        away_m = np.minimum(away_m, _metres_from(lattice, found[-1].points))
    return sorted(found, key=lambda path: path.energy_j)


def _plateaus(
    ahead: Search, behind: Search, table: MoveTable, most_j: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The first state of each plateau through which a path costs at most `most_j`, and the plateaus' energies [J]."""
    states = np.flatnonzero(ahead.energy_j + behind.energy_j <= most_j)
    onward = behind.before(table, states)  # -1 at the goal
    at = np.minimum(np.searchsorted(states, onward), states.size - 1)
    shared = (states[at] == onward) & (ahead.before(table, states[at]) == states)
    end = np.where(shared, at, np.arange(states.size))
    begins = np.flatnonzero(shared & ~np.isin(np.arange(states.size), at[shared]))
    while not np.array_equal(further := end[end], end):
        end = further
    return states[begins], ahead.energy_j[states[end[begins]]] - ahead.energy_j[states[begins]]


def improved_ways(lattice: CostLattice, best: Points, others: Sequence[Points]) -> list[Points]:
    """Return alternatives after the any-angle step, those that still differ from the best path and each other.

    Where the step draws one into a path before it, both sides of its place farthest from them are improved instead.

    `lattice`: prices and limits; `best` (n, 2): (row, col) polyline of the best path, improved already; `others` (m,
    2): alternatives over grid moves. Result (k, 2): the improved alternatives that are left.
    """
    separation_m, limit = _separation_m(lattice, best), STRETCH * max(path_price(lattice, best), 0.0)
    away_m, kept = _metres_from(lattice, best), []
    for other in others:
        way = improved(lattice, other)
        if _share_beyond(lattice, way, away_m, separation_m) < LEAST_SHARE:
            far = int(np.argmax(away_m[_cells(lattice, other)][1:-1])) + 1
            ahead, behind = (improved(lattice, half) for half in (other[: far + 1], other[far:]))
            way = np.vstack([ahead, behind[1:]])
        if _share_beyond(lattice, way, away_m, separation_m) >= LEAST_SHARE and path_price(lattice, way) <= limit:
            kept.append(way)
            away_m = np.minimum(away_m, _metres_from(lattice, way))
    return kept


def _separation_m(lattice: CostLattice, best: Points) -> float:
    """A twentieth of the best path's length, at least three cells [m]."""
    return lattice.frame.resolution_m * max(3.0, 0.05 * path_length(best))


def _cells(lattice: CostLattice, points: Points) -> NDArray[np.int64]:
    """Flat indices of the cells under some places; a place on the border of the map is in the outermost cell."""
    row, col = np.clip(np.rint(points).astype(np.int64), 0, np.array(lattice.frame.shape) - 1).T
    return np.asarray(row * lattice.frame.cols + col)


def _share_beyond(lattice: CostLattice, way: Points, away_m: NDArray[np.float64], separation_m: float) -> float:
    return float(np.mean(away_m[_cells(lattice, subdivided(way, 1.0))] > separation_m))


def _metres_from(lattice: CostLattice, way: Points) -> NDArray[np.float64]:
    """(cells,) distance [m] of every cell from the nearest that lies along a path."""
    away = np.ones(lattice.frame.shape, dtype=bool)
    away.ravel()[_cells(lattice, subdivided(way, 1.0))] = False
    from scipy.ndimage import distance_transform_edt  # loads slowly, and most questions need it not

    return distance_transform_edt(away).ravel() * lattice.frame.resolution_m
