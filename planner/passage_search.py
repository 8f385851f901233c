"""Compiled search among cell centres and points that divide the sides of cells.

The headings of short legs are few, so the traction of a cell is interpolated once for all of them, and a leg's mean is
a sum over the cells that it touches, with shares that depend only on where in a cell it begins (`leg_stencils`). Where
the traction changes its sign along a leg, and for legs of other headings, the one integrator prices it (`kernels`). A
passage may be open between two headings only: beside closed cells, where a leg is closed, those that point a little to
its sides are tried.
"""

from __future__ import annotations

import heapq
import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.frames import heading_of, heading_vector
from joulemap.planner.kernels import fill_tractions, heading_memory, leg_energy_with
from joulemap.planner.move_prices import leg_stencils, move_offsets

PER_CELL = 4
"""Points along the side of a cell; every second one is a point at half the spacing."""
_HALF = PER_CELL // 2
SHORT_LEGS = 32
"""Headings of the legs that are tried from every point, all of them at most three points long in row and column, of
those at half or at a quarter of the spacing."""
LONGEST_LEG = 6
"""Rows or columns that a leg between their headings may span [half-cells]. Of 66 random tasks on a real hillside, such
legs made 11 cheaper by over 0.1 %, by up to 3.6 %, and 3 dearer. Legs of up to 12 gain no more, at nearly twice the
time."""
_BEFORE, _ACROSS = 2, 6
"""The surroundings of a cell whose points a short leg may touch: rows and columns before it, and all of them."""


class Legs(NamedTuple):
    """Legs between points.

    Attributes
    ----------
    steps : ndarray of int64, (L, 2)
        (drow, dcol) [points]: the short ones between points at half the spacing, clockwise from north; those between
        their headings; the short ones between points at a quarter.
    between : ndarray of int64, (B,)
        Of each of the second kind, the number of the short one whose heading is before its own.
    touched : ndarray of int64, (PER_CELL ** 2, 2 * SHORT_LEGS, S)
        Cells that a short leg from a point touches, by their number in the surroundings of the point's cell.
    shares : ndarray of float64, (PER_CELL ** 2, 2 * SHORT_LEGS, S)
        Their shares of its mean traction; -1 where there are fewer.
    heading_rad : ndarray of float64, (SHORT_LEGS,)
        Heading of each short leg.
    directions : ndarray of float64, (SHORT_LEGS, 2)
        East and north component of it.
    """

    steps: NDArray[np.int64]
    between: NDArray[np.int64]
    touched: NDArray[np.int64]
    shares: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    directions: NDArray[np.float64]


class Region(NamedTuple):
    """Cells that take part in a search.

    Attributes
    ----------
    slot : ndarray of int32, (rows, cols)
        Number of each cell among those that take part, -1 for the others.
    cells : ndarray of int64, (S,)
        Their flat indices.
    halved : ndarray of bool, (S,)
        Whether their points at half the spacing take part.
    beside : ndarray of bool, (S,)
        Whether moves from them are closed, so that legs between headings are tried.
    quartered : ndarray of bool, (S,)
        Whether all their points take part.
    """

    slot: NDArray[np.int32]
    cells: NDArray[np.int64]
    halved: NDArray[np.bool_]
    beside: NDArray[np.bool_]
    quartered: NDArray[np.bool_]


@cache
def short_legs() -> Legs:
    """Return the legs between points."""
    short, span = move_offsets(SHORT_LEGS), range(-LONGEST_LEG, LONGEST_LEG + 1)
    known = set(map(tuple, short.tolist()))
    other = np.array([(r, c) for r in span for c in span if math.gcd(r, c) == 1 and (r, c) not in known])
    of_short, of_other = (heading_of(legs[:, 1], -legs[:, 0]) for legs in (short, other))
    kinds = np.vstack([_HALF * short, short])
    starts = [(row, col, *step) for row, col in np.ndindex(PER_CELL, PER_CELL) for step in kinds.tolist()]
    cells, shares = leg_stencils(np.array(starts) / PER_CELL)
    size = PER_CELL**2, len(kinds), -1
    return Legs(
        np.vstack([_HALF * short, _HALF * other, short]),
        np.searchsorted(of_short, of_other, side="right") - 1,
        ((cells + _BEFORE) @ np.array([_ACROSS, 1])).reshape(size),
        shares.reshape(size),
        of_short,
        np.column_stack(heading_vector(of_short)),
    )


