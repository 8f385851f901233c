"""Compiled pricing of straight legs over a lattice: arrays in, numbers out.

A leg is a straight line between two fractional (row, col) points. Between cell centres the traction of a leg's heading
is bilinear, so along a leg it is a quadratic within every square of four centres, and its price
hotel + max(t, 0) + regeneration * min(t, 0) is integrated in closed form, kink included; the hotel load is the idle
power over the speed. Cutting a leg anywhere, or joining two that are collinear, therefore leaves its energy unchanged.
A leg that touches a blocked cell, or one that is too steep in the leg's heading, has no price: NaN.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from joulemap.model.compiling import bare_njit
from joulemap.planner.lattice.obstacles import MEETS, meets

TOUCH = 1e-9
"""Bilinear weight below which a cell does not count as touched."""


@njit(cache=True)
def heading_memory(bins):
    """Return memory for the weights of one heading, and what they are computed from.

    Returns `weights` (K,): to be filled by `heading_weights`; `directions` (4, K): north and east component of every
    bin's heading, and the same with alternating signs.
    """
    directions = np.empty((4, bins))
    for k in range(bins):
        north, east = math.cos(2.0 * math.pi * k / bins), math.sin(2.0 * math.pi * k / bins)
        sign = 1.0 if k % 2 == 0 else -1.0
        directions[0, k], directions[1, k], directions[2, k], directions[3, k] = north, east, sign * north, sign * east
    return np.empty(bins), directions


@bare_njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def heading_weights(east, north, memory):
    """Fill memory with the weights of the trigonometric interpolation between equal heading bins.

    The periodic sinc (Dirichlet) kernel: exact for every Fourier series of order below K / 2. With d_k the angle from
    bin k, and K even, its weight is sin(K d_k / 2) / (K tan(d_k / 2)). sin(K d / 2) is a power at the nearest bin, and
    elsewhere the same value with alternating sign; so no trigonometric function is called.

    Reference: Berrut & Trefethen 2004, section 7.
    """
    weights, directions = memory
    bins = weights.size
    nearest = _nearest_bin(east, north, bins)
    sine = east * directions[0, nearest] - north * directions[1, nearest]
    cosine = north * directions[0, nearest] + east * directions[1, nearest]
    if abs(sine) < 1e-12:
        weights[:] = 0.0
        weights[nearest] = 1.0
    elif bins % 2 == 1:
        half = 0.5 * math.atan2(sine, cosine)
        for k in range(bins):
            angle = half - math.pi * (k - nearest) / bins
            weights[k] = math.sin(bins * angle) / (bins * math.sin(angle))
    else:
        wave = _sine_of_multiple(cosine, sine, bins // 2)
        top = (-wave if nearest % 2 == 1 else wave) / bins
        for k in range(bins):
            weights[k] = (
                top
                * (east * directions[2, k] - north * directions[3, k])
                / (1.0 - (north * directions[0, k] + east * directions[1, k]))
            )
        weights[nearest] = (1.0 + cosine) * wave / (bins * sine)


@njit(cache=True, forceinline=True)
def _sine_of_multiple(cosine, sine, times):
    """sin(n a) of the angle a with this cosine and sine: the n-th power of cos a + i sin a by repeated squaring."""
    real, imaginary = 1.0, 0.0
    while True:
        if times & 1:
            real, imaginary = real * cosine - imaginary * sine, real * sine + imaginary * cosine
        times >>= 1
        if times == 0:
            return imaginary
        cosine, sine = cosine * cosine - sine * sine, 2.0 * cosine * sine


@njit(cache=True, error_model="numpy")
def _nearest_bin(east, north, bins):
    """The bin nearest to a heading; within a quarter of a degree of the middle of two, either of them."""
    small, large = min(abs(east), abs(north)), max(abs(east), abs(north))
    ratio = small / large
    angle = ratio * (0.25 * math.pi + 0.273 * (1.0 - ratio))  # the arc tangent within 0.004 rad
    if abs(east) > abs(north):
        angle = 0.5 * math.pi - angle
    if north < 0.0:
        angle = math.pi - angle
    if east < 0.0:
        angle = 2.0 * math.pi - angle
    nearest = int(angle * (0.5 * bins / math.pi) + 0.5)
    return nearest if nearest < bins else 0


@bare_njit(cache=True)
def mean_response(t0, tm, t1, regeneration):
    """Return the mean price of motion over a piece of a leg.

    `t0`, `tm`, `t1`: traction at the start, the middle and the end of the piece [J/m]; `regeneration`: share of the
    energy that comes back where the traction is negative, 0..1. Result: mean of max(t, 0) + regeneration * min(t, 0)
    [J/m], t the quadratic through the three.
    """
    mean, ends = (t0 + 4.0 * tm + t1) / 6.0, t0 + t1
    if t0 >= 0.0 and t1 >= 0.0 and 4.0 * tm >= ends:  # the Bezier coefficients of the quadratic are not negative
        return mean
    if t0 <= 0.0 and t1 <= 0.0 and 4.0 * tm <= ends:
        return regeneration * mean
    a, b = 2.0 * (ends - 2.0 * tm), 4.0 * tm - 3.0 * t0 - t1  # t0 + b s + a s^2 for s from 0 to 1
    square = b * b - 4.0 * a * t0
    if square <= 0.0:
        return mean if ends > 0.0 else regeneration * mean
    q = -0.5 * (b + math.copysign(math.sqrt(square), b))
    low = q / a if a != 0.0 else 2.0
    high = t0 / q if q != 0.0 else 0.0
    if (t0 < 0.0 < t1) or (t1 < 0.0 < t0):  # one change of sign
        root = high if 0.0 <= high <= 1.0 else low
        before = ((a * root / 3.0 + 0.5 * b) * root + t0) * root
        positive = before if t0 > 0.0 else mean - before
    else:
        low, high = min(max(min(low, high), 0.0), 1.0), min(max(max(low, high), 0.0), 1.0)
        between = ((a * high / 3.0 + 0.5 * b) * high + t0) * high - ((a * low / 3.0 + 0.5 * b) * low + t0) * low
        positive = mean - between if ends > 0.0 else between
    return positive + regeneration * (mean - positive)


@bare_njit(cache=True, forceinline=True, fastmath={"reassoc", "contract"})
def _weighted(weights, traction, i, j):
    """Traction of a cell at the heading that the weights are for; reordered sums let the compiler use vectors."""
    total = 0.0
    for k in range(weights.size):
        total += weights[k] * traction[i, j, k]
    return total


@bare_njit(cache=True, forceinline=True)
def _corner(prices, weights, east, north, limits, i, j):
    """Traction of one cell at the leg's heading, NaN when it is blocked, too steep or takes too much power for it."""
    max_grade, max_cross, max_traction = limits
    rise_east, rise_north = np.float64(prices.gradient[i, j, 0]), np.float64(prices.gradient[i, j, 1])
    steep = abs(rise_east * east + rise_north * north) > max_grade
    tilted = abs(rise_east * north - rise_north * east) > max_cross
    # one exit: with several the compiler does not turn the sum into vector operations, which is ten times slower
    demand = _weighted(weights, prices.traction, i, j)
    code = prices.blocked.codes[i, j]
    shut = code != 0 and code != MEETS
    return math.nan if shut or steep or tilted or demand > max_traction else demand


