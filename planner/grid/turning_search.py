"""Compiled best-first search where turning costs: states of cell and heading, on the buckets of `buckets`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from joulemap.planner.grid.buckets import BUCKETS, NEVER, Ring, joined, new_bound, put


@njit(cache=True, nogil=True)
def search_headings(energy, pred, moves, aim, guide, terms, first, ring, stop):
    """Settle states where turning costs, as `search_cells` does without turning; all tiles must be there.

    The state is cell * N + the heading of the robot, which is that of a move. `energy` (states,): labels to start from
    [J], they are changed; `pred` (states,): how a state was reached, 0 for a seed, move + 1, or N + 1 for a turn to the
    right and N + 2 for one to the left; it is changed.

    From a state the robot drives straight ahead, or turns on the spot to the next heading on either side. Turns add up,
    so these reach every heading at its own price, and one round from the cheapest heading of a cell relaxes them all.
    The buckets therefore hold cells, each with a set of headings still to be driven in.
    """
    jump, near, near_j, gap = moves.jump, moves.near, moves.near_j, moves.gap
    targets, target_rest, margin, most, spent, budget = (
        aim.targets,
        aim.rest,
        aim.margin,
        aim.most,
        aim.spent,
        aim.budget,
    )
    cols, width, slack, backward, known = terms.cols, terms.width, terms.slack, terms.backward, guide.known
    headings_of = jump.size
    cells = energy.size // headings_of
    steps = -jump if backward else jump
    prices, marked = moves.price.reshape(-1), near.size > 0
    free = known.size == 0
    due = np.full(cells, NEVER)  # the bucket in which a cell waits
    to_drive = np.zeros(cells, dtype=np.uint32)  # bit set of headings
    per_j = 1.0 / width
    least = np.array([energy[cell * headings_of : (cell + 1) * headings_of].min() for cell in first])
    ring, due_first = joined(ring, first, least, guide, terms)
    queue, count, current, waiting = ring.queue, ring.sizes, ring.current, ring.waiting
    for k in range(first.size):
        if due_first[k] < NEVER:
            to_drive[first[k]] = (1 << headings_of) - 1
            due[first[k]] = due_first[k]
    total = np.inf
    last = np.int64(-1)
    expanded = np.int64(0)
    limit = most
    shared = spent.size > 0
    while waiting > 0 and current * width < limit and stop[0] == 0:
        here = current % BUCKETS
        q = 0
        while q < count[here]:
            cell = np.int64(queue[here, q])
            q += 1
            if due[cell] != current:
                continue
            base = cell * headings_of
            headings = to_drive[cell] | _turn(energy, pred, base, gap)
            for t in range(targets.size):
                if targets[t] == cell:
                    for n in range(headings_of):
                        if energy[base + n] + target_rest[t, n] < total:
                            total = energy[base + n] + target_rest[t, n]
                            last = base + n
                            limit = min(most, total + margin * abs(total))
            top = (current + 1) * width - new_bound(guide, cell, cols)
            later = np.inf
            left = headings
            for n in range(headings_of):
                bit = np.uint32(1) << np.uint32(n)
                if headings & bit == 0:
                    continue
                so_far = energy[base + n]
                if so_far >= top:
                    later = min(later, so_far)
                    continue
                left &= ~bit
                expanded += 1
                other = cell + steps[n]
                if other < 0 or other >= cells:
                    continue
                leaves = other if backward else cell
                reached = so_far + prices[leaves * headings_of + n]
                if marked and near[leaves] & bit:
                    reached += near_j[n]
                state = other * headings_of + n
                if not reached + slack * (1.0 + abs(reached)) < energy[state]:
                    continue
                if shared and reached + spent[other] > budget:
                    continue
                ahead = 0.0
                if not free:
                    ahead = known[other]
                    if ahead == 0.0:
                        ahead = known[other] = new_bound(guide, other, cols)
                if ahead == np.inf:
                    continue
                energy[state] = reached
                pred[state] = n + 1
                to_drive[other] |= bit
                at = min(max(math.floor((reached + ahead) * per_j), current), current + BUCKETS - 1)
                if at < due[other]:
                    due[other] = at
                    queue = put(queue, count, at, other)
                    waiting += 1
            to_drive[cell] = left
            due[cell] = NEVER
            if left != 0:
                at = math.floor((later - top) * per_j) + current + 1
                due[cell] = min(max(at, current + 1), current + BUCKETS - 1)
                queue = put(queue, count, due[cell], cell)
                waiting += 1
        waiting -= count[here]
        count[here] = 0
        current += 1
    return Ring(queue, count, current, waiting, False, last, total, expanded, np.int64(-1))


@njit(cache=True)
def _turn(energy, pred, base, gap):
    """Relax all turns on the spot of one cell; the bit set of headings that became cheaper."""
    moves = gap.size
    cheaper = np.uint32(0)
    best = 0
    for n in range(1, moves):
        if energy[base + n] < energy[base + best]:
            best = n
    for code, step in ((moves + 1, 1), (moves + 2, -1)):
        k = best
        for _ in range(moves - 1):
            to = k + step
            to += moves if to < 0 else -moves if to == moves else 0
            reached = energy[base + k] + gap[k if step > 0 else to]
            if reached < energy[base + to]:
                energy[base + to] = reached
                pred[base + to] = code
                cheaper |= np.uint32(1) << np.uint32(to)
            k = to
    return cheaper
