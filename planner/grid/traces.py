"""The way by which a search came to a state, with or without turning: read from its codes."""

from __future__ import annotations

import numpy as np
from numba import njit

from joulemap.planner.grid.buckets import SETTLED
from joulemap.planner.grid.turning_search import DROVE, TURNED_RIGHT

CODE = SETTLED - 1
"""The bits of `pred` that say how a state was reached; 0 for a seed."""


@njit(cache=True, nogil=True)
def state_before(pred, state, jump, layers, backward):
    """Return the state that one was reached from, -1 for a seed.

    `pred` (states,): codes as `search_cells` or, where `layers` is not 1, `search_headings` left them; `jump` (N,):
    step of each move in flat indices.
    """
    code = np.int64(pred[state]) & CODE
    if code == 0:
        return -1
    way = 1 if backward else -1
    if layers == 1:
        return state + way * jump[code - 1]
    heading = state % layers
    if code == DROVE:
        return state + way * jump[heading] * layers
    other = heading - 1 if code == TURNED_RIGHT else heading + 1
    return state - heading + (other + layers) % layers


@njit(cache=True, nogil=True)
def trace(pred, last, jump, layers, backward):
    """Return the states from one to the seed that it was reached from: (n,), `last` first; others as `state_before`."""
    count, state = 0, last
    while state >= 0:
        count, state = count + 1, state_before(pred, state, jump, layers, backward)
    out, state = np.empty(count, dtype=np.int64), last
    for k in range(count):
        out[k] = state
        state = state_before(pred, state, jump, layers, backward)
    return out