@bare_njit(cache=True, error_model="numpy")
def fill_tractions(out, n, prices, directions, weights, i, j):
    """Fill the tractions of a cell at some headings.

    `out` (N, H): row n is filled [J/m], NaN where the cell may not be driven at a heading; `directions` (H, 2): east
    and north component of each heading; `weights` (K, H): weights of the heading bins at each heading.
    """
    traction, terms = prices.traction, prices.terms
    code = prices.blocked.codes[i, j]
    shut, max_grade, max_cross, max_traction = code != 0 and code != MEETS, terms[3], terms[4], terms[5]
    rise_east, rise_north = np.float64(prices.gradient[i, j, 0]), np.float64(prices.gradient[i, j, 1])
    for h in range(out.shape[1]):
        out[n, h] = 0.0
    for k in range(weights.shape[0]):  # bin by bin, so that the compiler makes vectors of headings
        here = traction[i, j, k]
        for h in range(out.shape[1]):
            out[n, h] += weights[k, h] * here
    for h in range(out.shape[1]):
        along = rise_east * directions[h, 0] + rise_north * directions[h, 1]
        across = rise_east * directions[h, 1] - rise_north * directions[h, 0]
        if shut or abs(along) > max_grade or abs(across) > max_cross or out[n, h] > max_traction:
            out[n, h] = np.nan


