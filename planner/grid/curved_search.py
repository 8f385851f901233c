"""Paths whose curves are no tighter than a radius: a search over poses, driven straight on or along arcs.

Poses are continuous; of those in one cell that have nearly one heading, the cheapest is kept (hybrid A*: Dolgov et al.
2010, "Path planning for autonomous vehicles in unknown semi-structured environments"). The energy over grid moves to
the goal leads it. Where the heading at the goal is given, a search over poses back from it comes first, until the robot
may have turned round: grid moves do not know what that costs. The path ends with a curve to the goal itself, and parts
of it are replaced by curves where that is cheaper. So are those of the best path without a radius, which may be the
cheaper one. The robot drives forwards only.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import NoRouteError
from joulemap.model.frames import heading_of
from joulemap.planner.grid.curves import CORNER, HEADINGS, curve, moved, rounded
from joulemap.planner.grid.fields import field_beyond, field_towards
from joulemap.planner.grid.stopping import check_stop, stop_flag
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, Prices, driven_prices, leg_prices_between
from joulemap.planner.pricing.kernels import path_energy
from joulemap.planner.pricing.moves import MoveTable

_STRAIGHT = math.sqrt(2.0) + 1e-9
"""Length of a straight move [cells]: the least that leaves every cell."""


def curved_path(
    lattice: CostLattice,
    table: MoveTable,
    start: Points,
    goal: Points,
    free: Points,
    *,
    start_rad: float | None = None,
    goal_rad: float | None = None,
) -> tuple[Points, int]:
    """Return a path of little energy whose curves are no tighter than the robot's turning radius.

    `start`, `goal` (2,): fractional (row, col); `free` (m, 2): the best path without a radius, which is rounded too;
    `start_rad`, `goal_rad`: headings there [rad], any without them. Returns `points` (n, 2): a (row, col) polyline;
    `expanded`: number of settled poses. Raises NoRouteError.
    """
    radius = lattice.robot.min_turning_radius_m / lattice.frame.resolution_m
    cell_j = table.typical_j / float(table.length_m.mean()) * lattice.frame.resolution_m
    prices = driven_prices(lattice, cell_j)
    begins = np.arange(HEADINGS) * CORNER if start_rad is None else np.array([start_rad])
    seeds = np.column_stack([np.tile(start, (begins.size, 1)), begins])
    first = np.append(start, np.nan if start_rad is None else start_rad)
    last = np.append(goal, np.nan if goal_rad is None else goal_rad)
    ahead, known = field_towards(lattice, table, goal[None]).energy_j, np.zeros(0, dtype=np.float32)
    if goal_rad is not None:  # half a circle at its usual price: enough to come from the other side
        ahead, known = _energy_ahead(lattice, table, prices, last, math.pi * radius * cell_j)
    poses, came, _, _, at, expanded = _search(prices, radius, seeds, last, ahead, known, math.inf, stop_flag())
    check_stop()
    found = [rounded(prices, radius, free, *_poses_along(free, first, last))]
    if at >= 0:
        way = [at]
        while (at := came[at]) >= 0:
            way.append(at)
        found.append(rounded(prices, radius, *_driven(poses[way[::-1]], first, last, radius)))
    ways = [points for points in found if len(points)]
    if not ways:
        raise NoRouteError(
            "no way leads from start to goal on which no curve is tighter than the turning radius of "
            f"{lattice.robot.min_turning_radius_m:g} m of {lattice.robot.name}: with min_turning_radius_m 0 a route "
            "exists; driving backwards is not planned",
            limit="min_turning_radius_m",
            allowed=lattice.robot.min_turning_radius_m,
            reached=expanded,
        )
    return min(ways, key=lambda points: path_energy(prices, points)), expanded


Array = NDArray[np.float64]


def _poses_along(line: Points, first: Array, last: Array) -> tuple[Array, NDArray[np.int64]]:
    """The middles of the legs of a polyline as poses, with its ends; and the vertex that each of them follows."""
    step = np.diff(line, axis=0)
    middles = np.column_stack([line[:-1] + 0.5 * step, heading_of(step[:, 1], -step[:, 0])])
    legs = np.arange(len(step))
    return np.vstack([first, middles, last]), np.concatenate([legs[:1], legs, legs[-1:]])


def _driven(poses: Array, first: Array, last: Array, radius: float) -> tuple[Points, Array, NDArray[np.int64]]:
    """The polyline that the search drove over poses and by a curve to the last one; with these, as `_poses_along`."""
    turned = np.diff(poses[:, 2]) != 0.0
    after, tangent = poses[1:][turned], radius * math.tan(0.5 * CORNER)
    corners = after[:, :2] + tangent * np.column_stack([np.cos(after[:, 2]), -np.sin(after[:, 2])])
    line = np.vstack([poses[:1, :2], corners, curve(poses[-1], last, radius)[1:]])
    return line, np.vstack([first, poses[1:], last]), np.append(np.cumsum([0, *turned]), len(line) - 2)


def _energy_ahead(
    lattice: CostLattice, table: MoveTable, prices: Prices, goal: Array, most_j: float
) -> tuple[Array, NDArray[np.float32]]:
    """About the least energies to a pose (row, col, heading): from every cell, and from poses near it [J].

    Poses back from it are settled up to some energy; whatever the heading, other ways lead over the last of them, by
    grid moves. Returns `ahead` (rows, cols): of such ways; `known` (cells * HEADINGS,): of the poses, 0 elsewhere.
    """
    shape, cols = lattice.frame.shape, lattice.frame.cols
    radius = lattice.robot.min_turning_radius_m / lattice.frame.resolution_m
    known = np.zeros(shape[0] * cols * HEADINGS, dtype=np.float32)  # memory that is not touched is not taken
    poses, _, spent, last, *_ = _search(prices, radius, goal[None], goal, np.zeros(shape), known, most_j, stop_flag())
    check_stop()
    ends, border = poses[last, :2], np.full(shape[0] * cols, np.inf)
    for down, right in np.ndindex(2, 2):
        around = np.clip(np.floor(ends) + np.array([down, right]), 0, np.array(shape) - 1)
        rest = spent[last] + leg_prices_between(lattice, around, ends)
        np.fmin.at(border, around.astype(np.int64) @ [cols, 1], rest)
    first = np.flatnonzero(border < np.inf)
    return field_beyond(lattice, table, first, border[first]).energy_j, known


@njit(cache=True)
def _least_around(ahead, row, col):
    """The least of the values at the centres around a place."""
    least = np.inf
    for i in (math.floor(row), math.ceil(row)):
        for j in (math.floor(col), math.ceil(col)):
            if 0 <= i < ahead.shape[0] and 0 <= j < ahead.shape[1]:
                least = min(least, ahead[i, j])
    return least


@njit(cache=True, nogil=True)
def _search(prices, radius, seeds, goal, ahead, known, most, stop):
    """Settle poses from some seeds until a curve to the goal is cheapest; or back from the seeds, up to some energy.

    seeds (S, 3); goal (3,): poses. ahead (rows, cols): energy to the goal [J]. known (cells * HEADINGS,) or (0,): that
    from poses, 0 where `ahead` counts; a search back fills it. most : energy up to which poses back from the seeds are
    settled [J]; infinite for a search to the goal.

    Returns the poses (n, 3), what each came from (n,), the energy between it and its seed (n,) [J]; those that were not
    settled; the last pose before the goal, -1 where there is none; and the number of settled ones.
    """
    rows, cols = ahead.shape
    backward = most < np.inf
    way = -1.0 if backward else 1.0
    tangent, near = radius * math.tan(0.5 * CORNER), 4.0 * radius + 2.0 * _STRAIGHT
    kept = np.zeros(ahead.size * HEADINGS, dtype=np.int32)  # memory that is not touched is not taken
    nodes, came, spent = np.empty((1024, 3)), np.empty(1024, np.int64), np.empty(1024)
    count = expanded = 0
    best, last = np.inf, -1
    heap = [(0.0, 0)]
    heap.clear()
    for k in range(len(seeds)):
        rest = _least_around(ahead, seeds[k, 0], seeds[k, 1])
        nodes[k], came[k], spent[k] = seeds[k], -1, 0.0
        count += 1
        if rest < np.inf:
            heapq.heappush(heap, (rest, k))
    line, corner = np.empty((2, 2)), np.empty((3, 2))
    while len(heap) > 0 and heap[0][0] < min(best, most) and stop[0] == 0:
        _, k = heapq.heappop(heap)
        pose = nodes[k, 0], nodes[k, 1], nodes[k, 2]
        if k >= len(seeds) and kept[_key(pose, cols)] != k + 1:
            continue
        expanded += 1
        if backward:
            known[_key(pose, cols)] = spent[k]
        elif k < len(seeds) or math.hypot(pose[0] - goal[0], pose[1] - goal[1]) <= near:
            points = curve(nodes[k], goal, radius)
            total = spent[k] + path_energy(prices, points) if len(points) > 0 else np.inf
            if total < best:
                best, last = total, k
        for turn in (0, 1, -1):
            points = line if turn == 0 else corner
            points[0, 0], points[0, 1] = pose[0], pose[1]
            if turn == 0:
                to = moved(pose, way * _STRAIGHT)
            else:
                middle = moved(pose, way * tangent)
                points[1, 0], points[1, 1] = middle[0], middle[1]
                to = moved((middle[0], middle[1], pose[2] + turn * CORNER), way * tangent)
            points[-1, 0], points[-1, 1] = to[0], to[1]
            if not (-0.5 <= to[0] <= rows - 0.5 and -0.5 <= to[1] <= cols - 0.5):
                continue
            rest, key = _least_around(ahead, to[0], to[1]), _key(to, cols)
            if not backward and known.size > 0 and known[key] > 0.0:
                rest = known[key]
            reached = spent[k] + path_energy(prices, points[::-1].copy() if backward else points)
            if not reached + rest < best or (kept[key] > 0 and spent[kept[key] - 1] <= reached):
                continue
            if count == len(nodes):
                nodes, came = np.concatenate((nodes, nodes)), np.concatenate((came, came))
                spent = np.concatenate((spent, spent))
            nodes[count, 0], nodes[count, 1], nodes[count, 2] = to
            came[count], spent[count] = k, reached
            count += 1
            kept[key] = count
            heapq.heappush(heap, (reached + rest, count - 1))
    waiting = np.array([k for _, k in heap], dtype=np.int64)
    return nodes[:count], came[:count], spent[:count], waiting, last, expanded


@njit(cache=True)
def _key(pose, cols):
    """The number of a cell and a heading."""
    heading = int(round(pose[2] / CORNER)) % HEADINGS
    return (int(round(max(pose[0], 0.0))) * cols + int(round(max(pose[1], 0.0)))) * HEADINGS + heading
