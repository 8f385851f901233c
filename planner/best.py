"""The best route that we find between two places: one function, which every question goes through.

The grid path of every corridor within the grid's error of the best (`corridors`) is improved at any angle (`refine`):
the best one as a whole, while the others are searched, and these where they differ from it (`detours`). Where limits
close moves, the paths through `passages` are among them, and the best of a `tube` around the first of these. Each is
improved as a whole where it is not long, because many local optima lie close to each other there. Then ways beside the
best path are looked for (`beside`), it is `shaken`, and so are its `rivals`, the other paths that were improved as a
whole, where they differ from it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from joulemap.model.threads import both, share_out
from joulemap.planner.beside import MOST_CELLS, with_ways_beside
from joulemap.planner.corridors import Corridors
from joulemap.planner.detours import Improved, best_of_corridors, improved, largest_lag
from joulemap.planner.edges import Points, path_price
from joulemap.planner.lattice import CostLattice
from joulemap.planner.moves import MoveTable
from joulemap.planner.polylines import path_length
from joulemap.planner.refine import converged, refine_corners
from joulemap.planner.rivals import with_rivals
from joulemap.planner.shaken import shaken
from joulemap.planner.tube import cheapest_in_tube

ANY_ANGLE_NEIGHBOURS = 32
"""The any-angle step begins with the paths of as many neighbours at least: more headings find other passages and other
valleys."""
TUBE_CELLS = 4
"""Half the width of the tube around the best path through passages [cells]."""


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
    whole, parts = [first], [path.points for path in others]
    if through and path_length(through[0]) <= MOST_CELLS:

        def _improved(path: Points | None) -> Improved | None:
            """Of a path, or, where None is given, of the best in the tube around the first one."""
            path = cheapest_in_tube(lattice, through[0], half_side=TUBE_CELLS) if path is None else path
            return improved(lattice, path) if len(path) else None

        whole += [path for path in share_out(_improved, [None, *through]) if path is not None]
    else:
        parts = [*through, *parts]
    points = _best(lattice, whole, parts)
    return BestPath(points, path_price(lattice, points), grid.energy_j, grid.expanded, 1 + len(others))


def best_of(lattice: CostLattice, paths: Sequence[Points]) -> Points:
    """Return the best of what the any-angle step makes of some paths, with ways beside it, and shaken.

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
    return _best(lattice, [improved(lattice, paths[0])], paths[1:])


def _best(lattice: CostLattice, whole: Sequence[Improved], others: Sequence[Points]) -> Points:
    """As `best_of`; whole : paths that were improved as a whole."""
    points = converged(lattice, best_of_corridors(lattice, whole, others))
    for step in (with_ways_beside, shaken):
        changed = step(lattice, points)
        points = points if changed is points else converged(lattice, changed)
    return with_rivals(lattice, points, [path.points for path in whole]) if len(whole) > 1 else points


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
