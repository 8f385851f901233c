"""Dijkstra and A* on the implicit grid, with or without turning, and the energy field they leave behind."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError, NoRouteError
from joulemap.model.robot import Robot
from joulemap.planner.grid.heuristics import dijkstra_bounds, energy_bounds, guide_towards
from joulemap.planner.grid.states import layer_count, new_search, run_search
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, leg_prices_between
from joulemap.planner.pricing.kernels import turn_angle
from joulemap.planner.pricing.moves import MoveTable
from joulemap.planner.pricing.polylines import distinct

GRID_PLANNERS = ("astar", "dijkstra")
_NONE = -1


@dataclass(frozen=True, eq=False, repr=False)
class GridPath:
    """The answer of a grid search.

    Attributes
    ----------
    points : ndarray of float, (n, 2)
        (row, col) polyline from start to goal.
    energy_j : float
        Its energy as the search counted it [J].
    expanded : int
        Number of settled states.
    """

    points: Points
    energy_j: float
    expanded: int


def joining_legs(lattice: CostLattice, point: Points, *, outward: bool) -> tuple[NDArray[np.int64], Points]:
    """Return the cells around a point and the energy of the straight leg to or from each of their centres.

    `point` (2,): fractional (row, col). Returns `cells` (n, 2): (row, col) of the 1 to 4 cells; `energy_j` (n,): energy
    of each leg [J], NaN where it may not be driven.
    """
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
) -> GridPath:
    """Return the path of least energy from start to goal over grid moves, exactly.

    With a turn cost the state is (cell, heading) and every change of heading is paid for, at the first and the last
    centre too.

    `start`, `goal` (2,): fractional (row, col), joined to the cell centres around them by straight legs. Result: the
    path, with its energy [J] and the number of settled states. Raises NoRouteError if the goal cannot be reached.

    Reference: Hart, Nilsson & Raphael 1968 (A*); Dijkstra 1959. Bounds: see `heuristics`. Queue: see `buckets`.
    """
    if planner not in GRID_PLANNERS:
        raise InputError(f"planner must be one of {', '.join(GRID_PLANNERS)}, got {planner!r}", planner=planner)
    layers = layer_count(lattice, table)
    cells, cost = terminals(lattice, table, start, layers, outward=True)
    targets, rest = terminals(lattice, table, goal, layers, outward=False)
    bounds = energy_bounds(table) if planner == "astar" else dijkstra_bounds(table)
    guide = guide_towards(table, bounds, goal, targets, rest.min(axis=1), lattice.frame.resolution_m)
    search = new_search(table, layers, cells, cost, backward=False)
    last, total, expanded = run_search(search, table, np.unique(cells), guide, targets, rest)
    direct = direct_energy(lattice, start, goal)
    if direct < math.inf and direct <= total:
        return GridPath(np.vstack([start, goal]), direct, expanded)
    if last == _NONE:
        raise no_route(lattice.robot, expanded)
    states = search.trace(table, last)[::-1]
    return GridPath(joined_points(lattice, start, states // layers, goal), float(total), expanded)


def no_route(robot: Robot, reached: int) -> NoRouteError:
    """Return the error that says that a goal cannot be reached."""
    return NoRouteError(
        f"no way leads from start to goal within the limits of {robot.name} (grade {robot.max_grade_deg:g} deg, "
        f"cross slope {robot.max_cross_slope_deg:g} deg, outline {robot.length_m:g} x {robot.width_m:g} m and "
        f"{robot.clearance_m:g} m of clearance): {reached:,} places can be reached from the start, and the "
        "goal is none of them; move the start or the goal",
        reached=reached,
    )


def direct_energy(lattice: CostLattice, start: Points, goal: Points) -> float:
    """Return the energy of the straight leg between two points within a cell length of each other.

    The path over a cell centre may be a detour then.

    `start`, `goal` (2,): fractional (row, col). Result: energy [J]; infinite where the points are further from each
    other or the leg may not be driven.
    """
    if math.dist(start, goal) > 1.0:
        return math.inf
    energy = float(leg_prices_between(lattice, start[None], goal[None])[0])
    return energy if math.isfinite(energy) else math.inf


def joined_points(lattice: CostLattice, start: Points, cells: NDArray[np.int64], goal: Points) -> Points:
    """Return the polyline from start over cell centres to goal, without repeated points.

    `start` (2,): fractional (row, col); `cells` (k,): flat cell indices, row * cols + col, in order; `goal` (2,):
    fractional (row, col). Result (n, 2): (row, col) polyline.
    """
    cols = lattice.frame.cols
    return distinct(np.vstack([start, np.column_stack([cells // cols, cells % cols]).astype(np.float64), goal]))


def terminals(
    lattice: CostLattice, table: MoveTable, point: Points, layers: int, *, outward: bool
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the cells that join a point to the grid, and the energy of joining it.

    `point` (2,): fractional (row, col). Returns `cells` (S,): flat cell indices, row * cols + col; `cost` (S, L):
    energy [J] of the leg that joins each, by heading, for a start that is the heading of the *next* move, as if the
    robot had arrived in it, for a goal it is the heading of the last move.
    """
    cells, legs = joining_legs(lattice, point, outward=outward)
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
