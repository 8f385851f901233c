"""Compiled best-first search over the implicit grid: buckets of energy take the place of a heap.

A bucket holds what may be settled within `width` joules, in no order. Whoever is improved after it was settled is
settled again, so the answer is exact for any width and for any admissible guide, and on ties of rounding too
(Meyer & Sanders 2003, delta-stepping, on one thread). Buckets lie in a ring; what belongs beyond its end waits in the
last one and is sorted in again when that comes up.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

BUCKETS = 512
FIRST_CAPACITY = 128
SETTLED = 128
"""Flag in `pred` of cells that need no further look."""
NEVER = np.int64(1) << 62


class Guide(NamedTuple):
    """What a search knows of the energy still to come from a cell: the largest of some lower bounds, `heuristics`.

    Each of `pairs` (a, b) bounds it by a * cells to `goal` - b * surface + rest; each column of `marks` by its value
    there + marks_rest. Without either the bound is nothing.

    pairs : (B, 2) float64; rest : (B,) float64; goal : (2,) float64 (row, col); surface : (cells,) float64;
    marks : (cells, M) float32; marks_rest : (M,) float64.
    """

    pairs: NDArray[np.float64]
    rest: NDArray[np.float64]
    goal: NDArray[np.float64]
    surface: NDArray[np.float64]
    marks: NDArray[np.float32]
    marks_rest: NDArray[np.float64]


@njit(cache=True)
def bound_at(guide, cell, cols):
    """The bound at a cell; inf where the goal is known to be out of reach."""
    best = 0.0 if guide.pairs.shape[0] == 0 else -np.inf
    if guide.pairs.shape[0] > 0:
        row = np.int64(cell) // cols
        down, right = guide.goal[0] - row, guide.goal[1] - (np.int64(cell) - row * cols)
        cells = math.sqrt(down * down + right * right)
        height = guide.surface[cell]
        for k in range(guide.pairs.shape[0]):
            best = max(best, guide.pairs[k, 0] * cells - guide.pairs[k, 1] * height + guide.rest[k])
    for k in range(guide.marks.shape[1]):
        bound = guide.marks[cell, k] + guide.marks_rest[k]
        if bound > best:  # false where neither end knows the landmark
            best = bound
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
    """Lay a cell into a bucket of the ring; the ring, a wider one where that bucket was full."""
    slot = bucket & (BUCKETS - 1)
    if count[slot] == queue.shape[1]:
        queue = _grown(queue, count)
    queue[slot, count[slot]] = cell
    count[slot] += 1
    return queue


@njit(cache=True)
def open_ring(first, least, guide, cols, per_j):
    """A ring of buckets with the cells `first` (S,), reached with `least` (S,) [J], where they are due.

    Returns the ring, how many cells each bucket holds, the first one that holds any, and the bucket in which every cell
    is due (S,), be it beyond the ring's end; NEVER for a cell from where the goal is out of reach.
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
def search_cells(energy, pred, price, jump, first, targets, target_rest, guide, cols, width, slack, backward):
    """Settle cells until no bucket may improve the way to a target, or all of them where there is none.

    energy : (cells,) float64 [J], the labels to start from; pred : (cells,) uint8 move + 1 by which a label came, 0 a
    seed, with `SETTLED` where nothing is left to do; both are changed. price : (cells, N) float32 [J] of the move that
    leaves a cell; jump : (N,) step of a move in flat cells. first : (S,) cells to begin with. targets : (T,) cells,
    target_rest : (T,) [J] from there on. slack : relative gain below which a label stays, above 0 where prices may be
    negative. Backward, moves are run against their direction, each at its own price.

    Returns the last cell (-1: not reached), the energy to the goal, and the number of settled cells.
    """
    cells = np.uintp(energy.size)
    moves = jump.size
    steps = (-jump if backward else jump).astype(np.uintp)
    prices = price.reshape(-1)
    free = guide.pairs.shape[0] + guide.marks.shape[1] == 0
    known = np.full(1 if free else energy.size, np.nan)  # bounds, each reckoned once
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
    while waiting > 0 and current * width < total:
        here = current % BUCKETS
        k = 0
        while k < count[here]:
            cell = np.uintp(queue[here, k])
            k += 1
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
            for n in range(moves):
                other = cell + steps[n]
                if other >= cells:
                    continue
                reached = so_far + prices[(other if backward else cell) * np.uintp(moves) + np.uintp(n)]
                before = energy[other]
                if not reached + slack * (1.0 + abs(reached)) < before:  # nor where there is no such move
                    continue
                ahead = 0.0
                if not free:
                    ahead = known[other]
                    if math.isnan(ahead):
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
    """(n,) int64 cells that lead from `last` to the seed it was reached from, `last` first."""
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
