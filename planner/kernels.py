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

from joulemap.model.frames import heading_of_step

TOUCH = 1e-9
"""Bilinear weight below which a cell does not count as touched."""


@njit(cache=True, nogil=True)
def heading_weights(heading_rad, weights):
    """Fill an array with the weights of the trigonometric interpolation between equal heading bins.

    Parameters
    ----------
    heading_rad : float
        Heading [rad, clockwise from north].
    weights : ndarray of float64, (K,)
        Is filled with the weight of each bin; they sum to 1.

    Notes
    -----
    The periodic sinc (Dirichlet) kernel: exact for every Fourier series of order below K / 2.

    References
    ----------
    Berrut & Trefethen 2004, section 7.
    """
    count = weights.size
    step = math.pi / count
    nearest = int(math.floor(0.5 * heading_rad / step + 0.5))
    half = 0.5 * heading_rad - nearest * step
    weights[:] = 0.0
    if abs(half) < 1e-12:
        weights[nearest % count] = 1.0
        return
    top = math.sin(count * half) / count
    sine, cosine = math.sin(half), math.cos(half)
    even = count % 2 == 0
    turn_sine, turn_cosine = math.sin(step), math.cos(step)
    at = nearest % count
    for _ in range(count):  # half the angle to bin `at`; never near a zero of the sine but at the first
        weights[at] = top * cosine / sine if even else top / sine
        at = at + 1 if at + 1 < count else 0
        top = -top
        sine, cosine = sine * turn_cosine - cosine * turn_sine, cosine * turn_cosine + sine * turn_sine


@njit(cache=True)
def mean_response(t0, tm, t1, regeneration):
    """Return the mean price of motion over a piece of a leg.

    Parameters
    ----------
    t0, tm, t1 : float
        Traction at the start, the middle and the end of the piece [J/m].
    regeneration : float
        Share of the energy that comes back where the traction is negative, 0..1.

    Returns
    -------
    float
        Mean of max(t, 0) + regeneration * min(t, 0) [J/m], t the quadratic through the three.
    """
    mean = (t0 + 4.0 * tm + t1) / 6.0
    if t0 >= 0.0 and t1 >= 0.0 and 4.0 * tm >= t0 + t1:  # concave enough to stay above its chord
        return mean
    a = 2.0 * (t0 + t1 - 2.0 * tm)
    b = 4.0 * tm - 3.0 * t0 - t1
    low, high = 1.0, 1.0  # where the traction changes its sign
    if abs(a) < 1e-12 * (abs(b) + 1e-300):
        if b != 0.0:
            low = -t0 / b
    else:
        square = b * b - 4.0 * a * t0
        if square > 0.0:
            q = -0.5 * (b + math.copysign(math.sqrt(square), b))
            low = q / a
            high = t0 / q if q != 0.0 else 0.0
            if low > high:
                low, high = high, low
    low, high = min(max(low, 0.0), 1.0), min(max(high, 0.0), 1.0)
    positive = 0.0
    for u, v in ((0.0, low), (low, high), (high, 1.0)):
        w = 0.5 * (u + v)
        part = ((a * v / 3.0 + b / 2.0) * v + t0) * v - ((a * u / 3.0 + b / 2.0) * u + t0) * u
        if v > u and (a * w + b) * w + t0 > 0.0:
            positive += part
    return positive + regeneration * (mean - positive)


@njit(cache=True, fastmath={"reassoc", "contract"})
def _weighted(weights, traction, i, j):
    """Traction of a cell at the heading that the weights are for; reordered sums let the compiler use vectors."""
    total = 0.0
    for k in range(weights.size):
        total += weights[k] * traction[i, j, k]
    return total


@njit(cache=True)
def _corner(traction, gradient, blocked, weights, east, north, max_grade, max_cross, i, j):
    """Traction of one cell at the leg's heading, NaN when it is blocked or too steep for it."""
    rise_east, rise_north = np.float64(gradient[i, j, 0]), np.float64(gradient[i, j, 1])
    steep = abs(rise_east * east + rise_north * north) > max_grade
    tilted = abs(rise_east * north - rise_north * east) > max_cross
    # one exit: with several the compiler does not turn the sum into vector operations, which is ten times slower
    return math.nan if blocked[i, j] != 0 or steep or tilted else _weighted(weights, traction, i, j)


