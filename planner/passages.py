"""The cheapest path through passages that are too narrow for moves between cell centres.

A move touches up to ten cells, and is closed where one of them is blocked or too steep in its heading. A shorter piece
of the same heading touches fewer. So around closed moves, the cells that a nearly best path may use are searched once
more, among points at half the spacing, each piece priced by the one integrator. A passage may also be open between
two headings only: beside closed cells, where a leg is closed, those that point a little to its sides are tried.
Elsewhere the moves between centres stay.
"""

from __future__ import annotations

import heapq
import math
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.frames import heading_of
from joulemap.planner.edges import Points, price_arrays
from joulemap.planner.kernels import heading_memory, leg_energy_with
from joulemap.planner.lattice import CostLattice
from joulemap.planner.move_prices import move_offsets
from joulemap.planner.moves import MoveTable

AROUND = 6
"""How far beside the cells of nearly best grid paths, and beside closed moves, the points lie [cells]. With 2, nine of
100 random tasks on a real hillside cost over 0.1 % more than with the best of 2, 3, 4 and 6, by up to 3.3 %; with 9 or
12 the mean energy is no lower than with 6."""
SHORT_LEGS = 32
"""Headings of the legs that are tried from every point, all of them at most three half-cells long in row and column."""
LONGEST_LEG = 6
"""Rows or columns that a leg between their headings may span [half-cells]. Of 66 random tasks on a real hillside, such
legs made 11 cheaper by over 0.1 %, by up to 3.6 %, and 3 dearer. Legs of up to 12 gain no more, at nearly twice the
time."""


def path_through_passages(
    lattice: CostLattice,
    table: MoveTable,
    usual: NDArray[np.int64],
    seeds: tuple[NDArray[np.int64], NDArray[np.float64]],
    targets: tuple[NDArray[np.int64], NDArray[np.float64]],
) -> Points | None:
    """Return the cheapest path among cell centres and the points half-way between them near closed moves.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    table : MoveTable
        Priced moves of the lattice.
    usual : ndarray of int64, (n,)
        Flat indices of the cells of nearly best grid paths.
    seeds, targets : tuple of (ndarray of int64, (S,), ndarray of float64, (S,))
        Flat cells that are joined to the start and to the goal, and the energy of joining each [J].

    Returns
    -------
    ndarray of float, (k, 2), or None
        (row, col) of the path from a seed to a target; None where no move is closed near those cells, or there is no
        path.

    Notes
    -----
    Points that are settled stay settled, so with negative prices the path may not be the cheapest. A leg that cannot
    make its end cheaper is not priced and counts as open.
    """
    rows, cols = lattice.frame.shape
    near = _around(usual, lattice.frame.shape)
    cells = np.flatnonzero(near)
    closed = _closed(table.energy, table.offsets, cells)
    if not closed.size:
        return None
    fine = _around(closed, lattice.frame.shape).ravel()[cells]
    slot = np.full(rows * cols, -1, dtype=np.int64)
    slot[cells] = np.arange(cells.size)
    beside = np.zeros(cells.size, dtype=np.bool_)
    beside[slot[closed]] = True
    begins, ends = slot[seeds[0]], slot[targets[0]]
    least = max(float(table.bound_per_m[0]), 0.0) if table.never_pays else -math.inf
    place = _cheapest(
        *price_arrays(lattice), table.energy, table.offsets, *_legs(), slot.reshape(rows, cols), cells, fine, beside,
        begins[begins >= 0], seeds[1][begins >= 0], ends[ends >= 0], targets[1][ends >= 0],
        least * lattice.frame.resolution_m,
    )  # fmt: skip
    return 0.5 * place if len(place) else None


