"""Compiled best-first search over the implicit grid, with buckets of energy instead of a heap.

A bucket holds the cells that may be settled within `width` joules, in no order. A cell that is improved after it was
settled is settled again, so the answer is exact for any width and any admissible guide, and on ties of rounding too
(Meyer & Sanders 2003, delta-stepping, on one thread). Buckets form a ring; what belongs beyond its end waits in the
last one and is sorted in again when that comes up.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.planner.grid.prefetch import prefetch

BUCKETS = 512
FIRST_CAPACITY = 128
SOON = 3
"""How many cells ahead of their turn the prices of a cell are fetched: they mostly come from memory, which takes about
a third of the time of a search."""
LINE = 16
"""Prices in a line of the processor's cache."""
SETTLED = 128
"""Flag in `pred` of cells that need no further look."""
NEVER = np.int64(1) << 62


class Guide(NamedTuple):
    """Lower bounds of the energy still to come from a cell, of which the largest counts (see `heuristics`).

    Each of `pairs` (a, b) gives the bound a * cells to `goal` - b * surface + rest. Without any the bound is 0.

    Attributes
    ----------
    pairs : ndarray of float64, (B, 2)
        a [J per cell length] and b (share of the rise).
    rest : ndarray of float64, (B,)
        [J].
    goal : ndarray of float64, (2,)
        Fractional (row, col).
    surface : ndarray of float64, (cells,)
        What a rise is counted on [J].
    """

    pairs: NDArray[np.float64]
    rest: NDArray[np.float64]
    goal: NDArray[np.float64]
    surface: NDArray[np.float64]


@njit(cache=True)
def bound_at(guide, cell, cols):
    """Return the bound at a cell. Result: energy [J]; infinite where it is known that the goal cannot be reached."""
    best = 0.0 if guide.pairs.shape[0] == 0 else -np.inf
    if guide.pairs.shape[0] > 0:
        row = np.int64(cell) // cols
        down, right = guide.goal[0] - row, guide.goal[1] - (np.int64(cell) - row * cols)
        cells = math.sqrt(down * down + right * right)
        height = guide.surface[cell]
        for k in range(guide.pairs.shape[0]):
            best = max(best, guide.pairs[k, 0] * cells - guide.pairs[k, 1] * height + guide.rest[k])
    return best


@njit(cache=True)
def _grown(queue, count):
    """The same buckets with room for twice as many."""
    out = np.empty((BUCKETS, 2 * queue.shape[1]), dtype=queue.dtype)
    for slot in range(BUCKETS):
        out[slot, : count[slot]] = queue[slot, : count[slot]]
    return out


@njit(cache=True, inline="always")
def put(queue, count, bucket, cell):
    """Put a cell into a bucket of the ring."""
    slot = bucket & (BUCKETS - 1)
    if count[slot] == queue.shape[1]:
        queue = _grown(queue, count)
    queue[slot, count[slot]] = cell
    count[slot] += 1
    return queue


@njit(cache=True)
def open_ring(first, least, guide, cols, per_j):
    """Return a ring of buckets with the cells that a search begins with.

    `first` (S,): flat indices of the cells; `least` (S,): energy with which they are reached [J]. Returns `queue`: the
    ring; `count`: cells in each bucket; `current`: the first bucket that holds any; `due` (S,): the bucket of every
    cell, also beyond the ring's end, NEVER for a cell from which the goal cannot be reached.
    """
    due = np.full(first.size, NEVER)
    for k in range(first.size):
        key = least[k] + bound_at(guide, first[k], cols)
        if key < np.inf:
            due[k] = math.floor(key * per_j)
    queue = np.empty((BUCKETS, FIRST_CAPACITY), dtype=np.uint32)
    count = np.zeros(BUCKETS, dtype=np.int64)
    current = due.min() if due.size > 0 else NEVER
    for k in range(first.size):
        if due[k] < NEVER:
            queue = put(queue, count, min(due[k], current + BUCKETS - 1), first[k])
    return queue, count, current, due


