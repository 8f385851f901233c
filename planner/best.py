"""The best route that we find between two places: one function, which every question goes through.

The grid path of every corridor within the grid's error of the best (`corridors`) is improved at any angle (`refine`),
stage by stage; after each stage only those stay that may still win, and of those over the same cells only the best.
Where limits close moves, the path through `passages` is improved beside them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from joulemap.model.threads import share_out
from joulemap.planner.corridors import corridor_paths
from joulemap.planner.edges import Points, path_price
from joulemap.planner.lattice import CostLattice
from joulemap.planner.moves import MoveTable
from joulemap.planner.refine import STAGES, subdivided

LAGS = (0.3, 0.24, 0.2, 0.06, 0.0)
"""By how much the path that is the best in the end may lag behind before the stages and after each, as a share of the
energy, times the root of its length [cells]. What a stage gains is a sum along the path, so its share varies with the
inverse root of the length. With half of these lags and 4, 3, 1 and 1 paths, 41 of 2,500 random tasks on the maps of
`tests/bench/quality.py` were more than 0.1 % dearer than with twice these lags and 32 paths (up to 2.6 %)."""
KEEP = (24, 12, 6, 3)
"""Most paths that stay after each stage."""


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
    margin = LAGS[0] / math.sqrt(max(math.dist(start, goal), 1.0))
    found, through = corridor_paths(lattice, table, start, goal, margin=margin)
    points = best_of(lattice, [path.points for path in found])
    energy_j = path_price(lattice, points)
    if through is not None:  # its stages gain less, so that it does not compete with the others before the end
        other = best_of(lattice, [through])
        if path_price(lattice, other) < energy_j:
            points, energy_j = other, path_price(lattice, other)
    return BestPath(points, energy_j, found[0].energy_j, found[0].expanded, len(found))


def best_of(lattice: CostLattice, paths: list[Points]) -> Points:
    """Return the best of what the any-angle step makes of some paths.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    paths : list of ndarray of float, (n, 2)
        (row, col) polylines with the same ends, at least one.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline.
    """
    ways = list(paths)
    root = math.sqrt(max(float(np.hypot(*np.diff(paths[0], axis=0).T).sum()), 1.0))
    for stage, lag, most in zip(STAGES, LAGS[1:], KEEP, strict=True):
        ways = _improved(lattice, ways, stage)
        prices = np.array([path_price(lattice, way) for way in ways])
        prices[np.isnan(prices)] = math.inf
        least = float(prices.min())
        kept = np.flatnonzero(prices <= least + lag / root * abs(least))
        ways = _different(lattice, [ways[k] for k in kept[np.argsort(prices[kept], kind="stable")]], most)
    return ways[0]


def _different(lattice: CostLattice, ways: list[Points], most: int) -> list[Points]:
    """The first of some paths over each row of cells; paths a cell apart may still lead to different optima."""
    out: dict[bytes, Points] = {}
    for way in ways:
        row, col = np.rint(subdivided(way, 1.0)).astype(np.int64).T
        cells = row * lattice.frame.cols + col
        out.setdefault(cells[np.append(True, np.diff(cells) != 0)].tobytes(), way)
        if len(out) == most:
            break
    return list(out.values())


def _improved(lattice: CostLattice, ways: list[Points], stage: Callable[[CostLattice, Points], Points]) -> list[Points]:
    out = list(ways)

    def _improve(k: int) -> None:
        out[k] = stage(lattice, ways[k])

    share_out(_improve, range(len(ways)))
    return out
