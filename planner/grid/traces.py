"""The way by which a search came to a state: read from its codes."""

from __future__ import annotations

import numpy as np
from numba import njit

from joulemap.planner.grid.buckets import SETTLED

CODE = SETTLED - 1
"""The bits of `pred` that say how a state was reached; 0 for a seed."""


@njit(cache=True, nogil=True)
def state_before(pred, state, jump, layers, backward):
    """Return the state that one was reached from, -1 for a seed.

    `pred` (states,): codes as `search_cells` and `search_headings` left them; `jump` (N,): step of each move in flat
    indices.
    """
    code = np.int64(pred[state]) & CODE
    if code == 0:
        return -1
    if code <= jump.size:
        return state + (1 if backward else -1) * jump[code - 1] * layers
    heading = state % layers
    other = heading - 1 if code == jump.size + 1 else heading + 1
    return state - heading + (other + layers) % layers


@njit(cache=True, nogil=True)
def states_before(pred, states, jump, layers, backward):
    """Return the states that some (n,) were reached from, as `state_before`: (n,)."""
    out = np.empty(states.size, dtype=np.int64)
    for k in range(states.size):
        out[k] = state_before(pred, states[k], jump, layers, backward)
    return out


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
