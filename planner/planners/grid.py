"""A* and Dijkstra over grid moves: exact, and fast enough for every question."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from joulemap.planner.planners.contract import Options, Planner

if TYPE_CHECKING:  # names of planners are listed without what searches
    from joulemap.planner.lattice import CostLattice
    from joulemap.planner.pricing.integrator import Points
    from joulemap.planner.pricing.moves import MoveTable


def _searched(
    lattice: CostLattice, table: MoveTable, start: Points, goal: Points, options: Options, *, name: str
) -> tuple[Points, dict[str, Any]]:
    from joulemap.planner.grid.search import grid_search

    found = grid_search(lattice, table, start, goal, planner=name)
    return found.points, {"expanded": found.expanded, "grid_energy_j": found.energy_j}


ASTAR = Planner("astar", partial(_searched, name="astar"))
DIJKSTRA = Planner("dijkstra", partial(_searched, name="dijkstra"))
