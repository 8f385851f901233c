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
"""Most corridors."""
PLATEAU = 0.03
"""Least share of the energy that a path has in common with both searches."""
SEPARATION = 0.02
"""Least distance between the middles of two corridors, as a share of the length of the best path."""
WIDER = 3.0
"""Times the margin, where moves are closed beside the best path: a way that is much dearer over grid moves may be
cheaper through a passage between them (`passages`). Of 240 random tasks on a real hillside it made two cheaper by over
0.1 %, by 0.5 and 3.4 %, and none dearer, for a twentieth of the time of an answer."""
_NONE = -1


def corridor_paths(
    lattice: CostLattice,
    table: MoveTable,
    start: Points,
    goal: Points,
    *,
    margin: float = 0.01,
    count: int = COUNT,
) -> tuple[list[GridPath], list[Points]]:
    """Return the cheapest path over grid moves, and the best of every other corridor that is nearly as good.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    table : MoveTable
        Priced moves of the lattice.
    start, goal : ndarray of float, (2,)
        Fractional (row, col).
    margin : float, default 0.01
        Most energy beyond that of the best, as a share of it.
    count : int, default 24
        Most paths.

    Returns
    -------
    paths : list of GridPath
        The paths, cheapest first; the first is that of `search.grid_search`.
    through : list of ndarray of float, (n, 2)
        (row, col) of the cheapest paths between points of half and of a quarter of a cell, where limits close moves,
        see `passages`.

    Raises
    ------
    NoRouteError
        If the goal cannot be reached.
    """
    layers = layer_count(lattice, table)
    cells, cost = terminals(lattice, table, start, layers, outward=True)
    targets, rest = terminals(lattice, table, goal, layers, outward=False)
    guide = guide_towards(
        table,
        energy_bounds(table),
        goal,
        targets,
        rest.min(axis=1),
        lattice.frame.resolution_m,
    )
    margin = margin if count > 1 else 0.0

    def _ahead(margin: float) -> tuple[Search, int, float, int]:
        search = new_search(table, layers, cells, cost, backward=False)
        return search, *run_search(search, table, np.unique(cells), guide, targets, rest, margin=margin)

    ahead, last, total, expanded = _ahead(margin)
    direct = direct_energy(lattice, start, goal)
    if direct < math.inf and direct <= total:
        return [GridPath(np.vstack([start, goal]), direct, expanded)], []
    if last == _NONE:
        raise no_route(lattice.robot, expanded)
    first = ahead.trace(table, last)[::-1] // layers
    found = [GridPath(joined_points(lattice, start, first, goal), float(total), expanded)]
    if count == 1:
        return found, []
    most = wider = total + margin * abs(total)
    if beside_closed_moves(table, first):
        wider = total + WIDER * margin * abs(total)
        ahead, *_ = _ahead(WIDER * margin)
    behind = _back(ahead, table, targets, rest, wider)
    reached = np.flatnonzero(behind.energy_j < math.inf)
    states, via, length, middle = plateaus(ahead, behind, table, reached)
    good = (length >= PLATEAU * abs(total)) & (via <= most)
    states, via, middle = states[good], via[good], middle[good]
    cols = lattice.frame.cols
    taken = np.zeros(lattice.frame.shape, dtype=np.bool_)
    separation = max(2, round(SEPARATION * path_length(found[0].points)))
    mark_around(taken, first, cols, separation)
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
        found.append(GridPath(joined_points(lattice, start, way, goal), float(via[k]), 0))
        if len(found) == count:
            break
    usual = reached if layers == 1 else np.unique(reached // layers)
    through = paths_through_passages(lattice, table, usual, (cells, cost.min(axis=1)), (targets, rest.min(axis=1)))
    return found, [without_repeats(np.vstack([start, way, goal])) for way in through]


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
