"""The cheapest path within a few cells of another one, over points on the lines between neighbouring cell centres.

Within a square of four centres a leg is open where all four cells are; on one of its sides only two count, and at a
centre one. So where limits close much, cheap paths change their heading on these lines. Points that divide the sides of
all squares, joined by straight *chords* across a square or along its sides, offer such paths (Aleksandrov, Maheshwari &
Sack 2005: Steiner points on the edges of weighted regions). Along a chord the traction is a quadratic, whose values are
sums over four cells with weights that depend on the chord alone; and chords have few headings, so the traction of a
cell is interpolated once for each of these.
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
from joulemap.planner.crossovers import with_crossovers
from joulemap.planner.edges import Points, interpolation_matrix, leg_prices_between, price_arrays
from joulemap.planner.kernels import fill_tractions, mean_response
from joulemap.planner.lattice import CostLattice
from joulemap.planner.passages import mark_around
from joulemap.planner.polylines import distinct, subdivided
from joulemap.planner.refine import converged, shortcuts

PARTS = 8
"""Parts of a side of a square, which gives 176 headings."""
_AROUND = 3
"""Rows and columns of cells around a point's cell in which its chords end, and whose tractions they need."""


class Chords(NamedTuple):
    """Chords between line points. A cell has `kinds` of these: its centre, those on the side to the right, those below.

    Attributes
    ----------
    places : ndarray of float64, (kinds, 2)
        (row, col) of each kind from the centre of its cell [cells].
    first : ndarray of int64, (kinds + 1,)
        The first chord from each kind, and the number of all.
    cell : ndarray of int64, (C,)
        The cell of a chord's end, by its number among the nine around that of the beginning.
    kind : ndarray of int64, (C,)
        Kind of its end.
    heading : ndarray of int64, (C,)
        Number of its heading.
    length : ndarray of float64, (C,)
        Length [cells].
    corners : ndarray of int64, (C, 4)
        Cells that it touches, by their number among the nine; -1 where there are fewer.
    blend : ndarray of float64, (C, 3, 4)
        Weights of these at its beginning, middle and end.
    heading_rad : ndarray of float64, (H,)
        The headings.
    directions : ndarray of float64, (H, 2)
        East and north component of each.
    """

    places: NDArray[np.float64]
    first: NDArray[np.int64]
    cell: NDArray[np.int64]
    kind: NDArray[np.int64]
    heading: NDArray[np.int64]
    length: NDArray[np.float64]
    corners: NDArray[np.int64]
    blend: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    directions: NDArray[np.float64]


