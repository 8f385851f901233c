"""The cheapest way over several polylines that changes between them wherever they are near each other.

Improved on its own, each of several paths is the best in some stretches. Their vertices, joined by straight legs where
they are near each other, are a small graph. Its cheapest path (Dijkstra 1959) is the best choice of all stretches at
once, whatever overlaps.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from joulemap.planner.edges import Points, path_price, price_arrays
from joulemap.planner.kernels import heading_memory, leg_energy_with, turn_angle
from joulemap.planner.lattice import CostLattice
from joulemap.planner.polylines import corners, distinct, subdivided

SPACING = 0.5
"""Longest distance of the vertices along a polyline [cells]."""
ROUNDING = 1e-9
"""A smaller share of the energy is no gain."""
NEAR = 1.0
"""Longest leg between two vertices, where nothing else is said [cells]."""


def with_crossovers(lattice: CostLattice, points: Points, others: Sequence[Points], *, near: float = NEAR) -> Points:
    """Return the cheapest way over a path and other polylines.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline that may be driven.
    others : sequence of ndarray of float, (m, 2)
        (row, col) polylines, or places (m = 1); they need not begin and end on the path.
    near : float, default 1
        Longest leg between two vertices [cells].

    Returns
    -------
    ndarray of float, (k, 2)
        (row, col) polyline with the ends of `points` and at most the same energy.

    Notes
    -----
    Vertices that are settled stay settled, and a turn counts from the best way to its vertex; so where turning costs or
    prices are negative, the way may not be the cheapest.
    """
    if not others:
        return points
    lines = [subdivided(line, SPACING) for line in (points, *others)]
    places = np.vstack(lines)
    row, col = np.floor(places / near).astype(np.int64).T
    square = row * (lattice.frame.cols + 2) + col
    order = np.argsort(square, kind="stable")
    turn, never_pays = lattice.robot.turn_j_per_rad, lattice.robot.regeneration == 0.0
    squares = square, order, square[order], lattice.frame.cols + 2
    way = _cheapest(*price_arrays(lattice), turn, places, squares, near, len(lines[0]) - 1, never_pays)
    if way.size == 0:
        return points
    found = subdivided(corners(distinct(places[way])), SPACING)
    energy = path_price(lattice, points)
    return found if path_price(lattice, found) < energy - ROUNDING * abs(energy) else points


@njit(cache=True, nogil=True)
def _cheapest(traction, gradient, blocked, terms, turn_j_per_rad, places, squares, near, last, never_pays):
    """The vertices of the cheapest way from the first one to another; none where there is no way.

    squares : number of the square of the side `near` in which each vertex lies; the vertices in the order of these; the
    numbers in that order; by how much the number of a square is larger than that of the one above it.
    never_pays : no price is negative.
    """
    square, order, in_order, next_row = squares
    memory = heading_memory(traction.shape[2])
    label, came = np.full(len(places), np.inf), np.full(len(places), -1)
    settled = np.zeros(len(places), dtype=np.bool_)
    label[0] = 0.0
    heap = [(0.0, 0)]
    while len(heap) > 0 and not settled[last]:
        so_far, i = heapq.heappop(heap)
        if settled[i]:
            continue
        settled[i] = True
        row, col = places[i]
        for middle in range(square[i] - next_row, square[i] + 2 * next_row, next_row):
            begin, end = np.searchsorted(in_order, middle - 1), np.searchsorted(in_order, middle + 2)
            for j in order[begin:end]:
                if settled[j] or math.hypot(places[j, 0] - row, places[j, 1] - col) > near:
                    continue
                energy = so_far
                if turn_j_per_rad > 0.0 and i > 0:
                    before = places[came[i]]
                    energy += turn_j_per_rad * turn_angle(before[0], before[1], row, col, places[j, 0], places[j, 1])
                most = label[j] - energy if never_pays else np.inf
                energy += leg_energy_with(
                    memory, traction, gradient, blocked, terms, row, col, places[j, 0], places[j, 1], most
                )
                if energy < label[j]:
                    label[j], came[j] = energy, i
                    heapq.heappush(heap, (energy, j))
    way = [last]
    if not settled[last]:  # a limit that the whole leg keeps within rounding, and a part of it does not
        return np.zeros(0, dtype=np.int64)
    while way[-1] > 0:
        way.append(came[way[-1]])
    return np.array(way[::-1])
