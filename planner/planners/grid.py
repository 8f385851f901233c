"""A* and Dijkstra over grid moves: exact, and fast enough for every question."""

from __future__ import annotations

from typing import Any

from joulemap.planner.grid.search import GridPath, grid_search
from joulemap.planner.lattice import CostLattice
from joulemap.planner.planners.contract import Options, Planner
from joulemap.planner.pricing.integrator import Points
from joulemap.planner.pricing.moves import MoveTable


def _astar(
    lattice: CostLattice, table: MoveTable, start: Points, goal: Points, options: Options
) -> tuple[Points, dict[str, Any]]:
    return _answer(grid_search(lattice, table, start, goal, planner="astar"))


def _dijkstra(
    lattice: CostLattice, table: MoveTable, start: Points, goal: Points, options: Options
) -> tuple[Points, dict[str, Any]]:
    return _answer(grid_search(lattice, table, start, goal, planner="dijkstra"))


def _answer(found: GridPath) -> tuple[Points, dict[str, Any]]:
    return found.points, {"expanded": found.expanded, "grid_energy_j": found.energy_j}


ASTAR = Planner("astar", _astar)
DIJKSTRA = Planner("dijkstra", _dijkstra)
