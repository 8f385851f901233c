"""Compiled best-first search over the implicit grid: one 4-ary heap serves A*, Dijkstra and one-to-all fields."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def _bound(bounds, row, col, z, target_row, target_col, target_z, target_rest, spacing):
    """Lower bound of the energy from a cell to the goal: over bounds the best, over targets the least."""
    if target_row.size == 0:
        return -bounds[0, 1] * z
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
    move_energy, offsets, turn, layers, elevation, spacing, seeds, seed_cost, targets, target_cost, bounds
):  # fmt: skip
    """A* over states (cell, layer) with a 4-ary heap of decreasing keys; Dijkstra when `bounds` are flat.

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
        row, col = seeds[s] // cols, seeds[s] % cols
        ahead = _bound(bounds, row, col, elevation[row, col], target_row, target_col, target_z, target_rest, spacing)
        for layer in range(layers):
            state = seeds[s] * layers + layer
            energy[state] = seed_cost[s, layer]
            _sift_up(keys, nodes, place, size, energy[state] + ahead, state)
            size += 1
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
            step = move_energy[row, col, n]
            if math.isnan(step):
                continue
            reached = so_far + step
            other = cell + jump[n]
            if layers > 1:
                reached += turn[layer, n]
                other = other * layers + n
            if reached < energy[other]:
                if place[other] < 0:
                    if energy[other] < np.inf and reached > energy[other] - 1e-9 * (1.0 + abs(reached)):
                        continue  # settled before; the gain is rounding of the bounds
                    r, c = row + offsets[n, 0], col + offsets[n, 1]
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
def trace_cells(pred, offsets, last, layers, cols):
    """(n, 2) int64 cells from the first to the state `last`."""
    count = 1
    state = last
    while pred[state] > 0:
        code = pred[state] - 1
        n = code // layers
        cell = state // layers - offsets[n, 0] * cols - offsets[n, 1]
        state = cell * layers + code % layers
        count += 1
    out = np.empty((count, 2), dtype=np.int64)
    state = last
    for k in range(count - 1, -1, -1):
        out[k, 0] = (state // layers) // cols
        out[k, 1] = (state // layers) % cols
        if k > 0:
            code = pred[state] - 1
            n = code // layers
            cell = state // layers - offsets[n, 0] * cols - offsets[n, 1]
            state = cell * layers + code % layers
    return out
