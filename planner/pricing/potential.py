"""A surface whose rise explains as much of the prices as one surface can: heuristics and negative prices use it.

Robot weight times elevation explains the climbs except for noise: a price comes from the slope of a square metre, a
rise from two heights. Taken as it is, the noisiest move of the map would set the bound for all. The surface need not be
the ground, so it is first averaged towards the prices there and back, then lowered in places until every move costs at
least its rise and some `a` per metre on top. How large `a` may be is set by the cheapest loop of the map, around which
every rise cancels (Bellman-Ford; Johnson 1977).
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import NegativeCycleError
from joulemap.model.threads import pieces, share_out

SWEEPS = 5
"""Averages over the eight nearest neighbours: they remove noise, which is all that has to go."""
HALVINGS = 5
"""How often, at most, the span that the largest `a` may lie in is halved."""
CLOSE = 0.02
"""The span, as a share of its upper end, at which halving ends: a further try costs more than it gains."""
EFFORT = 0.5
"""Visits of cells that one try may take, as a share of all cells; where a loop forbids it they never end."""
CELLS_A_PART = 50_000
"""Cells that are worth a thread."""
ROUNDING_J = 1e-9
"""What a move may cost less than its rise: it would be rounding."""


def even_surface(
    energy: NDArray[np.float32], offsets: NDArray[np.int64], length_m: NDArray[np.float64], surface: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return a smoothed surface, so that every move costs as much as possible beyond its rise.

    `energy` (rows, cols, N): energy of every move [J], NaN where there is none; `offsets` (N, 2): (drow, dcol) of the
    moves, clockwise over the whole circle; `length_m` (N,): their lengths [m]; `surface` (rows, cols): the surface to
    begin with [J]. Result (rows, cols): the surface [J]. Where some prices are negative, no move costs less than its
    rise on it.

    Reference: Johnson 1977; Cherkassky & Goldberg 1999 (negative cycles).
    """
    surface = levelled(energy, offsets, surface)
    least = spare_per_m(energy, offsets, length_m, surface)
    if least.min() < 0.0:
        lower = surface.copy()
        endless = np.nanmin(energy) < 0.0
        place = _lower(energy, offsets, length_m, lower, least, 0.0, math.inf if endless else EFFORT * least.size)
        if place >= 0 and endless:
            row, col = divmod(place, energy.shape[1])
            raise NegativeCycleError(
                f"regeneration returns more than driving costs: a loop through row {row}, column {col} would fill the "
                "battery, so the energy to get anywhere has no least; lower the robot's `regeneration`",
                row=row,
                col=col,
            )
        if place >= 0:
            return surface
        surface, least = lower, spare_per_m(energy, offsets, length_m, lower)
    if not np.isfinite(least).any():
        return surface
    base, low, high = surface, float(least.min()), float(np.median(least[np.isfinite(least)]))
    for _ in range(HALVINGS):
        if high - low <= CLOSE * high:
            break
        aim = 0.5 * (low + high)
        lower = base.copy()
        if _lower(energy, offsets, length_m, lower, least, aim, EFFORT * least.size) < 0:
            low, surface = aim, lower
        else:
            high = aim
    return surface


