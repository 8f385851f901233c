"""The states of a search, their labels, and the compiled search that settles them: what paths and fields share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.buckets import Guide, search_cells, trace_cells
from joulemap.planner.headings import SEED, search_headings, trace_headings
from joulemap.planner.lattice import CostLattice
from joulemap.planner.moves import MoveTable

_SLACK = 1e-12
"""Relative gain that is taken for rounding where prices may be negative, so that no loop goes on for ever."""
_CELL_WIDTH, _TURN_WIDTH = 2.0, 0.6
"""Width of a bucket in typical prices, and with turning the share of a full turn that it spans; measured: wide buckets
settle some cells again, and walk through memory in better order."""


@dataclass(frozen=True, eq=False, repr=False)
class Search:
    """What a search leaves behind: a label [J] and a code of how it came there for every state (cell * layers + layer).

    With one layer a state is a cell; with as many as there are moves it is a cell and the heading that the robot looks
    in. Backward, labels count towards the seeds.
    """

    energy_j: NDArray[np.float64]
    pred: NDArray[np.uint8]
    layers: int
    backward: bool

    def seed(self, cells: NDArray[np.int64], cost: NDArray[np.float64]) -> None:
        """Let cells (S,) be reached at cost (S, layers) [J], where that is less than they have."""
        for cell, joined in zip(cells.tolist(), cost, strict=True):
            states = slice(cell * self.layers, (cell + 1) * self.layers)
            less = joined < self.energy_j[states]
            self.energy_j[states][less] = joined[less]
            self.pred[states][less] = SEED

    def trace(self, table: MoveTable, last: int) -> NDArray[np.int64]:
        """(n,) states from `last` back to the seed it was reached from (for backward searches: on to the goal)."""
        trace = trace_cells if self.layers == 1 else trace_headings
        return trace(self.pred, table.jump, last, self.backward)


def layer_count(lattice: CostLattice, table: MoveTable) -> int:
    """Headings in a search state: all of the moves' where turning costs, else one."""
    return len(table.offsets) if lattice.robot.turn_j_per_rad > 0.0 else 1


def new_search(
    table: MoveTable, layers: int, cells: NDArray[np.int64], cost: NDArray[np.float64], *, backward: bool
) -> Search:
    """Labels of nothing but the seeds: cells (S,) at cost (S, layers) [J]."""
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
) -> tuple[int, float, int]:
    """Settle what follows from the cells `first`, in place: the last state, the energy to the goal, states settled."""
    layers = search.layers
    cols = table.energy.shape[1]
    price = table.energy.reshape(-1, len(table.offsets))
    if targets is None or rest is None:
        targets, rest = np.empty(0, dtype=np.int64), np.empty((0, layers))
    slack = 0.0 if table.never_pays else _SLACK
    if layers == 1:
        return search_cells(
            search.energy_j,
            search.pred,
            price,
            table.jump,
            first,
            targets,
            np.ascontiguousarray(rest[:, 0]),
            guide,
            cols,
            _CELL_WIDTH * table.typical_j,
            slack,
            search.backward,
        )
    width = table.typical_j + _TURN_WIDTH * float(table.gap_j.sum())
    return search_headings(
        search.energy_j,
        search.pred,
        price,
        table.jump,
        table.gap_j,
        first,
        targets,
        rest,
        guide,
        cols,
        width,
        slack,
        search.backward,
    )
