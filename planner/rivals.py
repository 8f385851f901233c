"""Paths that lost get a second chance where they differ from the best one.

Where limits close moves, which of two passages is better shows only after many rounds of random changes (`shaken`), and
only the best path goes through these. So where another path is not beside the best one, its stretch goes through the
same rounds, and competes once more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from joulemap.planner.edges import Points, path_price
from joulemap.planner.lattice import CostLattice
from joulemap.planner.polylines import near_lines, stretches_around, subdivided
from joulemap.planner.refine import converged
from joulemap.planner.shaken import AROUND_CELLS, LEAST_GAIN, with_stretches

DISTANCE_CELLS = 0.5
"""A rival is compared where it is farther than this from the best path [cells]."""
ROUNDS = 3
"""Most rounds: after a gain that counts the best path is another one, from which rivals differ elsewhere."""


def with_rivals(lattice: CostLattice, points: Points, rivals: Sequence[Points]) -> Points:
    """Return a path with the stretches of others that are cheaper once they were shaken too.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline that was `shaken`.
    rivals : sequence of ndarray of float, (m, 2)
        (row, col) polylines with the same ends that may be driven.

    Returns
    -------
    ndarray of float, (k, 2)
        (row, col) polyline with the same ends and at most the same energy, the same for the same paths; `points` where
        nothing is gained.
    """
    random = np.random.default_rng(1)
    for _ in range(ROUNDS):
        stretches = []
        for rival in rivals:
            vertices = subdivided(rival, 1.0)
            differs = ~near_lines(vertices, [points], DISTANCE_CELLS)
            stretches += [vertices[a:b] for a, b in stretches_around(vertices, differs, AROUND_CELLS)]
        better = with_stretches(lattice, points, stretches, random)
        if better is points:
            break
        before, points = path_price(lattice, points), converged(lattice, better)
        if not before - path_price(lattice, points) > LEAST_GAIN * abs(before):
            break
    return points
