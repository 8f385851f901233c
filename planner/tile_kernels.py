"""Compiled best-first search over tiles of cells, which stops whenever a tile must be read first.

As `buckets.search_cells`, with three differences. Cells are numbered tile by tile, so that the labels of a tile lie
together and only tiles that the search reaches take memory. The prices of a tile are in a slot, and a tile without one
interrupts the search. The buckets are chains of pages, so that their memory is that of the waiting cells.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

BUCKETS = 512
PAGE = 256
SETTLED = 128
DONE, LOAD, OPEN, GROW, PAUSE = 0, 1, 2, 3, 4
"""Why `advance` returned: the search has ended; a tile needs prices, or labels; more pages; a moment for others."""
CURRENT, WAITING, FREE, FREE_COUNT, EXPANDED, LAST, CLOCK = 0, 1, 2, 3, 4, 5, 6
"""Places in the integer state: bucket, entries that wait, first free page, free pages, settled cells, last cell before
the goal, settled cells when prices were used last."""
_MOST_PAGES_A_STEP = 40


@njit(cache=True)
def put(pages, following, ends, state, bucket, cell):
    """Append a cell to a bucket.

    Parameters
    ----------
    pages : ndarray of uint32, (P, PAGE)
        The pages.
    following : ndarray of int32, (P,)
        The next page of each chain, or of the free ones; -1 at the end.
    ends : ndarray of int32, (BUCKETS, 4)
        Of each bucket: first page, place in it, last page, entries of that.
    state : ndarray of int64
        The integer state; it is changed.
    bucket : int
        Number of the bucket, not wrapped.
    cell : int
        Number of the cell.
    """
    slot = bucket & (BUCKETS - 1)
    if ends[slot, 0] < 0 or ends[slot, 3] == PAGE:
        page = state[FREE]
        state[FREE] = following[page]
        state[FREE_COUNT] -= 1
        following[page] = -1
        if ends[slot, 0] < 0:
            ends[slot, 0] = page
            ends[slot, 1] = 0
        else:
            following[ends[slot, 2]] = page
        ends[slot, 2] = page
        ends[slot, 3] = 0
    pages[ends[slot, 2], ends[slot, 3]] = cell
    ends[slot, 3] += 1
    state[WAITING] += 1


@njit(cache=True)
def _drop(following, ends, state, slot):
    """Take the first entry out of a bucket."""
    ends[slot, 1] += 1
    state[WAITING] -= 1
    page = ends[slot, 0]
    if ends[slot, 1] == (ends[slot, 3] if page == ends[slot, 2] else PAGE):
        ends[slot, 0] = following[page]
        ends[slot, 1] = 0
        following[page] = state[FREE]
        state[FREE] = page
        state[FREE_COUNT] += 1


@njit(cache=True, nogil=True)
def advance(
    energy,
    ahead,
    pred,
    slot_of,
    opened,
    used,
    prices,
    shift,
    tile_cols,
    offsets,
    pages,
    following,
    ends,
    state,
    total,
    targets,
    rest,
    width,
    steps,
):
    """Go on with a search until it ends or needs something.

    Parameters
    ----------
    energy : ndarray of float64, (cells,)
        Labels [J], tile by tile.
    ahead : ndarray of float32, (cells,)
        Lower bounds of the energy to the goal [J].
    pred : ndarray of uint8, (cells,)
        Move + 1 by which a cell was reached, 0 for a seed, with the flag `SETTLED`.
    slot_of : ndarray of int32, (tiles,)
        Where the prices of a tile are; -1 where they are not there.
    opened : ndarray of bool, (tiles,)
        Whether labels and bounds of a tile are there.
    used : ndarray of int64, (tiles,)
        When the prices of a tile were used last; it is changed.
    prices : ndarray of float32, (slots, cells of a tile, N)
        Energy of the move that leaves a cell [J]; NaN where there is none.
    shift : int
        A tile is 2 ** shift cells wide.
    tile_cols : int
        Tiles along a row of tiles.
    offsets : ndarray of int64, (N, 2)
        (drow, dcol) of each move.
    pages, following, ends
        The buckets, see `put`.
    state : ndarray of int64, (7,)
        The integer state.
    total : ndarray of float64, (1,)
        Energy to the goal [J]; it is changed.
    targets : ndarray of int64, (T,)
        Cells that are joined to the goal.
    rest : ndarray of float64, (T,)
        Energy from them to the goal [J].
    width : float
        Width of a bucket [J].
    steps : int
        Cells after which it pauses.

    Returns
    -------
    code : int
        `DONE`, `LOAD`, `OPEN`, `GROW` or `PAUSE`.
    tile : int
        The tile that is needed.
    """
    side = 1 << shift
    mask = side - 1
    moves = offsets.shape[0]
    reach = 0
    for n in range(moves):
        reach = max(reach, abs(offsets[n, 0]), abs(offsets[n, 1]))
    jump = offsets[:, 0] * side + offsets[:, 1]
    tiles = slot_of.size
    per_j = 1.0 / width
    until = state[EXPANDED] + steps
    while state[WAITING] > 0:
        current = state[CURRENT]
        if total[0] <= current * width:
            return DONE, -1
        slot = current & (BUCKETS - 1)
        if ends[slot, 0] < 0:
            state[CURRENT] += 1
            continue
        if state[FREE_COUNT] < _MOST_PAGES_A_STEP:
            return GROW, -1
        cell = np.int64(pages[ends[slot, 0], ends[slot, 1]])
        if pred[cell] >= SETTLED:
            _drop(following, ends, state, slot)
            continue
        so_far = energy[cell]
        due = math.floor((so_far + ahead[cell]) * per_j)
        if due > current:
            _drop(following, ends, state, slot)
            put(pages, following, ends, state, min(due, current + BUCKETS - 1), cell)
            continue
        tile = cell >> (2 * shift)
        if slot_of[tile] < 0:
            return LOAD, tile
        row, col = (cell >> shift) & mask, cell & mask
        inside = reach <= row < side - reach and reach <= col < side - reach
        if not inside:
            for corner in range(4):
                r = row + (reach if corner & 1 else -reach)
                c = col + (reach if corner & 2 else -reach)
                beside = tile % tile_cols + (c >> shift)
                other = tile + (r >> shift) * tile_cols + (c >> shift)
                if 0 <= beside < tile_cols and 0 <= other < tiles and not opened[other]:
                    return OPEN, other
        if state[EXPANDED] >= until:
            return PAUSE, -1
        _drop(following, ends, state, slot)
        pred[cell] |= SETTLED
        state[EXPANDED] += 1
        used[tile] = state[EXPANDED]
        for t in range(targets.size):
            if targets[t] == cell and so_far + rest[t] < total[0]:
                total[0] = so_far + rest[t]
                state[LAST] = cell
        price = prices[slot_of[tile], cell & ((1 << (2 * shift)) - 1)]
        for n in range(moves):
            reached = so_far + price[n]
            if math.isnan(reached):
                continue
            if inside:
                other = cell + jump[n]
            else:
                r, c = row + offsets[n, 0], col + offsets[n, 1]
                beside = tile + (r >> shift) * tile_cols + (c >> shift)
                other = (beside << (2 * shift)) | ((r & mask) << shift) | (c & mask)
            before = energy[other]
            if not reached + 1e-12 * abs(reached) < before:
                continue
            due = max(math.floor((reached + ahead[other]) * per_j), current)
            queued = pred[other] < SETTLED and before < np.inf
            energy[other] = reached
            pred[other] = n + 1
            if queued and max(math.floor((before + ahead[other]) * per_j), current) == due:
                continue
            put(pages, following, ends, state, min(due, current + BUCKETS - 1), other)
    return DONE, -1


@njit(cache=True, nogil=True)
def traced(pred, last, shift, tile_cols, offsets):
    """Return the cells that lead from one cell to the seed that it was reached from.

    Parameters
    ----------
    pred : ndarray of uint8, (cells,)
        As `advance` left it.
    last : int
        The cell to begin with.
    shift, tile_cols : int
        As for `advance`.
    offsets : ndarray of int64, (N, 2)
        (drow, dcol) of each move.

    Returns
    -------
    ndarray of int64, (n, 2)
        (row, col), `last` first.
    """
    mask = (1 << shift) - 1
    tile = last >> (2 * shift)
    row = ((tile // tile_cols) << shift) + ((last >> shift) & mask)
    col = ((tile % tile_cols) << shift) + (last & mask)
    out = [(row, col)]
    cell = last
    while pred[cell] & (SETTLED - 1) > 0:
        move = (pred[cell] & (SETTLED - 1)) - 1
        row -= offsets[move, 0]
        col -= offsets[move, 1]
        cell = (((row >> shift) * tile_cols + (col >> shift)) << (2 * shift)) | ((row & mask) << shift) | (col & mask)
        out.append((row, col))
    found = np.empty((len(out), 2), dtype=np.int64)
    for k in range(len(out)):
        found[k, 0], found[k, 1] = out[k]
    return found
