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
from joulemap.planner.landmarks import Landmarks
from joulemap.planner.lattice import CostLattice
from joulemap.planner.moves import MoveTable
from joulemap.planner.search import GridPath, direct_energy, joined_points, no_route, terminals
from joulemap.planner.states import Search, layer_count, new_search, run_search

COUNT = 4
"""Most corridors."""
PLATEAU = 0.03
"""Least share of the energy that a path has in common with both searches."""
APART = 0.02
"""Least distance between the middles of two corridors, as a share of the length of the best path."""
_NONE = -1


def corridor_paths(
    lattice: CostLattice,
    table: MoveTable,
    start: Points,
    goal: Points,
    *,
    margin: float = 0.01,
    count: int = COUNT,
    landmarks: Landmarks | None = None,
) -> list[GridPath]:
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
    count : int, default 4
        Most paths.
    landmarks : Landmarks, optional
        Made of this table, for fewer expansions.

    Returns
    -------
    list of GridPath
        The paths, cheapest first; the first is that of `search.grid_search`.

    Raises
    ------
    NoRouteError
        If the goal cannot be reached.
    """
    layers = layer_count(lattice, table)
    cells, cost = terminals(lattice, table, start, layers, outward=True)
    targets, rest = terminals(lattice, table, goal, layers, outward=False)
    marks, slack_j = (landmarks.marks, landmarks.slack_j) if landmarks is not None else (None, 0.0)
    guide = guide_towards(
        table,
        energy_bounds(table),
        goal,
        targets,
        rest.min(axis=1),
        lattice.frame.resolution_m,
        marks=marks,
        slack_j=slack_j,
    )
    ahead = new_search(table, layers, cells, cost, backward=False)
    margin = margin if count > 1 else 0.0
    last, total, expanded = run_search(ahead, table, np.unique(cells), guide, targets, rest, margin=margin)
    direct = direct_energy(lattice, start, goal)
    if direct < math.inf and direct <= total:
        return [GridPath(np.vstack([start, goal]), direct, expanded)]
    if last == _NONE:
        raise no_route(lattice, expanded)
    first = ahead.trace(table, last)[::-1] // layers
    found = [GridPath(joined_points(lattice, start, first, goal), float(total), expanded)]
    if count == 1:
        return found
    most = float(total) + margin * abs(float(total))
    behind = _back(ahead, table, targets, rest, most)
    via, length = plateaus(ahead, behind, table)
    good = np.flatnonzero((length >= PLATEAU * abs(total)) & (via <= most))
    cols = lattice.frame.cols
    taken = np.zeros(lattice.frame.shape, dtype=np.bool_)
    apart = max(2, round(APART * float(np.hypot(*np.diff(found[0].points, axis=0).T).sum())))
    mark_around(taken, first, cols, apart)
    for state in good[np.argsort(via[good], kind="stable")]:
        if taken.ravel()[_middle(behind, table, int(state), float(length[state]))]:
            continue
        into = ahead.trace(table, int(state))[::-1] // layers
        way = np.append(into, behind.trace(table, int(state))[1:] // layers)
        way = way[np.append(True, np.diff(way) != 0)]  # turns on the spot
        mark_around(taken, way, cols, apart)
        if np.unique(way).size < way.size:
            continue
        found.append(GridPath(joined_points(lattice, start, way, goal), float(via[state]), 0))
        if len(found) == count:
            break
    return found


def _back(
    ahead: Search, table: MoveTable, targets: NDArray[np.int64], rest: NDArray[np.float64], most: float
) -> Search:
    """The search back from the goal through all cells of a path that costs at most `most` [J]."""
    so_far = ahead.energy_j.reshape(-1, ahead.layers).min(axis=1)
    ceiling = (most + 1e-6 * abs(most) - so_far).astype(np.float32)
    behind = new_search(table, ahead.layers, targets, rest, backward=True)
    run_search(behind, table, np.unique(targets), guide_everywhere(table, backward=True), ceiling=ceiling)
    return behind


def _middle(behind: Search, table: MoveTable, state: int, length_j: float) -> int:
    """The cell half-way along the plateau that begins at a state."""
    way = behind.trace(table, state)
    at = int(np.argmin(np.abs(behind.energy_j[way] - (behind.energy_j[state] - 0.5 * length_j))))
    return int(way[at]) // behind.layers


@njit(cache=True, nogil=True)
def mark_around(taken, way, cols, apart):
    """Mark the squares around the cells of a path.

    Parameters
    ----------
    taken : ndarray of bool, (rows, cols)
        Is set there.
    way : ndarray of int64, (n,)
        Flat cell indices, row * cols + col.
    cols : int
        Columns of the map.
    apart : int
        Half the side of a square [cells].
    """
    rows = taken.shape[0]
    for cell in way:
        i, j = cell // cols, cell % cols
        taken[max(i - apart, 0) : min(i + apart + 1, rows), max(j - apart, 0) : min(j + apart + 1, cols)] = True


def plateaus(ahead: Search, behind: Search, table: MoveTable) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the stretches of moves that two searches share.

    Parameters
    ----------
    ahead, behind : Search
        From the start, and towards the goal.
    table : MoveTable
        Their moves.

    Returns
    -------
    via : ndarray of float, (states,)
        Energy [J] of the best path through each state that begins a plateau, else infinite.
    length : ndarray of float, (states,)
        Energy [J] of the plateau.
    """
    return _measure_plateaus(ahead.energy_j, ahead.pred, behind.energy_j, behind.pred, table.jump, ahead.layers)


@njit(cache=True, nogil=True)
def _measure_plateaus(ahead, ahead_pred, behind, behind_pred, jump, layers):
    states = ahead.size
    after = np.full(states, -1, dtype=np.int64)  # the next state of a plateau
    begins = np.ones(states, dtype=np.bool_)
    for state in range(states):
        if not (ahead[state] < np.inf and behind[state] < np.inf):
            continue
        if layers == 1:
            code = behind_pred[state] & (SETTLED - 1)
            if code == 0:
                continue
            following = state + jump[code - 1]
            shared = ahead_pred[following] & (SETTLED - 1) == code
        else:
            code = behind_pred[state]
            if code == SEED:
                continue
            following = state_before(code, state, jump, True)
            # what turned right on the way back is a turn to the left on the way there
            mirrored = TURNED_LEFT if code == TURNED_RIGHT else TURNED_RIGHT if code == TURNED_LEFT else code
            shared = ahead_pred[following] == mirrored
        if shared:
            after[state] = following
            begins[following] = False
    via = np.full(states, np.inf)
    length = np.zeros(states)
    for state in range(states):
        if after[state] >= 0 and begins[state]:
            end = after[state]
            while after[end] >= 0:
                end = after[end]
            via[state] = ahead[state] + behind[state]
            length[state] = ahead[end] - ahead[state]
    return via, length
