"""The states of a search, their labels, and the compiled search that settles them: shared by paths and fields."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.grid.buckets import SETTLED, Guide, search_cells, trace_cells
from joulemap.planner.grid.stopping import check_stop, stop_flag
from joulemap.planner.grid.turning_search import SEED, search_headings, trace_headings
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.moves import MoveTable

_SLACK = 1e-12
"""Relative gain that counts as rounding where prices may be negative, so that no loop goes on for ever."""
_CELL_WIDTH, _TURN_WIDTH = 2.0, 0.6
"""Width of a bucket in typical prices, and with turning the share of a full turn that it spans; measured: wide buckets
settle some cells again, and walk through memory in better order."""


@dataclass(frozen=True, eq=False, repr=False)
class Search:
    """The result of a search: for every state the energy and how it was reached.

    A state has the index cell * layers + layer. With one layer it is a cell; with as many as there are moves it is a
    cell and the heading of the robot.

    Attributes
    ----------
    energy_j : ndarray of float, (states,)
        Least energy [J]: from the seeds, or, backward, to them.
    pred : ndarray of uint8, (states,)
        Code of the move or turn by which each state was reached.
    layers : int
        Headings per cell.
    backward : bool
        Whether moves were run against their direction.
    """

    energy_j: NDArray[np.float64]
    pred: NDArray[np.uint8]
    layers: int
    backward: bool

    def seed(self, cells: NDArray[np.int64], cost: NDArray[np.float64]) -> None:
        """Set the energy of some cells where that is less than they have.

        Parameters
        ----------
        cells : ndarray of int, (S,)
            Flat indices.
        cost : ndarray of float, (S, layers)
            Energy [J].
        """
        for cell, joined in zip(cells.tolist(), cost, strict=True):
            states = slice(cell * self.layers, (cell + 1) * self.layers)
            less = joined < self.energy_j[states]
            self.energy_j[states][less] = joined[less]
            self.pred[states][less] = SEED

    def open_cells(self) -> NDArray[np.int64]:
        """Return the cells from which a search that ended early has to go on.

        Returns
        -------
        ndarray of int, (n,)
            Flat indices: the cells that were reached and not settled; with several layers all that were reached.
        """
        if self.layers > 1:
            return np.flatnonzero((self.energy_j < np.inf).reshape(-1, self.layers).any(axis=1))
        return np.flatnonzero((self.pred < SETTLED) & (self.energy_j < np.inf))

    def trace(self, table: MoveTable, last: int) -> NDArray[np.int64]:
        """Return the states from one state back to the seed that it was reached from.

        Parameters
        ----------
        table : MoveTable
            The moves of the search.
        last : int
            The state to begin with.

        Returns
        -------
        ndarray of int, (n,)
            `last` first; for a backward search the way on to the goal.
        """
        trace = trace_cells if self.layers == 1 else trace_headings
        return trace(self.pred, table.jump, last, self.backward)


def layer_count(lattice: CostLattice, table: MoveTable) -> int:
    """Return the number of headings in a search state: all of the moves' where turning costs, else one."""
    return len(table.offsets) if lattice.robot.turn_j_per_rad > 0.0 else 1


def new_search(
    table: MoveTable, layers: int, cells: NDArray[np.int64], cost: NDArray[np.float64], *, backward: bool
) -> Search:
    """Return a search in which nothing but the seeds has been reached.

    `cells` (S,): flat indices of the seeds; `cost` (S, L): their energies [J].
    """
    states = table.surface.size * layers
    search = Search(np.full(states, np.inf), np.zeros(states, dtype=np.uint8), layers, backward)
    search.seed(cells, cost)
    return search


def run_search(
    search: Search,
    table: MoveTable,
    first: NDArray[np.int64],
    guide: Guide,
    targets: NDArray[np.int64] | None = None,
    rest: NDArray[np.float64] | None = None,
    *,
    margin: float = 0.0,
    most: float = np.inf,
    spent: NDArray[np.float64] | None = None,
    budget: float = np.inf,
) -> tuple[int, float, int]:
    """Settle what follows from some cells, in place.

    `first` (F,): flat indices of the cells to begin with, each once; `targets` (T,); `rest` (T, layers): energy from
    them to the goal [J]; `most`: energy beyond which nothing is settled [J]; `spent` (cells,): energy that a path
    through a cell needs beside the one that is searched for [J]; `budget`: where both together exceed it [J], the cell
    is left alone. Returns `last`: the last state before the goal, -1 where it was not reached; `energy_j`: energy to
    the goal [J]; `settled`: number of settled states.
    """
    layers = search.layers
    cols = table.energy.shape[1]
    price = table.energy.reshape(-1, len(table.offsets))
    if targets is None or rest is None:
        targets, rest = np.empty(0, dtype=np.int64), np.empty((0, layers))
    slack = 0.0 if table.never_pays else _SLACK
    spent = np.empty(0) if spent is None else spent
    known = np.zeros(table.surface.size if len(guide.pairs) else 1)  # memory that is never touched costs nothing
    if layers == 1:
        found = search_cells(
            search.energy_j,
            search.pred,
            price,
            table.length_m if table.metric else np.empty(0),
            table.jump,
            table.near,
            table.near_j,
            first,
            targets,
            np.ascontiguousarray(rest[:, 0]),
            guide,
            known,
            cols,
            _CELL_WIDTH * table.typical_j,
            slack,
            search.backward,
            margin,
            most,
            spent,
            budget,
            stop_flag(),
        )
    else:
        width = table.typical_j + _TURN_WIDTH * float(table.gap_j.sum())
        found = search_headings(
            search.energy_j,
            search.pred,
            price,
            table.jump,
            table.near,
            table.near_j,
            table.gap_j,
            first,
            targets,
            rest,
            guide,
            known,
            cols,
            width,
            slack,
            search.backward,
            margin,
            most,
            spent,
            budget,
            stop_flag(),
        )
    check_stop()
    return found
