"""Ways a few cells beside a path, in corridors that are too near to each other for the grid to tell them.

Chains through ribbons around the path (`ribbon`) leave it and join it again, as detours do (`detours`), and compete for
it like them. Where ways were taken, the path is a new one, and ways beside it are searched once more.
"""

from __future__ import annotations

from itertools import chain, product

import numpy as np

from joulemap.model.threads import share_out
from joulemap.planner.detours import AFTER_JOINING, Detour, cell_energy, combined, competed
from joulemap.planner.edges import Points, path_price
from joulemap.planner.lattice import CostLattice
from joulemap.planner.polylines import near_lines, path_length, stretches_around, subdivided
from joulemap.planner.refine import converged, path_stages
from joulemap.planner.ribbon import Ribbon, ways_beside

MOST_CELLS = 200.0
"""Longest path for which this is done [cells]: a way saves the energy of a few cells, which is a smaller share of a
longer path and takes more time there. Of 70 random paths of 200 to 290 cells ways saved 0.1 % of one."""
RIBBONS = (
    Ribbon(spacing=12, half_width=12.0, step=0.5, slope=1.0),
    Ribbon(spacing=4, half_width=4.0, step=0.25, slope=0.75),
    Ribbon(spacing=6, half_width=6.0, step=0.25, slope=1.0),
    Ribbon(spacing=8, half_width=8.0, step=0.25, slope=1.0),
    Ribbon(spacing=3, half_width=3.0, step=0.25, slope=1.0),
    Ribbon(spacing=16, half_width=16.0, step=0.5, slope=1.0),
)
"""Ribbons in which ways are searched; a leg of the path is at most half a cell long. Each ribbon finds ways that the
others miss. The ways of all compete for the same path: one ribbon after the other, the first small gain often closes
the way to a larger one."""
SLACK = 2.0
"""By how much a chain through a ribbon may be dearer than the cheapest one, in mean energies of a cell."""
SAME_CELLS = 1.0
"""A way all of whose places are within this distance of ways that are cheaper so far is left out [cells]: several
ribbons find it, and it would settle alike."""
LAGS = (1.0, 0.2, 0.0)
"""By how much a way may be dearer than what it replaces after each stage of its settling, in mean energies of a cell:
of the ways that saved 0.1 % or more in the end, 19 of 20 lagged by at most 1.1, 0.5 and 0.1."""
ROUNDS, LEAST_GAIN = 3, 1e-4
"""Most rounds, and the gain of one, as a share of the energy, for which another one follows."""
MOVED_CELLS, AROUND_CELLS = 0.25, 12.0
"""A further round looks beside those places of the path that are farther than the first distance from where it was, and
along it for the second distance before and after them [cells]."""


def with_ways_beside(lattice: CostLattice, points: Points) -> Points:
    """Return a path with the ways beside it that cost less.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline that went through all stages of `refine`.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline with the same ends and at most the same energy; `points` where it is longer than
        `MOST_CELLS`.
    """
    if path_length(points) > MOST_CELLS:
        return points
    earlier, energy = None, path_price(lattice, points)
    for _ in range(ROUNDS):
        earlier, points = points, _improved(lattice, points, earlier)
        before, energy = energy, path_price(lattice, points)
        if not before - energy > LEAST_GAIN * abs(energy):
            break
    return points


def _improved(lattice: CostLattice, points: Points, earlier: Points | None) -> Points:
    """The path with the ways, through any ribbon, that are cheaper once their vertices have settled.

    earlier : a path beside which ways were searched before; only where it is left they are searched again.
    """
    vertices, cell_j = subdivided(points, 0.5), cell_energy(lattice, points)
    parts = [(0, len(vertices))]
    if earlier is not None:
        parts = stretches_around(vertices, ~near_lines(vertices, [earlier], MOVED_CELLS), AROUND_CELLS)

    def _ways(where: tuple[tuple[int, int], Ribbon]) -> list[Detour]:
        (a, b), ribbon = where
        ways = ways_beside(lattice, vertices[a:b], ribbon, slack_j=SLACK * cell_j)
        return [
            Detour(way, a + first, a + last, path_price(lattice, vertices[a + first : a + last + 1]), cell_j)
            for first, last, way in ways
        ]

    def _settled(way: Detour) -> Points | None:
        stages = path_stages(way.points)[AFTER_JOINING:]
        settled = competed(lattice, way, stages, [way.replaced_j + lag * way.unit_j for lag in LAGS])
        return None if settled is None else converged(lattice, settled)

    ways = list(chain.from_iterable(share_out(_ways, list(product(parts, RIBBONS)))))
    settled = [way for way in share_out(_settled, _distinct(lattice, ways)) if way is not None]
    return combined(lattice, points, settled)


def _distinct(lattice: CostLattice, ways: list[Detour]) -> list[Detour]:
    """The ways without those that go where cheaper ones go."""
    lags_j = [path_price(lattice, way.points) - way.replaced_j for way in ways]
    kept: list[Detour] = []
    for k in np.argsort(lags_j, kind="stable"):
        way = ways[k]
        cheaper = [other.points for other in kept if other.first < way.last and way.first < other.last]
        if not cheaper or not near_lines(subdivided(way.points, 0.5), cheaper, SAME_CELLS, all_or_none=True).all():
            kept.append(way)
    return kept
