"""Landmarks: least energies to and from a few places at the rim, sharper bounds for A* than distance and height."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.heuristics import guide_everywhere
from joulemap.planner.moves import MoveTable
from joulemap.planner.states import new_search, run_search

DEFAULT_LANDMARKS = 4
_EPS = float(np.finfo(np.float32).eps)


@dataclass(frozen=True, eq=False, repr=False)
class Landmarks:
    """Energies between every cell and some places, as bounds on what is still to come (see `heuristics`).

    Turns do not count in them, which makes them lower bounds where turning costs.

    Attributes
    ----------
    cells : ndarray of int, (L,)
        Flat indices of the places.
    marks : ndarray of float32, (cells, 2 L)
        Least energy to each place [J], then minus the least energy from each; infinite where there is no path.
    slack_j : float
        What rounding to float32 may have added to a difference of two marks [J].

    References
    ----------
    Goldberg & Harrelson 2005.
    """

    cells: NDArray[np.int64]
    marks: NDArray[np.float32]
    slack_j: float


def make_landmarks(
    table: MoveTable, *, count: int = DEFAULT_LANDMARKS, progress: Callable[[float], None] | None = None
) -> Landmarks:
    """Compute two energy fields for each of some landmarks.

    They are the outermost cells in equally spaced directions (for 4: the corners) of the largest connected ground.

    Parameters
    ----------
    table : MoveTable
        Priced moves.
    count : int, default 4
        Number of landmarks.
    progress : callable, optional
        Called with the share that is done, 0..1.

    Returns
    -------
    Landmarks
        For A* searches over this table.

    Notes
    -----
    O(count * cells) time; 8 * count bytes per cell are kept.
    """
    cells = _outermost(table, count)
    marks = np.empty((table.surface.size, 2 * cells.size), dtype=np.float32)
    largest = 0.0

    def _fill(column: int) -> float:
        """Compute one column; the largest finite energy in it [J]."""
        backward = column < cells.size
        search = new_search(table, 1, cells[column % cells.size, None], np.zeros((1, 1)), backward=backward)
        run_search(search, table, cells[column % cells.size, None], guide_everywhere(table, backward=backward))
        marks[:, column] = search.energy_j if backward else -search.energy_j
        return float(np.abs(search.energy_j[np.isfinite(search.energy_j)]).max())

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for k, size in enumerate(pool.map(_fill, range(marks.shape[1]))):
            largest = max(largest, size)
            if progress is not None:
                progress((k + 1) / marks.shape[1])
    return Landmarks(cells, marks, _EPS * largest)


def _outermost(table: MoveTable, count: int) -> NDArray[np.int64]:
    from scipy.ndimage import label  # loads slowly, and most questions need it not

    regions, _ = label(np.isfinite(table.energy).any(axis=2), structure=np.ones((3, 3)))
    largest = np.bincount(regions.ravel())[1:].argmax() + 1 if regions.any() else 0
    row, col = np.nonzero(regions == largest)
    angles = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    outermost = [int(np.argmax(np.cos(a) * row + np.sin(a) * col)) for a in angles]
    return np.unique(row[outermost] * table.energy.shape[1] + col[outermost])
