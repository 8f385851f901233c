"""Dijkstra and A* on the implicit grid, with or without turning, and the energy field they leave behind."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import BlockedError, InputError, NoRouteError
from joulemap.planner.edges import Points, leg_prices_between
from joulemap.planner.heuristics import dijkstra_bounds, energy_bounds, guide_towards
from joulemap.planner.kernels import turn_angle
from joulemap.planner.landmarks import Landmarks
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.moves import MoveTable
from joulemap.planner.states import layer_count, new_search, run_search

PLANNERS = ("astar", "dijkstra")
_NONE = -1


@dataclass(frozen=True, eq=False, repr=False)
class GridPath:
    """The answer of a grid search.

    points : (n, 2) (row, col) polyline from start to goal. energy_j : its energy as the search counted it.
    expanded : settled states.
    """

    points: Points
    energy_j: float
    expanded: int


def check_standing(lattice: CostLattice, x: float, y: float, *, name: str) -> tuple[int, int]:
    """The cell under a world point. Raises PointError outside the map, BlockedError where every heading
    is blocked; the reason given is the one that comes first in `Blocked`.
    """
    row, col = lattice.frame.cell_of(x, y, name=name)
    codes = lattice.window(row, row + 1, col, col + 1).blocked_by_heading()[0, 0]
    if codes.all():
        reason = Blocked(int(codes.min()))
        raise BlockedError(
            f"{name} ({x:.2f}, {y:.2f}) stands on blocked ground: {reason.label.replace('_', ' ')}",
            which=name,
            x=x,
            y=y,
            reason=reason.label,
        )
    return row, col


def standing_point(lattice: CostLattice, x: float, y: float, *, name: str) -> tuple[Points, bool]:
    """(2,) fractional (row, col) where a route begins or ends, and whether it was moved to its cell's centre.

    The point itself when some leg joins it to a neighbouring cell centre; otherwise (it leans on blocked ground) the
    centre of its own cell.
    """
    cell = check_standing(lattice, x, y, name=name)
    row, col = lattice.frame.rowcol(x, y)
    point = np.array([float(row), float(col)])
    _, legs = _connections(lattice, point, outward=True)
    if np.isfinite(legs).any():
        return point, False
    return np.array(cell, dtype=np.float64), True


def _connections(lattice: CostLattice, point: Points, *, outward: bool) -> tuple[NDArray[np.int64], Points]:
    """The (up to 4) cells around a point, (n, 2), and the energy [J] of the leg to each (or from each), NaN if none."""
    rows, cols = lattice.frame.shape
    near_rows = np.unique(np.clip([math.floor(point[0]), math.ceil(point[0])], 0, rows - 1))
    near_cols = np.unique(np.clip([math.floor(point[1]), math.ceil(point[1])], 0, cols - 1))
    cells = np.array([(r, c) for r in near_rows for c in near_cols], dtype=np.int64)
    centres = cells.astype(np.float64)
    here = np.broadcast_to(point, centres.shape)
    starts, ends = (here, centres) if outward else (centres, here)
    return cells, leg_prices_between(lattice, starts, ends)


def grid_search(
    lattice: CostLattice,
    table: MoveTable,
    start: Points,
    goal: Points,
    *,
    planner: str = "astar",
    landmarks: Landmarks | None = None,
) -> GridPath:
    """Least energy from `start` to `goal` over grid moves, exactly.

    start, goal : (2,) fractional (row, col), joined to the cell centres around them by straight legs. With a turn cost
    the state is (cell, heading) and every change of heading is paid for, at the first and last centre too. landmarks :
    of this table, for fewer expansions. Raises NoRouteError when the goal cannot be reached.
    """
    if planner not in PLANNERS:
        raise InputError(f"planner must be one of {', '.join(PLANNERS)}, got {planner!r}", planner=planner)
    layers = layer_count(lattice, table)
    cells, cost = terminals(lattice, table, start, layers, outward=True)
    targets, rest = terminals(lattice, table, goal, layers, outward=False)
    marks, slack_j = (landmarks.marks, landmarks.slack_j) if landmarks is not None else (None, 0.0)
    bounds = energy_bounds(table) if planner == "astar" else dijkstra_bounds(table)
    guide = guide_towards(
        table, bounds, goal, targets, rest.min(axis=1), lattice.frame.resolution_m, marks=marks, slack_j=slack_j
    )
    search = new_search(table, layers, cells, cost, backward=False)
    last, total, expanded = run_search(search, table, np.unique(cells), guide, targets, rest)
    direct = direct_energy(lattice, start, goal)
    if direct < math.inf and direct <= total:
        return GridPath(np.vstack([start, goal]), direct, expanded)
    if last == _NONE:
        robot = lattice.robot
        raise NoRouteError(
            f"no route: the start reaches {expanded:,} places, the goal is not among them within the limits "
            f"of {robot.name} (grade {robot.max_grade_deg:g} deg, cross slope {robot.max_cross_slope_deg:g} deg)",
            reached=expanded,
        )
    states = search.trace(table, last)[::-1]
    return GridPath(joined_points(lattice, start, states // layers, goal), float(total), expanded)


def direct_energy(lattice: CostLattice, start: Points, goal: Points) -> float:
    """Energy [J] of the straight leg between points a cell apart or less (the way over a centre may be a detour)."""
    if math.dist(start, goal) > 1.0:
        return math.inf
    energy = float(leg_prices_between(lattice, start[None], goal[None])[0])
    return energy if math.isfinite(energy) else math.inf


def joined_points(lattice: CostLattice, start: Points, cells: NDArray[np.int64], goal: Points) -> Points:
    """(n, 2) polyline from start over flat cell indices to goal, without repeated points."""
    cols = lattice.frame.cols
    points = np.vstack([start, np.column_stack([cells // cols, cells % cols]).astype(np.float64), goal])
    keep = np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-12)
    return np.ascontiguousarray(points[keep])


def terminals(
    lattice: CostLattice, table: MoveTable, point: Points, layers: int, *, outward: bool
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Cells that join a point to the grid, as flat indices (S,), and the cost of joining per heading layer (S, L).

    The layer of a seed is the heading of the *next* move, as if the robot had arrived in it; that of a target is the
    heading of the last move. The turn between a joining leg and that heading is part of the cost.
    """
    cells, legs = _connections(lattice, point, outward=outward)
    cost = np.repeat(legs[:, None], layers, axis=1)
    if layers > 1:
        for s, cell in enumerate(cells):
            for k, (drow, dcol) in enumerate(table.offsets):
                here, there = point, cell.astype(np.float64)
                angle = (
                    turn_angle(here[0], here[1], there[0], there[1], there[0] + drow, there[1] + dcol)
                    if outward
                    else turn_angle(there[0] - drow, there[1] - dcol, there[0], there[1], here[0], here[1])
                )
                cost[s, k] += lattice.robot.turn_j_per_rad * angle
    usable = np.isfinite(legs)
    return (cells[usable, 0] * lattice.frame.cols + cells[usable, 1]), np.ascontiguousarray(cost[usable])
