"""Ways out of local optima: a path is changed at random, and its changed copies compete with it.

Vertices settle into local optima, of which there are many within a cell of each other. In iterated local search
(Lourenço, Martin & Stützle 2003) copies of the path, whose vertices are moved at random by about a cell, settle once
more, and the cheapest way over the path and all copies (`crossovers`) is the next path. Beside ground that limits
close there are more optima: stretches of the path there begin with the best of a `tube` around them, and go through
further rounds of their own, in which random places are `scattered` around them too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from joulemap.model.threads import share_out
from joulemap.planner.beside import MOST_CELLS
from joulemap.planner.crossovers import with_crossovers
from joulemap.planner.edges import Points, leg_prices, path_price
from joulemap.planner.lattice import CostLattice
from joulemap.planner.polylines import distances_along, path_length, stretches_around, subdivided
from joulemap.planner.refine import STAGES
from joulemap.planner.scattered import beside_closed_ground, with_scattered
from joulemap.planner.tube import with_way_around

COPIES = 6
"""How many copies of the path are shaken in a round; there are rounds until one gains nothing."""
AROUND_CELLS = 6.0
"""How far before and after closed ground a stretch begins and ends [cells]."""
TUBE_CELLS = 5
"""Half the width of the tube around a stretch [cells]."""
STRETCH_COPIES, STRETCH_PATIENCE = 2, 2
"""How many copies of a stretch are shaken in a round, and after how many rounds without gain in succession there is no
further one."""
ROUNDS, LEAST_GAIN = 15, 1e-4
"""Most rounds, and the least gain that counts, as a share of the energy of the path."""
SHIFT_CELLS = 0.7
"""Standard deviation of the shifts in row and in column [cells]."""
KNOT_CELLS = 2.0
"""Distance of the vertices whose shifts are drawn; between them the shifts change evenly [cells]."""


def shaken(lattice: CostLattice, points: Points) -> Points:
    """Return a path with what random changes of it gain.

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
    whole = partial(_changed, lattice, copies=COPIES, scatter=False)
    points = _until_idle(lattice, points, random, whole, patience=1, least_j=_least_gain(lattice, points))
    return with_stretches(lattice, points, _closed_stretches(lattice, points), random)


def with_stretches(
    lattice: CostLattice, points: Points, stretches: Sequence[Points], random: np.random.Generator
) -> Points:
    """Return the cheapest way over a path and some polylines, each of which went through rounds of its own.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline that may be driven.
    stretches : sequence of ndarray of float, (m, 2)
        (row, col) polylines that may be driven, and begin and end near the path.
    random : Generator
        Draws the changes.

    Returns
    -------
    ndarray of float, (k, 2)
        (row, col) polyline with the ends of `points` and at most the same energy.
    """
    part, least_j = partial(_changed, lattice, copies=STRETCH_COPIES, scatter=True), _least_gain(lattice, points)

    def _improved(stretch: tuple[Points, np.random.Generator]) -> Points:
        way, draws = stretch
        way = with_way_around(lattice, way, half_side=TUBE_CELLS)
        return _until_idle(lattice, way, draws, part, patience=STRETCH_PATIENCE, least_j=least_j)

    draws = random.spawn(len(stretches))
    return with_crossovers(lattice, points, share_out(_improved, list(zip(stretches, draws, strict=True))))


def _least_gain(lattice: CostLattice, points: Points) -> float:
    return LEAST_GAIN * abs(path_price(lattice, points))


def _closed_stretches(lattice: CostLattice, points: Points) -> list[Points]:
    """The stretches beside closed ground, which do not overlap."""
    vertices = subdivided(points, 1.0)
    closed = beside_closed_ground(lattice, vertices)
    return [vertices[a:b] for a, b in stretches_around(vertices, closed, AROUND_CELLS) if b - a > 2]


def _until_idle(
    lattice: CostLattice,
    points: Points,
    random: np.random.Generator,
    changed: Callable[[Points, np.random.Generator], Points],
    *,
    patience: int,
    least_j: float,
) -> Points:
    """A path after rounds of changes, until so many in succession gained less than `least_j`."""
    idle, energy = 0, path_price(lattice, points)
    for _ in range(ROUNDS):
        points = changed(points, random)
        before, energy = energy, path_price(lattice, points)
        idle = 0 if before - energy > least_j else idle + 1
        if idle == patience:
            break
    return points


def _changed(
    lattice: CostLattice, points: Points, random: np.random.Generator, *, copies: int, scatter: bool
) -> Points:
    """The cheapest way over a path and copies of it that were shaken."""
    first, *draws = random.spawn(1 + copies)
    tasks = [partial(with_scattered, lattice, points, first)] if scatter else []
    tasks += [partial(_settled_copy, lattice, points, draw) for draw in draws]
    return with_crossovers(lattice, points, share_out(lambda task: task(), tasks))


def _settled_copy(lattice: CostLattice, points: Points, random: np.random.Generator) -> Points:
    """The path after its vertices were moved at random and settled."""
    copy = _moved(lattice, points, random)
    for stage in STAGES[-2:]:
        copy = stage(lattice, copy)
    return copy


def _moved(lattice: CostLattice, points: Points, random: np.random.Generator) -> Points:
    """The path with its vertices shifted at random; those stay where a leg could not be driven."""
    vertices = subdivided(points, 1.0)
    along = distances_along(vertices)
    knots = np.linspace(0.0, along[-1], max(round(along[-1] / KNOT_CELLS), 1) + 1)
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
