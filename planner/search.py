"""Dijkstra and A* on the implicit grid, with or without turning, and the energy field they leave behind."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.errors import BlockedError, InputError, NoRouteError
from planner.edges import Points, leg_prices_between
from planner.heuristics import dijkstra_bounds, energy_bounds
from planner.kernels import turn_angle
from planner.lattice import Blocked, CostLattice
from planner.moves import MoveTable
from planner.search_kernels import search_states, trace_cells

PLANNERS = ("astar", "dijkstra")
_NONE = -1


@dataclass(frozen=True, eq=False, repr=False)
class GridSearch:
    """What a search knows when it stops.

    energy_j : (rows, cols) float64, least energy from the start to each cell centre, over all arrival headings; inf
        where not reached, an upper bound where the search stopped before settling it.
    points : (n, 2) (row, col) polyline from start to goal, None for a one-to-all field. energy_to_goal_j : its energy
        as the search counted it. expanded : settled states.
    """

    energy_j: NDArray[np.float64]
    points: Points | None
    energy_to_goal_j: float
    expanded: int


def check_standing(lattice: CostLattice, x: float, y: float, *, name: str) -> tuple[int, int]:
    """The cell under a world point. Raises PointError outside the map, BlockedError where every heading
    is blocked; the reason given is the one that comes first in `Blocked`."""
    row, col = lattice.frame.cell_of(x, y, name=name)
    codes = lattice.window(row, row + 1, col, col + 1).blocked_by_heading()[0, 0]
    if codes.all():
        reason = Blocked(int(codes.min()))
        raise BlockedError(
            f"{name} ({x:.2f}, {y:.2f}) stands on blocked ground: {reason.label.replace('_', ' ')}",
            which=name, x=x, y=y, reason=reason.label,
        )  # fmt: skip
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
    lattice: CostLattice, table: MoveTable, start: Points, goal: Points | None, *, planner: str = "astar"
) -> GridSearch:
    """Least energy from `start` to `goal` over grid moves, exactly; to every cell when `goal` is None.

    start, goal : (2,) fractional (row, col), joined to the cell centres around them by straight legs. With a turn cost
    the state is (cell, heading of arrival) and every change of heading is paid for, at the first and last centre too.
    Raises NoRouteError when the goal cannot be reached, NegativeCycleError for impossible regeneration.
    """
    if planner not in PLANNERS:
        raise InputError(f"planner must be one of {', '.join(PLANNERS)}, got {planner!r}", planner=planner)
    bounds = energy_bounds(table) if planner == "astar" and goal is not None else dijkstra_bounds(table)
    turning = lattice.robot.turn_j_per_rad > 0.0
    layers = len(table.offsets) if turning else 1
    seeds, seed_cost = _terminals(lattice, table, start, layers, outward=True)
    targets, target_cost = (
        _terminals(lattice, table, goal, layers, outward=False)
        if goal is not None
        else (np.empty(0, dtype=np.int64), np.empty((0, layers)))
    )
    energy, pred, last, total, expanded = search_states(
        table.energy, table.offsets, table.turn_j, layers, lattice.elevation_m, lattice.frame.resolution_m,
        seeds, seed_cost, targets, target_cost, bounds,
    )  # fmt: skip
    field = (energy.reshape(-1, layers).min(axis=1) if turning else energy).reshape(lattice.frame.shape)
    if goal is None:
        return GridSearch(field, None, math.nan, expanded)
    if math.dist(start, goal) <= 1.0:  # both lean on the same cells: the way over a centre may be a detour
        direct = leg_prices_between(lattice, start[None], goal[None])[0]
        if direct <= total or (last == _NONE and np.isfinite(direct)):
            return GridSearch(field, np.vstack([start, goal]), float(direct), expanded)
    if last == _NONE:
        robot = lattice.robot
        raise NoRouteError(
            f"no route: the start reaches {expanded:,} places, the goal is not among them within the limits "
            f"of {robot.name} (grade {robot.max_grade_deg:g} deg, cross slope {robot.max_cross_slope_deg:g} deg)",
            reached=expanded,
        )
    nodes = trace_cells(pred, table.offsets, last, layers, lattice.frame.cols)
    points = np.vstack([start, nodes.astype(np.float64), goal])
    keep = np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-12)
    return GridSearch(field, np.ascontiguousarray(points[keep]), float(total), expanded)


def _terminals(lattice, table, point, layers, *, outward):
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
