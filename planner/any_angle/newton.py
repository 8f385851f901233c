"""Compiled settling of a polyline into the local optimum that it lies near: Newton's method on its vertices.

Every vertex may move to either side. The energy of a leg depends on the offsets of its two ends only, so the Hessian of
the path's energy has three diagonals, and a step of Newton's method costs as much as pricing the path a few times. What
a leg costs is known from its prices at offsets of `probe` cells, which smooths the edges of cells and of prices that
are clipped. The step is a proposal: the cheapest combination of vertices that take it and vertices that stay is chosen
exactly, as in `bending`, so no round makes the path dearer.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from joulemap.planner.any_angle.bending import ACROSS, SHIFTS, choose, price_leg, set_sides, shifted
from joulemap.planner.pricing.kernels import heading_memory

DAMPING = 1e-3
"""Added to the diagonal of the Hessian, as a share of its largest entry, where a stretch has no curvature at all."""


@njit(cache=True, nogil=True)
def settled(prices, points, probes):
    """The polyline after one step of Newton's method for each of some probes: (n, 2) float64, at most as dear.

    prices : an `integrator.Prices`. points : (row, col) polyline that may be driven
    (n, 2), n >= 2; turning costs nothing. probes : offsets of the probes of each round [cells]; no vertex moves
    further than twice that in the round. Where a probe may not be driven, the vertex goes to the other side if that
    costs less (Nocedal & Wright 2006, section 3.4, for the modified Hessian).
    """
    points = points.copy()
    n = points.shape[0]
    memory = heading_memory(prices.traction.shape[2])
    side, chosen = np.zeros((n, 2)), np.zeros(n, dtype=np.int64)
    cost = np.full((n - 1, SHIFTS, SHIFTS), np.inf)
    for probe in probes:
        set_sides(points, side, ACROSS, 0, n)
        for k in range(n - 1):
            price_leg(memory, prices, points, side, k, probe, cost)
        side *= probe * _steps(cost).reshape(n, 1)
        for k in range(n - 1):
            price_leg(memory, prices, points, side, k, 1.0, cost)
        if choose(cost, chosen) > 0.0:
            for i in range(1, n - 1):
                points[i, 0], points[i, 1] = shifted(points, side, i, chosen[i], 1.0)
    return points


@njit(cache=True)
def _steps(cost):
    """Newton's step of each vertex, at most 2, in probes: (n,).

    cost : (n - 1, 3, 3) energies of the legs where either end stays or is probed to one side or the other [J]. The
    second derivatives of each leg are made positive semidefinite.
    """
    n = cost.shape[0] + 1
    ahead = np.zeros((n, 2))  # what a probe of the vertex to either side costs more
    curve, mixed = np.zeros(n), np.zeros(n)
    for k in range(n - 1):
        here, first, last, cross = cost[k, 0, 0], 0.0, 0.0, 0.0
        if k > 0:
            ahead[k] += cost[k, 1:, 0] - here
            first = cost[k, 1, 0] + cost[k, 2, 0] - 2.0 * here
        if k < n - 2:
            ahead[k + 1] += cost[k, 0, 1:] - here
            last = cost[k, 0, 1] + cost[k, 0, 2] - 2.0 * here
        if not math.isfinite(first + last):
            continue
        if 0 < k < n - 2 and math.isfinite(cost[k, 1, 1] + cost[k, 2, 2]):
            cross = 0.5 * (cost[k, 1, 1] + cost[k, 2, 2] - 2.0 * here - first - last)
        middle, spread = 0.5 * (first + last), math.hypot(0.5 * (first - last), cross)
        if middle < spread:  # one eigenvalue is negative: only the other's part stays
            high = middle + spread
            keep = high / (2.0 * spread) if high > 0.0 else 0.0
            low = middle - spread
            first, last, cross = keep * (first - low), keep * (last - low), keep * cross
        curve[k] += first
        curve[k + 1] += last
        mixed[k] = cross
    steps = _solved(0.5 * (ahead[:, 0] - ahead[:, 1]), curve, mixed)
    for i in range(n):
        if not math.isfinite(ahead[i, 0] + ahead[i, 1]):  # to the one side that is free and costs less, if there is one
            steps[i] = 1.0 if ahead[i, 0] < 0.0 else -1.0 if ahead[i, 1] < 0.0 else 0.0
        steps[i] = min(max(steps[i], -2.0), 2.0)
    return steps


@njit(cache=True)
def _solved(slope, curve, mixed):
    """Newton's step from a system of three diagonals, (n,). Both ends and vertices without a slope stay."""
    n = slope.size
    curve = curve + DAMPING * curve.max() + 1e-12
    steps = np.zeros(n)
    for i in range(n):
        if i == 0 or i == n - 1 or not math.isfinite(slope[i]):
            curve[i], slope[i], mixed[i] = 1.0, 0.0, 0.0
            if i > 0:
                mixed[i - 1] = 0.0
    for i in range(1, n):
        share = mixed[i - 1] / curve[i - 1]
        curve[i] -= share * mixed[i - 1]
        slope[i] -= share * slope[i - 1]
    for i in range(n - 2, -1, -1):
        steps[i] = (-slope[i] - mixed[i] * steps[i + 1]) / curve[i]
    return steps
