"""Compiled best-first search over the implicit grid, with buckets of energy instead of a heap.

A bucket holds the cells that may be settled within `width` joules, in no order. A cell that is improved after it was
settled is settled again, so the answer is exact for any width and any admissible guide, and on ties of rounding too
(Meyer & Sanders 2003, delta-stepping, on one thread). Buckets form a ring; what belongs beyond its end waits in the
last one and is sorted in again when that comes up.

Of a map that is priced tile by tile, a cell whose tile has no prices yet is left unsettled and the tile is noted with
the least key of such cells; when nothing else may be cheaper the search returns to ask for that tile, and goes on.
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


class Moves(NamedTuple):
    """What a search reads of a `MoveTable`."""

    price: NDArray[np.float32]  # (cells, N): energy of the move that leaves a cell [J]; NaN where there is none
    lengths: NDArray[np.float64]  # (N,): what every move there is costs instead; empty for its energy
    jump: NDArray[np.int64]  # (N,): step of each move in flat indices
    near: NDArray[np.uint32]  # (cells,): bit n is set where move n leaves the cell within the margin; empty for none
    near_j: NDArray[np.float64]  # (N,): what such a move costs more [J]
    gap: NDArray[np.float64]  # (N,): energy of turning from heading k to k + 1 [J]


class Aim(NamedTuple):
    """What a search is for, and where it ends."""

    targets: NDArray[np.int64]  # (T,): cells that are joined to the goal; none where all cells are to be settled
    rest: NDArray[np.float64]  # (T, layers): energy from them to the goal by heading [J]
    margin: float  # share of the least energy by which paths may exceed it and still have all their states settled
    most: float  # energy beyond which nothing is settled [J]
    spent: NDArray[np.float64]  # (cells,): energy of a path through a cell beside the one searched for [J], or empty
    budget: float  # where both together exceed it [J], the cell is left alone


class Terms(NamedTuple):
    """How a search goes about it."""

    cols: int  # of the map
    width: float  # of a bucket [J]
    slack: float  # relative gain below which a label stays; above 0 where prices may be negative
    backward: bool  # whether moves are run against their direction, each at its own price


class TileState(NamedTuple):
    """Which tiles of a map a search may settle cells of; it changes all three arrays."""

    ready: NDArray[np.uint8]  # (tiles,): whether the prices and labels that its cells need are there; empty: all are
    parked: NDArray[np.float64]  # (tiles,): least key of the cells that wait for a tile [J]
    used: NDArray[np.int64]  # (tiles,): number of settled cells when one of a tile was settled last
    shift: int  # a tile is 2 ** shift cells wide
    across: int  # tiles in a row
    thick_j: float  # how far the search goes on beyond the key of a cell that waits: about a move [J]


class Guide(NamedTuple):
    """Lower bounds of the energy still to come from a cell, of which the largest counts (see `heuristics`).

    Each of `pairs` (a, b) gives the bound a * cells to `goal` - b * surface + rest.
    """

    pairs: NDArray[np.float64]  # (B, 2): a [J per cell length] and b (share of the rise)
    rest: NDArray[np.float64]  # (B,) [J]
    goal: NDArray[np.float64]  # (2,): fractional (row, col)
    surface: NDArray[np.float64]  # (cells,): what a rise is counted on [J]
    known: NDArray[np.float64]  # (cells,): computed bounds [J], 0 elsewhere; without pairs all; empty: every one is 0


class Ring(NamedTuple):
    """A search that may go on."""

    queue: NDArray[np.uint32]  # (BUCKETS, capacity): the cells of each bucket
    sizes: NDArray[np.int64]  # (BUCKETS,): their number
    current: np.int64  # the bucket that is next
    waiting: np.int64  # cells in all buckets
    beyond: bool  # whether something may wait in the last bucket before its time
    last: np.int64  # the last state before the goal, -1 where it was not reached
    total: float  # energy to the goal [J]
    expanded: np.int64  # number of settled states
    wanted: np.int64  # the tile without which it cannot go on, -1 where it has ended


@njit(cache=True)
def empty_ring():
    """Return the ring of a search that is to begin: Ring."""
    queue, count = np.empty((BUCKETS, FIRST_CAPACITY), dtype=np.uint32), np.zeros(BUCKETS, dtype=np.int64)
    return Ring(queue, count, np.int64(0), np.int64(0), False, np.int64(-1), np.inf, np.int64(0), np.int64(-1))


@njit(cache=True)
def bound_at(guide, cell, cols):
    """Return the lower bound at a cell, and keep it [J]; infinite where it is known that the goal cannot be reached."""
    if guide.known.size == 0:
        return 0.0
    ahead = guide.known[cell]
    if ahead == 0.0 and guide.pairs.shape[0] > 0:
        ahead = guide.known[cell] = new_bound(guide, cell, cols)
    return ahead


@njit(cache=True)
def new_bound(guide, cell, cols):
    """Return the largest bound of the pairs at a cell [J], 0 where there is no pair."""
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
    """Put a cell into a bucket of the ring, whose number is not wrapped.

    Returns the ring, a wider one where it was full.
    """
    slot = bucket & (BUCKETS - 1)
    if count[slot] == queue.shape[1]:
        queue = _grown(queue, count)
    queue[slot, count[slot]] = cell
    count[slot] += 1
    return queue


@njit(cache=True)
def joined(ring, first, least, guide, terms):
    """Put cells into the ring of a search, each once.

    `first` (S,): flat indices of the cells; `least` (S,): energy with which they are reached [J]. Returns the ring, and
    `due` (S,): the bucket of every cell, NEVER for a cell from which the goal cannot be reached.
    """
    due = np.full(first.size, NEVER)
    for k in range(first.size):
        key = least[k] + bound_at(guide, first[k], terms.cols)
        if key < np.inf:
            due[k] = math.floor(key / terms.width)
    queue, count, current, waiting, beyond = ring.queue, ring.sizes, ring.current, ring.waiting, ring.beyond
    if waiting == 0 and first.size > 0:
        current = due.min()
    for k in range(first.size):
        if due[k] < NEVER:
            beyond |= due[k] >= current + BUCKETS
            due[k] = min(max(due[k], current), current + BUCKETS - 1)
            queue = put(queue, count, due[k], first[k])
            waiting += 1
    return Ring(queue, count, current, waiting, beyond, ring.last, ring.total, ring.expanded, np.int64(-1)), due


@njit(cache=True, nogil=True)
def search_cells(energy, pred, moves, tiles, aim, guide, terms, first, ring, stop):
    """Settle cells until no bucket may improve the path to a target, or all cells where there is no target.

    `energy` (cells,): labels to start from [J], they are changed; `pred` (cells,): move + 1 by which a cell was
    reached, 0 for a seed, with the flag `SETTLED` where nothing is left to do, it is changed; `first` (S,): cells to go
    on with; `ring`: an empty one, or that of before; `stop` (1,): the search ends early once this is not 0, see
    `stopping`. Returns the ring: the search has ended, or wants a tile.

    Reference: Meyer & Sanders 2003 (delta-stepping).
    """
    cells = np.uintp(energy.size)
    count_moves = moves.jump.size
    cols, width, slack, backward = terms.cols, terms.width, terms.slack, terms.backward
    steps = (-moves.jump if backward else moves.jump).astype(np.uintp)
    prices, lengths, near, near_j = moves.price.reshape(-1), moves.lengths, moves.near, moves.near_j
    metric, marked, free = lengths.size > 0, near.size > 0, guide.known.size == 0
    targets, target_rest, spent, budget = aim.targets, aim.rest, aim.spent, aim.budget
    known, shared, tiled = guide.known, aim.spent.size > 0, tiles.ready.size > 0
    ready, parked, used, shift, across = tiles.ready, tiles.parked, tiles.used, tiles.shift, tiles.across
    per_j = 1.0 / width
    for k in range(first.size):
        pred[first[k]] &= SETTLED - 1
    late = ring.waiting > 0 and first.size > 0  # some of them may have been due before the current bucket
    ring, _ = joined(ring, first, energy[first], guide, terms)
    queue, count, current, waiting, beyond = ring.queue, ring.sizes, ring.current, ring.waiting, ring.beyond
    last, total, expanded, wanted = ring.last, ring.total, ring.expanded, np.int64(-1)
    limit = min(aim.most, total + aim.margin * abs(total)) if last >= 0 else aim.most
    least_parked = parked.min() if tiled else np.inf
    while stop[0] == 0:
        ended = waiting == 0 or (current * width >= limit and not late)
        if least_parked < limit and (ended or (least_parked + tiles.thick_j <= current * width and not late)):
            wanted = np.int64(parked.argmin())
            break
        if ended:
            break
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
            if tiled:
                row = np.int64(cell) // cols
                tile = (row >> shift) * across + ((np.int64(cell) - row * cols) >> shift)
                if ready[tile] == 0:
                    parked[tile] = min(parked[tile], so_far + bound_at(guide, cell, cols))
                    least_parked = min(least_parked, parked[tile])
                    continue
                used[tile] = expanded
            pred[cell] |= SETTLED
            expanded += 1
            for t in range(targets.size):
                if targets[t] == cell and so_far + target_rest[t, 0] < total:
                    total = so_far + target_rest[t, 0]
                    last = targets[t]
                    limit = min(aim.most, total + aim.margin * abs(total))
            for n in range(count_moves):
                other = cell + steps[n]
                if other >= cells:
                    continue
                if tiled and shared and spent[other] == np.inf:  # its prices may not be there
                    continue
                step = np.float64(prices[(other if backward else cell) * np.uintp(count_moves) + np.uintp(n)])
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
                        ahead = bound_at(guide, other, cols)
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
        late = False
    return Ring(queue, count, current, waiting, beyond, last, total, expanded, wanted)
