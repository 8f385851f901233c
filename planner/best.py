"""The best route that we find between two places: one function, which every question goes through.

The grid path of every corridor within the grid's error of the best (`corridors`) is improved at any angle (`refine`):
the best one as a whole, while the others are searched, and these where they differ from it (`detours`). Where limits
close moves, the paths through `passages` are among them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from joulemap.model.threads import both
from joulemap.planner.corridors import Corridors
from joulemap.planner.detours import Improved, best_of_corridors, improved, largest_lag
from joulemap.planner.edges import Points, path_price
from joulemap.planner.lattice import CostLattice
from joulemap.planner.moves import MoveTable
from joulemap.planner.polylines import path_length
from joulemap.planner.refine import converged, refine_corners

ANY_ANGLE_NEIGHBOURS = 32
"""The any-angle step begins with the paths of as many neighbours at least: more headings find other passages and other
valleys."""


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
    corridors : int
        Number of corridors that were looked at.
    """

    points: Points
    energy_j: float
    grid_energy_j: float
    expanded: int
    corridors: int


def best_path(lattice: CostLattice, table: MoveTable, start: Points, goal: Points) -> BestPath:
    """Return the best path of any angles between two places.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    table : MoveTable
        Priced moves of the lattice.
    start, goal : ndarray of float, (2,)
        Fractional (row, col).

    Returns
    -------
    BestPath
        The path.

    Raises
    ------
    NoRouteError
        If the goal cannot be reached.
    """
    corridors = Corridors(lattice, table, start, goal, margin=largest_lag(math.dist(start, goal)))
    grid = corridors.first
    first, (others, through) = both(lambda: improved(lattice, grid.points), corridors.others)
    points = _best(lattice, first, [*through, *(path.points for path in others)])
    return BestPath(points, path_price(lattice, points), grid.energy_j, grid.expanded, 1 + len(others))


def best_of(lattice: CostLattice, paths: Sequence[Points]) -> Points:
    """Return the best of what the any-angle step makes of some paths.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    paths : sequence of ndarray of float, (n, 2)
        (row, col) polylines with the same ends that may be driven, at least one; the first is improved as a whole, so
        that it should be the best known.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline.
    """
    return _best(lattice, improved(lattice, paths[0]), paths[1:])


def _best(lattice: CostLattice, first: Improved, others: Sequence[Points]) -> Points:
    return converged(lattice, best_of_corridors(lattice, first, others))


def shorter_of(lattice: CostLattice, distances: CostLattice, shortest: Points, points: Points) -> Points:
    """Return the shortest path known: the route of least energy may know a passage that the moves of the grid miss.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    distances : CostLattice
        The same limits at a price of 1 J/m.
    shortest, points : ndarray of float, (n, 2)
        (row, col) of the shortest path over the grid, improved, and of the route of least energy.

    Returns
    -------
    ndarray of float, (n, 2)
        `shortest`, or the other one with its corners cut where that is shorter.
    """
    if not path_length(points) < path_length(shortest):
        return shortest
    cut = refine_corners(distances, points)
    return points if math.isnan(path_price(lattice, cut)) else cut