@njit(cache=True)
def leg_energy(prices, leg):
    """Return the energy of a straight leg (row0, col0, row1, col1) [J]; NaN where it may not be driven.

    `prices`: an `integrator.Prices`.
    """
    return leg_energy_with(heading_memory(prices.traction.shape[2]), prices, leg, math.inf)


@bare_njit(cache=True, error_model="numpy", forceinline=True)
def leg_energy_with(memory, prices, leg, most):
    """Return the energy of a leg as `leg_energy` does, with memory of the caller and a limit.

    `most`: where the energy exceeds this [J], the rest of the leg is not looked at, infinite where prices may be
    negative. Result: energy [J]; NaN where the leg may not be driven; above `most`, some number above it or NaN.

    The leg is cut where it crosses lines of cell centres (Amanatides & Woo 1987). It is compiled into its callers: to
    hand over all these arrays takes a third of the time that a short leg takes.
    """
    row0, col0, row1, col1 = leg
    blocked, terms = prices.blocked, prices.terms
    spacing, hotel, regeneration = terms[0], terms[1], terms[2]
    rows, cols, _ = prices.traction.shape
    slack = 0.5 + 1e-6
    if not (
        -slack <= row0 <= rows - 1 + slack
        and -slack <= row1 <= rows - 1 + slack
        and -slack <= col0 <= cols - 1 + slack
        and -slack <= col1 <= cols - 1 + slack
    ):
        return math.nan
    drow, dcol = row1 - row0, col1 - col0
    length = math.sqrt(drow * drow + dcol * dcol)
    if length == 0.0:
        i, j = int(round(row0)), int(round(col0))
        return 0.0 if blocked.codes[min(max(i, 0), rows - 1), min(max(j, 0), cols - 1)] == 0 else math.nan
    per_length = 1.0 / length
    east, north = dcol * per_length, -drow * per_length
    heading_weights(east, north, memory)
    weights = memory[0]
    enough = most * per_length / spacing
    ends = row0, col0, row1, col1
    # rows and columns are counted in the direction of travel, so that the leg enters squares on their near side
    down, right = 1 if drow >= 0.0 else -1, 1 if dcol >= 0.0 else -1
    row0, col0, drow, dcol = row0 * down, col0 * right, abs(drow), abs(dcol)
    per_row, per_col = 1.0 / drow, 1.0 / dcol
    same = 1e-9 * min(per_row, per_col)  # crossings nearer to each other count as one
    i, j = int(math.floor(row0 + 1e-9)), int(math.floor(col0 + 1e-9))
    next_row, next_col = (i + 1 - row0) * per_row, (j + 1 - col0) * per_col  # shares of the leg at the next lines
    near_i, far_i = min(max(down * i, 0), rows - 1), min(max(down * (i + 1), 0), rows - 1)
    near_j, far_j = min(max(right * j, 0), cols - 1), min(max(right * (j + 1), 0), cols - 1)
    limits = terms[3], terms[4], terms[5]
    c00 = _corner(prices, weights, east, north, limits, near_i, near_j)
    c01 = _corner(prices, weights, east, north, limits, near_i, far_j)
    c10 = _corner(prices, weights, east, north, limits, far_i, near_j)
    c11 = _corner(prices, weights, east, north, limits, far_i, far_j)
    u0, v0 = max(row0 - i, 0.0), max(col0 - j, 0.0)  # place in the square: 0 near, 1 far
    energy = t = 0.0
    t0 = math.nan
    beside_obstacles = blocked.room.size > 0 and blocked.near.size == 0
    looked_for = blocked.near.size > 0
    while True:
        if looked_for:
            close = blocked.near[near_i, near_j] or blocked.near[far_i, far_j]
            beside_obstacles = beside_obstacles or close or blocked.near[near_i, far_j] or blocked.near[far_i, near_j]
        t_next = min(next_row, next_col, 1.0)
        u1, v1 = min(row0 + t_next * drow - i, 1.0), min(col0 + t_next * dcol - j, 1.0)
        a00, a01, a10, a11 = c00, c01, c10, c11
        if 1.0 - u0 <= TOUCH or u1 <= TOUCH or 1.0 - v0 <= TOUCH or v1 <= TOUCH:  # along a line: two do not count
            near_row, far_row, near_col, far_col = 1.0 - u0 > TOUCH, u1 > TOUCH, 1.0 - v0 > TOUCH, v1 > TOUCH
            a00, a01 = c00 if near_row and near_col else 0.0, c01 if near_row and far_col else 0.0
            a10, a11 = c10 if far_row and near_col else 0.0, c11 if far_row and far_col else 0.0
        rise, across, twist = a10 - a00, a01 - a00, a00 - a01 - a10 + a11
        if t == 0.0:
            t0 = a00 + u0 * rise + v0 * (across + u0 * twist)
        t1 = a00 + u1 * rise + v1 * (across + u1 * twist)
        tm = 0.5 * (t0 + t1) - 0.25 * twist * (u1 - u0) * (v1 - v0)
        if math.isnan(tm):
            return math.nan
        energy += (t_next - t) * (hotel + mean_response(t0, tm, t1, regeneration))
        if t_next >= 1.0 - same or energy > enough:
            if beside_obstacles and meets(blocked.room, blocked.body, *ends, east, north, 0.0):
                return math.nan
            return energy * length * spacing
        over_row, over_col = next_row <= t_next + same, next_col <= t_next + same
        u0, v0 = u1, v1
        if over_row:
            i += 1
            u0, next_row = 0.0, (i + 1 - row0) * per_row
            near_i, far_i = far_i, min(max(down * (i + 1), 0), rows - 1)
            c00, c01 = c10, c11
        if over_col:
            j += 1
            v0, next_col = 0.0, (j + 1 - col0) * per_col
            near_j, far_j = far_j, min(max(right * (j + 1), 0), cols - 1)
            c00, c10 = c01, c11
            c01 = _corner(prices, weights, east, north, limits, near_i, far_j)
        if over_row:
            c10 = _corner(prices, weights, east, north, limits, far_i, near_j)
        c11 = _corner(prices, weights, east, north, limits, far_i, far_j)
        t, t0 = t_next, t1


