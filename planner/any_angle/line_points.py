"""The cheapest path over line points of the cells of a region (Dijkstra 1959, with buckets of energy).

Along a chord the traction is a quadratic, whose mean is a sum over four cells with shares that depend on the chord
alone; and chords have few headings, so the traction of a cell is interpolated once for each of these.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.compiling import bare_njit
from joulemap.model.frames import wrap_angle
from joulemap.planner.any_angle.chords import AROUND, Chords, chords_of
from joulemap.planner.any_angle.region import mark_around
from joulemap.planner.grid.buckets import BUCKETS, put
from joulemap.planner.grid.states import CELL_WIDTH
from joulemap.planner.grid.stopping import check_stop, stop_flag
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.obstacles import meets
from joulemap.planner.pricing.integrator import Points, Prices, interpolation_matrix, leg_prices_between
from joulemap.planner.pricing.kernels import fill_tractions, mean_response
from joulemap.planner.pricing.polylines import distinct

_ROUNDING = 1e-12
"""Relative gain that counts as rounding, so that no loop of negative prices goes on for ever."""


class _Part(NamedTuple):
    """The cells that take part. A line point has the number kinds * number of its cell + kind."""

    slot: NDArray[np.int32]  # (rows, cols): number of each cell, from 1; 0 for those that do not
    cells: NDArray[np.int64]  # their flat indices
    inside: NDArray[np.bool_]  # whether chords may touch them, and not only those within the margin


class _Joined(NamedTuple):
    """Line points that are joined to the start, or to the goal."""

    points: NDArray[np.int64]  # each once
    energy_j: NDArray[np.float64]  # of the leg between [J]


class _Terms(NamedTuple):
    """How the search goes about it."""

    least_per_cell: float  # what a way of one cell costs at least [J]; below 0 where prices may be negative
    per_j: float  # buckets to a joule
    turn: NDArray[np.float64]  # (H, H): energy of turning from one heading to another [J], or (0, 0)


@cache
def _heading_weights(parts: int, bins: int) -> NDArray[np.float32]:
    """The weights of heading bins at the headings of chords, (K, H)."""
    return np.ascontiguousarray(interpolation_matrix(chords_of(parts).heading_rad, bins).T, dtype=np.float32)


def cheapest_over_line_points(
    lattice: CostLattice,
    prices: Prices,
    region: NDArray[np.bool_],
    start: Points,
    goal: Points,
    *,
    parts: int,
    typical_j: float,
) -> Points:
    """The (row, col) of the cheapest path over line points of a region, (n, 2); n = 0 where there is none.

    prices : of the lattice; within their margin a chord has their penalty. region : cells that take part, (rows, cols).
    parts : of a side between two centres. typical_j : energy of a typical cell [J]. A turn counts from the best way to
    its point, so where turning costs the path may not be the cheapest.
    """
    margin = float(prices.terms[6])
    around = region
    if margin > 0.0:
        around = np.zeros_like(region)
        mark_around(around, np.flatnonzero(region), region.shape[1], math.ceil(margin))
    cells, slot = np.flatnonzero(around), np.zeros(region.shape, dtype=np.int32)  # zeros take no memory until written
    slot.ravel()[cells] = np.arange(1, cells.size + 1)
    chords, robot = chords_of(parts, margin), lattice.robot
    part = _Part(slot, cells, region.ravel()[cells])
    begins, ends = (_joined(lattice, part, chords, *end) for end in ((start, True), (goal, False)))
    least = robot.hotel_per_m * lattice.frame.resolution_m if robot.regeneration == 0.0 else -math.inf
    turn = np.zeros((0, 0))
    if robot.turn_j_per_rad > 0.0:
        headings = chords.heading_rad
        turn = robot.turn_j_per_rad * np.abs(wrap_angle(headings[None, :] - headings[:, None]))
    weights = _heading_weights(parts, lattice.headings)
    terms = _Terms(least, 1.0 / (CELL_WIDTH * typical_j), turn)
    way = _cheapest(prices, chords, weights, part, begins, ends, terms, stop_flag())
    check_stop()
    return distinct(np.vstack([start[None], way, goal[None]])) if len(way) else way


def _joined(lattice: CostLattice, part: _Part, chords: Chords, place: Points, outward: bool) -> _Joined:
    """The line points of the squares in which a place lies, with the legs from it, or to it."""
    slot, cells = part.slot, part.cells
    kinds, (rows, cols) = len(chords.places), slot.shape
    low, high = np.maximum(np.floor(place - 1e-9), 0), np.ceil(place + 1e-9)
    top, left = low.astype(np.int64)
    bottom, right = np.minimum(high, [rows - 1, cols - 1]).astype(np.int64)
    slots = slot[top : bottom + 1, left : right + 1].ravel()
    numbers = (kinds * (slots[slots > 0, None] - 1) + np.arange(kinds)).ravel()
    corners = np.column_stack(np.divmod(cells[numbers // kinds], cols))
    there = corners + chords.places[numbers % kinds]
    inside = (there <= high).all(axis=1)
    numbers, there = numbers[inside], there[inside]
    here = np.tile(place, (len(there), 1))
    prices = leg_prices_between(lattice, *((here, there) if outward else (there, here)))
    return _Joined(numbers, np.where(np.isnan(prices), np.inf, prices))


@njit(cache=True, nogil=True)
def _cheapest(prices, chords, weights, part, begins, ends, how, stop):
    """The (row, col) of the line points of the cheapest way, (k, 2); k = 0 where there is none.

    weights : of the heading bins at the headings of chords, (K, H). begins, ends : `_Joined` to the start and the goal.
    """
    slot, cells, inside = part
    least_per_cell, per_j, turn = how
    cols = slot.shape[1]
    blocked, terms = prices.blocked, prices.terms
    spacing, hotel, regeneration = terms[0], terms[1], terms[2]
    chord_cell, chord_kind, chord_heading, chord_length = chords.cell, chords.kind, chords.heading, chords.length
    first, corners, other_corners, share, blend = (
        chords.first,
        chords.corners,
        chords.other_corners,
        chords.share,
        chords.blend,
    )
    kinds, directions, beside_cells = len(chords.places), chords.directions, chords.beside
    turning, beside = turn.size > 0, beside_cells.shape[1]
    label, joined = np.full(kinds * cells.size, np.inf), np.full(kinds * cells.size, np.inf)
    expanded = np.full(label.size, np.inf)
    came = np.full(label.size, -1, dtype=np.int32)
    arrived_by = np.full(label.size if turning else 1, -1, dtype=np.int16)
    at_headings = np.empty((cells.size, weights.shape[1]), dtype=np.float32)
    known = np.zeros(cells.size, dtype=np.bool_)
    around = np.empty(AROUND * AROUND, dtype=np.int64)
    queue = np.empty((BUCKETS, 64), dtype=np.uint32)
    count = np.zeros(BUCKETS, dtype=np.int64)
    joined[ends.points] = ends.energy_j
    low = begins.energy_j.min() if begins.points.size else np.inf
    current = np.int64(0) if low == np.inf else np.int64(math.floor(low * per_j))
    waiting = 0
    for point, spent in zip(begins.points, begins.energy_j):  # noqa: B905 - compiled
        if spent < np.inf:
            label[point] = spent
            queue = put(queue, count, min(np.int64(math.floor(spent * per_j)), current + BUCKETS - 1), point)
            waiting += 1
    total, last = np.inf, np.int64(-1)
    while waiting > 0 and (current < total * per_j or least_per_cell < 0.0) and stop[0] == 0:
        here_slot = current & (BUCKETS - 1)
        q = 0
        while q < count[here_slot]:
            point = np.int64(queue[here_slot, q])
            q += 1
            so_far = label[point]
            if so_far >= expanded[point]:
                continue
            due = np.int64(math.floor(so_far * per_j))
            if due > current:  # it waited in the last bucket of the ring
                queue = put(queue, count, min(due, current + BUCKETS - 1), point)
                waiting += 1
                continue
            expanded[point] = so_far
            if so_far + joined[point] < total:
                total, last = so_far + joined[point], point
            here, kind = point // kinds, point % kinds
            row, col = cells[here] // cols, cells[here] % cols
            for k in range(around.size):
                i, j = row + k // AROUND - 1, col + k % AROUND - 1
                there = _filled(at_headings, known, prices, slot, directions, weights, i, j)
                around[k] = there if there >= 0 and inside[there] else -1
            heading_in = arrived_by[point] if turning else -1
            touched, a, b, c, d = False, np.uintp(0), np.uintp(0), np.uintp(0), np.uintp(0)
            for n in range(np.uintp(first[kind]), np.uintp(first[kind + 1])):  # unsigned: none counts from the end
                if other_corners[n]:
                    i, j = around[corners[n, 0]], around[corners[n, 1]]
                    k, there = around[corners[n, 2]], around[corners[n, 3]]
                    touched = min(min(i, j), min(k, there)) >= 0
                    a, b, c, d = np.uintp(i), np.uintp(j), np.uintp(k), np.uintp(there)
                if not touched:
                    continue
                other = np.uintp(kinds * around[chord_cell[n]] + chord_kind[n])  # its cell is one of the four
                before = label[other]
                length = chord_length[n]
                if so_far + length * least_per_cell >= before:
                    continue
                h = np.uintp(chord_heading[n])
                ta, tb, tc, td = at_headings[a, h], at_headings[b, h], at_headings[c, h], at_headings[d, h]
                mean = share[n, 0] * ta + share[n, 1] * tb + share[n, 2] * tc + share[n, 3] * td
                if math.isnan(mean):
                    continue
                if min(min(ta, tb), min(tc, td)) < 0.0:
                    t0 = blend[n, 0, 0] * ta + blend[n, 0, 1] * tb + blend[n, 0, 2] * tc + blend[n, 0, 3] * td
                    tm = blend[n, 1, 0] * ta + blend[n, 1, 1] * tb + blend[n, 1, 2] * tc + blend[n, 1, 3] * td
                    t1 = blend[n, 2, 0] * ta + blend[n, 2, 1] * tb + blend[n, 2, 2] * tc + blend[n, 2, 3] * td
                    mean = mean_response(t0, tm, t1, regeneration)
                arrived = so_far + (hotel + mean) * length * spacing
                if turning and heading_in >= 0:
                    arrived += turn[heading_in, h]
                if arrived < before and blocked.room.size > 0 and (blocked.near.size == 0 or blocked.near[row, col]):
                    begin_row, begin_col = row + chords.places[kind, 0], col + chords.places[kind, 1]
                    east, north = directions[h, 0], directions[h, 1]
                    end_row, end_col = begin_row - length * north, begin_col + length * east
                    leg = (begin_row, begin_col, end_row, end_col, east, north)
                    if meets(blocked.room, blocked.body, *leg, 0.0):
                        continue
                    if terms[6] > 0.0 and meets(blocked.room, blocked.body, *leg, terms[6]):
                        arrived += terms[8] * length
                if arrived < before and beside > 0:
                    for k in range(beside):
                        i, j = row + beside_cells[n, k, 0], col + beside_cells[n, k, 1]
                        there = _filled(at_headings, known, prices, slot, directions, weights, i, j)
                        if there >= 0 and math.isnan(at_headings[there, h]):
                            arrived += terms[8] * length
                            break
                if not arrived < before - _ROUNDING * abs(arrived):
                    continue
                label[other], came[other] = arrived, point
                if turning:
                    arrived_by[other] = h
                due = max(np.int64(math.floor(arrived * per_j)), current)
                queue = put(queue, count, min(due, current + BUCKETS - 1), other)
                waiting += 1
        waiting -= count[here_slot]
        count[here_slot] = 0
        current += 1
    return _way_to(last, came, cells, cols, chords.places)


@bare_njit(cache=True, forceinline=True)
def _filled(at_headings, known, prices, slot, directions, weights, i, j):
    """The number of a cell, from 0, whose tractions are then known; -1 where it takes no part."""
    rows, cols = slot.shape
    there = np.int64(slot[i, j]) - 1 if 0 <= i < rows and 0 <= j < cols else -1
    if there >= 0 and not known[there]:
        known[there] = True
        fill_tractions(at_headings, there, prices, directions, weights, i, j)
    return there


@njit(cache=True)
def _way_to(last, came, cells, cols, places):
    """The (row, col) of the line points by which the search came to one, (k, 2)."""
    count, at = 0, last
    while at >= 0:
        count += 1
        at = np.int64(came[at])
    way, at = np.empty((count, 2)), last
    for k in range(count - 1, -1, -1):
        cell, kind = cells[at // len(places)], at % len(places)
        way[k, 0], way[k, 1] = cell // cols + places[kind, 0], cell % cols + places[kind, 1]
        at = np.int64(came[at])
    return way
