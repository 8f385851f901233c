"""Compiled bending of a polyline: all its vertices move at once, by the combination of shifts that costs least.

Every control vertex may stay or be shifted by one step to either side (or along the path too), and the vertices between
two controls follow linearly. What a stretch between two controls costs depends on the shifts of both, so the cheapest
combination of all shifts is a shortest path over the controls (dynamic programming: Viterbi 1967; active contours of
Amini, Weymouth & Jain 1990). With a turn cost the state is a pair of shifts, since a turn depends on two stretches. No
sweep makes the path dearer, because staying is always among the combinations.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from joulemap.planner.kernels import heading_memory, leg_energy_with, turn_angle

TOLERANCE = 1e-5
"""Relative gain of a sweep below which the next step is tried."""
ROUNDING = 1e-9
"""Relative difference within which two combinations cost the same, and the first one is taken: crossings of a leg that
are nearer to each other count as one (`kernels`)."""


@njit(cache=True, nogil=True)
def bent(traction, gradient, blocked, terms, turn_j_per_rad, points, movable, every, step, turned, sweeps):
    """Return a polyline after sweeps of the cheapest shifts, until no shift pays.

    Parameters
    ----------
    traction : ndarray of float32, (rows, cols, K)
        As for `kernels.leg_energy`, like the next three.
    gradient : ndarray of float32, (rows, cols, 2)
        Rise per metre.
    blocked : ndarray of uint8, (rows, cols)
        `Blocked` codes.
    terms : ndarray of float64, (6,)
        Terms of the price.
    turn_j_per_rad : float
        Energy of turning on the spot [J/rad].
    points : ndarray of float64, (n, 2)
        (row, col) polyline that may be driven.
    movable : ndarray of bool, (n,)
        Which of the vertices may be shifted.
    every : int
        Every how many vertices there is a control.
    step : float
        Size of a shift [cells].
    turned : float
        Angle of the shifts from the path's sides [rad]: 0 to the sides, pi / 2 ahead and back.
    sweeps : int
        Largest number of sweeps.

    Returns
    -------
    ndarray of float64, (n, 2)
        The polyline, at most as dear.
    """
    points = points.copy()
    n = points.shape[0]
    stretches = max((n - 1 + every - 1) // every, 1)
    controls = np.empty(stretches + 1, dtype=np.int64)
    for k in range(stretches):
        controls[k] = (k * (n - 1)) // stretches
    controls[stretches] = n - 1
    side = np.zeros((n, 2))
    cost = np.full((stretches, 3, 3), np.inf)  # shift of either control: 0 stay, 1 and 2 to either side
    stale = np.ones(stretches, dtype=np.bool_)
    memory = heading_memory(traction.shape[2])
    chosen = np.zeros(stretches + 1, dtype=np.int64)
    turn_sides(points, side, turned, 0, n)
    for _ in range(sweeps):
        for k in range(stretches):
            if stale[k]:
                _price_stretch(
                    memory,
                    traction,
                    gradient,
                    blocked,
                    terms,
                    turn_j_per_rad,
                    points,
                    movable,
                    side,
                    controls,
                    k,
                    step,
                    cost,
                )
                stale[k] = False
        if turn_j_per_rad > 0.0:
            gain = _choose_with_turns(turn_j_per_rad, points, side, controls, step, cost, chosen)
        else:
            gain = _choose(cost, chosen)
        if not gain > 0.0:
            break
        for k in range(stretches):
            a, b = chosen[k], chosen[k + 1]
            if a == 0 and b == 0:
                continue
            for s in range(max(k - 1, 0), min(k + 2, stretches)):
                stale[s] = True
            first, last = controls[k], controls[k + 1]
            for i in range(first + 1, last + 1):
                points[i, 0], points[i, 1] = _shifted(points, side, i, first, last, a, b, step)
        for k in range(stretches):
            if stale[k]:
                turn_sides(points, side, turned, controls[k], controls[k + 1] + 1)
    return points


@njit(cache=True)
def turn_sides(points, side, turned, first, end):
    """Fill the unit vectors of the shifts at some vertices.

    Parameters
    ----------
    points : ndarray of float64, (n, 2)
        (row, col) polyline.
    side : ndarray of float64, (n, 2)
        Is filled from `first` to `end` - 1.
    turned : float
        Angle from the path's sides [rad].
    first, end : int
        First vertex, and the one after the last.
    """
    n = points.shape[0]
    cosine, sine = math.cos(turned), math.sin(turned)
    for i in range(first, end):
        before, after = max(i - 1, 0), min(i + 1, n - 1)
        a, b = points[after, 0] - points[before, 0], points[after, 1] - points[before, 1]
        size = math.hypot(a, b)
        if size > 0.0:
            side[i, 0], side[i, 1] = (b * cosine + a * sine) / size, (b * sine - a * cosine) / size


@njit(cache=True)
def _shifted(points, side, i, first, last, a, b, step):
    """Vertex i between two controls with shifts a and b."""
    share = (i - first) / (last - first)
    left = (1.0 - share) * step * (0.0 if a == 0 else 3.0 - 2.0 * a)
    right = share * step * (0.0 if b == 0 else 3.0 - 2.0 * b)
    return (
        points[i, 0] + left * side[first, 0] + right * side[last, 0],
        points[i, 1] + left * side[first, 1] + right * side[last, 1],
    )


@njit(cache=True)
def _price_stretch(
    memory, traction, gradient, blocked, terms, turn_j_per_rad, points, movable, side, controls, k, step, cost
):
    """Fill cost[k]: energies of stretch k for all shifts of its two controls, turns between them included."""
    shifts = cost.shape[1]
    first, last = controls[k], controls[k + 1]
    for a in range(shifts):
        for b in range(shifts):
            if (k == 0 and a > 0) or (k == cost.shape[0] - 1 and b > 0):  # both ends stay
                continue
            if (a > 0 and not movable[first]) or (b > 0 and not movable[last]):
                continue
            total = 0.0
            r0, c0 = _shifted(points, side, first, first, last, a, b, step)
            r_, c_ = r0, c0
            for i in range(first + 1, last + 1):
                r1, c1 = _shifted(points, side, i, first, last, a, b, step)
                total += leg_energy_with(memory, traction, gradient, blocked, terms, r0, c0, r1, c1, math.inf)
                if math.isnan(total):
                    break
                if turn_j_per_rad > 0.0 and i > first + 1:
                    total += turn_j_per_rad * turn_angle(r_, c_, r0, c0, r1, c1)
                r_, c_, r0, c0 = r0, c0, r1, c1
            cost[k, a, b] = math.inf if math.isnan(total) else total


@njit(cache=True)
def _choose(cost, chosen):
    """Fill the cheapest shifts; what they gain [J], 0 where that is within rounding."""
    stretches, shifts, _ = cost.shape
    least = np.full(shifts, np.inf)
    least[0] = 0.0
    came = np.zeros((stretches, shifts), dtype=np.int8)
    stay = 0.0
    for k in range(stretches):
        ahead = np.full(shifts, np.inf)
        for b in range(shifts):
            for a in range(shifts):
                total = least[a] + cost[k, a, b]
                if total < ahead[b] - ROUNDING * abs(total):
                    ahead[b] = total
                    came[k, b] = a
        least = ahead
        stay += cost[k, 0, 0]
    chosen[stretches] = 0
    for k in range(stretches - 1, -1, -1):
        chosen[k] = came[k, chosen[k + 1]]
    gain = stay - least[0]
    return gain if gain > TOLERANCE * abs(stay) + 1e-9 else 0.0


@njit(cache=True)
def _choose_with_turns(turn_j_per_rad, points, side, controls, step, cost, chosen):
    """As `_choose`, with the turn at every control."""
    stretches, shifts, _ = cost.shape
    least = np.full((shifts, shifts), np.inf)  # shift of the control before, and of the one here
    least[0] = cost[0, 0]
    came = np.zeros((stretches, shifts, shifts), dtype=np.int8)
    stay = cost[0, 0, 0]
    for k in range(1, stretches):
        before, here, after = controls[k - 1], controls[k], controls[k + 1]
        ahead = np.full((shifts, shifts), np.inf)
        for b in range(shifts):
            r1, c1 = _shifted(points, side, here, before, here, 0, b, step)
            for a in range(shifts):
                if least[a, b] == np.inf:
                    continue
                r0, c0 = _shifted(points, side, here - 1, before, here, a, b, step)
                for c in range(shifts):
                    if cost[k, b, c] == np.inf:
                        continue
                    r2, c2 = _shifted(points, side, here + 1, here, after, b, c, step)
                    turn = turn_j_per_rad * turn_angle(r0, c0, r1, c1, r2, c2)
                    total = least[a, b] + turn + cost[k, b, c]
                    if total < ahead[b, c] - ROUNDING * abs(total):
                        ahead[b, c] = total
                        came[k, b, c] = a
                    if a == 0 and b == 0 and c == 0:
                        stay += turn + cost[k, 0, 0]
        least = ahead
    last = int(np.argmin(least[:, 0]))
    gain = stay - least[last, 0]
    chosen[stretches] = 0
    if stretches > 0:
        chosen[stretches - 1] = last
    for k in range(stretches - 1, 0, -1):
        chosen[k - 1] = came[k, chosen[k], chosen[k + 1]]
    return gain if gain > TOLERANCE * abs(stay) + 1e-9 else 0.0