@bare_njit(cache=True, error_model="numpy")
def driven_leg_energy(memory, prices, leg, most):
    """Return the mean energy of a leg that is driven with an error to its sides.

    Result: energy [J]; NaN where the leg itself may not be driven.

    The mean of a normal error from three legs side by side (Gauss-Hermite), exact for a price that is quadratic across
    the leg. They are longer than it by the margin at both ends, because a robot is late and early too. Where they are
    more than a cell from each other, legs between them are looked at, so that nothing is passed by.
    """
    price, terms = leg_energy_with(memory, prices, leg, most), prices.terms
    margin = terms[6]
    if margin == 0.0 or not price <= most:
        return price
    row0, col0, row1, col1 = leg
    rows, cols, _ = prices.traction.shape
    drow, dcol = row1 - row0, col1 - col0
    length = math.sqrt(drow * drow + dcol * dcol)
    if length == 0.0:
        return price
    bands = int(math.ceil(2.0 * margin))
    mean, down, right = price, drow / length * margin, dcol / length * margin
    longer = length / (length + 2.0 * margin)
    for k in range(bands + 1):
        share = 2.0 * k / bands - 1.0
        begin_row, begin_col = row0 + share * right - down, col0 - share * down - right
        end_row, end_col = row1 + share * right + down, col1 - share * down + right
        shifted = begin_row, begin_col, end_row, end_col
        cut = (  # beyond the map nothing is known to be closed
            min(max(begin_row, -0.5), rows - 0.5),
            min(max(begin_col, -0.5), cols - 0.5),
            min(max(end_row, -0.5), rows - 0.5),
            min(max(end_col, -0.5), cols - 0.5),
        )
        beside = leg_energy_with(memory, prices, cut, math.inf)
        if math.isnan(beside):
            return price + terms[8] * length
        if (k == 0 or k == bands) and cut == shifted:
            mean += terms[7] * (beside * longer - price)
    return mean


