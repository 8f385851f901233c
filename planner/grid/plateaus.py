"""Plateaus: stretches of moves that the search from a start and the one towards a goal both use.

The path start - plateau - goal is locally the best: no detour shorter than the plateau makes it cheaper (Jones 2007;
Abraham, Delling, Goldberg & Werneck 2013).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.planner.grid.states import Search
from joulemap.planner.grid.traces import CODE, state_before
from joulemap.planner.grid.turning_search import DROVE, TURNED_LEFT, TURNED_RIGHT
from joulemap.planner.pricing.moves import MoveTable

_NONE = -1


def plateaus(
    ahead: Search, behind: Search, table: MoveTable, reached: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return the stretches of moves that two searches share.

    `reached` (n,): states that the search towards the goal has reached. Returns `states` (n,): the state that each
    plateau begins with; `via` (n,): energy of the best path through it [J]; `length` (n,): energy of the plateau [J];
    `middle` (n,): the cell half-way along it.
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
    following = state_before(behind_pred, state, jump, layers, True)
    if following == _NONE:
        return _NONE
    code, came = behind_pred[state] & CODE, ahead_pred[following] & CODE
    if layers > 1 and code != DROVE:  # what turned right on the way back is a turn to the left on the way there
        code = TURNED_LEFT if code == TURNED_RIGHT else TURNED_RIGHT
    return following if came == code else _NONE


@njit(cache=True)
def _is_shared(state, ahead, ahead_pred, behind, behind_pred, jump, layers):
    """Whether the move by which the search from the start reached a state is one that the search back used too."""
    before = state_before(ahead_pred, state, jump, layers, False)
    if before == _NONE or not (ahead[before] < np.inf and behind[before] < np.inf):
        return False
    return _shared_next(before, ahead_pred, behind_pred, jump, layers) == state
