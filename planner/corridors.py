"""The corridors in which the best any-angle path may lie: every locally best grid path within the grid's error.

A grid of 32 neighbours makes a path up to 1.31 % dearer than it is at any angle, and not every path by the same share.
So the cheapest grid path need not lie in the corridor of the cheapest path. An A* search that goes on until every cell
is settled whose path costs at most a margin more, and a second one back from the goal among those cells alone, give the
least energy of a path through each of them. Where both use the same moves over a stretch (a plateau; Jones 2007,
Abraham et al. 2013) the path through it is locally the best.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.planner.buckets import SETTLED
from joulemap.planner.edges import Points
from joulemap.planner.headings import SEED, TURNED_LEFT, TURNED_RIGHT, state_before
from joulemap.planner.heuristics import energy_bounds, guide_everywhere, guide_towards
from joulemap.planner.lattice import CostLattice
from joulemap.planner.moves import MoveTable
from joulemap.planner.passages import beside_closed_moves, mark_around, paths_through_passages
from joulemap.planner.polylines import path_length
from joulemap.planner.search import GridPath, direct_energy, joined_points, no_route, terminals, without_repeats
from joulemap.planner.states import Search, layer_count, new_search, run_search

COUNT = 24
"""Most corridors, the first one among them."""
PLATEAU = 0.03
"""Least share of the energy that a path has in common with both searches."""
SEPARATION = 0.02
"""Least distance between the middles of two corridors, as a share of the length of the best path."""
WIDER = 3.0
"""Times the margin, where moves are closed beside the best path: a way that is much dearer over grid moves may be
cheaper through a passage between them (`passages`). Of 240 random tasks on a real hillside it made two cheaper by over
0.1 %, by 0.5 and 3.4 %, and none dearer, for a twentieth of the time of an answer."""
_NONE = -1


class Corridors:
    """The cheapest path over grid moves, and on request the best of every other corridor that is nearly as good.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    table : MoveTable
        Priced moves of the lattice.
    start, goal : ndarray of float, (2,)
        Fractional (row, col).
    margin : float, default 0.01
        Most energy of a path beyond that of the cheapest, as a share of it.

    Attributes
    ----------
    first : GridPath
        The cheapest path, that of `search.grid_search`.

    Raises
    ------
    NoRouteError
        If the goal cannot be reached.
    """

    def __init__(
        self, lattice: CostLattice, table: MoveTable, start: Points, goal: Points, *, margin: float = 0.01
    ) -> None:
        self._lattice, self._table, self._start, self._goal, self._margin = lattice, table, start, goal, margin
        layers = layer_count(lattice, table)
        self._seeds, self._cost = terminals(lattice, table, start, layers, outward=True)
        self._targets, self._rest = terminals(lattice, table, goal, layers, outward=False)
        self._guide = guide_towards(
            table, energy_bounds(table), goal, self._targets, self._rest.min(axis=1), lattice.frame.resolution_m
        )
        self._ahead = ahead = new_search(table, layers, self._seeds, self._cost, backward=False)
        last, total, expanded = run_search(
            ahead, table, np.unique(self._seeds), self._guide, self._targets, self._rest, margin=margin
        )
        direct = direct_energy(lattice, start, goal)
        self._direct = direct < math.inf and direct <= total
        if self._direct:
            self.first = GridPath(np.vstack([start, goal]), direct, expanded)
            return
        if last == _NONE:
            raise no_route(lattice.robot, expanded)
        self._cells = ahead.trace(table, last)[::-1] // layers
        self.first = GridPath(joined_points(lattice, start, self._cells, goal), float(total), expanded)

    def others(self) -> tuple[list[GridPath], list[Points]]:
        """Return the paths of the other corridors, and those through passages that the moves of the grid miss.

        Returns
        -------
        paths : list of GridPath
            The paths, cheapest first, at most `COUNT` with the first one.
        through : list of ndarray of float, (n, 2)
            (row, col) of the cheapest paths between points of half and of a quarter of a cell, where limits close
            moves, see `passages`.
        """
        if self._direct:
            return [], []
        lattice, table, ahead, layers = self._lattice, self._table, self._ahead, self._ahead.layers
        total, margin_j = self.first.energy_j, self._margin * abs(self.first.energy_j)
        most = wider = total + margin_j
        if beside_closed_moves(table, self._cells):
            wider = total + WIDER * margin_j
            run_search(ahead, table, ahead.open_cells(), self._guide, most=wider)
        behind = _back(ahead, table, self._targets, self._rest, wider)
        reached = np.flatnonzero(behind.energy_j < math.inf)
        states, via, length, middle = plateaus(ahead, behind, table, reached)
        good = (length >= PLATEAU * abs(total)) & (via <= most)
        states, via, middle = states[good], via[good], middle[good]
        cols, found = lattice.frame.cols, []
        taken = np.zeros(lattice.frame.shape, dtype=np.bool_)
        separation = max(2, round(SEPARATION * path_length(self.first.points)))
        mark_around(taken, self._cells, cols, separation)
        for k in np.argsort(via, kind="stable"):
            state = int(states[k])
            if taken.ravel()[middle[k]]:
                continue
            into = ahead.trace(table, state)[::-1] // layers
            way = np.append(into, behind.trace(table, state)[1:] // layers)
            way = way[np.append(True, np.diff(way) != 0)]  # turns on the spot
            mark_around(taken, way, cols, separation)
            if np.unique(way).size < way.size:
                continue
            found.append(GridPath(joined_points(lattice, self._start, way, self._goal), float(via[k]), 0))
            if len(found) == COUNT - 1:
                break
        usual = reached if layers == 1 else np.unique(reached // layers)
        ends = (self._seeds, self._cost.min(axis=1)), (self._targets, self._rest.min(axis=1))
        through = paths_through_passages(lattice, table, ahead, usual, *ends)
        return found, [without_repeats(np.vstack([self._start, way, self._goal])) for way in through]


def _back(
    ahead: Search, table: MoveTable, targets: NDArray[np.int64], rest: NDArray[np.float64], most: float
) -> Search:
    """The search back from the goal through all cells of a path that costs at most `most` [J]."""
    so_far = ahead.energy_j if ahead.layers == 1 else ahead.energy_j.reshape(-1, ahead.layers).min(axis=1)
    behind = new_search(table, ahead.layers, targets, rest, backward=True)
    guide = guide_everywhere(table, backward=True)
    run_search(behind, table, np.unique(targets), guide, spent=so_far, budget=most + 1e-9 * abs(most))
    return behind


def plateaus(
    ahead: Search, behind: Search, table: MoveTable, reached: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return the stretches of moves that two searches share.

    Parameters
    ----------
    ahead, behind : Search
        From the start, and towards the goal.
    table : MoveTable
        Their moves.
    reached : ndarray of int64, (n,)
        States that the search towards the goal has reached.

    Returns
    -------
    states : ndarray of int64, (n,)
        The state that each plateau begins with.
    via : ndarray of float64, (n,)
        Energy of the best path through it [J].
    length : ndarray of float64, (n,)
        Energy of the plateau [J].
    middle : ndarray of int64, (n,)
        The cell half-way along it.
    """
    labels = ahead.energy_j, ahead.pred, behind.energy_j, behind.pred
    return _measured(reached, *labels, table.jump, ahead.layers)