@cache
def chords_of(parts: int) -> Chords:
    """Return the chords between points that divide each side of a square.

    Parameters
    ----------
    parts : int
        Number of parts of a side.

    Returns
    -------
    Chords
        Across squares from each point to all on other sides; along sides to the next point.
    """
    whole = range(parts + 1)
    border = [(a, b) for a in whole for b in whole if a in (0, parts) or b in (0, parts)]
    kinds = [(0, 0), *((0, k) for k in range(1, parts)), *((k, 0) for k in range(1, parts))]
    headings: dict[tuple[int, int], int] = {}
    first, rows = [0], []
    for row, col in kinds:
        for up, left in np.ndindex(1 if row else 2, 1 if col else 2):  # squares on whose border the point is
            here = np.array([row + up * parts, col + left * parts])
            for there in np.array(border):
                step = there - here
                along = (step == 0) & (here % parts == 0)
                if not step.any() or (along.any() and (np.abs(step).sum() > 1 or here[along] != 0)):
                    continue  # along a side only to the next point, and once for both squares beside it
                u, v = (np.linspace(a, b, 3) / parts for a, b in zip(here, there, strict=True))
                blend = np.column_stack([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v])
                cells = np.array([_number(i - up, j - left) for i, j in np.ndindex(2, 2)])
                owner, end = np.divmod(there, parts)
                direction = tuple((step // math.gcd(*step.tolist())).tolist())
                rows.append(
                    (
                        _number(*(owner - (up, left))),
                        kinds.index(tuple(end.tolist())),
                        headings.setdefault(direction, len(headings)),
                        math.hypot(*step) / parts,
                        np.where(blend.any(axis=0), cells, -1),
                        blend,
                    )
                )
        first.append(len(rows))
    down, right = np.array(list(headings)).T
    heading_rad = heading_of(right, -down)
    cell, kind, heading, length, corners, weights = (np.array(column) for column in zip(*rows, strict=True))
    directions = np.column_stack(heading_vector(heading_rad))
    places = np.array(kinds) / parts
    return Chords(places, np.array(first), cell, kind, heading, length, corners, weights, heading_rad, directions)


@cache
def _heading_weights(parts: int, bins: int) -> NDArray[np.float64]:
    """The weights of heading bins at the headings of chords, (H, K)."""
    return interpolation_matrix(chords_of(parts).heading_rad, bins)


def _number(down: int, right: int) -> int:
    """The number of a cell among the nine around another."""
    return _AROUND * (down + 1) + right + 1


def with_way_around(lattice: CostLattice, points: Points, *, half_side: int) -> Points:
    """Return the cheapest way over a path and what the any-angle step makes of the best of a tube around it.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline that may be driven.
    half_side : int
        As for `cheapest_in_tube`.

    Returns
    -------
    ndarray of float, (k, 2)
        (row, col) polyline with the same ends and at most the same energy.
    """
    way = cheapest_in_tube(lattice, points, half_side=half_side)
    return with_crossovers(lattice, points, [converged(lattice, shortcuts(lattice, way))]) if len(way) else points


def cheapest_in_tube(lattice: CostLattice, points: Points, *, half_side: int, parts: int = PARTS) -> Points:
    """Return the cheapest path over line points of the cells around another one.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline, n >= 2.
    half_side : int
        How far beside its cells those lie that take part [cells].
    parts : int, default 8
        As for `chords_of`.

    Returns
    -------
    ndarray of float, (k, 2)
        (row, col) polyline with the same ends; k = 0 where there is none. Turns are not counted.
    """
    cols, near = lattice.frame.cols, np.zeros(lattice.frame.shape, dtype=np.bool_)
    mark_around(near, np.rint(subdivided(points, 1.0)).astype(np.int64) @ np.array([cols, 1]), cols, half_side)
    cells, slot = np.flatnonzero(near), np.full(near.shape, -1, dtype=np.int32)
    slot.ravel()[cells] = np.arange(cells.size)
    chords, robot = chords_of(parts), lattice.robot
    (begins, spent), (ends, rest) = (_joined(lattice, slot, cells, chords, points[k], outward=k == 0) for k in (0, -1))
    weights = _heading_weights(parts, lattice.headings)
    least = robot.hotel_per_m * lattice.frame.resolution_m if robot.regeneration == 0.0 else -math.inf
    way = _cheapest(*price_arrays(lattice), chords, weights, slot, cells, begins, spent, ends, rest, least)
    return distinct(np.vstack([points[:1], way, points[-1:]])) if len(way) else way


def _joined(
    lattice: CostLattice,
    slot: NDArray[np.int32],
    cells: NDArray[np.int64],
    chords: Chords,
    place: Points,
    *,
    outward: bool,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The line points of the squares in which a place lies, and the energies of the legs from it, or to it [J]."""
    kinds, (rows, cols) = len(chords.places), slot.shape
    low, high = np.maximum(np.floor(place - 1e-9), 0), np.ceil(place + 1e-9)
    top, left = low.astype(np.int64)
    bottom, right = np.minimum(high, [rows - 1, cols - 1]).astype(np.int64)
    slots = slot[top : bottom + 1, left : right + 1].ravel()
    numbers = (kinds * slots[slots >= 0, None] + np.arange(kinds)).ravel()
    corners = np.column_stack(np.divmod(cells[numbers // kinds], cols))
    there = corners + chords.places[numbers % kinds]
    inside = (there <= high).all(axis=1)
    numbers, there = numbers[inside], there[inside]
    here = np.tile(place, (len(there), 1))
    prices = leg_prices_between(lattice, *((here, there) if outward else (there, here)))
    return numbers, np.where(np.isnan(prices), np.inf, prices)


@njit(cache=True, nogil=True)
def _cheapest(
    traction, gradient, blocked, terms, chords, weights, slot, cells, begins, spent, ends, rest, least_per_cell
):
    """The (row, col) of the line points of the cheapest way, (k, 2); k = 0 where there is none.

    weights : of the heading bins at the headings of chords, (H, K). slot : number of each cell among those that take
    part, -1 for the others; cells : their flat indices. A line point has the number kinds * number of its cell + kind.
    begins, ends : line points that are joined to the start and to the goal; spent, rest : energies of joining each [J].
    least_per_cell : what a way of one cell costs at least [J]; below 0 where prices may be negative.
    """
    rows, cols = slot.shape
    spacing, hotel, regeneration = terms[0], terms[1], terms[2]
    kinds = len(chords.places)
    label, joined = np.full(kinds * cells.size, np.inf), np.full(kinds * cells.size, np.inf)
    came = np.full(label.size, -1, dtype=np.int64)
    settled = np.zeros(label.size, dtype=np.bool_)
    at_headings = np.empty((cells.size, weights.shape[0]), dtype=np.float32)
    known = np.zeros(cells.size, dtype=np.bool_)
    around = np.empty(_AROUND * _AROUND, dtype=np.int64)
    for k in range(ends.size):
        joined[ends[k]] = rest[k]
    heap = [(np.inf, np.int64(-1))]
    for k in range(begins.size):
        if spent[k] < np.inf:
            label[begins[k]] = spent[k]
            heapq.heappush(heap, (spent[k], begins[k]))
    total, last = np.inf, np.int64(-1)
    while True:
        so_far, point = heapq.heappop(heap)
        if not so_far < total:
            break
        if settled[point]:
            continue
        settled[point] = True
        if so_far + joined[point] < total:
            total, last = so_far + joined[point], point
        here, kind = point // kinds, point % kinds
        row, col = cells[here] // cols, cells[here] % cols
        for k in range(around.size):
            i, j = row + k // _AROUND - 1, col + k % _AROUND - 1
            there = slot[i, j] if 0 <= i < rows and 0 <= j < cols else -1
            around[k] = there
            if there >= 0 and not known[there]:
                known[there] = True
                fill_tractions(at_headings[there], traction, gradient, blocked, terms, chords.directions, weights, i, j)
        for n in range(chords.first[kind], chords.first[kind + 1]):
            there = around[chords.cell[n]]
            if there < 0:
                continue
            other = kinds * there + chords.kind[n]
            if settled[other] or chords.length[n] * least_per_cell >= label[other] - so_far:
                continue
            t0 = tm = t1 = 0.0
            low = np.inf
            for k in range(4):
                corner = chords.corners[n, k]
                if corner < 0:
                    continue
                value = np.nan
                if around[corner] >= 0:
                    value = np.float64(at_headings[around[corner], chords.heading[n]])
                t0 += chords.blend[n, 0, k] * value
                tm += chords.blend[n, 1, k] * value
                t1 += chords.blend[n, 2, k] * value
                low = min(low, value)
            if math.isnan(tm):
                continue
            mean = (t0 + 4.0 * tm + t1) / 6.0 if low >= 0.0 else mean_response(t0, tm, t1, regeneration)
            arrived = so_far + (hotel + mean) * chords.length[n] * spacing
            if arrived < label[other]:
                label[other], came[other] = arrived, point
                heapq.heappush(heap, (arrived, other))
    return _way_to(last, came, cells, cols, chords.places)


@njit(cache=True)
def _way_to(last, came, cells, cols, places):
    """The (row, col) of the line points by which the search came to one, (k, 2)."""
    count, at = 0, last
    while at >= 0:
        count += 1
        at = came[at]
    way, at = np.empty((count, 2)), last
    for k in range(count - 1, -1, -1):
        cell, kind = cells[at // len(places)], at % len(places)
        way[k, 0], way[k, 1] = cell // cols + places[kind, 0], cell % cols + places[kind, 1]
        at = came[at]
    return way
