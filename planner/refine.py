"""Any-angle improvement of a path: never dearer, never over blocked ground, priced by the one integrator.

Steps from coarse to fine. *Shortcuts* keep, out of all vertices, the chain of straight legs that costs least
(dynamic programming, so zigzags stay where they pay). *Bending* shifts long stretches by many cells, all at once by the
combination of shifts that costs least (`deform`). *Settling* moves every vertex to the least energy nearby by Newton's
method (`settle`); where turning costs or limits are near, vertices are bent there too, by small shares of a cell. A
path that is not long is settled and bent again and again until that gains nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.planner.deform import bent
from joulemap.planner.edges import Points, path_price, price_arrays
from joulemap.planner.kernels import heading_memory, leg_energy_with, path_energy, turn_angle
from joulemap.planner.lattice import CostLattice
from joulemap.planner.polylines import distinct, path_length, subdivided
from joulemap.planner.settle import settled
from joulemap.planner.stopping import check_stop

SPAN = 4
"""Vertices that a shortcut may leave out in one pass; passes are repeated while the path becomes cheaper."""
SWEEPS = 24
"""Largest number of sweeps with one shift."""
COARSE_STEPS = ((4.0, 8), (1.0, 8))
"""Shifts of stretches and the lengths of these [cells]: large shifts of short ones find a zigzag where only one of
large angles pays."""
FINE_PROBES = ((4.0, (1.0, 0.5, 0.25, 0.0625)), (2.0, (0.25, 0.0625)))
"""Distances of the vertices that settle, and the probes of each step of Newton's method [cells]."""
LAST_PROBES = (0.25, 0.0625)
"""Probes of vertices a cell apart [cells]."""
FINE_STEPS = (0.5, 0.25, 0.125, 0.0625, 0.03125)
"""Shifts of single vertices where they are bent [cells]."""
LAST_SPACING, LAST_STEPS = 0.5, (0.25, 0.0625)
"""Distance of the vertices that are shifted last, and their shifts to the sides and along the path [cells]. Half a cell
lets a path bend within a cell."""
CORNER_STEPS = (8.0, 4.0, 2.0, 1.0, *FINE_STEPS)
"""Shifts of the corners of a path of long legs, to the sides and along it [cells]: so a zigzag changes its angle."""
BENT_CELLS = 500.0
"""Longest path whose vertices are shifted a last time, to the sides and along it [cells]: that gains a few hundredths
of a percent and takes most of the time."""
LEAST_GAIN, PASSES = 2e-5, 8
"""Gain of the last two stages, as a share of the energy, for which they are repeated, and how often at most."""
_SIDES, _BOTH = (0.0,), (0.0, 0.5 * math.pi)
Stage = Callable[[CostLattice, Points], Points]
"""Lattice and (row, col) polyline to a polyline with the same ends."""


def refine_path(lattice: CostLattice, points: Points, *, stages: tuple[Stage, ...] | None = None) -> Points:
    """Return a polyline of any angles with the same ends and at most the same energy.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline.
    stages : tuple of callable, optional
        The first of `STAGES`, where less is enough; those of `path_stages` by default, and `converged` after them.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline whose legs may all be driven; `points` where nothing is gained.
    """
    for stage in path_stages(points) if stages is None else stages:
        points = stage(lattice, points)
    return converged(lattice, points) if stages is None else points


def converged(lattice: CostLattice, points: Points) -> Points:
    """Return a path that went through all stages, after the last two were repeated until they gained nothing.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline with the same ends and at most the same energy; `points` where it is longer than
        `BENT_CELLS`.
    """
    if path_length(points) > BENT_CELLS:
        return points
    energy = path_price(lattice, points)
    for _ in range(PASSES):
        for stage in STAGES[-2:]:
            points = stage(lattice, points)
        before, energy = energy, path_price(lattice, points)
        if not before - energy > LEAST_GAIN * abs(energy):
            break
    return points


