"""The any-angle path over several corridors: the best one is improved, the others only where they differ from it.

Paths of two corridors mostly begin and end over the same cells. The part in between is a *detour*: it leaves the best
path, runs through the other corridor, and joins the path again. It competes with the stretch of the best path that it
would replace, and is given up after a stage that leaves it too far behind. Detours that replace different stretches may
all be taken. Then the path is compared with detours a few cells beside it, in corridors that are too near for the grid
(`ribbon`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from joulemap.model.threads import share_out
from joulemap.planner.edges import Points, leg_prices, path_price
from joulemap.planner.lattice import CostLattice
from joulemap.planner.refine import Stage, converged, path_length, path_stages, subdivided
from joulemap.planner.ribbon import Ribbon, ways_beside

LAGS = (0.2, 0.15, 0.1, 0.03, 0.01, 0.0)
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
RIBBONS = (
    Ribbon(spacing=12, half_width=12.0, step=0.5, slope=1.0),
    Ribbon(spacing=4, half_width=4.0, step=0.25, slope=0.75),
    Ribbon(spacing=6, half_width=6.0, step=0.25, slope=1.0),
    Ribbon(spacing=8, half_width=8.0, step=0.25, slope=1.0),
    Ribbon(spacing=3, half_width=3.0, step=0.25, slope=1.0),
)
"""Ribbons in which cheaper ways beside the path are searched; a leg of the path is at most half a cell long. Each
ribbon finds ways that the others miss. The ways of all compete for the same path: one ribbon after the other, the first
small gain often closes the way to a larger one."""
RIBBON_SLACK = 2.0
"""By how much a chain through a ribbon may be dearer than the cheapest one, in mean energies of a cell."""
ROUNDS, ROUND_GAIN = 3, 1e-4
"""Most rounds, and the gain of one, as a share of the energy, for which another one follows: the path beside which ways
are searched is a new one then."""
RIBBON_CELLS, VALLEY_CELLS = 300.0, 150.0
"""Longest path for which this is done, and for which valleys compete and further rounds follow [cells]: a way saves the
energy of a few cells, a smaller share of a longer path, and takes more time there."""
_AFTER_JOINING = 2
"""The first stage that a path with detours goes through once more, because it has corners where they begin and end."""


@dataclass(frozen=True, eq=False, repr=False)
class _Improved:
    """What became of a grid path.

    prices_j : energy of the grid path and after each stage; vertices : `points`, at most a cell apart.
    """

    grid: Points
    stages: tuple[Stage, ...]
    prices_j: tuple[float, ...]
    points: Points
    vertices: Points
    j_per_cell: float


@dataclass(frozen=True, eq=False, repr=False)
class _Detour:
    """Points that may replace the vertices `first` to `last` of the best path.

    replaced_j : energy of these; unit_j : what `LAGS` are counted in.
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


def best_of(lattice: CostLattice, paths: Sequence[Points]) -> Points:
    """Return the best of what the any-angle step makes of some paths.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    paths : sequence of ndarray of float, (n, 2)
        (row, col) polylines with the same ends that may be driven, at least one. The others are compared with the
        first, so that it should be the best known.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline.
    """
    best = _improved(lattice, paths[0])
    detours = [detour for other in paths[1:] if (detour := _detour(lattice, best, other)) is not None]

    def _improve(detour: _Detour) -> _Detour | None:
        share = (detour.last - detour.first) / (len(best.vertices) - 1)
        most_j = [
            detour.replaced_j + share * (usual_j - best.prices_j[-1]) + lag * detour.unit_j
            for usual_j, lag in zip(best.prices_j[1:], LAGS[1:], strict=False)
        ]
        return _competed(lattice, detour, best.stages, most_j)

    points = _with_best(lattice, best.points, best.vertices, detours, _improve)
    return converged(lattice, _with_ways_beside(lattice, points))


def _with_ways_beside(lattice: CostLattice, points: Points) -> Points:
    """The path after rounds of `_beside`, while they gain more than a little."""
    length, energy = path_length(points), path_price(lattice, points)
    if length > RIBBON_CELLS:
        return points
    if length > VALLEY_CELLS:
        return _beside(lattice, points, 0.0)
    for _ in range(ROUNDS):
        points = _beside(lattice, points, RIBBON_SLACK)
        before, energy = energy, path_price(lattice, points)
        if not before - energy > ROUND_GAIN * abs(energy):
            break
    return points


