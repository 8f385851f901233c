"""Ways out of local optima: copies of a path are shaken, settle anew, and compete with it.

Vertices settle into local optima, of which there are many within a cell of each other where limits close moves. In
iterated local search (Lourenço, Martin & Stützle 2003) they are moved at random by about a cell, as far as the path can
still be driven, and settle once more. The cheapest way over the path and several such copies (`crossovers`) takes from
each the stretches in which it is better.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from joulemap.model.threads import share_out
from joulemap.planner.beside import MOST_CELLS
from joulemap.planner.crossovers import with_crossovers
from joulemap.planner.edges import Points, leg_prices, path_price
from joulemap.planner.lattice import CostLattice
from joulemap.planner.polylines import path_length, subdivided
from joulemap.planner.refine import STAGES
from joulemap.planner.scattered import with_scattered

COPIES = 6
"""How many copies of a path are shaken in a round."""
ROUNDS, LEAST_GAIN = 6, 1e-4
"""Most rounds, and the gain of one, as a share of the energy, for which another one follows."""
SHIFT_CELLS = 0.7
"""Standard deviation of the shifts in row and in column [cells]."""
KNOT_CELLS = 2.0
"""Distance of the vertices whose shifts are drawn; between them the shifts change evenly [cells]."""


def shaken(lattice: CostLattice, points: Points) -> Points:
    """Return a path after several random changes competed with it.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline that went through all stages of `refine`.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline with the same ends and at most the same energy, the same for the same path; `points` where
        it is longer than `beside.MOST_CELLS`.
    """
    if path_length(points) > MOST_CELLS:
        return points
    random = np.random.default_rng(0)
    energy = path_price(lattice, points)
    for _ in range(ROUNDS):
        first, *draws = random.spawn(1 + COPIES)
        tasks = [partial(with_scattered, lattice, points, first)]
        tasks += [partial(_settled_copy, lattice, points, draw) for draw in draws]
        points = with_crossovers(lattice, points, share_out(lambda task: task(), tasks))
        before, energy = energy, path_price(lattice, points)
        if not before - energy > LEAST_GAIN * abs(energy):
            break
    return points


def _settled_copy(lattice: CostLattice, points: Points, random: np.random.Generator) -> Points:
    """The path after its vertices were moved at random and settled."""
    copy = _moved(lattice, points, random)
    for stage in STAGES[-2:]:
        copy = stage(lattice, copy)
    return copy


def _moved(lattice: CostLattice, points: Points, random: np.random.Generator) -> Points:
    """The path with its vertices shifted at random; those stay where a leg could not be driven."""
    vertices = subdivided(points, 1.0)
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(vertices, axis=0).T)))
    knots = np.linspace(0.0, along[-1], max(round(path_length(points) / KNOT_CELLS), 1) + 1)
    shifts = random.normal(0.0, SHIFT_CELLS, (len(knots), 2))
    shifts[0] = shifts[-1] = 0.0
    shifted = vertices + np.column_stack([np.interp(along, knots, shift) for shift in shifts.T])
    moves = np.ones((len(vertices), 1), dtype=np.bool_)
    while moves.any():
        copy = np.where(moves, shifted, vertices)
        closed = np.isnan(leg_prices(lattice, copy))
        if not closed.any():
            return copy
        moves[:-1][closed] = moves[1:][closed] = False
    return vertices
