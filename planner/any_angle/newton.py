"""Compiled settling of a polyline into the local optimum that it lies near: Newton's method on its vertices.

Every vertex may move to either side. The energy of a leg depends on the offsets of its two ends only, so the Hessian of
the path's energy has three diagonals, and a step of Newton's method costs as much as pricing the path a few times. What
a leg costs is known from its prices at offsets of `probe` cells, which smooths the edges of cells and of prices that
are clipped. The step is a proposal: the cheapest combination of vertices that take it and vertices that stay is chosen
exactly, so no round makes the path dearer.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from joulemap.planner.any_angle.bending import ACROSS, set_sides
from joulemap.planner.pricing.kernels import driven_leg_energy, heading_memory, polyline_energies

DAMPING = 1e-3
"""Added to the diagonal of the Hessian, as a share of its largest entry, where a stretch has no curvature at all."""
_PROBED = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 1.0), (-1.0, -1.0))
"""Offsets of a leg's two ends at which it is priced, in probes."""


@njit(cache=True, nogil=True)
def settled(traction, gradient, blocked, terms, points, probes):
    """The polyline after one step of Newton's method for each of some probes: (n, 2) float64, at most as dear.

    traction, gradient, blocked, terms : as for `kernels.leg_energy`. points : (row, col) polyline that may be driven
    (n, 2), n >= 2; turning costs nothing. probes : offsets of the probes of each round [cells]; no vertex moves
    further than twice that in the round. Where a probe may not be driven, the vertex goes to the other side if that
    costs less (Nocedal & Wright 2006, section 3.4, for the modified Hessian).
    """
    points = points.copy()
    n = points.shape[0]
    memory = heading_memory(traction.shape[2])
    arrays = (memory, traction, gradient, blocked, terms)
    side = np.zeros((n, 2))
    slope, curve, mixed, shift = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    hindered = np.zeros(n, dtype=np.bool_)
    ahead = np.empty((n, 2))  # what a probe of the vertex to either side costs more
    energy = polyline_energies(traction, gradient, blocked, terms, points)
    for r in range(probes.size):
        probe = probes[r]
        set_sides(points, side, ACROSS, 0, n)
        _probe(arrays, points, side, probe, energy, slope, curve, mixed, ahead)
        for i in range(n):
            hindered[i] = math.isnan(ahead[i, 0] + ahead[i, 1])
        _newton(slope, curve, mixed, hindered, shift)
        for i in range(n):
            if hindered[i]:  # to the one side that is free and costs less, if there is one
                shift[i] = probe if ahead[i, 0] < 0.0 else -probe if ahead[i, 1] < 0.0 else 0.0
            shift[i] = min(max(shift[i], -2.0 * probe), 2.0 * probe)
        _move(arrays, points, side, shift, energy)
    return points