@njit(cache=True, nogil=True)
def cheapest_way(
    traction,
    gradient,
    blocked,
    terms,
    energy,
    offsets,
    legs,
    weights,
    region,
    reached,
    begins,
    ends,
    rest,
    least_per_cell,
):
    """Return the cheapest way, or the last part of it; turns are not counted.

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
    energy : ndarray of float32, (rows, cols, N)
        Energy of the moves between centres [J]; NaN where there is none.
    offsets : ndarray of int64, (N, 2)
        (drow, dcol) of these.
    legs : Legs
        Between points.
    weights : ndarray of float64, (SHORT_LEGS, K)
        Weights of the heading bins at the headings of the short legs.
    region : Region
        The cells that take part.
    reached : ndarray of float64, (S,)
        Energy with which the centre of each cell is reached already [J], infinite where it is not.
    begins : ndarray of int, (A,)
        Numbers of the cells from which ways may improve that.
    ends : ndarray of int, (B,)
        Numbers of the cells that are joined to the goal.
    rest : ndarray of float64, (B,)
        Energy of joining each [J].
    least_per_cell : float
        What a way of one cell costs at least [J]; below 0 where prices may be negative.

    Returns
    -------
    ndarray of float64, (k, 2)
        (row, col) of the way, times `PER_CELL`, from a centre with the energy given; k = 0 where there is no way, and
        k = 1 where none is cheaper than by the energies given.
    """
    # a point has the number PER_CELL ** 2 * slot + PER_CELL * (points down) + (points right of the centre)
    slot, cells = region.slot, region.cells
    halved, beside, quartered = region.halved, region.beside, region.quartered
    steps, between, touched, shares = legs.steps, legs.between, legs.touched, legs.shares
    rows, cols = slot.shape
    spacing, hotel, regeneration = terms[0], terms[1], terms[2]
    each, last_other = PER_CELL * PER_CELL, SHORT_LEGS + between.size
    label = np.full(each * cells.size, np.inf)
    label[::each] = reached
    came = np.full(each * cells.size, -1, dtype=np.int64)
    settled = np.zeros(each * cells.size, dtype=np.bool_)
    joined = np.full(cells.size, np.inf)  # energy from a target to the goal
    memory = heading_memory(traction.shape[2])
    at_headings = np.empty((cells.size, SHORT_LEGS), dtype=np.float32)
    known = np.zeros(cells.size, dtype=np.bool_)
    around = np.empty(_ACROSS * _ACROSS, dtype=np.int64)
    shut = np.zeros(SHORT_LEGS + 1, dtype=np.bool_)  # the first one again at the end
    total, last = np.inf, np.int64(-1)
    for k in range(ends.size):
        joined[ends[k]] = min(joined[ends[k]], rest[k])
        if label[each * ends[k]] + rest[k] < total:
            total, last = label[each * ends[k]] + rest[k], each * ends[k]
    heap = [(np.inf, np.int64(-1))]
    for k in range(begins.size):
        if reached[begins[k]] < np.inf:
            heapq.heappush(heap, (reached[begins[k]], each * begins[k]))
    while True:
        so_far, point = heapq.heappop(heap)
        if not so_far < total:
            break
        if settled[point]:
            continue
        settled[point] = True
        here, part = point // each, point % each
        row, col = cells[here] // cols, cells[here] % cols
        if part == 0 and so_far + joined[here] < total:
            total, last = so_far + joined[here], point
        down, right = PER_CELL * row + part // PER_CELL, PER_CELL * col + part % PER_CELL
        if part == 0:
            for n in range(offsets.shape[0]):  # moves between centres
                r, c = row + offsets[n, 0], col + offsets[n, 1]
                if 0 <= r < rows and 0 <= c < cols and slot[r, c] >= 0:
                    other = each * slot[r, c]
                    arrived = so_far + energy[row, col, n]
                    if arrived < label[other] and not settled[other]:
                        label[other], came[other] = arrived, point
                        heapq.heappush(heap, (arrived, other))
        if not halved[here]:
            continue
        for k in range(around.size):
            i, j = row - _BEFORE + k // _ACROSS, col - _BEFORE + k % _ACROSS
            there = slot[i, j] if 0 <= i < rows and 0 <= j < cols else -1
            around[k] = there
            if there >= 0 and not known[there]:
                known[there] = True
                fill_tractions(at_headings[there], traction, gradient, blocked, terms, legs.directions, weights, i, j)
        even = down % _HALF == 0 and right % _HALF == 0
        shut[:] = False
        first = 0 if even else last_other
        after = len(steps) if quartered[here] else last_other if beside[here] else SHORT_LEGS
        for n in range(first, after):
            other_heading = SHORT_LEGS <= n < last_other
            if other_heading and not (shut[between[n - SHORT_LEGS]] or shut[between[n - SHORT_LEGS] + 1]):
                continue
            a, b = down + steps[n, 0], right + steps[n, 1]
            if not (0 <= a <= PER_CELL * (rows - 1) and 0 <= b <= PER_CELL * (cols - 1)):
                continue
            there = slot[a // PER_CELL, b // PER_CELL]
            if there < 0:
                continue
            other = each * there + PER_CELL * (a % PER_CELL) + b % PER_CELL
            if settled[other] or not (
                other % each == 0 or quartered[there] or (halved[there] and a % _HALF == 0 and b % _HALF == 0)
            ):
                continue
            most = label[other] - so_far
            length = math.hypot(steps[n, 0], steps[n, 1]) / PER_CELL
            if length * least_per_cell >= most:
                continue
            mean, low, high = 0.0, np.inf, -np.inf
            if not other_heading:
                kind = n if n < SHORT_LEGS else n - between.size
                heading = n if n < SHORT_LEGS else n - last_other
                for k in range(shares.shape[2]):
                    if shares[part, kind, k] < 0.0:
                        break
                    cell = around[touched[part, kind, k]]
                    value = np.float64(at_headings[cell, heading]) if cell >= 0 else np.nan
                    mean += shares[part, kind, k] * value
                    low, high = value if value < low else low, value if value > high else high
                if math.isnan(mean):
                    if n < SHORT_LEGS:
                        shut[n] = True
                        shut[SHORT_LEGS] = shut[0]
                    continue
            if low >= 0.0 and not other_heading:
                price = (hotel + mean) * length * spacing
            elif high <= 0.0 and not other_heading:
                price = (hotel + regeneration * mean) * length * spacing
            else:
                limit = most if least_per_cell >= 0.0 else np.inf
                r0, c0, r1, c1 = down / PER_CELL, right / PER_CELL, a / PER_CELL, b / PER_CELL
                price = leg_energy_with(memory, traction, gradient, blocked, terms, r0, c0, r1, c1, limit)
            if price < most:
                label[other], came[other] = so_far + price, point
                heapq.heappush(heap, (so_far + price, other))
    return _way_to(last, came, cells, cols)


@njit(cache=True)
def _way_to(last, came, cells, cols):
    """The points by which the search came to one, (k, 2) as `cheapest_way` returns them."""
    count = 0
    at = last
    while at >= 0:
        count += 1
        at = came[at]
    place = np.empty((count, 2))
    at = last
    for k in range(count - 1, -1, -1):
        cell, part = cells[at // PER_CELL**2], at % PER_CELL**2
        place[k, 0] = PER_CELL * (cell // cols) + part // PER_CELL
        place[k, 1] = PER_CELL * (cell % cols) + part % PER_CELL
        at = came[at]
    return place
