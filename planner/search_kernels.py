"""Compiled best-first search over the implicit grid: one 4-ary heap serves A*, Dijkstra and one-to-all fields."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def _bound(bounds, row, col, z, target_row, target_col, target_z, target_rest, spacing):
    """Lower bound of the energy from a cell to the goal: over bounds the best, over targets the least."""
    if target_row.size == 0:
        return -bounds[0, 1] * z  # a potential only; the caller turns its sign for a backward field
    least = np.inf
    for k in range(target_row.size):
        distance = math.hypot(target_row[k] - row, target_col[k] - col) * spacing
        best = -np.inf
        for b in range(bounds.shape[0]):
            best = max(best, bounds[b, 0] * distance + bounds[b, 1] * (target_z[k] - z))
        least = min(least, best + target_rest[k])
    return least


@njit(cache=True)
def _sift_up(keys, nodes, place, k, key, node):
    """Put (key, node) where slot k, or an ancestor of it, is. Keys lie beside each other: children share a line."""
    while k > 0:
        parent = (k - 1) >> 2
        if keys[parent] <= key:
            break
        keys[k] = keys[parent]
        nodes[k] = nodes[parent]
        place[nodes[k]] = k
        k = parent
    keys[k] = key
    nodes[k] = node
    place[node] = k


@njit(cache=True)
def _sift_down(keys, nodes, place, size, key, node):
    """Put (key, node) where the root, or a descendant of it, is."""
    k = 0
    while True:
        child = 4 * k + 1
        if child >= size:
            break
        best = child
        for c in range(child + 1, min(child + 4, size)):
            if keys[c] < keys[best]:
                best = c
        if keys[best] >= key:
            break
        keys[k] = keys[best]
        nodes[k] = nodes[best]
        place[nodes[k]] = k
        k = best
    keys[k] = key
    nodes[k] = node
    place[node] = k


@njit(cache=True, nogil=True)
def search_states(
    move_energy, offsets, turn, layers, elevation, spacing, seeds, seed_cost, targets, target_cost, bounds, backward
):  # fmt: skip
    """A* over states (cell, layer) with a 4-ary heap of decreasing keys; Dijkstra when `bounds` are flat.

    Forward, the layer is the heading of arrival; backward, moves are run against their direction (each at its own
    price), energies count towards the seeds, and the layer is the heading in which a cell is left. seeds : (S,) states;
    seed_cost : (S,) [J]; targets : (T,) cells; target_cost : (T, layers) [J].

    Returns energy (states,), pred (states,) uint16 of move * layers + predecessor layer + 1 (0: a seed), the last state
    (-1: not reached), the energy to the goal, and the number of settled states.
    """
    rows, cols, moves = move_energy.shape
    states = rows * cols * layers
    energy = np.full(states, np.inf)
    pred = np.zeros(states, dtype=np.uint16)
    place = np.full(states, -1, dtype=np.int32)
    keys = np.empty(states)
    nodes = np.empty(states, dtype=np.int32)
    sign = -1 if backward else 1
    jump = offsets[:, 0] * cols + offsets[:, 1]
    target_row = np.empty(targets.size)
    target_col = np.empty(targets.size)
    target_z = np.empty(targets.size)
    target_rest = np.empty(targets.size)
    is_target = np.full(rows * cols, -1, dtype=np.int8)
    for k in range(targets.size):
        target_row[k] = targets[k] // cols
        target_col[k] = targets[k] % cols
        target_z[k] = elevation[targets[k] // cols, targets[k] % cols]
        target_rest[k] = target_cost[k].min()
        is_target[targets[k]] = k
    size = 0
    for s in range(seeds.size):
        state = seeds[s]
        row, col = state // layers // cols, state // layers % cols
        ahead = _bound(bounds, row, col, elevation[row, col], target_row, target_col, target_z, target_rest, spacing)
        if seed_cost[s] < energy[state]:
            slot = size if place[state] < 0 else place[state]
            size += 1 if slot == size else 0
            energy[state] = seed_cost[s]
            _sift_up(keys, nodes, place, slot, energy[state] + ahead, state)
    total = np.inf
    last = -1
    expanded = 0
    while size > 0:
        state = nodes[0]
        if keys[0] >= total:
            break
        size -= 1
        if size > 0:
            _sift_down(keys, nodes, place, size, keys[size], nodes[size])
        place[state] = -1
        expanded += 1
        layer = state % layers
        cell = state // layers
        goal = is_target[cell]
        if goal >= 0 and energy[state] + target_cost[goal, layer] < total:
            total = energy[state] + target_cost[goal, layer]
            last = state
        row, col = cell // cols, cell % cols
        so_far = energy[state]
        for n in range(moves):
            if backward:
                r, c = row - offsets[n, 0], col - offsets[n, 1]
                if not (0 <= r < rows and 0 <= c < cols):
                    continue
                step = move_energy[r, c, n]
            else:
                step = move_energy[row, col, n]
            if math.isnan(step):
                continue
            reached = so_far + step
            other = cell + sign * jump[n]
            if layers > 1:
                reached += turn[layer, n]
                other = other * layers + n
            if reached < energy[other]:
                if place[other] < 0:
                    if energy[other] < np.inf and reached > energy[other] - 1e-9 * (1.0 + abs(reached)):
                        continue  # settled before; the gain is rounding of the bounds
                    r, c = row + sign * offsets[n, 0], col + sign * offsets[n, 1]
                    ahead = _bound(
                        bounds, r, c, elevation[r, c], target_row, target_col, target_z, target_rest, spacing
                    )
                    _sift_up(keys, nodes, place, size, reached + ahead, other)
                    size += 1
                else:
                    slot = place[other]
                    _sift_up(keys, nodes, place, slot, keys[slot] + (reached - energy[other]), other)
                energy[other] = reached
                pred[other] = n * layers + layer + 1
    return energy, pred, last, total, expanded


@njit(cache=True, nogil=True)
def trace_states(pred, offsets, last, layers, cols, backward):
    """(n,) int64 states that lead from `last` to the seed it was reached from, `last` first."""
    count = 1
    state = last
    while pred[state] > 0:
        state = _previous(pred[state] - 1, state, offsets, layers, cols, backward)
        count += 1
    out = np.empty(count, dtype=np.int64)
    state = last
    for k in range(count):
        out[k] = state
        if k < count - 1:
            state = _previous(pred[state] - 1, state, offsets, layers, cols, backward)
    return out


@njit(cache=True)
def _previous(code, state, offsets, layers, cols, backward):
    """The state that this one was reached from."""
    n = code // layers
    jump = offsets[n, 0] * cols + offsets[n, 1]
    return (state // layers + (jump if backward else -jump)) * layers + code % layers
