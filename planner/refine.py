"""Any-angle improvement of a grid path: never dearer, never over blocked ground, priced by the one integrator.

Two steps alternate from coarse to fine. *Shortcut* keeps, out of all vertices, the chain of straight legs that costs
least (dynamic programming, so zigzags stay where they pay). *Relax* cuts long legs and shifts every vertex, and every
leg as a whole, by ever smaller steps as long as the energy falls (a pattern search, Hooke & Jeeves 1961).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from joulemap.planner.edges import Points, leg_prices_between, path_price, price_arrays
from joulemap.planner.kernels import leg_energy, turn_angle
from joulemap.planner.lattice import CostLattice

PAIR_BUDGET = 300_000
"""Cells that the legs of one shortcut pass may cross in total; on longer paths a shortcut spans fewer vertices."""
Levels = tuple[tuple[float, float, float], ...]
LEVELS: Levels = (
    (math.inf, 8.0, 0.5),
    (8.0, 2.0, 0.125),
    (2.0, 0.5, 0.03125),
    (math.inf, 0.25, 0.015625),
)
"""Longest leg, first and last shift of its vertices [cells]. Coarse to fine, so that small changes of direction are
found too; whole legs first and last, so that a zigzag can change its angle as one."""
SWEEPS = 24
"""Largest number of sweeps over the vertices with one shift."""


def refine_path(lattice: CostLattice, points: Points, *, levels: Levels = LEVELS) -> Points:
    """Return a polyline of any angles with the same ends and at most the same energy.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline.
    levels : tuple of tuple of float
        Longest leg, first and last shift of its vertices [cells], from coarse to fine.

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline whose legs may all be driven; `points` where nothing is gained.
    """
    best = _distinct(np.ascontiguousarray(points, dtype=np.float64))
    if len(best) < 3:
        return best
    energy = path_price(lattice, best)
    for _ in range(2):
        best, energy = _cheaper(lattice, best, energy, _shortcut(lattice, best))
    for leg, first_step, last_step in levels:
        fine = subdivided(best, leg)
        relaxed = _relax(*price_arrays(lattice), lattice.robot.turn_j_per_rad, fine, first_step, last_step, SWEEPS)
        best, energy = _cheaper(lattice, best, energy, relaxed)
        best, energy = _cheaper(lattice, best, energy, _shortcut(lattice, best))
    return best


def _cheaper(lattice: CostLattice, best: Points, energy: float, candidate: Points) -> tuple[Points, float]:
    price = path_price(lattice, candidate)
    return (candidate, price) if price < energy else (best, energy)


def _distinct(points: Points) -> Points:
    """Without vertices that repeat their predecessor; both ends stay."""
    keep = np.append(True, np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-9)
    if not keep[-1]:
        keep[-2], keep[-1] = False, True
    keep[0] = True
    return np.ascontiguousarray(points[keep])


def subdivided(points: Points, leg_cells: float) -> Points:
    """Return the same polyline with no leg longer than a limit.

    Parameters
    ----------
    points : ndarray of float, (n, 2)
        (row, col) polyline.
    leg_cells : float
        Longest leg [cells].

    Returns
    -------
    ndarray of float, (m, 2)
        (row, col) polyline.
    """
    out = [points[:1]]
    for a, b in zip(points[:-1], points[1:], strict=True):
        count = max(1, math.ceil(math.dist(a, b) / leg_cells))
        share = np.arange(1, count + 1)[:, None] / count
        out.append((1.0 - share) * a + share * b)  # exactly b at the end
    return np.ascontiguousarray(np.vstack(out))


def _shortcut(lattice: CostLattice, points: Points) -> Points:
    """The cheapest chain of straight legs over a subsequence of the vertices."""
    n = len(points)
    step = max(np.hypot(*np.diff(points, axis=0).T).mean(), 1.0)
    span = int(np.clip(math.sqrt(2.0 * PAIR_BUDGET / (n * step)), 2, n - 1))
    first, second = np.triu_indices(n, 1)
    near = second - first <= span
    first, second = first[near], second[near]
    energy = leg_prices_between(lattice, points[first], points[second])
    keep = _cheapest_chain(points, first, second, energy, lattice.robot.turn_j_per_rad)
    return np.ascontiguousarray(points[keep])


@njit(cache=True, nogil=True)
def _cheapest_chain(points, first, second, energy, turn_j_per_rad):
    """Indices of the kept vertices. Pairs are sorted by `first`; the turn at a vertex counts from its best chain."""
    n = points.shape[0]
    best = np.full(n, np.inf)
    parent = np.zeros(n, dtype=np.int64)
    best[0] = 0.0
    for k in range(first.size):
        i, j = first[k], second[k]
        if math.isnan(energy[k]):
            continue
        total = best[i] + energy[k]
        if i > 0 and turn_j_per_rad > 0.0:
            p = parent[i]
            total += turn_j_per_rad * turn_angle(
                points[p, 0], points[p, 1], points[i, 0], points[i, 1], points[j, 0], points[j, 1]
            )
        if total < best[j]:
            best[j] = total
            parent[j] = i
    keep = np.zeros(n, dtype=np.bool_)
    j = n - 1
    while j > 0:
        keep[j] = True
        j = parent[j]
    keep[0] = True
    return np.flatnonzero(keep)


@njit(cache=True)
def _local_energy(traction, gradient, blocked, terms, turn_j_per_rad, points, i, j):
    """Energy that changes with vertices i..j: their legs and the turns at i - 1 .. j + 1."""
    n = points.shape[0]
    energy = 0.0
    for k in range(i, j + 2):
        energy += leg_energy(
            traction, gradient, blocked, terms, points[k - 1, 0], points[k - 1, 1], points[k, 0], points[k, 1]
        )
    if turn_j_per_rad > 0.0:
        for k in range(max(i - 1, 1), min(j + 1, n - 2) + 1):
            energy += turn_j_per_rad * turn_angle(
                points[k - 1, 0], points[k - 1, 1], points[k, 0], points[k, 1], points[k + 1, 0], points[k + 1, 1]
            )
    return energy


@njit(cache=True, nogil=True)
def _relax(traction, gradient, blocked, terms, turn_j_per_rad, points, step, last_step, sweeps):
    """Pattern search over vertices and whole legs, with shifts from `step` halved down to `last_step`.

    A vertex is tried again only after it or one of its neighbours has moved.
    """
    points = points.copy()
    n = points.shape[0]
    while step >= last_step:
        due = np.ones(n, dtype=np.bool_)
        for _ in range(sweeps):
            gained = 0.0
            for i in range(1, n - 1):
                if not due[i]:
                    continue
                due[i] = False
                for j in range(i, min(i + 2, n - 1)):
                    here = _local_energy(traction, gradient, blocked, terms, turn_j_per_rad, points, i, j)
                    lowest = here - 1e-6 * abs(here) - 1e-9
                    best_r = 0.0
                    best_c = 0.0
                    for d in range(8):
                        dr = step * math.cos(0.25 * math.pi * d)
                        dc = step * math.sin(0.25 * math.pi * d)
                        for k in range(i, j + 1):
                            points[k, 0] += dr
                            points[k, 1] += dc
                        there = _local_energy(traction, gradient, blocked, terms, turn_j_per_rad, points, i, j)
                        for k in range(i, j + 1):
                            points[k, 0] -= dr
                            points[k, 1] -= dc
                        if there < lowest:
                            lowest = there
                            best_r = dr
                            best_c = dc
                    if best_r != 0.0 or best_c != 0.0:
                        gained += here - lowest
                        for k in range(i, j + 1):
                            points[k, 0] += best_r
                            points[k, 1] += best_c
                        for k in range(max(i - 2, 1), min(j + 3, n - 1)):
                            due[k] = True
            if gained == 0.0:
                break
        step *= 0.5
    return points
