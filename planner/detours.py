"""The any-angle path over several corridors: the best one is improved, the others only where they differ from it.

Paths of two corridors mostly begin and end over the same cells. The part in between is a *detour*: it leaves the best
path, runs through the other corridor, and joins the path again. It competes with the stretch of the best path that it
would replace, and is given up after a stage that leaves it too far behind. The cheapest way over the path and all
detours that are left is taken (`crossovers`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from joulemap.model.threads import share_out
from joulemap.planner.crossovers import with_crossovers
from joulemap.planner.edges import Points, leg_prices, path_price
from joulemap.planner.lattice import CostLattice
from joulemap.planner.polylines import distances_along, path_length, subdivided
from joulemap.planner.refine import STAGES, Stage, path_stages, shortcuts

LAGS = (0.15, 0.12, 0.08, 0.03, 0.01, 0.0)
"""By how much a detour that wins in the end may lag behind before the stages and after each, as a share of the mean
energy of a cell, times the root of its length [cells]: what a stage gains is a sum along the path, so its spread grows
with that root. Measured on the five maps of `tests/bench/quality.py`, 400 random tasks each: of the detours that saved
0.1 % or more, 99 of 100 lagged by at most 0.12, 0.08, 0.03 and 0.003 after the first four stages."""
LEAST_CELLS = 400.0
"""Shorter detours may lag behind as much as one of this length: where blocked cells are near, a stage gains much on few
cells, and short detours take little time."""
JOINT_CELLS = 12.0
"""Length that a detour has in common with the grid path of the best one at either end [cells], along which it leaves
the improved path and joins it. With 6, six of 1,878 random tasks cost over 0.1 % more, and three less."""
BENT_DETOURS_CELLS = 200.0
"""Longest path whose detours are bent before they are compared [cells]; of longer ones the path is bent, with those
that it takes. Of the detours that saved 0.1 % or more, 99 of 100 lagged by less than 0.06 cells before: a small share
of such a path."""
AFTER_JOINING = 2
"""The first stage that a path with detours goes through once more, after `shortcuts`, because it has corners where they
begin and end."""


@dataclass(frozen=True, eq=False, repr=False)
class Improved:
    """What became of a path.

    Attributes
    ----------
    grid : ndarray of float, (n, 2)
        (row, col) polyline as it was.
    stages : tuple of callable
        The stages that it went through.
    prices_j : tuple of float
        Its energy at first and after each stage [J].
    points : ndarray of float, (m, 2)
        (row, col) polyline after them.
    vertices : ndarray of float, (k, 2)
        The same, its vertices at most a cell apart.
    j_per_cell : float
        Mean energy of a cell's length [J].
    """

    grid: Points
    stages: tuple[Stage, ...]
    prices_j: tuple[float, ...]
    points: Points
    vertices: Points
    j_per_cell: float


@dataclass(frozen=True, eq=False, repr=False)
class Detour:
    """Points that may replace some vertices of the best path.

    Attributes
    ----------
    points : ndarray of float, (n, 2)
        (row, col) polyline.
    first, last : int
        The vertices at which it begins and ends.
    replaced_j : float
        Energy of the path between these [J].
    unit_j : float
        Energy in which it is counted how far the detour lags behind [J].
    """

    points: Points
    first: int
    last: int
    replaced_j: float
    unit_j: float


def largest_lag(cells: float) -> float:
    """Return how much dearer than the best path over grid moves another one is that may still win.

    Parameters
    ----------
    cells : float
        Distance of the two ends [cells].

    Returns
    -------
    float
        Share of the energy.
    """
    cells = max(cells, 1.0)
    return LAGS[0] * math.sqrt(max(cells, LEAST_CELLS)) / cells


def best_of_corridors(lattice: CostLattice, best: Improved, others: Sequence[Points]) -> Points:
    """Return the best of what the any-angle step makes of some paths.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    best : Improved
        A path that was improved as a whole, the best known.
    others : sequence of ndarray of float, (n, 2)
        (row, col) polylines with the same ends that may be driven.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline.
    """
    detours = [detour for other in others if (detour := _detour(lattice, best, other)) is not None]
    stages = best.stages if path_length(best.points) <= BENT_DETOURS_CELLS else STAGES[:-1]

    def _improve(detour: Detour) -> Points | None:
        share = (detour.last - detour.first) / (len(best.vertices) - 1)
        most_j = [
            detour.replaced_j + share * (usual_j - best.prices_j[-1]) + lag * detour.unit_j
            for usual_j, lag in zip(best.prices_j[1:], LAGS[1:], strict=False)
        ]
        return _competed(lattice, detour, stages, most_j)

    won = [points for points in share_out(_improve, detours) if points is not None]
    return _combined(lattice, best.points, won)


def _combined(lattice: CostLattice, points: Points, others: Sequence[Points]) -> Points:
    """The cheapest way over a path and others, without the corners where it changes between them."""
    way = with_crossovers(lattice, points, others)
    if way is points:
        return points
    way = shortcuts(lattice, way)  # it has a vertex every half cell, of which each stage would move all
    for stage in path_stages(points)[AFTER_JOINING:]:
        way = stage(lattice, way)
    return way


def improved(lattice: CostLattice, grid: Points) -> Improved:
    """Return what the any-angle step makes of a path.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    grid : ndarray of float, (n, 2)
        (row, col) polyline that may be driven.

    Returns
    -------
    Improved
        The path, and what each stage gained.
    """
    points, prices_j = grid, [path_price(lattice, grid)]
    stages = path_stages(grid)
    for stage in stages:
        points = stage(lattice, points)
        prices_j.append(path_price(lattice, points))
    return Improved(grid, stages, tuple(prices_j), points, subdivided(points, 1.0), _cell_energy(lattice, points))


def _cell_energy(lattice: CostLattice, points: Points) -> float:
    """Mean energy of a cell's length [J], without signs: with regeneration the energy of a whole path may be 0."""
    return float(np.abs(leg_prices(lattice, points)).sum()) / max(path_length(points), 1.0)