def _beside(lattice: CostLattice, points: Points, slack: float) -> Points:
    """The path with the ways beside it, through any ribbon, that are cheaper once their vertices have settled.

    slack : as `RIBBON_SLACK`.
    """
    vertices, cell_j = subdivided(points, 0.5), _cell_energy(lattice, points)
    ways = [
        _Detour(way, first, last, path_price(lattice, vertices[first : last + 1]), cell_j * math.sqrt(LEAST_CELLS))
        for ribbon in RIBBONS
        for first, last, way in ways_beside(lattice, vertices, ribbon, slack_j=slack * cell_j)
    ]

    def _finished(detour: _Detour) -> _Detour | None:
        stages = path_stages(detour.points)[_AFTER_JOINING:]
        most_j = [detour.replaced_j + lag * detour.unit_j for lag in LAGS[_AFTER_JOINING + 1 :]]
        settled = _competed(lattice, detour, stages, most_j)
        return None if settled is None else replace(settled, points=converged(lattice, settled.points))

    return _with_best(lattice, points, vertices, ways, _finished)


def _with_best(
    lattice: CostLattice,
    points: Points,
    vertices: Points,
    detours: list[_Detour],
    improve: Callable[[_Detour], _Detour | None],
) -> Points:
    """The path after the detours that pay were taken; vertices : of the path, those that detours replace."""
    gains_j = np.zeros(len(detours))

    def _improve(k: int) -> None:
        if (detour := improve(detours[k])) is not None:
            detours[k] = detour
            gains_j[k] = detour.replaced_j - path_price(lattice, detour.points)

    share_out(_improve, range(len(detours)))
    taken = [detours[k] for k in np.argsort(-gains_j, kind="stable") if gains_j[k] > 0.0]
    if not taken:
        return points
    joined = _smoothed(lattice, _joined(vertices, taken))
    return joined if path_price(lattice, joined) < path_price(lattice, points) else points


def _smoothed(lattice: CostLattice, points: Points) -> Points:
    """The path without the corners where detours begin and end."""
    for stage in path_stages(points)[_AFTER_JOINING:]:
        points = stage(lattice, points)
    return points


def _improved(lattice: CostLattice, grid: Points) -> _Improved:
    points, prices_j = grid, [path_price(lattice, grid)]
    stages = path_stages(grid)
    for stage in stages:
        points = stage(lattice, points)
        prices_j.append(path_price(lattice, points))
    return _Improved(grid, stages, tuple(prices_j), points, subdivided(points, 1.0), _cell_energy(lattice, points))


def _cell_energy(lattice: CostLattice, points: Points) -> float:
    """Mean energy of a cell's length [J], without signs: with regeneration that of a whole path may be 0."""
    return float(np.abs(leg_prices(lattice, points)).sum()) / max(path_length(points), 1.0)


def _detour(lattice: CostLattice, best: _Improved, other: Points) -> _Detour | None:
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
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(other, axis=0).T)))
    a = max(int(np.searchsorted(along, along[a] - JOINT_CELLS)) - 1, 0)
    b = min(int(np.searchsorted(along, along[b] + JOINT_CELLS)), len(other) - 1)
    first, last = _nearest(best.vertices, other[a]), _nearest(best.vertices, other[b])
    points = np.vstack([best.vertices[first], other[a + 1 : b], best.vertices[last]])
    if first >= last or math.isnan(path_price(lattice, points)):  # the joints may not be driven
        points, first, last = other, 0, len(best.vertices) - 1
    return _Detour(points, first, last, path_price(lattice, best.vertices[first : last + 1]), unit_j)


def _nearest(vertices: Points, place: Points) -> int:
    return int(np.argmin(((vertices - place) ** 2).sum(axis=1)))


def _competed(
    lattice: CostLattice, detour: _Detour, stages: Sequence[Stage], most_j: Sequence[float]
) -> _Detour | None:
    """The detour after some stages; None where it costs more after one of them than it may [J]."""
    points = detour.points
    for stage, most in zip(stages, most_j, strict=False):
        points = stage(lattice, points)
        if not path_price(lattice, points) <= most:
            return None
    return replace(detour, points=points)


def _joined(vertices: Points, detours: Sequence[_Detour]) -> Points:
    """The path with those detours that replace vertices which none before them replaces."""
    free = np.ones(len(vertices), dtype=np.bool_)
    chosen = []
    for detour in detours:
        if free[detour.first : detour.last + 1].all():
            free[detour.first : detour.last + 1] = False
            chosen.append(detour)
    for detour in sorted(chosen, key=lambda detour: -detour.first):  # from the end, so that indices stay
        vertices = np.vstack([vertices[: detour.first], detour.points, vertices[detour.last + 1 :]])
    return vertices
