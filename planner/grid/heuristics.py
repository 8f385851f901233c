"""Lower bounds [J] of the energy that is still to come.

Every move of a `MoveTable` satisfies  energy >= a_s * length + s * rise  for each tabulated share s of the rise of its
surface p, with a_s = bound_per_m the largest such number. Summed along any grid path from n to a cell m, the rises
telescope to p_m - p_n and the lengths are at least the straight distance, so for a_s >= 0

    h_s(n) = a_s * |n - m| + s * (p_m - p_n)  <=  energy of every grid path from n to m                  (admissible)

and for a move n -> k, h_s(n) - h_s(k) <= a_s * length + s * rise <= energy                              (consistent).

A goal g joined to several cells m, each with r_m still to drive, has one bound for all: with
c_s = min over m of (r_m + s p_m - a_s |m - g|),

    h_s(n) = a_s * |n - g| - s p_n + c_s  <=  a_s * |n - m| + s * (p_m - p_n) + r_m  for every m  (triangle inequality).

The maximum of consistent bounds is consistent. s = 0 is the plain bound by the cheapest metre. s = 1 counts the climb
to a higher goal in full. Where some prices are negative (regeneration), any s with a_s >= 0 is the height potential
that makes energy - s * rise >= 0 on every move, which is what Dijkstra needs (Johnson 1977; Sachenbacher et
al. 2011). `potential.py` makes the surface such that s = 1 is one of them wherever there is any.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.grid.buckets import Guide
from joulemap.planner.pricing.integrator import Points
from joulemap.planner.pricing.moves import MoveTable
from joulemap.planner.pricing.tiles import reserved


def energy_bounds(table: MoveTable) -> NDArray[np.float64]:
    """Return the bounds that A* may use. Result (B, 2): pairs (a_s [J/m], s) with a_s >= 0."""
    pairs = np.column_stack([table.bound_per_m, table.rise_share])
    usable = pairs[(pairs[:, 0] >= 0.0) & np.isfinite(pairs[:, 0])]
    return usable if usable.size else np.zeros((1, 2))  # no move at all


def dijkstra_bounds(table: MoveTable) -> NDArray[np.float64]:
    """Return the bound that turns A* into Dijkstra's search.

    Result (1, 2): the pair (0, s): s = 0, or the least share of the rise that negative prices need.
    """
    usable = energy_bounds(table)
    return np.array([[0.0, usable[:, 1].min()]])


def guide_towards(
    table: MoveTable,
    bounds: NDArray[np.float64],
    goal: Points,
    targets: NDArray[np.int64],
    rest: NDArray[np.float64],
    spacing_m: float,
) -> Guide:
    """Return the bounds that lead a search to a goal.

    `bounds` (B, 2): pairs (a_s [J/m], s), from `energy_bounds` or `dijkstra_bounds`; `goal` (2,): fractional (row,
    col); `targets` (T,): flat cells that the goal is joined to; `rest` (T,): energy from each of them to the goal [J].
    """
    surface = table.surface.ravel()
    if table.tiles is not None and table.lead is not None:
        known = table.tiles.bounds(table.lead(goal, targets, rest))
        return Guide(np.zeros((0, 2)), np.zeros(0), np.ascontiguousarray(goal), surface, known)
    pairs = bounds * [[spacing_m, 1.0]]  # [J per cell length]
    row, col = np.divmod(targets, table.energy.shape[1])
    away = np.hypot(row - goal[0], col - goal[1])
    least = (rest + pairs[:, 1:] * surface[targets] - pairs[:, :1] * away).min(axis=1, initial=np.inf)
    return Guide(pairs, least, np.ascontiguousarray(goal), surface, _unknown(table))


def guide_everywhere(table: MoveTable, *, backward: bool) -> Guide:
    """Return the bounds for a search to all cells: none, or the potential that negative prices need.

    Reference: Johnson 1977.
    """
    pairs = dijkstra_bounds(table) * ([[1.0, -1.0]] if backward else [[1.0, 1.0]])
    pairs = pairs[pairs[:, 1] != 0.0]
    surface = table.surface.ravel()
    return Guide(pairs, np.zeros(len(pairs)), np.zeros(2), surface, _unknown(table) if len(pairs) else np.zeros(0))


def _unknown(table: MoveTable) -> NDArray[np.float64]:
    """Bounds of which none was computed yet: memory that is never touched costs nothing."""
    size = table.surface.size
    return np.zeros(size) if table.tiles is None else reserved((size,), np.dtype(np.float64)).array
