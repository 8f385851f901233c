"""Compiled best-first search over tiles of cells: one tile at a time, as long as its cells are about as good as any.

Cells are numbered tile by tile, so that the labels of a tile lie together and stay in the processor's cache while it is
worked on, and only tiles that the search reaches take memory. A tile is settled up to a little above the least key of
all waiting cells (label + bound), in order of the keys; what improves in its neighbours waits there. A cell that is
improved after it was settled is settled again, so the answer is exact for any order (delta-stepping on tiles: Meyer &
Sanders 2003), and the least key of all that waits is a proven bound.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

WAITS = 128
"""Flag in `pred` of cells that are still to be settled."""
FINE = 64
"""Steps in which the keys of a tile are put in order while it is worked on."""
DONE, LOAD, OPEN, PAUSE = 0, 1, 2, 3
"""Why `advance` returned: the search has ended; a tile needs prices, or labels; a moment for others."""
EXPANDED, LAST = 0, 1
"""Places in the integer state: settled cells, last cell before the goal."""
TOTAL, PROVEN = 0, 1
"""Places in the state of energies [J]: energy to the goal, and what no path costs less than."""


@njit(cache=True, nogil=True)
def advance(
    energy,
    ahead,
    pred,
    least,
    slot_of,
    opened,
    used,
    prices,
    shift,
    tile_cols,
    offsets,
    state,
    energies,
    targets,
    rest,
    thickness,
    steps,
):
    """Go on with a search until it ends or needs something.

    `energy` (cells,): labels [J], tile by tile; `ahead` (cells,): lower bounds of the energy to the goal [J]; `pred`
    (cells,); `least` (tiles,): least key of the waiting cells of each tile [J], it is changed; `slot_of` (tiles,):
    where the prices of a tile are, -1 where they are not there; `opened` (tiles,): whether labels and bounds of a tile
    are there; `used` (tiles,): when the prices of a tile were used last, it is changed; `prices` (slots, cells of a
    tile, N): energy of the move that leaves a cell [J], NaN where there is none; `offsets` (N, 2): (drow, dcol) of each
    move; `state` (2,): the integer state; `energies` (2,): the state of energies; `targets` (T,): cells that are joined
    to the goal; `rest` (T,): energy from them to the goal [J]; `thickness`: how far above the least key a tile is
    settled [J]. Returns `code`: `DONE`, `LOAD`, `OPEN` or `PAUSE`; `tile`: the tile that is needed.
    """
    side = 1 << shift
    cells = side * side
    after = np.empty(cells, dtype=np.int32)  # chains of waiting cells, by key: the next one and the one before
    before = np.empty(cells, dtype=np.int32)
    chain = np.full(cells, -1, dtype=np.int16)  # in which chain a cell is
    heads = np.full(FINE, -1, dtype=np.int32)
    jump = offsets[:, 0] * side + offsets[:, 1]
    reach = np.abs(offsets).max()
    until = state[EXPANDED] + steps
    while True:
        tile = int(np.argmin(least))
        low = least[tile]
        energies[PROVEN] = min(low, energies[TOTAL])
        if not low < energies[TOTAL]:
            return DONE, -1
        if slot_of[tile] < 0:
            return LOAD, tile
        for corner in range(9):
            col = tile % tile_cols + corner % 3 - 1
            other = tile + (corner // 3 - 1) * tile_cols + corner % 3 - 1
            if 0 <= col < tile_cols and 0 <= other < least.size and not opened[other]:
                return OPEN, other
        if state[EXPANDED] >= until:
            return PAUSE, -1
        used[tile] = state[EXPANDED]
        _settle(
            energy, ahead, pred, least, prices[slot_of[tile]], tile, shift, tile_cols, offsets, jump, reach, state,
            energies, targets, rest, low, thickness, after, before, chain, heads,
        )  # fmt: skip


@njit(cache=True, nogil=True)
def _settle(
    energy,
    ahead,
    pred,
    least,
    price,
    tile,
    shift,
    tile_cols,
    offsets,
    jump,
    reach,
    state,
    energies,
    targets,
    rest,
    low,
    thickness,
    after,
    before,
    chain,
    heads,
):
    """Settle the cells of one tile whose keys lie below `low` + `thickness`."""
    side = 1 << shift
    mask = side - 1
    base = tile << (2 * shift)
    cells = side * side
    moves = offsets.shape[0]
    per_j = FINE / thickness
    first = FINE
    for cell in range(cells):
        if pred[base + cell] >= WAITS:
            place = (energy[base + cell] + ahead[base + cell] - low) * per_j
            if place < FINE:
                k = int(place) if place > 0.0 else 0
                _link(after, before, chain, heads, cell, k)
                first = min(first, k)
    k = first
    while k < FINE:
        cell = heads[k]
        if cell < 0:
            k += 1
            continue
        _unlink(after, before, chain, heads, cell)
        here = base + cell
        pred[here] &= WAITS - 1
        state[EXPANDED] += 1
        so_far = energy[here]
        for t in range(targets.size):
            if targets[t] == here and so_far + rest[t] < energies[TOTAL]:
                energies[TOTAL] = so_far + rest[t]
                state[LAST] = here
        row, col = cell >> shift, cell & mask
        inside = reach <= row < side - reach and reach <= col < side - reach
        for n in range(moves):
            reached = so_far + price[cell, n]
            if inside:
                other = here + jump[n]
            else:
                if math.isnan(reached):
                    continue
                r, c = row + offsets[n, 0], col + offsets[n, 1]
                beside = tile + (r >> shift) * tile_cols + (c >> shift)
                other = (beside << (2 * shift)) | ((r & mask) << shift) | (c & mask)
            if not reached + 1e-12 * abs(reached) < energy[other]:  # nor where there is no such move
                continue
            energy[other] = reached
            key = reached + ahead[other]
            if key == np.inf:
                pred[other] = n + 1
                continue
            pred[other] = (n + 1) | WAITS
            if other >> (2 * shift) != tile:
                least[other >> (2 * shift)] = min(least[other >> (2 * shift)], key)
                continue
            place = (key - low) * per_j
            own = other - base
            if place < FINE:
                into = max(np.int64(place), k)
                if chain[own] != into:
                    if chain[own] >= 0:
                        _unlink(after, before, chain, heads, own)
                    _link(after, before, chain, heads, own, into)
    lowest = np.inf
    for cell in range(cells):
        if pred[base + cell] >= WAITS:
            lowest = min(lowest, energy[base + cell] + ahead[base + cell])
    least[tile] = lowest


@njit(cache=True, inline="always")
def _link(after, before, chain, heads, cell, k):
    """Put a cell at the head of chain k."""
    head = heads[k]
    after[cell] = head
    before[cell] = -1
    if head >= 0:
        before[head] = cell
    heads[k] = cell
    chain[cell] = k


@njit(cache=True, inline="always")
def _unlink(after, before, chain, heads, cell):
    """Take a cell out of its chain."""
    if before[cell] >= 0:
        after[before[cell]] = after[cell]
    else:
        heads[chain[cell]] = after[cell]
    if after[cell] >= 0:
        before[after[cell]] = before[cell]
    chain[cell] = -1


@njit(cache=True, nogil=True)
def traced(pred, last, shift, tile_cols, offsets):
    """Return the cells that lead from one cell to the seed that it was reached from.

    `pred` (cells,): as `advance` left it; `offsets` (N, 2): (drow, dcol) of each move. Result (n, 2): (row, col),
    `last` first.
    """
    mask = (1 << shift) - 1
    tile = last >> (2 * shift)
    row = ((tile // tile_cols) << shift) + ((last >> shift) & mask)
    col = ((tile % tile_cols) << shift) + (last & mask)
    out = [(row, col)]
    cell = last
    while pred[cell] & (WAITS - 1) > 0:
        move = np.int64(pred[cell] & (WAITS - 1)) - 1
        row -= offsets[move, 0]
        col -= offsets[move, 1]
        cell = (((row >> shift) * tile_cols + (col >> shift)) << (2 * shift)) | ((row & mask) << shift) | (col & mask)
        out.append((row, col))
    found = np.empty((len(out), 2), dtype=np.int64)
    for k in range(len(out)):
        found[k, 0], found[k, 1] = out[k]
    return found