@njit(cache=True)
def _probe(arrays, points, side, probe, energy, slope, curve, mixed, ahead):
    """Fill the derivatives of the energy by the offsets; the second ones of each leg are made positive semidefinite.

    arrays : what pricing needs, with memory first.
    """
    memory, traction, gradient, blocked, terms = arrays
    n = points.shape[0]
    slope[:], curve[:], mixed[:], ahead[:] = 0.0, 0.0, 0.0, 0.0
    probed = np.empty(6)
    for k in range(n - 1):
        here = energy[k]
        for v in range(6):
            start, end = probe * _PROBED[v][0], probe * _PROBED[v][1]
            if (start != 0.0 and k == 0) or (end != 0.0 and k == n - 2):  # both ends of the path stay
                probed[v] = here
                continue
            row0, col0 = points[k, 0] + start * side[k, 0], points[k, 1] + start * side[k, 1]
            row1, col1 = points[k + 1, 0] + end * side[k + 1, 0], points[k + 1, 1] + end * side[k + 1, 1]
            probed[v] = driven_leg_energy(memory, traction, gradient, blocked, terms, row0, col0, row1, col1, math.inf)
        left, right, other_left, other_right = probed[0], probed[1], probed[2], probed[3]
        ahead[k, 0] += left - here
        ahead[k, 1] += right - here
        ahead[k + 1, 0] += other_left - here
        ahead[k + 1, 1] += other_right - here
        first, last = left + right - 2.0 * here, other_left + other_right - 2.0 * here
        if math.isnan(first + last):
            continue
        cross = 0.0
        if 0 < k < n - 2:
            cross = 0.5 * (probed[4] + probed[5] - 2.0 * here - first - last)
            if math.isnan(cross):
                cross = 0.0
        middle, spread = 0.5 * (first + last), math.hypot(0.5 * (first - last), cross)
        if middle < spread:  # one eigenvalue is negative: only the other's part stays
            high = middle + spread
            keep = high / (2.0 * spread) if high > 0.0 else 0.0
            low = middle - spread
            first, last, cross = keep * (first - low), keep * (last - low), keep * cross
        square = probe * probe
        slope[k] += 0.5 * (left - right) / probe
        slope[k + 1] += 0.5 * (other_left - other_right) / probe
        curve[k] += first / square
        curve[k + 1] += last / square
        mixed[k] = cross / square


@njit(cache=True)
def _newton(slope, curve, mixed, hindered, shift):
    """Fill the offsets of Newton's step: a system of three diagonals. Both ends and hindered vertices stay."""
    n = slope.size
    floor = DAMPING * curve.max() + 1e-12
    for i in range(n):
        curve[i] += floor
        if i == 0 or i == n - 1 or hindered[i]:
            curve[i], slope[i], mixed[i] = 1.0, 0.0, 0.0
            if i > 0:
                mixed[i - 1] = 0.0
    for i in range(1, n):
        share = mixed[i - 1] / curve[i - 1]
        curve[i] -= share * mixed[i - 1]
        slope[i] -= share * slope[i - 1]
    shift[n - 1] = 0.0
    for i in range(n - 2, -1, -1):
        shift[i] = (-slope[i] - mixed[i] * shift[i + 1]) / curve[i]


@njit(cache=True)
def _move(arrays, points, side, shift, energy):
    """Shift those vertices whose shifts together cost least (dynamic programming), and fill the new energies."""
    memory, traction, gradient, blocked, terms = arrays
    n = points.shape[0]
    cost = np.full((n - 1, 2, 2), np.inf)
    came = np.zeros((n, 2), dtype=np.int8)
    stays, moves = 0.0, math.inf
    for k in range(n - 1):
        cost[k, 0, 0] = energy[k]
        for v in range(1, 4):
            a, b = v >> 1, v & 1
            here, there = a * shift[k], b * shift[k + 1]
            if (a == 1 and here == 0.0) or (b == 1 and there == 0.0):
                continue
            row0, col0 = points[k, 0] + here * side[k, 0], points[k, 1] + here * side[k, 1]
            row1, col1 = points[k + 1, 0] + there * side[k + 1, 0], points[k + 1, 1] + there * side[k + 1, 1]
            price = driven_leg_energy(memory, traction, gradient, blocked, terms, row0, col0, row1, col1, math.inf)
            if not math.isnan(price):
                cost[k, a, b] = price
        to_stay, to_move = stays + cost[k, 0, 0], stays + cost[k, 0, 1]
        if moves + cost[k, 1, 0] < to_stay:
            to_stay, came[k + 1, 0] = moves + cost[k, 1, 0], 1
        if moves + cost[k, 1, 1] < to_move:
            to_move, came[k + 1, 1] = moves + cost[k, 1, 1], 1
        stays, moves = to_stay, to_move
    there = 0
    for k in range(n - 2, -1, -1):
        here = came[k + 1, there]
        energy[k] = cost[k, here, there]
        if here == 1:
            points[k, 0] += shift[k] * side[k, 0]
            points[k, 1] += shift[k] * side[k, 1]
        there = here