@njit(cache=True)
def leg_energy(traction, gradient, blocked, terms, row0, col0, row1, col1):
    """Return the energy of the straight leg from (row0, col0) to (row1, col1).

    Parameters
    ----------
    traction : ndarray of float32, (rows, cols, K)
        Traction of the lattice [J/m].
    gradient : ndarray of float32, (rows, cols, 2)
        Rise per metre towards east and north.
    blocked : ndarray of uint8, (rows, cols)
        `Blocked` codes for every heading.
    terms : ndarray of float64, (5,)
        Side of a cell [m], idle energy per metre [J/m], regeneration, tangents of the greatest grade and cross slope.
    row0, col0 : float
        Start.
    row1, col1 : float
        End.

    Returns
    -------
    float
        Energy [J]; NaN where the leg may not be driven.
    """
    return leg_energy_with(
        np.empty(traction.shape[2]), traction, gradient, blocked, terms, row0, col0, row1, col1, math.inf
    )


@njit(cache=True)
def leg_energy_with(weights, traction, gradient, blocked, terms, row0, col0, row1, col1, most):
    """Return the energy of a leg as `leg_energy` does, with memory of the caller and a limit.

    Parameters
    ----------
    weights : ndarray of float64, (K,)
        Memory that is written to.
    traction, gradient, blocked, terms : ndarray
        As for `leg_energy`.
    row0, col0, row1, col1 : float
        Start and end.
    most : float
        Where the energy exceeds this [J], the rest of the leg is not looked at. Infinite where prices may be negative.

    Returns
    -------
    float
        Energy [J]; NaN where the leg may not be driven; above `most`, some number above it or NaN.
    """
    spacing, hotel, regeneration, max_grade, max_cross = terms[0], terms[1], terms[2], terms[3], terms[4]
    rows, cols, _ = traction.shape
    slack = 0.5 + 1e-6
    if not (
        -slack <= row0 <= rows - 1 + slack
        and -slack <= row1 <= rows - 1 + slack
        and -slack <= col0 <= cols - 1 + slack
        and -slack <= col1 <= cols - 1 + slack
    ):
        return math.nan
    drow = row1 - row0
    dcol = col1 - col0
    length = math.hypot(drow, dcol)
    if length == 0.0:
        i = int(round(row0))
        j = int(round(col0))
        return 0.0 if blocked[min(max(i, 0), rows - 1), min(max(j, 0), cols - 1)] == 0 else math.nan
    heading = heading_of_step(drow, dcol)
    east = math.sin(heading)
    north = math.cos(heading)
    heading_weights(heading, weights)
    enough = most / (length * spacing)
    energy = 0.0
    t = 0.0
    last_i, last_j = -9, -9
    c00 = c01 = c10 = c11 = 0.0
    known = 0  # bit set of the corners that hold a traction: 1 for 00, 2 for 01, 4 for 10, 8 for 11
    while t < 1.0:
        t_next = 1.0
        if drow != 0.0:
            row = row0 + t * drow
            line = math.floor(row + 1e-9) + 1.0 if drow > 0.0 else math.ceil(row - 1e-9) - 1.0
            t_next = min(t_next, (line - row0) / drow)
        if dcol != 0.0:
            col = col0 + t * dcol
            line = math.floor(col + 1e-9) + 1.0 if dcol > 0.0 else math.ceil(col - 1e-9) - 1.0
            t_next = min(t_next, (line - col0) / dcol)
        middle = 0.5 * (t + t_next)
        i = min(max(int(math.floor(row0 + middle * drow)), 0), rows - 2)
        j = min(max(int(math.floor(col0 + middle * dcol)), 0), cols - 2)
        u0 = min(max(row0 + t * drow - i, 0.0), 1.0)
        u1 = min(max(row0 + t_next * drow - i, 0.0), 1.0)
        v0 = min(max(col0 + t * dcol - j, 0.0), 1.0)
        v1 = min(max(col0 + t_next * dcol - j, 0.0), 1.0)
        if i != last_i or j != last_j:  # two corners are those of the square before
            if i == last_i and j == last_j + 1:
                c00, c10, known = c01, c11, (known & 10) >> 1
            elif i == last_i and j == last_j - 1:
                c01, c11, known = c00, c10, (known & 5) << 1
            elif j == last_j and i == last_i + 1:
                c00, c01, known = c10, c11, (known & 12) >> 2
            elif j == last_j and i == last_i - 1:
                c10, c11, known = c00, c01, (known & 3) << 2
            else:
                known = 0
            last_i, last_j = i, j
        top, bottom = 1.0 - min(u0, u1) > TOUCH, max(u0, u1) > TOUCH
        left, right = 1.0 - min(v0, v1) > TOUCH, max(v0, v1) > TOUCH
        if top and left and known & 1 == 0:
            c00 = _corner(traction, gradient, blocked, weights, east, north, max_grade, max_cross, i, j)
        if top and right and known & 2 == 0:
            c01 = _corner(traction, gradient, blocked, weights, east, north, max_grade, max_cross, i, j + 1)
        if bottom and left and known & 4 == 0:
            c10 = _corner(traction, gradient, blocked, weights, east, north, max_grade, max_cross, i + 1, j)
        if bottom and right and known & 8 == 0:
            c11 = _corner(traction, gradient, blocked, weights, east, north, max_grade, max_cross, i + 1, j + 1)
        use = (top and left) * 1 + (top and right) * 2 + (bottom and left) * 4 + (bottom and right) * 8
        known |= use
        a00 = c00 if use & 1 else 0.0
        a01 = c01 if use & 2 else 0.0
        a10 = c10 if use & 4 else 0.0
        a11 = c11 if use & 8 else 0.0
        if math.isnan(a00 + a01 + a10 + a11):
            return math.nan
        t0 = _blend(a00, a01, a10, a11, u0, v0)
        tm = _blend(a00, a01, a10, a11, 0.5 * (u0 + u1), 0.5 * (v0 + v1))
        t1 = _blend(a00, a01, a10, a11, u1, v1)
        energy += (t_next - t) * (hotel + mean_response(t0, tm, t1, regeneration))
        if energy > enough:
            break
        t = t_next
    return energy * length * spacing