def refine_coarsely(lattice: CostLattice, points: Points) -> Points:
    """Return what shortcuts and the bending of long stretches make of a path.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline with the same ends and at most the same energy.
    """
    best = distinct(np.ascontiguousarray(points, dtype=np.float64))
    if _fixed(lattice, best):
        return best
    best = subdivided(shortcuts(lattice, best), 4.0)
    for step, length in COARSE_STEPS:
        best = _bent(lattice, best, (step,), every=length // 4)
    return shortcuts(lattice, best)


def refine_corners(lattice: CostLattice, points: Points) -> Points:
    """Return what shifts of the vertices alone make of a path, with no vertex added.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline with the same ends and at most the same energy.
    """
    if _fixed(lattice, points):
        return points
    return shortcuts(lattice, _bent(lattice, points, CORNER_STEPS, _BOTH))


def refine_finely(lattice: CostLattice, points: Points) -> Points:
    """Return what settling of vertices four and then two cells apart makes of a path.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline with the same ends and at most the same energy.
    """
    if _fixed(lattice, points):
        return points
    if lattice.robot.turn_j_per_rad > 0.0:
        points = refine_corners(lattice, points)
    for spacing, probes in FINE_PROBES:
        points = _settled(lattice, subdivided(points, spacing), probes)
    return points


def refine_last(lattice: CostLattice, points: Points) -> Points:
    """Return what settling of vertices a cell apart makes of a path, and take needless vertices away.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline with the same ends and at most the same energy.
    """
    if _fixed(lattice, points):
        return points
    return shortcuts(lattice, _settled(lattice, subdivided(shortcuts(lattice, points), 1.0), LAST_PROBES))


def refine_bent(lattice: CostLattice, points: Points) -> Points:
    """Return a path after its vertices, half a cell apart, were moved to the sides and along it.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline with the same ends and at most the same energy.
    """
    if _fixed(lattice, points):
        return points
    return shortcuts(lattice, _bent(lattice, subdivided(points, LAST_SPACING), LAST_STEPS, _BOTH))


def path_stages(points: Points) -> tuple[Stage, ...]:
    """Return the stages that are worth their time for a path.

    Parameters
    ----------
    points : ndarray of float, (n, 2)
        (row, col) polyline.

    Returns
    -------
    tuple of callable
        All of `STAGES`, without the last one where the path is longer than `BENT_CELLS`.
    """
    return STAGES if path_length(points) <= BENT_CELLS else STAGES[:-1]


def _fixed(lattice: CostLattice, points: Points) -> bool:
    """Whether there is nothing to be moved. A straight leg is no reason: it may pay to leave it."""
    return path_length(points) == 0.0 or math.isnan(path_price(lattice, points))


def _settled(lattice: CostLattice, points: Points, probes: tuple[float, ...]) -> Points:
    """The path after steps of Newton's method, bent where a limit is near or turning costs."""
    check_stop()
    bend = np.ones(len(points), dtype=np.bool_)
    if lattice.robot.turn_j_per_rad == 0.0:
        points = settled(*price_arrays(lattice), points, np.array(probes), bend)
        bend[1:] |= bend[:-1]
        bend[:-1] |= bend[1:]
    return _bent(lattice, points, FINE_STEPS, movable=bend) if bend.any() else points


def _bent(
    lattice: CostLattice,
    points: Points,
    steps: tuple[float, ...],
    turned: tuple[float, ...] = _SIDES,
    *,
    every: int = 1,
    movable: NDArray[np.bool_] | None = None,
) -> Points:
    """The path after bending with each of some shifts, in each of some directions."""
    arrays, turn = price_arrays(lattice), lattice.robot.turn_j_per_rad
    movable = np.ones(len(points), dtype=np.bool_) if movable is None else movable
    for step in steps:
        check_stop()
        for angle in turned if len(points) > 2 else ():
            points = bent(*arrays, turn, points, movable, every, step, angle, SWEEPS)
    return points


def shortcuts(lattice: CostLattice, points: Points) -> Points:
    """Return the path after its vertices were left out wherever a straight leg costs at most the same.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline that may be driven.

    Returns
    -------
    ndarray of float, (m, 2)
        Some of its vertices, both ends among them.
    """
    never_pays = lattice.robot.regeneration == 0.0
    return _shortened(*price_arrays(lattice), lattice.robot.turn_j_per_rad, points, SPAN, never_pays)


STAGES = (shortcuts, refine_coarsely, refine_finely, refine_last, refine_bent)
"""The stages of `refine_path`: each costs more time than the one before, and gains less."""


@njit(cache=True, nogil=True)
def _shortened(traction, gradient, blocked, terms, turn_j_per_rad, points, span, never_pays):
    """The path after passes of `_cheapest_chain`, while they leave vertices out. never_pays : no price is negative."""
    arrays = (heading_memory(traction.shape[2]), traction, gradient, blocked, terms)
    energy = path_energy(traction, gradient, blocked, terms, turn_j_per_rad, points)
    legs = np.full((points.shape[0], span), np.nan)
    while points.shape[0] > 2:
        keep, total = _cheapest_chain(arrays, turn_j_per_rad, points, legs, never_pays)
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
def _cheapest_chain(arrays, turn_j_per_rad, points, legs, never_pays):
    """The vertices that the cheapest chain of legs keeps, and its energy [J].

    The turn at a vertex counts from its best chain. legs : (n, span) energy of the leg from a vertex over 1 to `span`
    vertices [J], NaN where it is not known yet, infinite where it may not be driven or is too dear; it is filled.
    """
    memory, traction, gradient, blocked, terms = arrays
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
                r0, c0, r1, c1 = points[i, 0], points[i, 1], points[j, 0], points[j, 1]
                price = leg_energy_with(memory, traction, gradient, blocked, terms, r0, c0, r1, c1, most)
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
