"""The states of a search, their labels, and the compiled search that settles them: shared by paths and fields."""

from __future__ import annotations

from dataclasses import dataclass, field

import numba
import numpy as np
from numpy.typing import NDArray

from joulemap.planner.grid.buckets import (
    SETTLED,
    Aim,
    Guide,
    Moves,
    Ring,
    Terms,
    TileState,
    empty_ring,
    search_cells,
)
from joulemap.planner.grid.stopping import check_stop, stop_flag
from joulemap.planner.grid.traces import states_before, trace
from joulemap.planner.grid.turning_search import search_headings
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.moves import MoveTable
from joulemap.planner.pricing.tiles import Tiles, reserved

_SLACK = 1e-12
"""Relative gain that counts as rounding where prices may be negative, so that no loop goes on for ever."""
CELL_WIDTH, _TURN_WIDTH = 1 / 16, 0.6
"""Width of a bucket in typical prices, and with turning the share of a full turn that it spans. Any width gives the
same energies; bounds of a coarse level rise by nearly what a move costs, so that wide buckets settle cells again."""


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
    tiles : Tiles, optional
        The tiles of the moves, where they are priced when the search reaches them.
    opened : ndarray of bool, (tiles,)
        In which of them labels were made.
    """

    energy_j: NDArray[np.float64]
    pred: NDArray[np.uint8]
    layers: int
    backward: bool
    tiles: Tiles | None = None
    opened: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))

    @property
    def least_j(self) -> NDArray[np.float64]:
        """Least energy over the headings of each cell [J]: float64, (cells,)."""
        return self.energy_j if self.layers == 1 else self.energy_j.reshape(-1, self.layers).min(axis=1)

    def open(self, tile: int) -> None:
        """Make the labels of a tile, once: nothing in it was reached.

        Parameters
        ----------
        tile : int
            Its number.
        """
        if self.tiles is not None and not self.opened[tile]:
            self.tiles.count_label(tile)
            self.energy_j.reshape(self.tiles.shape)[self.tiles.window(tile)] = np.inf
            self.opened[tile] = True

    def reached_in(self, tile: int, *, open_only: bool = False) -> NDArray[np.int64]:
        """Return the cells of a tile that were reached.

        Parameters
        ----------
        tile : int
            Its number.
        open_only : bool, default False
            Whether to leave out those that were settled.

        Returns
        -------
        ndarray of int, (n,)
            Flat indices.
        """
        assert self.tiles is not None
        window = self.tiles.window(tile)
        found = self.energy_j.reshape(self.tiles.shape)[window] < np.inf
        if open_only:
            found &= self.pred.reshape(self.tiles.shape)[window] < SETTLED
        row, col = np.nonzero(found)
        return (row + window[0].start) * self.tiles.shape[1] + col + window[1].start

    def reached_cells(self, *, open_only: bool = False) -> NDArray[np.int64]:
        """Return the cells that were reached.

        Parameters
        ----------
        open_only : bool, default False
            Whether to leave out those from which a search that ended early has not to go on; with several layers it
            has to from all.

        Returns
        -------
        ndarray of int, (n,)
            Flat indices, each once.
        """
        if self.tiles is not None:
            parts = [self.reached_in(int(tile), open_only=open_only) for tile in np.flatnonzero(self.opened)]
            return np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)
        reached = self.energy_j < np.inf
        if self.layers > 1:
            return np.unique(np.flatnonzero(reached) // self.layers)
        if open_only:
            reached &= self.pred < SETTLED
        return np.flatnonzero(reached)

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
            self.pred[states][less] = 0

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
        return trace(self.pred, last, table.jump, self.layers, self.backward)

    def before(self, table: MoveTable, states: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the states that some were reached from.

        Parameters
        ----------
        table : MoveTable
            The moves of the search.
        states : ndarray of int, (n,)
            The states.

        Returns
        -------
        ndarray of int, (n,)
            -1 for a seed.
        """
        return states_before(self.pred, states, table.jump, self.layers, self.backward)


def layer_count(lattice: CostLattice, table: MoveTable) -> int:
    """Return the number of headings in a search state: all of the moves' where turning costs, else one.

    With tiles it is one.
    """
    return len(table.offsets) if lattice.robot.turn_j_per_rad > 0.0 and table.tiles is None else 1


