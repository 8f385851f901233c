"""Which grid moves come within the robot's margin to ground that may not be driven, by the moves around them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


def beside_moves(offsets: NDArray[np.int64], margin: float) -> NDArray[np.int64]:
    """Return the cells around each move that bands of twice the margin [cells] reach: steps (N, 3, A, 2).

    The bands lie to the left of the move, around it and to its right; some cells are repeated.
    """
    if margin == 0.0:
        return np.zeros((len(offsets), 3, 0, 2), dtype=np.int64)
    steps = 2 * math.ceil(margin)
    bands: list[list[list[tuple[int, int]]]] = []
    for drow, dcol in offsets / np.hypot(*offsets.T)[:, None]:
        bands.append([])
        for middle in (-margin, 0.0, margin):
            sides = np.linspace(middle - margin, middle + margin, steps + 1)
            along = (-margin, 0.0, margin)  # a robot is late and early too
            shifts = [(ahead * drow - side * dcol, ahead * dcol + side * drow) for side in sides for ahead in along]
            ends = [[(math.floor(v + 1e-9), math.ceil(v - 1e-9)) for v in shift] for shift in shifts]
            bands[-1].append(sorted({(i, j) for rows, cols in ends for i in rows for j in cols}))
    most = max(len(cells) for three in bands for cells in three)
    return np.array([[(cells * most)[:most] for cells in three] for three in bands])


@njit(cache=True, nogil=True)
def near_closed(energy, offsets, beside, row, col, map_rows, map_cols):
    """Return the bit sets of moves near closed ones, of a part of a map: two of (rows, cols) uint32.

    In the first, bit n is set where a move n is closed in the band around move n, in the second where one is closed in
    each of its bands, so that no path of that heading keeps the margin there. `energy` (rows, cols, N): energy of the
    moves that leave the cells of the part [J]; `beside`: from `beside_moves`; `row`, `col`: the part's first cell in a
    map of `map_rows` x `map_cols`: a move that leaves this is not closed.
    """
    rows, cols, moves = energy.shape
    near = np.zeros((3, rows, cols), dtype=np.uint32)
    for i in range(rows):
        for j in range(cols):
            if not (0 <= row + i < map_rows and 0 <= col + j < map_cols):
                continue
            for n in range(moves):
                if not math.isnan(energy[i, j, n]):
                    continue
                down, right = row + i + offsets[n, 0], col + j + offsets[n, 1]
                if not (0 <= down < map_rows and 0 <= right < map_cols):
                    continue  # it leaves the map
                for band in range(3):
                    for k in range(beside.shape[2]):
                        a, b = i - beside[n, band, k, 0], j - beside[n, band, k, 1]
                        if 0 <= a < rows and 0 <= b < cols:
                            near[band, a, b] |= np.uint32(1) << np.uint32(n)
    return near[1], near[0] & near[1] & near[2]