def _detour(lattice: CostLattice, best: Improved, other: Points) -> Detour | None:
    """The part of another path that the best one has not; None where it is the same or too dear to win."""
    usual, common = best.grid, min(len(best.grid), len(other))
    differ = (usual[:common] != other[:common]).any(axis=1)
    if not differ.any():
        return None
    a = max(int(np.argmax(differ)) - 1, 0)  # the last vertex before they part
    differ = (usual[-common:] != other[-common:]).any(axis=1)[::-1]
    after = min(max(int(np.argmax(differ)), 1), common - 1 - a)  # vertices from where they meet again
    b = len(other) - after
    instead, part = usual[a : len(usual) - after + 1], other[a : b + 1]
    unit_j = best.j_per_cell * math.sqrt(max(path_length(part), path_length(instead), LEAST_CELLS))
    if not path_price(lattice, part) - path_price(lattice, instead) <= LAGS[0] * unit_j:
        return None
    along = distances_along(other)
    a = max(int(np.searchsorted(along, along[a] - JOINT_CELLS)) - 1, 0)
    b = min(int(np.searchsorted(along, along[b] + JOINT_CELLS)), len(other) - 1)
    first, last = _nearest(best.vertices, other[a]), _nearest(best.vertices, other[b])
    points = np.vstack([best.vertices[first], other[a + 1 : b], best.vertices[last]])
    if first >= last or math.isnan(path_price(lattice, points)):  # the joints may not be driven
        points, first, last = other, 0, len(best.vertices) - 1
    return Detour(points, first, last, path_price(lattice, best.vertices[first : last + 1]), unit_j)


def _nearest(vertices: Points, place: Points) -> int:
    return int(np.argmin(((vertices - place) ** 2).sum(axis=1)))


def _competed(lattice: CostLattice, detour: Detour, stages: Sequence[Stage], most_j: Sequence[float]) -> Points | None:
    """A detour after some stages; None where it costs more after a stage than it may, most_j [J]."""
    points = detour.points
    for stage, most in zip(stages, most_j, strict=False):
        points = stage(lattice, points)
        if not path_price(lattice, points) <= most:
            return None
    return points
