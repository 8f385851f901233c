"""Compiled best-first search where turning costs: states of cell and heading, on the buckets of `buckets`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from joulemap.planner.buckets import BUCKETS, NEVER, bound_at, open_ring, put

SEED, DROVE, TURNED_RIGHT, TURNED_LEFT = 0, 1, 2, 3
"""How a state of `search_headings` came by its energy."""


@njit(cache=True, nogil=True)
def search_headings(energy, pred, price, jump, gap, first, targets, target_rest, guide, cols, width, slack, backward):
    """`search_cells` where turning costs: the state is cell * N + the heading (a move's) that the robot looks in.

    A state has three ways on: the move straight ahead, and a turn on the spot to the next heading on either side. Turns
    add up, so these reach every heading at its own price, and one round from the cheapest heading of a cell relaxes
    them all. The buckets therefore hold cells, each with a set of headings still to be driven in.

    energy : (states,) float64 [J]; pred : (states,) uint8 `SEED`, `DROVE`, `TURNED_RIGHT` or `TURNED_LEFT`;
    gap : (N,) [J] of turning from heading k to k + 1; first : (S,) cells; target_rest : (T, N) [J]. The rest, and what
    comes back, as there, with a state for the last cell.
    """
    moves = jump.size
    cells = energy.size // moves
    steps = -jump if backward else jump
    prices = price.reshape(-1)
    free = guide.pairs.shape[0] + guide.marks.shape[1] == 0
    known = np.full(1 if free else cells, np.nan)
    due = np.full(cells, NEVER)  # the bucket in which a cell waits
    to_drive = np.zeros(cells, dtype=np.uint32)  # bit set of headings
    per_j = 1.0 / width
    least = np.array([energy[cell * moves : (cell + 1) * moves].min() for cell in first])
    queue, count, current, due_first = open_ring(first, least, guide, cols, per_j)
    for k in range(first.size):
        if due_first[k] < NEVER:
            to_drive[first[k]] = (1 << moves) - 1
            due[first[k]] = min(due_first[k], current + BUCKETS - 1)
    waiting = count.sum()
    total = np.inf
    last = -1
    expanded = 0
    while waiting > 0 and current * width < total:
        here = current % BUCKETS
        q = 0
        while q < count[here]:
            cell = np.int64(queue[here, q])
            q += 1
            if due[cell] != current:
                continue
            base = cell * moves
            headings = to_drive[cell] | _turn(energy, pred, base, gap)
            for t in range(targets.size):
                if targets[t] == cell:
                    for n in range(moves):
                        if energy[base + n] + target_rest[t, n] < total:
                            total = energy[base + n] + target_rest[t, n]
                            last = base + n
            top = (current + 1) * width - (0.0 if free else bound_at(guide, cell, cols))
            later = np.inf
            left = headings
            for n in range(moves):
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
                reached = so_far + prices[(other if backward else cell) * moves + n]
                state = other * moves + n
                if not reached + slack * (1.0 + abs(reached)) < energy[state]:
                    continue
                ahead = 0.0
                if not free:
                    ahead = known[other]
                    if math.isnan(ahead):
                        ahead = known[other] = bound_at(guide, other, cols)
                if ahead == np.inf:
                    continue
                energy[state] = reached
                pred[state] = DROVE
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
    return last, total, expanded


@njit(cache=True)
def _turn(energy, pred, base, gap):
    """Relax all turns on the spot of one cell; the bit set of headings that became cheaper."""
    moves = gap.size
    cheaper = np.uint32(0)
    best = 0
    for n in range(1, moves):
        if energy[base + n] < energy[base + best]:
            best = n
    for code, step in ((TURNED_RIGHT, 1), (TURNED_LEFT, -1)):
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


@njit(cache=True, nogil=True)
def trace_headings(pred, jump, last, backward):
    """(n,) int64 states that lead from `last` to the seed it was reached from, `last` first."""
    count = 1
    state = last
    while pred[state] != SEED:
        state = state_before(pred[state], state, jump, backward)
        count += 1
    out = np.empty(count, dtype=np.int64)
    out[0] = last
    for k in range(1, count):
        out[k] = state_before(pred[out[k - 1]], out[k - 1], jump, backward)
    return out


@njit(cache=True)
def state_before(code, state, jump, backward):
    """The state that this one was reached from."""
    moves = jump.size
    heading = state % moves
    if code == DROVE:
        return state + (jump[heading] if backward else -jump[heading]) * moves
    other = heading - 1 if code == TURNED_RIGHT else heading + 1
    return state - heading + (other + moves) % moves
