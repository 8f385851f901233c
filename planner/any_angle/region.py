"""The cells in which the best path may lie: those of all grid paths whose energy is within a margin of the least.

A grid of 32 neighbours makes a path up to 1.31 % dearer than it is at any angle, and not every path by the same share:
the differences add up like a random walk, so their share falls with the root of the length. An A* search that goes on
until every cell is settled whose path costs at most the margin more, and a second one back from the goal among those
cells alone, give the least energy of a path through each cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.planner.grid.heuristics import energy_bounds, guide_everywhere, guide_towards
from joulemap.planner.grid.search import GridPath, direct_energy, joined_points, no_route, terminals
from joulemap.planner.grid.states import layer_count, new_search, run_search
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, margin_cells
from joulemap.planner.pricing.moves import MoveTable
from joulemap.planner.pricing.polylines import subdivided

CLOSED_LAG, OPEN_LAG = 0.15, 0.015
"""Most energy of a grid path beyond the least, as a share of the energy of a cell, for each root of its length [cells]:
where moves are closed beside the cheapest path, and elsewhere. Tried on five maps (`python -m tests.bench.guard`); half
of the first makes answers on a real hillside 0.06 % dearer in the mean, twice as much none cheaper."""
LEAST_CELLS = 400.0
"""Shorter paths have the margin of this length: a passage costs the same on a short way [cells]."""
CLOSED_GROWTH, OPEN_GROWTH = 2, 1
"""Cells beside those of these paths that take part too."""
_NONE = -1


@dataclass(frozen=True, eq=False, repr=False)
class Region:
    """Where the best path may lie.

    Attributes
    ----------
    grid : GridPath
        The cheapest path over grid moves.
    cells : ndarray of bool, (rows, cols), or None
        The cells; None where start and goal are within a cell of each other and `grid` is the leg between them.
    beside_closed : bool
        Whether moves are closed beside the grid path.
    any_closed : bool
        Whether moves are closed from any of the cells.
    """

    grid: GridPath
    cells: NDArray[np.bool_] | None
    beside_closed: bool
    any_closed: bool


def region_between(lattice: CostLattice, table: MoveTable, start: Points, goal: Points) -> Region:
    """The region of two places (row, col); raises NoRouteError if the goal cannot be reached.

    Where the cheapest path over all moves keeps the robot's margin by itself, the cells are those of such paths. Else
    they are also those of paths on which moves within the margin count as dearer. Moves keep to centres, so a passage
    may be wide enough for a path at any angle and too narrow for any of them; hence those of paths on which only moves
    in narrow passages do (`MoveTable.narrow`), too.
    """
    plain = _region_between(lattice, table, table.near[:0], start, goal)
    if plain.cells is None or not _near_closed(table, plain.grid.points):
        return plain
    region = _region_between(lattice, table, table.near, start, goal)
    for other in (plain, _region_between(lattice, table, table.narrow, start, goal)):
        if other.cells is not None and region.cells is not None:
            region.cells[other.cells] = True
    return region


def _near_closed(table: MoveTable, points: Points) -> bool:
    """Whether a move of a path over the grid, (n, 2) with its ends, is within the margin."""
    if table.near.size == 0:
        return False
    last = np.array(table.surface.shape) - 1
    cells = np.clip(np.rint(points).astype(np.int64), 0, last) @ np.array([table.surface.shape[1], 1])
    steps, order = np.diff(cells), np.argsort(table.jump)
    moves = np.isin(steps, table.jump)  # and not the legs to the first centre and from the last
    move = order[np.searchsorted(table.jump[order], steps[moves])].astype(np.uint32)
    return bool((table.near[cells[:-1][moves]] >> move & np.uint32(1)).any())


def _region_between(
    lattice: CostLattice, table: MoveTable, near: NDArray[np.uint32], start: Points, goal: Points
) -> Region:
    """As `region_between`, of paths on which some moves count as within the margin, as `MoveTable.near`."""
    flagged, table = table.near, replace(table, near=near, sampled_j=table.typical_j)
    layers = layer_count(lattice, table)
    seeds, cost = terminals(lattice, table, start, layers, outward=True)
    targets, rest = terminals(lattice, table, goal, layers, outward=False)
    guide = guide_towards(table, energy_bounds(table), goal, targets, rest.min(axis=1), lattice.frame.resolution_m)
    distance = max(math.dist(start, goal), 1.0)
    root_share = math.sqrt(max(distance, LEAST_CELLS)) / distance
    margin = OPEN_LAG * root_share
    ahead = new_search(table, layers, seeds, cost, backward=False)
    last, total, expanded = run_search(ahead, table, np.unique(seeds), guide, targets, rest, margin=margin)
    direct = direct_energy(lattice, start, goal)
    if direct < math.inf and direct <= total:
        return Region(GridPath(np.vstack([start, goal]), direct, expanded), None, False, False)
    if last == _NONE:
        raise no_route(lattice.robot, expanded)
    cells = ahead.trace(table, last)[::-1] // layers
    grid = GridPath(joined_points(lattice, start, cells, goal), float(total), expanded)
    closed = _closed_from(table, np.unique(cells))
    closed |= flagged.size > 0 and bool(flagged[cells].any())
    most = total + margin * abs(total)
    if closed:
        most = total + CLOSED_LAG * root_share * abs(total)
        run_search(ahead, table, ahead.reached_cells(open_only=True), guide, most=most)
    behind = new_search(table, layers, targets, rest, backward=True)
    budget = most + 1e-9 * abs(most)
    run_search(behind, table, np.unique(targets), guide_everywhere(table, backward=True), spent=ahead, budget=budget)
    reached = behind.reached_cells()
    region, growth = np.zeros(lattice.frame.shape, dtype=np.bool_), max(CLOSED_GROWTH, math.ceil(margin_cells(lattice)))
    for part in (reached, cells):
        mark_around(region, part, lattice.frame.cols, growth if closed else OPEN_GROWTH)
    any_closed = closed or _closed_from(table, np.flatnonzero(region))
    return Region(grid, region, closed, any_closed)


def region_around(lattice: CostLattice, points: Points, *, half_side: int) -> NDArray[np.bool_]:
    """The cells within a few of a (row, col) polyline: (rows, cols) bool."""
    near = np.zeros(lattice.frame.shape, dtype=np.bool_)
    last = np.array(lattice.frame.shape) - 1
    cells = np.clip(np.rint(subdivided(points, 1.0)).astype(np.int64), 0, last) @ np.array([lattice.frame.cols, 1])
    mark_around(near, cells, lattice.frame.cols, half_side)
    return near


def _closed_from(table: MoveTable, cells: NDArray[np.int64]) -> bool:
    """As `has_closed_move`; of a tiled table, tile by tile."""
    if table.tiles is None:
        return bool(has_closed_move(table.energy, table.offsets, cells))
    of = table.tiles.tile_of(cells)
    for tile in np.unique(of).tolist():
        table.tiles.price([tile])
        if has_closed_move(table.energy, table.offsets, cells[of == tile]):
            return True
    return False


@njit(cache=True, nogil=True)
def mark_around(taken, cells, cols, half_side):
    """Set `taken` (rows, cols) in the squares around some flat cells; half_side : half their side [cells]."""
    rows = taken.shape[0]
    for cell in cells:
        i, j = cell // cols, cell % cols
        taken[
            max(i - half_side, 0) : min(i + half_side + 1, rows), max(j - half_side, 0) : min(j + half_side + 1, cols)
        ] = True


@njit(cache=True, nogil=True)
def has_closed_move(energy, offsets, cells):
    """Whether a move from one of some flat cells is closed that does not leave the map."""
    rows, cols, moves = energy.shape
    for cell in cells:
        i, j = cell // cols, cell % cols
        for n in range(moves):
            if math.isnan(energy[i, j, n]) and 0 <= i + offsets[n, 0] < rows and 0 <= j + offsets[n, 1] < cols:
                return True
    return False
