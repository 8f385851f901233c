"""Compiled best-first search where turning costs: states of cell and heading, on the buckets of `buckets`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from joulemap.planner.grid.buckets import BUCKETS, NEVER, bound_at, open_ring, put

SEED, DROVE, TURNED_RIGHT, TURNED_LEFT = 0, 1, 2, 3
"""How a state of `search_headings` was reached."""


@njit(cache=True, nogil=True)
def search_headings(
    energy,
    pred,
    price,
    jump,
    near,
    near_j,
    gap,
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
    """Settle states where turning costs, as `search_cells` does without turning.

    The state is cell * N + the heading of the robot, which is that of a move.

    `energy` (states,): labels to start from [J], they are changed; `pred` (states,): `SEED`, `DROVE`, `TURNED_RIGHT` or
    `TURNED_LEFT`, it is changed; `price` (cells, N): energy of the move that leaves a cell [J], NaN where there is
    none; `jump` (N,): step of each move in flat indices; `near` (cells,): bit n is set where move n leaves the cell
    within the margin, empty for no margin, see `MoveTable`; `near_j` (N,): what such a move costs more [J]; `gap` (N,):
    energy of turning from heading k to k + 1 [J]; `first` (S,): cells to begin with; `targets` (T,): cells that are
    joined to the goal; `target_rest` (T, N): energy from them to the goal by heading [J]; `known` (cells,): zeros,
    bounds that were computed stand here; `width`: width of a bucket [J]; `slack`: relative gain below which a label
    stays, above 0 where prices may be negative; `most`: energy beyond which nothing is settled [J]; `spent` (cells,):
    energy that a path through a cell needs beside the one that is searched for [J], empty for none; `budget`: where
    both together exceed it [J], the cell is left alone; `stop` (1,): the search ends early once this is not 0, see
    `stopping`. Returns `last`: the last state, -1 where the goal was not reached; `total`: energy to the goal [J];
    `expanded`: number of settled states.

    From a state the robot drives straight ahead, or turns on the spot to the next heading on either side. Turns add up,
    so these reach every heading at its own price, and one round from the cheapest heading of a cell relaxes them all.
    The buckets therefore hold cells, each with a set of headings still to be driven in.
    """
    moves = jump.size
    cells = energy.size // moves
    steps = -jump if backward else jump
    prices, marked = price.reshape(-1), near.size > 0
    free = guide.pairs.shape[0] == 0
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
            base = cell * moves
            headings = to_drive[cell] | _turn(energy, pred, base, gap)
            for t in range(targets.size):
                if targets[t] == cell:
                    for n in range(moves):
                        if energy[base + n] + target_rest[t, n] < total:
                            total = energy[base + n] + target_rest[t, n]
                            last = base + n
                            limit = min(most, total + margin * abs(total))
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
                leaves = other if backward else cell
                reached = so_far + prices[leaves * moves + n]
                if marked and near[leaves] & bit:
                    reached += near_j[n]
                state = other * moves + n
                if not reached + slack * (1.0 + abs(reached)) < energy[state]:
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
    """Return the states that lead from one state to the seed that it was reached from.

    `pred` (states,): as `search_headings` left it; `jump` (N,): step of each move in flat indices. The result is (n,).
    """
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
    """Return the state that one was reached from. `jump` (N,): step of each move in flat indices."""
    moves = jump.size
    heading = state % moves
    if code == DROVE:
        return state + (jump[heading] if backward else -jump[heading]) * moves
    other = heading - 1 if code == TURNED_RIGHT else heading + 1
    return state - heading + (other + moves) % moves