@njit(cache=True, nogil=True)
def _measured(reached, ahead, ahead_pred, behind, behind_pred, jump, layers):
    """As `plateaus`; reached : the states that the search back has reached."""
    states = np.empty(reached.size, dtype=np.int64)
    via, length, middle = np.empty(reached.size), np.empty(reached.size), np.empty(reached.size, dtype=np.int64)
    count = 0
    for state in reached:
        end = _shared_next(state, ahead_pred, behind_pred, jump, layers) if ahead[state] < np.inf else _NONE
        if end == _NONE or _is_shared(state, ahead, ahead_pred, behind, behind_pred, jump, layers):
            continue
        while True:
            further = _shared_next(end, ahead_pred, behind_pred, jump, layers)
            if further == _NONE:
                break
            end = further
        states[count] = state
        via[count] = ahead[state] + behind[state]
        length[count] = ahead[end] - ahead[state]
        at = state
        while ahead[at] - ahead[state] < 0.5 * length[count]:
            at = _shared_next(at, ahead_pred, behind_pred, jump, layers)
        middle[count] = at // layers
        count += 1
    return states[:count], via[:count], length[:count], middle[:count]


@njit(cache=True)
def _shared_next(state, ahead_pred, behind_pred, jump, layers):
    """The state after one on the way to the goal where the search from the start came over the same move, else -1."""
    if layers == 1:
        code = behind_pred[state] & (SETTLED - 1)
        if code == 0:
            return _NONE
        following = state + jump[code - 1]
        return following if ahead_pred[following] & (SETTLED - 1) == code else _NONE
    code = behind_pred[state]
    if code == SEED:
        return _NONE
    following = state_before(code, state, jump, True)
    # what turned right on the way back is a turn to the left on the way there
    mirrored = TURNED_LEFT if code == TURNED_RIGHT else TURNED_RIGHT if code == TURNED_LEFT else code
    return following if ahead_pred[following] == mirrored else _NONE


@njit(cache=True)
def _is_shared(state, ahead, ahead_pred, behind, behind_pred, jump, layers):
    """Whether the move by which the search from the start reached a state is one that the search back used too."""
    if layers == 1:
        code = ahead_pred[state] & (SETTLED - 1)
        before = state - jump[code - 1] if code > 0 else _NONE
    else:
        before = state_before(ahead_pred[state], state, jump, False) if ahead_pred[state] != SEED else _NONE
    if before == _NONE or not (ahead[before] < np.inf and behind[before] < np.inf):
        return False
    return _shared_next(before, ahead_pred, behind_pred, jump, layers) == state
