"""Corners of a path that survive rounding: a leg along the edge of blocked ground is blocked once a corner moves.

The planner's best paths touch the edge of blocked ground exactly, so any rounding of a corner may push a leg over it.
The corner is then moved by a few millimetres, to where both of its legs may be driven.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from joulemap.model.errors import BlockedError
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, leg_prices, leg_prices_between, world_points
from joulemap.planner.route import Route, price_route

FURTHEST_M = 0.005
"""How far a corner is moved in a file: half of the 1 cm within which written positions hold."""

READ_FURTHEST_M = 0.01
"""How far a corner of a given path is moved: so much may its file have rounded off."""

_RADII = (0.2, 0.45, 0.8)  # of the furthest shift; what quantising adds stays within the rest
_DIRECTIONS = 8
_WIDER = 3  # times that the corners around a blocked leg are moved too

Quantise = Callable[[Points], Points]


def cleared(lattice: CostLattice, points: Points, *, furthest_m: float, quantise: Quantise | None = None) -> Points:
    """Return a path whose legs may all be driven, with corners moved as little as that needs.

    `points` (n, 2): fractional (row, col). Result (n, 2): where no such path was found, only that was done.

    The shortest path through the candidates of successive corners (dynamic programming): 8 directions at three
    distances, and the lines through cell centres nearby, on which a passage of one cell is driven.
    """
    rounded = np.array(points, dtype=np.float64) if quantise is None else quantise(points)
    if len(points) < 2:
        return rounded
    blocked = np.isnan(leg_prices(lattice, rounded))
    movable = np.zeros(len(points), dtype=np.bool_)
    for _ in range(_WIDER):
        if not blocked.any():
            break
        movable[:-1] |= blocked
        movable[1:] |= blocked
        found = _cheapest_chain(lattice, points, rounded, movable, furthest_m, quantise)
        if found is not None:
            return found
        blocked = movable[:-1] | movable[1:]
    return rounded


def price_given_path(lattice: CostLattice, xy: Points) -> Route:
    """Return the route along given world points, which a file may have rounded onto blocked ground.

    `xy` (n, 2 or more): world x, y [m]. Result: with a note where corners were moved, by at most `READ_FURTHEST_M`.
    Raises BlockedError if a leg may not be driven.
    """
    try:
        return price_route(lattice, xy)
    except BlockedError:
        points = world_points(lattice, xy)
        found = cleared(lattice, points, furthest_m=READ_FURTHEST_M)
        if np.isnan(leg_prices(lattice, found)).any():
            raise
    moved = np.hypot(*(found - points).T) * lattice.frame.resolution_m
    note = (
        f"{int((moved > 0).sum())} points of the path touch blocked ground by rounding and were moved, by "
        f"{1e3 * moved.max():.1f} mm at most"
    )
    return price_route(lattice, np.column_stack(lattice.frame.xy(found[:, 0], found[:, 1])), notes=[note])


def _cheapest_chain(
    lattice: CostLattice,
    points: Points,
    rounded: Points,
    movable: np.ndarray,
    furthest_m: float,
    quantise: Quantise | None,
) -> Points | None:
    """Of each corner's candidates, those that are moved least and whose legs may all be driven; None without any."""
    choices = [rounded[k : k + 1] for k in range(len(points))]
    for k in np.flatnonzero(movable).tolist():
        choices[k] = _candidates(lattice, points[k], rounded[k], furthest_m, quantise)
    cost, before = np.zeros(len(choices[0])) + _shift(choices[0], points[0]), list[np.ndarray]()
    for k in range(1, len(choices)):
        here, there = choices[k - 1], choices[k]
        pairs = np.isfinite(_prices(lattice, here, there))  # (here, there)
        total = np.where(pairs, cost[:, None], np.inf)
        before.append(total.argmin(axis=0))
        cost = total.min(axis=0) + _shift(there, points[k])
    if not np.isfinite(cost).any():
        return None
    at = int(cost.argmin())
    chain = [choices[-1][at]]
    for k in range(len(choices) - 2, -1, -1):
        at = int(before[k][at])
        chain.append(choices[k][at])
    return np.array(chain[::-1])


def _prices(lattice: CostLattice, here: Points, there: Points) -> np.ndarray:
    starts, ends = np.repeat(here, len(there), axis=0), np.tile(there, (len(here), 1))
    return leg_prices_between(lattice, starts, ends).reshape(len(here), len(there))


def _shift(candidates: Points, point: Points) -> np.ndarray:
    return np.hypot(*(candidates - point).T)


def _candidates(
    lattice: CostLattice, point: Points, rounded: Points, furthest_m: float, quantise: Quantise | None
) -> Points:
    furthest = furthest_m / lattice.frame.resolution_m
    angles = np.arange(_DIRECTIONS) * (2.0 * np.pi / _DIRECTIONS)
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    around = point + np.vstack([furthest * radius * ring for radius in _RADII])
    centre = np.round(point)
    lines = np.array([[centre[0], point[1]], [point[0], centre[1]], centre])
    around = np.vstack([around, lines[_shift(lines, point) <= furthest]])
    return np.vstack([rounded, around if quantise is None else quantise(around)])
