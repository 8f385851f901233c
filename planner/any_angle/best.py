"""The best path of any angles between two places: one function, which every question goes through.

A grid search says in which cells it may lie (`region`). One more search, among points on the lines between their
centres, decides between all ways through these cells at once (`line_points`). Its path is then moved to the least
energy nearby: vertices slide along the lines, and are then bent by small shares of a cell.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.any_angle.bending import ACROSS, ALONG, ON_LINE, bent
from joulemap.planner.any_angle.line_points import cheapest_over_line_points
from joulemap.planner.any_angle.region import region_around, region_between
from joulemap.planner.any_angle.shortcuts import shortcuts
from joulemap.planner.grid.stopping import check_stop
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import (
    MARGIN_PENALTY,
    SHAPE_PENALTY,
    Points,
    Prices,
    driven_prices,
    exact_prices,
    leg_prices,
    margin_cells,
    metres_within_margin,
    path_price,
    within_margin,
)
from joulemap.planner.pricing.kernels import path_energy
from joulemap.planner.pricing.moves import MoveTable
from joulemap.planner.pricing.polylines import distinct, path_length, subdivided

ANY_ANGLE_NEIGHBOURS = 32
"""Moves per cell of the grid search before: more headings find other passages and other valleys."""
OPEN_PARTS, CLOSED_PARTS = 4, 8
"""Parts of the side of a square on open ground, and where moves are closed beside the grid path."""
AROUND = 2
"""How far beside a given path the cells lie among which it is improved."""
OPEN_SPACING, CLOSED_SPACING = 1.0, 0.5
"""Between vertices that are bent, likewise [cells]: beside closed ground a path bends within a cell."""
SHIFTS = (0.5 / CLOSED_PARTS, 0.125 / CLOSED_PARTS)
"""Of vertices, along the lines between centres and then across the path and along it [cells]: half of what the line
points leave, and a fourth of that."""
CORNER_SHIFTS = (8.0, 4.0, 1.0, 0.5, 0.25, 0.125, 1 / 16, 1 / 32)
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
        Energy of the cheapest path over grid moves, penalties of the margin not counted [J]: it may keep less of it.
    expanded : int
        Number of settled states.
    """

    points: Points
    energy_j: float
    grid_energy_j: float
    expanded: int


def best_path(
    lattice: CostLattice,
    table: MoveTable,
    start: Points,
    goal: Points,
    *,
    read: Callable[[NDArray[np.bool_], Points], bool] | None = None,
) -> BestPath:
    """Return the best path of any angles between two places (row, col).

    read : of a lattice on disk, gets the cells and the grid path, and reads the lattice around the cells, or only
    around the path where they are too many: then it returns false, and the path is improved where it is.

    Raises NoRouteError if the goal cannot be reached. For a robot that keeps to its path exactly it is at most as dear
    as the cheapest one over grid moves; else it is the best as the robot will drive it (`driven_prices`).
    """
    region = region_between(lattice, table, start, goal)
    grid, points = region.grid, region.grid.points
    if region.cells is not None and read is not None and not read(region.cells, points):
        points = improved(lattice, points)
    elif region.cells is not None:
        points = _cheapest_in(lattice, region.cells, points, closed=region.beside_closed, any_closed=region.any_closed)
    return BestPath(points, path_price(lattice, points), path_price(lattice, grid.points), grid.expanded)


def improved(lattice: CostLattice, points: Points) -> Points:
    """Return the best path of any angles within a few cells of a (row, col) polyline, (n, 2)."""
    points = distinct(np.ascontiguousarray(points, dtype=np.float64))
    if path_length(points) == 0.0 or math.isnan(path_price(lattice, points)):
        return points
    points = shortcuts(_prices(lattice, points), points)
    around = region_around(lattice, points, half_side=AROUND)
    return _cheapest_in(lattice, around, points, closed=True, any_closed=True)


def driven_energy_j(lattice: CostLattice, points: Points, *, like: Points) -> float:
    """The energy of a (row, col) polyline as the robot will drive it, penalties of its margin included [J].

    like : a path whose energy says what a metre usually costs; paths are compared with the same one.
    """
    return float(path_energy(_prices(lattice, like), points))


def tightened(lattice: CostLattice, points: Points) -> Points:
    """Return a (row, col) polyline after shortcuts and shifts of its corners, with no vertex added."""
    points = distinct(np.ascontiguousarray(points, dtype=np.float64))
    return _tightened(_prices(lattice, points), points)


