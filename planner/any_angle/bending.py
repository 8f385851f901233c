"""Compiled bending of a polyline: all its vertices move at once, by the combination of shifts that costs least.

Every vertex but the two ends may stay or be shifted by one step to either side of a direction. What a leg costs depends
on the shifts of its two ends, so the cheapest combination of all shifts is a shortest path over the vertices (dynamic
programming: Viterbi 1967; active contours of Amini, Weymouth & Jain 1990). With a turn cost the state is a pair of
shifts, since a turn depends on two legs. No sweep makes the path dearer, because staying is among the combinations.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from joulemap.model.compiling import bare_njit
from joulemap.planner.pricing.kernels import driven_leg_energy, heading_memory, turn_angle

ACROSS, ALONG, ON_LINE = 0, 1, 2
"""Directions of a shift: across the path, along it, or along the line of cell centres that the vertex lies on."""
TOLERANCE = 1e-5
"""Relative gain of a sweep below which no further one is made."""
ROUNDING = 1e-9
"""Relative difference within which two combinations cost the same, and the first one is taken: crossings of a leg that
are nearer to each other count as one (`kernels`)."""
SWEEPS = 24
"""Largest number of sweeps."""
LEAST_LEG = 1e-3
"""Shortest leg that a shift may leave where turning costs [cells]: at two vertices in one place no turn is counted."""
SHIFTS = 3
_SIGN = (0.0, 1.0, -1.0)


@njit(cache=True, nogil=True)
def bent(prices, points, step, direction):
    """The polyline after sweeps of the cheapest shifts, until none pays: (n, 2) float64, at most as dear.

    prices : an `integrator.Prices`. points : (row, col) polyline that may be driven (n, 2). step : size of a shift
    [cells]. direction : `ACROSS`, `ALONG` or `ON_LINE`.
    """
    points = points.copy()
    legs = points.shape[0] - 1
    if legs < 2:
        return points
    side = np.zeros((legs + 1, 2))
    cost = np.full((legs, SHIFTS, SHIFTS), np.inf)
    stale = np.ones(legs, dtype=np.bool_)
    memory, turn_j_per_rad = heading_memory(prices.traction.shape[2]), prices.turn_j_per_rad
    chosen = np.zeros(legs + 1, dtype=np.int64)
    around = 1 if direction == ON_LINE else 2  # elsewhere the sides of a vertex's neighbours turn with it
    _set_sides(points, side, direction, 0, legs + 1)
    for _ in range(SWEEPS):
        for k in range(legs):
            if stale[k]:
                _price_leg(memory, prices, points, side, k, step, cost)
                stale[k] = False
        if turn_j_per_rad > 0.0:
            gain = _choose_with_turns(turn_j_per_rad, points, side, step, cost, chosen)
        else:
            gain = _choose(cost, chosen)
        if not gain > 0.0:
            break
        for i in range(1, legs):
            if chosen[i] != 0:
                stale[max(i - around, 0) : i + around] = True
                points[i, 0], points[i, 1] = _shifted(points, side, i, chosen[i], step)
        if direction != ON_LINE:
            for k in range(legs):
                if stale[k]:
                    _set_sides(points, side, direction, k, k + 2)
    return points


@bare_njit(cache=True)
def _set_sides(points, side, direction, first, end):
    """Fill the unit vectors (n, 2) of the shifts of the vertices from `first` to `end` - 1."""
    n = points.shape[0]
    for i in range(first, end):
        before, after = max(i - 1, 0), min(i + 1, n - 1)
        down, right = points[after, 0] - points[before, 0], points[after, 1] - points[before, 1]
        if direction == ON_LINE:
            on_row = abs(points[i, 0] - round(points[i, 0])) < 1e-9
            if on_row and abs(points[i, 1] - round(points[i, 1])) < 1e-9:  # at a centre: on the line more across
                on_row = abs(right) < abs(down)
            side[i, 0], side[i, 1] = (0.0, 1.0) if on_row else (1.0, 0.0)
            continue
        size = math.hypot(down, right)
        if size > 0.0:
            along, across = (0.0, 1.0 / size) if direction == ACROSS else (1.0 / size, 0.0)
            side[i, 0], side[i, 1] = along * down + across * right, along * right - across * down


@bare_njit(cache=True)
def _shifted(points, side, i, shift, step):
    """Vertex i after a shift: 0 stay, 1 and 2 to either side."""
    move = step * _SIGN[shift]
    return points[i, 0] + move * side[i, 0], points[i, 1] + move * side[i, 1]


@bare_njit(cache=True)
def _price_leg(memory, prices, points, side, k, step, cost):
    """Fill cost[k]: energies of leg k [J] for all shifts of its ends; infinite where it may not be driven."""
    least_leg = LEAST_LEG if prices.turn_j_per_rad > 0.0 else 0.0
    for a in range(1 if k == 0 else SHIFTS):
        row0, col0 = _shifted(points, side, k, a, step)
        for b in range(1 if k == cost.shape[0] - 1 else SHIFTS):
            row1, col1 = _shifted(points, side, k + 1, b, step)
            price = driven_leg_energy(memory, prices, (row0, col0, row1, col1), math.inf)
            short = (a != 0 or b != 0) and math.hypot(row1 - row0, col1 - col0) < least_leg
            cost[k, a, b] = math.inf if short or math.isnan(price) else price


@njit(cache=True)
def _choose(cost, chosen):
    """Fill the cheapest shifts; what they gain [J], 0 where that is within the tolerance."""
    legs = cost.shape[0]
    least = np.full(SHIFTS, np.inf)
    least[0] = 0.0
    came = np.zeros((legs, SHIFTS), dtype=np.int8)
    stay = 0.0
    for k in range(legs):
        ahead = np.full(SHIFTS, np.inf)
        for b in range(SHIFTS):
            for a in range(SHIFTS):
                total = least[a] + cost[k, a, b]
                if total < ahead[b] - ROUNDING * abs(total):
                    ahead[b] = total
                    came[k, b] = a
        least = ahead
        stay += cost[k, 0, 0]
    chosen[legs] = 0
    for k in range(legs - 1, -1, -1):
        chosen[k] = came[k, chosen[k + 1]]
    return _worth(stay, least[0])


@njit(cache=True)
def _choose_with_turns(turn_j_per_rad, points, side, step, cost, chosen):
    """As `_choose`, with the turn at every vertex."""
    legs = cost.shape[0]
    least = np.full((SHIFTS, SHIFTS), np.inf)  # shift of the vertex before, and of the one here
    least[0] = cost[0, 0]
    came = np.zeros((legs, SHIFTS, SHIFTS), dtype=np.int8)
    stay = cost[0, 0, 0]
    for k in range(1, legs):
        ahead = np.full((SHIFTS, SHIFTS), np.inf)
        for b in range(SHIFTS):
            row1, col1 = _shifted(points, side, k, b, step)
            for a in range(SHIFTS):
                if least[a, b] == np.inf:
                    continue
                row0, col0 = _shifted(points, side, k - 1, a, step)
                for c in range(SHIFTS):
                    if cost[k, b, c] == np.inf:
                        continue
                    row2, col2 = _shifted(points, side, k + 1, c, step)
                    turn = turn_j_per_rad * turn_angle(row0, col0, row1, col1, row2, col2)
                    total = least[a, b] + turn + cost[k, b, c]
                    if total < ahead[b, c] - ROUNDING * abs(total):
                        ahead[b, c] = total
                        came[k, b, c] = a
                    if a == 0 and b == 0 and c == 0:
                        stay += turn + cost[k, 0, 0]
        least = ahead
    chosen[legs] = 0
    chosen[legs - 1] = int(np.argmin(least[:, 0]))
    for k in range(legs - 1, 0, -1):
        chosen[k - 1] = came[k, chosen[k], chosen[k + 1]]
    return _worth(stay, least[chosen[legs - 1], 0])


@njit(cache=True)
def _worth(stay, moved):
    """What a combination of shifts gains over staying [J]; 0 where that is within the tolerance."""
    gain = stay - moved
    return gain if gain > TOLERANCE * abs(stay) + 1e-9 else 0.0
