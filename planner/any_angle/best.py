"""The best path of any angles between two places: one function, which every question goes through.

A grid search says in which cells it may lie (`region`). One more search, among points on the lines between their
centres, decides between all ways through these cells at once (`line_points`). Its path is then moved to the least
energy nearby: vertices slide along the lines, settle by Newton's method, and are bent by small shares of a cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.any_angle.bending import ACROSS, ALONG, ON_LINE, bent
from joulemap.planner.any_angle.line_points import cheapest_over_line_points
from joulemap.planner.any_angle.newton import settled
from joulemap.planner.any_angle.region import region_around, region_between
from joulemap.planner.any_angle.shortcuts import shortcuts
from joulemap.planner.grid.stopping import check_stop
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, leg_prices, path_price, price_arrays
from joulemap.planner.pricing.moves import MoveTable
from joulemap.planner.pricing.polylines import distinct, path_length, subdivided

ANY_ANGLE_NEIGHBOURS = 32
"""Moves per cell of the grid search before: more headings find other passages and other valleys."""
OPEN_PARTS, CLOSED_PARTS = 4, 8
"""Parts of the side of a square on open ground, and where moves are closed beside the grid path."""
OPEN_ROUNDS, CLOSED_ROUNDS = 1, 2
"""How often all `BENDS` are tried there: next to closed ground a path has more corners."""
AROUND = 2
"""How far beside a given path the cells lie among which it is improved."""
SLIDES = (1 / 16, 1 / 32, 1 / 64)
"""Shifts along the lines between centres [cells]: halves of what the line points leave, and so on."""
PROBES = np.array([0.25, 0.0625])
"""Probes of Newton's method, for vertices a cell apart [cells]."""
BENDS = (0.25, 0.125, 1 / 32)
"""Shifts of vertices half a cell apart [cells]: a path may bend within a cell."""
LONG_SHIFTS = (4.0, 1.0)
"""Shifts of the corners of long legs [cells]: so a zigzag changes its angle."""
CORNER_SHIFTS = (8.0, *LONG_SHIFTS, 0.5, 0.25, 0.125, 1 / 16, 1 / 32)
"""Shifts of corners where they are all there is to move [cells]."""


@dataclass(frozen=True, eq=False, repr=False)
class BestPath:
    """The best path found.

    Attributes
    ----------
    points : ndarray of float, (n, 2)
        (row, col) polyline.
    energy_j : float
        Its energy [J].
    grid_energy_j : float
        Least energy over grid moves [J].
    expanded : int
        Number of settled states.
    """

    points: Points
    energy_j: float
    grid_energy_j: float
    expanded: int


def best_path(lattice: CostLattice, table: MoveTable, start: Points, goal: Points) -> BestPath:
    """Return the best path of any angles between two places (row, col).

    Raises NoRouteError if the goal cannot be reached. The path is at most as dear as the cheapest one over grid moves.
    """
    region = region_between(lattice, table, start, goal)
    grid, points = region.grid, region.grid.points
    if region.cells is not None:
        check_stop()
        points = _cheapest_in(lattice, region.cells, points, closed=region.beside_closed)
    return BestPath(points, path_price(lattice, points), grid.energy_j, grid.expanded)


def improved(lattice: CostLattice, points: Points) -> Points:
    """Return the best path of any angles within a few cells of a (row, col) polyline: at most as dear, (n, 2)."""
    points = distinct(np.ascontiguousarray(points, dtype=np.float64))
    if path_length(points) == 0.0 or math.isnan(path_price(lattice, points)):
        return points
    points = shortcuts(lattice, points)
    return _cheapest_in(lattice, region_around(lattice, points, half_side=AROUND), points, closed=True)


def tightened(lattice: CostLattice, points: Points) -> Points:
    """Return a (row, col) polyline after shortcuts and shifts of its corners: at most as dear, no vertex added."""
    points = shortcuts(lattice, distinct(np.ascontiguousarray(points, dtype=np.float64)))
    for step in CORNER_SHIFTS:
        points = _bent(lattice, points, step)
    return shortcuts(lattice, points)


def shorter_of(lattice: CostLattice, distances: CostLattice, shortest: Points, points: Points) -> Points:
    """Return the shortest path known: the route of least energy may know a passage that the moves of the grid miss.

    distances : the same limits at a price of 1 J/m. shortest, points : (row, col) of the shortest path over the grid,
    improved, and of the route of least energy, whose corners are cut where it is the shorter one.
    """
    if not path_length(points) < path_length(shortest):
        return shortest
    cut = tightened(distances, points)
    return points if math.isnan(path_price(lattice, cut)) else cut


def _cheapest_in(lattice: CostLattice, cells: NDArray[np.bool_], known: Points, *, closed: bool) -> Points:
    """The cheapest path over line points of some cells, moved to the least energy nearby.

    It is at most as dear as a known one. closed : whether moves are closed near that. Where turning costs, the known
    path is moved too: the grid weighs turns exactly, at fewer headings.
    """
    known = shortcuts(lattice, known)
    typical_j = float(np.abs(leg_prices(lattice, known)).sum()) / max(path_length(known), 1.0)
    turning = lattice.robot.turn_j_per_rad > 0.0
    parts, rounds = (CLOSED_PARTS, CLOSED_ROUNDS) if closed or turning else (OPEN_PARTS, OPEN_ROUNDS)
    found = cheapest_over_line_points(
        lattice, cells, known[0], known[-1], parts=parts, typical_j=typical_j or lattice.robot.weight_n
    )
    paths = [found, known] if len(found) and turning else [found] if len(found) else [known]
    return min([*(_moved(lattice, path, rounds) for path in paths), known], key=lambda path: path_price(lattice, path))


def _moved(lattice: CostLattice, points: Points, rounds: int) -> Points:
    """The path after all its vertices were moved to the least energy nearby. rounds : how often it is bent."""
    arrays = price_arrays(lattice)
    if lattice.robot.turn_j_per_rad > 0.0:
        points = tightened(lattice, points)
    else:
        for step in SLIDES:
            points = bent(*arrays, 0.0, points, step, ON_LINE)
        points = shortcuts(lattice, points)
        for step in LONG_SHIFTS:
            points = _bent(lattice, points, step)
        points = shortcuts(lattice, settled(*arrays, subdivided(points, 1.0), PROBES))
    for _ in range(rounds):
        points = subdivided(points, 0.5)
        for step in BENDS:
            points = _bent(lattice, points, step)
        points = shortcuts(lattice, points)
    return points


def _bent(lattice: CostLattice, points: Points, step: float) -> Points:
    """The path after shifts of its vertices across it and along it."""
    check_stop()
    for direction in (ACROSS, ALONG):
        points = bent(*price_arrays(lattice), lattice.robot.turn_j_per_rad, points, step, direction)
    return points
