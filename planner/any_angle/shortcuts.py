"""Leaving out vertices: of all chains over the vertices of a path, the one of straight legs that costs least.

Zigzags stay where they pay. A leg may leave out a few vertices; passes are repeated while they find a cheaper chain.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from joulemap.planner.pricing.integrator import Points, Prices
from joulemap.planner.pricing.kernels import driven_leg_energy, heading_memory, path_energy, turn_angle

SPAN = 4
"""Legs that one leg may replace in one pass."""


def shortcuts(prices: Prices, points: Points) -> Points:
    """Some vertices of a (row, col) polyline that may be driven, both ends among them: at most as dear, (m, 2)."""
    never_pays = prices.terms[2] == 0.0  # no regeneration
    return _shortened(prices, points, SPAN, never_pays)


@njit(cache=True, nogil=True)
def _shortened(prices, points, span, never_pays):
    """The path after passes of `_cheapest_chain`, while they leave vertices out. never_pays : no price is negative."""
    memory, energy = heading_memory(prices.traction.shape[2]), path_energy(prices, points)
    legs = np.full((points.shape[0], span), np.nan)
    while points.shape[0] > 2:
        keep, total = _cheapest_chain(memory, prices, points, legs, never_pays)
        if keep.size == points.shape[0] or not total <= energy + 1e-12 * abs(energy):
            break
        known = np.full((keep.size, span), np.nan)  # legs that the next pass need not price again
        for k in range(keep.size):
            for s in range(1, min(span, keep.size - 1 - k) + 1):
                over = keep[k + s] - keep[k]
                if over <= span:
                    known[k, s - 1] = legs[keep[k], over - 1]
        points, legs, energy = points[keep], known, total
    return points


@njit(cache=True)
def _cheapest_chain(memory, prices, points, legs, never_pays):
    """The vertices that the cheapest chain of legs keeps, and its energy [J].

    The turn at a vertex counts from its best chain. legs : (n, span) energy of the leg from a vertex over 1 to `span`
    vertices [J], NaN where it is not known yet, infinite where it may not be driven or is too dear; it is filled.
    """
    turn_j_per_rad = prices.turn_j_per_rad
    n, span = legs.shape
    best = np.full(n, np.inf)
    parent = np.zeros(n, dtype=np.int64)
    best[0] = 0.0
    for i in range(n - 1):
        p = parent[i]
        for j in range(min(i + span, n - 1), i, -1):
            turn = 0.0
            if i > 0 and turn_j_per_rad > 0.0:
                turn = turn_j_per_rad * turn_angle(
                    points[p, 0], points[p, 1], points[i, 0], points[i, 1], points[j, 0], points[j, 1]
                )
            price = legs[i, j - i - 1]
            if math.isnan(price):
                most = best[j] - best[i] if never_pays else np.inf
                leg = points[i, 0], points[i, 1], points[j, 0], points[j, 1]
                price = driven_leg_energy(memory, prices, leg, most)
                if not price <= most:
                    price = np.inf
                legs[i, j - i - 1] = price
            total = best[i] + turn + price
            if total < best[j] - 1e-13 * abs(total):  # of equal ones the first, which is the longest leg
                best[j] = total
                parent[j] = i
    chain = np.empty(n, dtype=np.int64)
    j, first = n - 1, n - 1
    chain[first] = j
    while j > 0:
        j = parent[j]
        first -= 1
        chain[first] = j
    return chain[first:], best[n - 1]