@njit(cache=True)
def _blend(c00, c01, c10, c11, u, v):
    return (1.0 - u) * ((1.0 - v) * c00 + v * c01) + u * ((1.0 - v) * c10 + v * c11)


@njit(cache=True, nogil=True)
def leg_energies(traction, gradient, blocked, terms, legs):
    """Return the energies of many straight legs.

    Parameters
    ----------
    traction : ndarray of float32, (rows, cols, K)
        As for `leg_energy`, like the next three.
    gradient : ndarray of float32, (rows, cols, 2)
        Rise per metre.
    blocked : ndarray of uint8, (rows, cols)
        `Blocked` codes.
    terms : ndarray of float64, (5,)
        Terms of the price.
    legs : ndarray of float64, (n, 4)
        row0, col0, row1, col1 of each.

    Returns
    -------
    ndarray of float64, (n,)
        Energy [J]; NaN where a leg may not be driven.

    Notes
    -----
    On one thread: most questions are a few legs, and on a busy machine waiting for a second thread takes longer.
    """
    out = np.empty(legs.shape[0])
    weights = np.empty(traction.shape[2])
    for k in range(legs.shape[0]):
        out[k] = leg_energy_with(
            weights,
            traction,
            gradient,
            blocked,
            terms,
            legs[k, 0],
            legs[k, 1],
            legs[k, 2],
            legs[k, 3],
            math.inf,
        )
    return out


@njit(cache=True)
def turn_angle(row0, col0, row1, col1, row2, col2):
    """Return the absolute change of heading between the legs 0-1 and 1-2.

    Parameters
    ----------
    row0, col0 : float
        Point 0.
    row1, col1 : float
        Point 1, where the turn is.
    row2, col2 : float
        Point 2.

    Returns
    -------
    float
        Angle [rad, 0..pi]; zero beside a leg of no length.
    """
    a, b = row1 - row0, col1 - col0
    c, d = row2 - row1, col2 - col1
    if (a == 0.0 and b == 0.0) or (c == 0.0 and d == 0.0):
        return 0.0
    return abs(math.atan2(a * d - b * c, a * c + b * d))


@njit(cache=True, nogil=True)
def path_energy(traction, gradient, blocked, terms, turn_j_per_rad, points):
    """Return the energy of a polyline with its turns.

    Parameters
    ----------
    traction : ndarray of float32, (rows, cols, K)
        As for `leg_energy`, like the next three.
    gradient : ndarray of float32, (rows, cols, 2)
        Rise per metre.
    blocked : ndarray of uint8, (rows, cols)
        `Blocked` codes.
    terms : ndarray of float64, (5,)
        Terms of the price.
    turn_j_per_rad : float
        Energy of turning on the spot [J/rad].
    points : ndarray of float64, (n, 2)
        (row, col) polyline.

    Returns
    -------
    float
        Energy [J]; NaN where a leg may not be driven.
    """
    energy = 0.0
    for k in range(1, points.shape[0]):
        energy += leg_energy(
            traction, gradient, blocked, terms, points[k - 1, 0], points[k - 1, 1], points[k, 0], points[k, 1]
        )
        if k >= 2 and turn_j_per_rad > 0.0:
            energy += turn_j_per_rad * turn_angle(
                points[k - 2, 0], points[k - 2, 1], points[k - 1, 0], points[k - 1, 1], points[k, 0], points[k, 1]
            )
    return energy
