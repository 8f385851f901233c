"""Fewer corners for a mission: straight legs over free ground that cost what the route costs."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, leg_prices, path_price

ENERGY_SHARE = 0.005
"""By which share of a route's energy its mission may differ: half of the promised 1 %; rounding has the other half."""


def corners_to_keep(lattice: CostLattice, points: Points, *, share: float = ENERGY_SHARE) -> NDArray[np.int64]:
    """Return the corners of a path that a mission needs.

    `points` (n, 2): (row, col) polyline. Result (m,): their numbers, in order, the first and the last among them. All
    legs between them may be driven.

    Greedy, from the bottom up, as Visvalingam & Whyatt 1993, with energy instead of area: of all corners the one is
    left out whose absence changes the energy least, until no other may be left out.
    """
    count = len(points)
    whole = path_price(lattice, points)
    if count < 3 or np.isnan(whole):
        return np.arange(count)
    most, changed = share * abs(whole), 0.0
    before, after = np.arange(-1, count - 1), np.arange(1, count + 1)
    version = np.zeros(count, dtype=np.int64)
    there = np.ones(count, dtype=np.bool_)

    def _change(k: int) -> float:
        """Energy that leaving out a corner adds [J]: of the legs next to it, with the turns at their ends."""
        i, j = int(before[k]), int(after[k])
        if np.isnan(leg_prices(lattice, points[[i, j]])).any():
            return np.inf
        around = [n for n in (int(before[i]) if i > 0 else -1, i, j, int(after[j]) if j < count - 1 else -1) if n >= 0]
        at = around.index(j)
        return path_price(lattice, points[around]) - path_price(lattice, points[[*around[:at], k, *around[at:]]])

    changes = {k: _change(k) for k in range(1, count - 1)}
    heap = [(abs(change), k, 0) for k, change in changes.items() if np.isfinite(change)]
    heapq.heapify(heap)
    while heap:
        _, k, made = heapq.heappop(heap)
        if not there[k] or made != version[k] or abs(changed + changes[k]) > most:
            continue
        there[k] = False
        changed += changes[k]
        i, j = int(before[k]), int(after[k])
        after[i], before[j] = j, i
        for near in (i, j, int(before[i]), int(after[j])):  # the turns next to a leg count in four corners' changes
            if 0 < near < count - 1 and there[near]:
                version[near] += 1
                changes[near] = _change(near)
                if np.isfinite(changes[near]):
                    heapq.heappush(heap, (abs(changes[near]), near, int(version[near])))
    return np.flatnonzero(there)