@njit(cache=True, nogil=True)
def search_cells(
    energy,
    pred,
    price,
    lengths,
    jump,
    near,
    near_j,
    first,
    targets,
    target_rest,
    guide,
    known,
    cols,
    width,
    slack,
    backward,
    margin,
    most,
    spent,
    budget,
    stop,
):
    """Settle cells until no bucket may improve the path to a target, or all cells where there is no target.

    `energy` (cells,): labels to start from [J], they are changed; `pred` (cells,); `price` (cells, N): energy of the
    move that leaves a cell [J], NaN where there is none; `lengths` (N,): what every move there is costs instead, empty
    for its energy; `jump` (N,): step of each move in flat indices; `near` (cells,): bit n is set where move n leaves
    the cell within the margin, empty for no margin, see `MoveTable`; `near_j` (N,): what such a move costs more [J];
    `first` (S,): cells to begin with; `targets` (T,): cells that are joined to the goal; `target_rest` (T,): energy
    from them to the goal [J]; `known` (cells,): zeros, bounds that were computed stand here; `width`: width of a bucket
    [J]; `slack`: relative gain below which a label stays, above 0 where prices may be negative; `most`: energy beyond
    which nothing is settled [J]; `spent` (cells,): energy that a path through a cell needs beside the one that is
    searched for [J], empty for none; `budget`: where both together exceed it [J], the cell is left alone; `stop` (1,):
    the search ends early once this is not 0, see `stopping`. Returns `last`: the last cell, -1 where the goal was not
    reached; `total`: energy to the goal [J]; `expanded`: number of settled cells.

    Reference: Meyer & Sanders 2003 (delta-stepping).
    """
    cells = np.uintp(energy.size)
    moves = jump.size
    steps = (-jump if backward else jump).astype(np.uintp)
    prices = price.reshape(-1)
    metric, marked = lengths.size > 0, near.size > 0
    free = guide.pairs.shape[0] == 0
    per_j = 1.0 / width
    queue, count, current, due_first = open_ring(first, energy[first], guide, cols, per_j)
    beyond = False  # whether something may wait in the last bucket of the ring before its time
    for k in range(first.size):
        pred[first[k]] &= SETTLED - 1
        beyond |= current + BUCKETS <= due_first[k] < NEVER
    waiting = count.sum()
    total = np.inf
    last = -1
    expanded = 0
    limit = most
    shared = spent.size > 0
    while waiting > 0 and current * width < limit and stop[0] == 0:
        here = current % BUCKETS
        k = 0
        while k < count[here]:
            cell = np.uintp(queue[here, k])
            k += 1
            if k + SOON <= count[here]:
                place = np.int64(queue[here, k + SOON - 1]) * moves
                for line in range(0, moves, LINE):
                    prefetch(prices, place + line)
            if pred[cell] >= SETTLED:
                continue
            so_far = energy[cell]
            if beyond:
                due = math.floor((so_far + bound_at(guide, cell, cols)) * per_j)
                if due > current:
                    queue = put(queue, count, min(due, current + BUCKETS - 1), cell)
                    waiting += 1
                    continue
            pred[cell] |= SETTLED
            expanded += 1
            for t in range(targets.size):
                if targets[t] == cell and so_far + target_rest[t] < total:
                    total = so_far + target_rest[t]
                    last = targets[t]
                    limit = min(most, total + margin * abs(total))
            for n in range(moves):
                other = cell + steps[n]
                if other >= cells:
                    continue
                step = np.float64(prices[(other if backward else cell) * np.uintp(moves) + np.uintp(n)])
                if metric:
                    step = lengths[n] + 0.0 * step  # NaN stays
                if marked and near[other if backward else cell] >> np.uint32(n) & np.uint32(1):
                    step += near_j[n]
                reached = so_far + step
                before = energy[other]
                if not reached < before:  # nor where there is no such move
                    continue
                if slack > 0.0 and not reached + slack * (1.0 + abs(reached)) < before:
                    continue
                if shared and reached + spent[other] > budget:
                    continue
                ahead = 0.0
                if not free:
                    ahead = known[other]
                    if ahead == 0.0:
                        ahead = known[other] = bound_at(guide, other, cols)
                if ahead == np.inf:
                    continue
                queued = pred[other] < SETTLED and before < np.inf
                energy[other] = reached
                pred[other] = n + 1
                due = max(math.floor((reached + ahead) * per_j), current)
                if queued and math.floor((before + ahead) * per_j) == due:
                    continue
                if due >= current + BUCKETS:
                    due = current + BUCKETS - 1
                    beyond = True
                queue = put(queue, count, due, other)
                waiting += 1
        waiting -= count[here]
        count[here] = 0
        current += 1
    return last, total, expanded


@njit(cache=True, nogil=True)
def trace_cells(pred, jump, last, backward):
    """Return the cells that lead from one cell to the seed that it was reached from.

    `pred` (cells,): as `search_cells` left it; `jump` (N,): step of each move in flat indices. Result (n,): flat
    indices, `last` first.
    """
    sign = 1 if backward else -1
    count = 1
    cell = last
    while pred[cell] & (SETTLED - 1) > 0:
        cell += sign * jump[(pred[cell] & (SETTLED - 1)) - 1]
        count += 1
    out = np.empty(count, dtype=np.int64)
    out[0] = last
    for k in range(1, count):
        out[k] = out[k - 1] + sign * jump[(pred[out[k - 1]] & (SETTLED - 1)) - 1]
    return out