def shorter_of(lattice: CostLattice, distances: CostLattice, shortest: Points, points: Points) -> Points:
    """Return the shortest path known: the route of least energy may know a passage that the moves of the grid miss.

    distances : the same limits at a price of 1 J/m. shortest, points : (row, col) of the shortest path over the grid,
    improved, and of the route of least energy, whose corners are cut where it is the shorter one.
    """
    if not path_length(points) < path_length(shortest):
        return shortest
    cut = tightened(distances, points)
    return points if math.isnan(path_price(lattice, cut)) else cut


def margin_notes(lattice: CostLattice, points: Points) -> list[str]:
    """Return what the driver should know where a (row, col) polyline is nearer to closed ground than the margin."""
    metres = metres_within_margin(lattice, points)
    if metres == 0.0:
        return []
    margin_m = margin_cells(lattice) * lattice.frame.resolution_m
    return [
        f"for {metres:.1f} m the route is nearer than {margin_m:g} m to ground that may not be driven: no way around "
        f"was found that costs less than {MARGIN_PENALTY:g} times as much as that stretch"
    ]


def _prices(lattice: CostLattice, points: Points) -> Prices:
    """The prices of paths like a known one, as the robot will drive them."""
    return driven_prices(lattice, _cell_j(lattice, points))


def _cell_j(lattice: CostLattice, points: Points) -> float:
    """Energy of a typical cell's length of a path [J], above 0."""
    size = float(np.abs(leg_prices(lattice, points)).sum()) / max(path_length(points), 1.0)
    return size if size > 0.0 else lattice.robot.weight_n


def _cheapest_in(
    lattice: CostLattice, cells: NDArray[np.bool_], known: Points, *, closed: bool, any_closed: bool
) -> Points:
    """The cheapest path over line points of some cells, moved to the least energy nearby.

    It is at most as dear as a known one. closed : whether moves are closed near that; any_closed : from any of the
    cells, else no margin is needed. A path that comes within the margin is the best of its passage for its shape
    (`SHAPE_PENALTY`). Where turning costs, the known path is moved too: the grid weighs turns exactly, at fewer
    headings.
    """
    check_stop()
    typical_j = _cell_j(lattice, known)
    passages = driven_prices(lattice, typical_j) if any_closed else exact_prices(lattice)
    known = shortcuts(passages, known)
    turning = passages.turn_j_per_rad > 0.0
    fine = closed or turning

    def _cheapest(prices: Prices, cells: NDArray[np.bool_]) -> Points:
        parts = CLOSED_PARTS if fine else OPEN_PARTS
        found = cheapest_over_line_points(lattice, prices, cells, known[0], known[-1], parts=parts, typical_j=typical_j)
        return found if len(found) else known

    prices, path = passages, _cheapest(passages, cells)
    if any_closed and within_margin(lattice, path):
        prices = driven_prices(lattice, typical_j, penalty=SHAPE_PENALTY)
        path = _cheapest(prices, region_around(lattice, path, half_side=AROUND))
    paths = [path, known] if turning and path is not known else [path]
    return min([known, *(_moved(prices, path, fine) for path in paths)], key=lambda path: path_energy(passages, path))


def _moved(prices: Prices, points: Points, fine: bool) -> Points:
    """The path after its vertices were moved to the least energy nearby. fine : whether it bends within a cell."""
    if prices.turn_j_per_rad > 0.0:
        points = _tightened(prices, points)
    else:
        for step in SHIFTS:
            points = bent(prices, points, step, ON_LINE)
        points = shortcuts(prices, points)
    points = subdivided(points, CLOSED_SPACING if fine else OPEN_SPACING)
    for step in SHIFTS:
        points = _bent(prices, points, step)
    return shortcuts(prices, points)


def _tightened(prices: Prices, points: Points) -> Points:
    """As `tightened`."""
    points = shortcuts(prices, points)
    for step in CORNER_SHIFTS:
        points = _bent(prices, points, step)
    return shortcuts(prices, points)


def _bent(prices: Prices, points: Points, step: float) -> Points:
    """The path after shifts of its vertices across it and along it."""
    check_stop()
    for direction in (ACROSS, ALONG):
        points = bent(prices, points, step, direction)
    return points