@njit(cache=True, nogil=True)
def leg_energies(prices, legs):
    """Return the energies of many straight legs (n, 4), as `leg_energy`: (n,) [J].

    On one thread: most questions are a few legs, and on a busy machine waiting for a second thread takes longer.
    """
    out = np.empty(legs.shape[0])
    memory = heading_memory(prices.traction.shape[2])
    for k in range(legs.shape[0]):
        out[k] = leg_energy_with(memory, prices, (legs[k, 0], legs[k, 1], legs[k, 2], legs[k, 3]), math.inf)
    return out


@njit(cache=True, nogil=True)
def polyline_energies(prices, points):
    """Return the energies of the legs of a (row, col) polyline (n, 2), as they are driven, without turns: (n - 1,) [J].

    NaN where a leg may not be driven.
    """
    out = np.empty(max(points.shape[0] - 1, 0))
    memory = heading_memory(prices.traction.shape[2])
    for k in range(out.size):
        leg = points[k, 0], points[k, 1], points[k + 1, 0], points[k + 1, 1]
        out[k] = driven_leg_energy(memory, prices, leg, math.inf)
    return out


@bare_njit(cache=True)
def turn_angle(row0, col0, row1, col1, row2, col2):
    """Return the absolute change of heading between the legs 0-1 and 1-2.

    Result: angle [rad, 0..pi]; zero beside a leg of no length.
    """
    a, b = row1 - row0, col1 - col0
    c, d = row2 - row1, col2 - col1
    if (a == 0.0 and b == 0.0) or (c == 0.0 and d == 0.0):
        return 0.0
    return abs(math.atan2(a * d - b * c, a * c + b * d))


@njit(cache=True, nogil=True)
def path_energy(prices, points):
    """Return the energy of a (row, col) polyline (n, 2) with its turns [J]; NaN where a leg may not be driven."""
    energy, turn_j_per_rad = polyline_energies(prices, points).sum(), prices.turn_j_per_rad
    before, here = 0, 1
    for k in range(2, points.shape[0] if turn_j_per_rad > 0.0 else 0):
        if points[here, 0] == points[before, 0] and points[here, 1] == points[before, 1]:
            here = k  # the robot has not left its first place
            continue
        if points[k, 0] == points[here, 0] and points[k, 1] == points[here, 1]:
            continue  # a vertex that repeats the one before it hides no turn
        energy += turn_j_per_rad * turn_angle(
            points[before, 0], points[before, 1], points[here, 0], points[here, 1], points[k, 0], points[k, 1]
        )
        before, here = here, k
    return energy