def new_search(
    table: MoveTable, layers: int, cells: NDArray[np.int64], cost: NDArray[np.float64], *, backward: bool
) -> Search:
    """Return a search in which nothing but the seeds has been reached.

    `cells` (S,): flat indices of the seeds; `cost` (S, L): their energies [J].
    """
    states = table.surface.size * layers
    if (tiles := table.tiles) is not None:
        energy, pred = (reserved((states,), np.dtype(of)).array for of in (np.float64, np.uint8))
        search = Search(energy, pred, layers, backward, tiles, np.zeros(tiles.count, dtype=np.bool_))
        for tile in np.unique(tiles.tile_of(cells)).tolist():
            search.open(tile)
        search.seed(cells, cost)
        return search
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
    spent: Search | None = None,
    budget: float = np.inf,
) -> tuple[int, float, int]:
    """Settle what follows from some cells, in place.

    `first` (F,): flat indices of the cells to begin with, each once; `targets`, `rest`, `margin`, `most`, `budget`: see
    `Aim`; `spent`: the search of the energy that a path through a cell needs beside the one that is searched for.
    Returns `last`: the last state before the goal, -1 where it was not reached; `energy_j`: energy to the goal [J];
    `settled`: number of settled states.
    """
    layers = search.layers
    if targets is None or rest is None:
        targets, rest = np.empty(0, dtype=np.int64), np.empty((0, layers))
    moves = Moves(
        table.energy.reshape(-1, len(table.offsets)),
        table.length_m if table.metric else np.empty(0),
        table.jump,
        table.near,
        table.near_j,
        table.gap_j,
    )
    width = CELL_WIDTH * table.typical_j
    if layers > 1:
        width = table.typical_j + _TURN_WIDTH * float(table.gap_j.sum())
    terms = Terms(table.energy.shape[1], width, 0.0 if table.never_pays else _SLACK, search.backward)
    aim = Aim(targets, rest, margin, most, np.empty(0) if spent is None else spent.least_j, budget)
    if layers > 1:
        ring = search_headings(search.energy_j, search.pred, moves, aim, guide, terms, first, empty_ring(), stop_flag())
        check_stop()
        return ring.last, ring.total, ring.expanded
    state, ring = TileState(np.empty(0, np.uint8), np.empty(0), np.empty(0, np.int64), 0, 0, 0.0), empty_ring()
    tiles = table.tiles
    if tiles is not None:
        tiles.used[:] = 0
        ready, parked = np.zeros(tiles.count, np.uint8), np.full(tiles.count, np.inf)
        state = TileState(ready, parked, tiles.used, tiles.shift, tiles.across, table.typical_j)
    while True:
        ring = search_cells(search.energy_j, search.pred, moves, state, aim, guide, terms, first, ring, stop_flag())
        check_stop()
        if ring.wanted < 0 or tiles is None:
            return ring.last, ring.total, ring.expanded
        first = _made_ready(search, spent, tiles, state, guide, ring)


def _made_ready(
    search: Search, spent: Search | None, tiles: Tiles, state: TileState, guide: Guide, ring: Ring
) -> NDArray[np.int64]:
    """Price the tile that a search wants, and those around it which it reads; the cells that waited for it."""
    tile = int(ring.wanted)
    around = tiles.around(tile)
    for each in around:
        search.open(each)
        if spent is not None:
            spent.open(each)
        if guide.known.size and not guide.pairs.size:
            tiles.open_bounds(guide.known, each)
    wanted = [tile]
    if search.backward:
        wanted = around if spent is None else [each for each in around if each == tile or spent.reached_in(each).size]
    tiles.used[wanted] = ring.expanded
    if not tiles.full:  # one more for each further thread, which are next as it looks now
        soon = np.argsort(state.parked)[: numba.get_num_threads()].tolist()
        wanted += [each for each in soon if each not in wanted and state.parked[each] < np.inf]
    for dropped in tiles.price(wanted):
        state.ready[tiles.around(dropped)] = 0
    state.ready[tile] = 1
    state.parked[tile] = np.inf
    return search.reached_in(tile, open_only=True)
