"""Dijkstra and A* on the implicit grid, with or without turning, and the energy field they leave behind."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from model.errors import BlockedError, InputError, NoRouteError
from planner.edges import Points, leg_prices_between
from planner.heuristics import dijkstra_bounds, energy_bounds
from planner.kernels import turn_angle
from planner.lattice import Blocked, CostLattice
from planner.moves import MoveTable

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
    """The cell under a world point. Raises PointError outside the map, BlockedError where the robot cannot stand."""
    row, col = lattice.frame.cell_of(x, y, name=name)
    reason = Blocked(int(lattice.blocked[row, col]))
    if reason is not Blocked.FREE:
        raise BlockedError(
            f"{name} ({x:g}, {y:g}) stands on blocked ground: {reason.label.replace('_', ' ')}",
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
    energy, pred, last, total, expanded = _search(
        table.energy, table.offsets, table.turn_j, layers, lattice.elevation_m, lattice.frame.resolution_m,
        seeds, seed_cost, targets, target_cost, bounds,
    )  # fmt: skip
    field = energy.reshape(*lattice.frame.shape, layers).min(axis=2)
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
    nodes = _trace(pred, table.offsets, last, layers, lattice.frame.cols)
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


@njit(cache=True)
def _bound(bounds, row, col, z, target_row, target_col, target_z, target_rest, spacing):
    """Lower bound of the energy from a cell to the goal: over bounds the best, over targets the least."""
    if target_row.size == 0:
        return -bounds[0, 1] * z
    least = np.inf
    for k in range(target_row.size):
        distance = math.hypot(target_row[k] - row, target_col[k] - col) * spacing
        best = -np.inf
        for b in range(bounds.shape[0]):
            best = max(best, bounds[b, 0] * distance + bounds[b, 1] * (target_z[k] - z))
        least = min(least, best + target_rest[k])
    return least


@njit(cache=True)
def _sift_up(heap, place, key, k):
    node = heap[k]
    value = key[node]
    while k > 0:
        parent = (k - 1) >> 2
        other = heap[parent]
        if key[other] <= value:
            break
        heap[k] = other
        place[other] = k
        k = parent
    heap[k] = node
    place[node] = k


@njit(cache=True)
def _sift_down(heap, place, key, size):
    node = heap[0]
    value = key[node]
    k = 0
    while True:
        child = 4 * k + 1
        if child >= size:
            break
        best = child
        for c in range(child + 1, min(child + 4, size)):
            if key[heap[c]] < key[heap[best]]:
                best = c
        other = heap[best]
        if key[other] >= value:
            break
        heap[k] = other
        place[other] = k
        k = best
    heap[k] = node
    place[node] = k


@njit(cache=True)
def _search(
    move_energy, offsets, turn, layers, elevation, spacing, seeds, seed_cost, targets, target_cost, bounds
):  # fmt: skip
    """A* over states (cell, layer) with a 4-ary heap of decreasing keys; Dijkstra when `bounds` are flat.

    Returns energy (states,), pred (states,) uint16 of move * layers + predecessor layer + 1 (0: a seed), the last state
    (-1: not reached), the energy to the goal, and the number of settled states.
    """
    rows, cols, moves = move_energy.shape
    states = rows * cols * layers
    energy = np.full(states, np.inf)
    key = np.empty(states)
    pred = np.zeros(states, dtype=np.uint16)
    place = np.full(states, -1, dtype=np.int32)
    heap = np.empty(states, dtype=np.int32)
    target_row = np.empty(targets.size)
    target_col = np.empty(targets.size)
    target_z = np.empty(targets.size)
    target_rest = np.empty(targets.size)
    is_target = np.full(rows * cols, -1, dtype=np.int8)
    for k in range(targets.size):
        target_row[k] = targets[k] // cols
        target_col[k] = targets[k] % cols
        target_z[k] = elevation[targets[k] // cols, targets[k] % cols]
        target_rest[k] = target_cost[k].min()
        is_target[targets[k]] = k
    size = 0
    for s in range(seeds.size):
        row, col = seeds[s] // cols, seeds[s] % cols
        ahead = _bound(bounds, row, col, elevation[row, col], target_row, target_col, target_z, target_rest, spacing)
        for layer in range(layers):
            state = seeds[s] * layers + layer
            energy[state] = seed_cost[s, layer]
            key[state] = energy[state] + ahead
            heap[size] = state
            _sift_up(heap, place, key, size)
            size += 1
    total = np.inf
    last = -1
    expanded = 0
    while size > 0:
        state = heap[0]
        if key[state] >= total:
            break
        size -= 1
        if size > 0:
            heap[0] = heap[size]
            _sift_down(heap, place, key, size)
        place[state] = -1
        expanded += 1
        layer = state % layers
        cell = state // layers
        goal = is_target[cell]
        if goal >= 0 and energy[state] + target_cost[goal, layer] < total:
            total = energy[state] + target_cost[goal, layer]
            last = state
        row, col = cell // cols, cell % cols
        for n in range(moves):
            step = move_energy[row, col, n]
            if math.isnan(step):
                continue
            reached = energy[state] + step
            r, c = row + offsets[n, 0], col + offsets[n, 1]
            other = r * cols + c
            if layers > 1:
                reached += turn[layer, n]
                other = other * layers + n
            if reached < energy[other]:
                if place[other] < 0:
                    if energy[other] < np.inf and reached > energy[other] - 1e-9 * (1.0 + abs(reached)):
                        continue  # settled before; the gain is rounding of the bounds
                    ahead = _bound(
                        bounds, r, c, elevation[r, c], target_row, target_col, target_z, target_rest, spacing
                    )
                    place[other] = size
                    heap[size] = other
                    size += 1
                    key[other] = reached + ahead
                else:
                    key[other] += reached - energy[other]
                energy[other] = reached
                pred[other] = n * layers + layer + 1
                _sift_up(heap, place, key, place[other])
    return energy, pred, last, total, expanded


@njit(cache=True)
def _trace(pred, offsets, last, layers, cols):
    """(n, 2) int64 cells from the first to the state `last`."""
    count = 1
    state = last
    while pred[state] > 0:
        code = pred[state] - 1
        n = code // layers
        cell = state // layers - offsets[n, 0] * cols - offsets[n, 1]
        state = cell * layers + code % layers
        count += 1
    out = np.empty((count, 2), dtype=np.int64)
    state = last
    for k in range(count - 1, -1, -1):
        out[k, 0] = (state // layers) // cols
        out[k, 1] = (state // layers) % cols
        if k > 0:
            code = pred[state] - 1
            n = code // layers
            cell = state // layers - offsets[n, 0] * cols - offsets[n, 1]
            state = cell * layers + code % layers
    return out
