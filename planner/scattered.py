"""Ways through narrow passages that no leg of a path points through: random places around it, joined by straight legs.

Near ground that limits close, a passage may be open to long legs of few headings only, which neither the searches nor
shifts of single vertices hit. A probabilistic roadmap (Kavraki et al. 1996) of places around such vertices, with the
path itself in it, offers many.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.crossovers import with_crossovers
from joulemap.planner.edges import Points, leg_prices_between
from joulemap.planner.lattice import CostLattice
from joulemap.planner.polylines import subdivided

SPREADS_CELLS = np.geomspace(0.8, 0.05, 12)
"""Standard deviation, in row and in column, of each of the places around a cell of the path [cells]: the far ones find
other passages, the near ones the best way through the same."""
LONGEST_CELLS = 3.0
"""Longest leg [cells]."""
_FEELERS = 1.5 * np.array([(np.cos(a), np.sin(a)) for a in np.arange(8) * np.pi / 4.0])
"""Legs from a vertex by which closed ground is noticed [cells]."""


def with_scattered(lattice: CostLattice, points: Points, random: np.random.Generator) -> Points:
    """Return the cheapest way over a path and random places around it, where limits are near.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline that may be driven.
    random : Generator
        Draws the places.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline with the same ends and at most the same energy.
    """
    vertices = subdivided(points, 1.0)
    beside = vertices[beside_closed_ground(lattice, vertices)]
    around = np.repeat(beside, len(SPREADS_CELLS), axis=0)
    places = around + random.normal(0.0, np.tile(SPREADS_CELLS, len(beside))[:, None], around.shape)
    row, col = np.rint(places).astype(np.int64).T
    rows, cols = lattice.frame.shape
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    free = places[inside][lattice.blocked[row[inside], col[inside]] == 0]
    return with_crossovers(lattice, points, list(free[:, None]), near=LONGEST_CELLS)


def beside_closed_ground(lattice: CostLattice, places: Points) -> NDArray[np.bool_]:
    """Return which places have ground close by that limits close in some direction.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    places : ndarray of float, (n, 2)
        (row, col) of the places.

    Returns
    -------
    ndarray of bool, (n,)
        Whether one of eight legs of 1.5 cells from the place may not be driven.
    """
    starts = np.repeat(places, len(_FEELERS), axis=0)
    closed = np.isnan(leg_prices_between(lattice, starts, starts + np.tile(_FEELERS, (len(places), 1))))
    beside: NDArray[np.bool_] = np.logical_or.reduce(closed.reshape(len(places), -1), axis=1)
    return beside