def parts_of(rows: int, cols: int) -> list[slice]:
    """Return rows in parts that are worth a thread each."""
    return pieces(rows, max(CELLS_A_PART // max(cols, 1), 1))


def levelled(
    energy: NDArray[np.float32], offsets: NDArray[np.int64], surface: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return a surface after some sweeps, each of which puts every cell where its neighbours and the prices put it.

    `energy` (rows, cols, N), `offsets` (N, 2), `surface` (rows, cols): as of `even_surface`.
    """
    rows, cols, moves = energy.shape
    ways = min(moves // 2, 4)  # as many have their way back among the others
    steps = offsets[:: max(moves // 8, 1)][:ways]  # of more than eight moves, those between the eight say little new
    rises = np.empty((rows, cols, ways), np.float32)
    share_out(lambda p: _rise_rows(energy, offsets, p.start, p.stop, rises), parts_of(rows, cols))
    for _ in range(SWEEPS):
        before, surface = surface, np.empty_like(surface)
        share_out(partial(_level_rows, rises, steps, before, surface), parts_of(rows, cols))
    return surface


@njit(cache=True, nogil=True)
def _rise_rows(energy, offsets, first, end, rises):
    """Fill rows first..end - 1 [J]: half of what a move in some directions costs more than its way back, else NaN."""
    _, cols, moves = energy.shape
    stride = max(moves // 8, 1)
    for i in range(first, end):
        for j in range(cols):
            for k in range(rises.shape[2]):
                n = k * stride
                there, back = energy[i, j, n], np.float32(math.nan)
                if not math.isnan(there):
                    back = energy[i + offsets[n, 0], j + offsets[n, 1], n + moves // 2]
                rises[i, j, k] = np.float32(0.5) * (there - back)


@njit(cache=True, nogil=True)
def _level_rows(rises, steps, surface, out, part):
    """Fill a part of the rows [J]: each cell where its neighbours and the rises from them put it, on average.

    A sweep towards the surface of least squares. steps : (k, 2) the directions of the rises.
    """
    rows, cols, ways = rises.shape
    for i in range(part.start, part.stop):
        for j in range(cols):
            total, count = 0.0, 0
            for k in range(ways):
                r, c = i + steps[k, 0], j + steps[k, 1]
                rise = rises[i, j, k]
                if not math.isnan(rise):
                    total += surface[r, c] - rise
                    count += 1
                r, c = i - steps[k, 0], j - steps[k, 1]
                if 0 <= r < rows and 0 <= c < cols:
                    rise = rises[r, c, k]
                    if not math.isnan(rise):
                        total += surface[r, c] + rise
                        count += 1
            out[i, j] = total / count if count > 0 else surface[i, j]


def spare_per_m(
    energy: NDArray[np.float32], offsets: NDArray[np.int64], length_m: NDArray[np.float64], surface: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the least energy per metre beyond the rise, over the moves of each cell.

    `energy` (rows, cols, N): energy of every move [J], NaN where there is none; `offsets` (N, 2): (drow, dcol) of the
    moves; `length_m` (N,): their lengths [m]; `surface` (rows, cols): what a rise is counted on [J]. Result (rows,
    cols): least (energy - rise) / length [J/m]; infinite where a cell has no move.
    """
    least = np.full(surface.shape, np.inf)
    share_out(
        lambda p: _spare_rows(energy, offsets, length_m, surface, p.start, p.stop, least), parts_of(*surface.shape)
    )
    return least


@njit(cache=True, nogil=True)
def _spare_rows(energy, offsets, length_m, surface, first, end, least):
    """Fill rows first..end - 1 of `spare_per_m`."""
    _, cols, moves = energy.shape
    per_m = 1.0 / length_m
    for i in range(first, end):
        for j in range(cols):
            here, most = surface[i, j], np.inf
            for n in range(moves):
                step = energy[i, j, n]
                if not math.isnan(step):
                    rise = surface[i + offsets[n, 0], j + offsets[n, 1]] - here
                    most = min(most, (step - rise) * per_m[n])
            least[i, j] = most


def spare_bounds(
    energy: NDArray[np.float32],
    offsets: NDArray[np.int64],
    length_m: NDArray[np.float64],
    surface: NDArray[np.float64],
    shares: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the least energy per metre beyond shares of the rise, over all moves of the map.

    `energy` (rows, cols, N): energy of every move [J], NaN where there is none; `offsets` (N, 2): (drow, dcol) of the
    moves; `length_m` (N,): their lengths [m]; `surface` (rows, cols): what a rise is counted on [J]; `shares` (B,).
    Result (B,): least (energy - share * rise) / length [J/m], 0 where that is rounding; infinite where there is no
    move.
    """
    bounds = np.array([spare_per_m(energy, offsets, length_m, share * surface).min() for share in shares])
    return np.where(np.abs(bounds) * length_m.min() < 2.0 * ROUNDING_J, 0.0, bounds)


@njit(cache=True, nogil=True)
def _lower(energy, offsets, length_m, surface, least, floor, effort):
    """Lower `surface` until each move costs at least its rise and `floor` per metre: -1, or a cell where that failed.

    least : `spare_per_m` of the surface, which says where to begin; effort : visits of cells before it counts as
    failed. With unlimited effort it fails only where it must: the cell lies on a loop that costs less (`_loop`).
    """
    rows, cols, moves = energy.shape
    cells = rows * cols
    flat, first, steps = surface.reshape(-1), least.reshape(-1), energy.reshape(cells, moves)
    jump, floors = offsets[:, 0] * cols + offsets[:, 1], floor * length_m
    came_by = np.full(cells, -1, dtype=np.int8)
    queue = np.empty(cells, dtype=np.int64)  # a ring; no cell is in it twice
    queued = np.zeros(cells, dtype=np.bool_)
    head, size, looks = 0, 0, 0
    check = max(cells // 16, 1024)  # then twice as late each time: a loop shows early, and looking for it takes time
    for cell in range(cells):
        if first[cell] < floor:
            queue[size] = cell
            queued[cell] = True
            size += 1
    while size > 0:
        cell = queue[head]
        head = head + 1 if head + 1 < cells else 0
        size -= 1
        queued[cell] = False
        looks += 1
        if looks > effort:
            return cell
        if looks == check:
            check += min(check, cells)
            place = _loop(came_by, offsets, cols)
            if place >= 0:
                return place
        here = flat[cell]
        for n in range(moves):
            top = here + steps[cell, n] - floors[n]
            if math.isnan(top):
                continue
            other = cell + jump[n]
            if top < flat[other] - ROUNDING_J:
                flat[other] = top
                came_by[other] = n
                if not queued[other]:
                    queued[other] = True
                    at = head + size
                    queue[at if at < cells else at - cells] = other
                    size += 1
    return -1


@njit(cache=True, nogil=True)
def _loop(came_by, offsets, cols):
    """A cell on a loop of the moves by which cells were lowered last, -1 where there is none.

    Such a loop is one of negative spare energy, and while there is one in the map it turns up here in the end
    (Cherkassky & Goldberg 1999).
    """
    seen = np.zeros(came_by.size, dtype=np.int32)
    for begin in range(came_by.size):
        at = begin
        while seen[at] == 0 and came_by[at] >= 0:
            seen[at] = begin + 1
            at -= offsets[came_by[at], 0] * cols + offsets[came_by[at], 1]
        if came_by[at] >= 0 and seen[at] == begin + 1:
            return at
    return -1