@cache
def _legs() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The legs between points, (drow, dcol) in half-cells, first the short ones clockwise from north; and of each other
    one, the number of the short one whose heading is before its own."""
    short, span = move_offsets(SHORT_LEGS), range(-LONGEST_LEG, LONGEST_LEG + 1)
    known = set(map(tuple, short.tolist()))
    long = np.array([(r, c) for r in span for c in span if math.gcd(r, c) == 1 and (r, c) not in known])
    of_short, of_long = (heading_of(legs[:, 1], -legs[:, 0]) for legs in (short, long))
    return np.vstack([short, long]), np.searchsorted(of_short, of_long, side="right") - 1


def _around(cells: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.bool_]:
    out = np.zeros(shape, dtype=np.bool_)
    mark_around(out, cells, shape[1], AROUND)
    return out


@njit(cache=True, nogil=True)
def mark_around(taken, way, cols, half_side):
    """Mark the squares around the cells of a path.

    Parameters
    ----------
    taken : ndarray of bool, (rows, cols)
        Is set there.
    way : ndarray of int64, (n,)
        Flat cell indices, row * cols + col.
    cols : int
        Columns of the map.
    half_side : int
        Half the side of a square [cells].
    """
    rows = taken.shape[0]
    k = 0
    while k < way.size:
        first = way[k]
        while k + 1 < way.size and way[k + 1] == way[k] + 1 and way[k + 1] % cols > 0:
            k += 1  # cells side by side are marked together
        i, j, end = first // cols, first % cols, way[k] % cols + 1
        taken[
            max(i - half_side, 0) : min(i + half_side + 1, rows), max(j - half_side, 0) : min(end + half_side, cols)
        ] = True
        k += 1


@njit(cache=True, nogil=True)
def _closed(energy, offsets, cells):
    """Those of some flat cells of which a move is closed that does not leave the map."""
    rows, cols, moves = energy.shape
    reach = np.abs(offsets).max()
    out = np.empty(cells.size, dtype=np.int64)
    count = 0
    for cell in cells:
        i, j = cell // cols, cell % cols
        closed = 0
        if reach <= i < rows - reach and reach <= j < cols - reach:
            for n in range(moves):  # without a branch, so that the compiler uses vectors
                closed += math.isnan(energy[i, j, n])
        else:
            for n in range(moves):
                inside = 0 <= i + offsets[n, 0] < rows and 0 <= j + offsets[n, 1] < cols
                closed += inside and math.isnan(energy[i, j, n])
        if closed > 0:
            out[count] = cell
            count += 1
    return out[:count]


@njit(cache=True, nogil=True)
def _cheapest(
    traction,
    gradient,
    blocked,
    terms,
    energy,
    offsets,
    legs,
    between,
    slot,
    cells,
    fine,
    beside,
    begins,
    cost,
    ends,
    rest,
    least_per_cell,
):
    """The cheapest path as (k, 2) twice the (row, col), k = 0 where there is none. Turns are not counted.

    A point has the number 4 slot + 2 (half a cell down) + (half a cell right). slot : (rows, cols) number of each cell
    in `cells`, -1 where it takes no part; fine : (S,) whether its points between centres take part; beside : (S,)
    whether moves from it are closed; legs, between : as of `_legs`; least_per_cell : what a way of one cell costs at
    least [J].
    """
    rows, cols = slot.shape
    label = np.full(4 * cells.size, np.inf)
    came = np.full(4 * cells.size, -1, dtype=np.int64)
    settled = np.zeros(4 * cells.size, dtype=np.bool_)
    joined = np.full(cells.size, np.inf)  # energy from a target to the goal
    for k in range(ends.size):
        joined[ends[k]] = min(joined[ends[k]], rest[k])
    memory = heading_memory(traction.shape[2])
    short = legs.shape[0] - between.size
    shut = np.zeros(short + 1, dtype=np.bool_)  # the first one again at the end
    heap = [(np.inf, np.int64(-1))]
    for k in range(begins.size):
        if cost[k] < label[4 * begins[k]]:
            label[4 * begins[k]] = cost[k]
            heapq.heappush(heap, (cost[k], 4 * begins[k]))
    total, last = np.inf, np.int64(-1)
    while True:
        so_far, point = heapq.heappop(heap)
        if not so_far < total:
            break
        if settled[point]:
            continue
        settled[point] = True
        here, part = point >> 2, point & 3
        row, col = cells[here] // cols, cells[here] % cols
        if part == 0 and so_far + joined[here] < total:
            total, last = so_far + joined[here], point
        down, right = 2 * row + (part >> 1), 2 * col + (part & 1)
        if part == 0:
            for n in range(offsets.shape[0]):  # moves between centres
                r, c = row + offsets[n, 0], col + offsets[n, 1]
                if 0 <= r < rows and 0 <= c < cols and slot[r, c] >= 0:
                    other = 4 * slot[r, c]
                    reached = so_far + energy[row, col, n]
                    if reached < label[other] and not settled[other]:
                        label[other], came[other] = reached, point
                        heapq.heappush(heap, (reached, other))
        if not fine[here]:
            continue
        shut[:] = False
        for n in range(legs.shape[0] if beside[here] else short):
            if n >= short and not (shut[between[n - short]] or shut[between[n - short] + 1]):
                continue
            a, b = down + legs[n, 0], right + legs[n, 1]
            if not (0 <= a < 2 * rows - 1 and 0 <= b < 2 * cols - 1):
                continue
            there = slot[a >> 1, b >> 1]
            if there < 0:
                continue
            other = 4 * there + 2 * (a & 1) + (b & 1)
            if settled[other] or not (fine[there] or other & 3 == 0):
                continue
            most = label[other] - so_far
            if 0.5 * math.hypot(legs[n, 0], legs[n, 1]) * least_per_cell >= most:
                continue
            limit = most if least_per_cell >= 0.0 else np.inf
            price = leg_energy_with(
                memory, traction, gradient, blocked, terms, 0.5 * down, 0.5 * right, 0.5 * a, 0.5 * b, limit
            )
            if math.isnan(price) and n < short:
                shut[n] = True
                shut[short] = shut[0]
            if price < most:
                label[other], came[other] = so_far + price, point
                heapq.heappush(heap, (so_far + price, other))
    count = 0
    at = last
    while at >= 0:
        count += 1
        at = came[at]
    place = np.empty((count, 2))
    at = last
    for k in range(count - 1, -1, -1):
        cell = cells[at >> 2]
        place[k, 0], place[k, 1] = 2 * (cell // cols) + ((at & 3) >> 1), 2 * (cell % cols) + (at & 1)
        at = came[at]
    return place
