"""Lower bounds in joules for the energy that is still to come.

Every move of a `MoveTable` satisfies  energy >= a_b * length + b * climb  for each tabulated rate b [J per metre of
climb], with a_b = bound_per_m the largest such number. Summed along any grid path from n to a cell m, the climbs
telescope to z_m - z_n and the lengths are at least the straight distance, so for a_b >= 0

    h_b(n) = a_b * |n - m| + b * (z_m - z_n)  <=  energy of every grid path from n to m                  (admissible)

and for a move n -> k, h_b(n) - h_b(k) <= a_b * length + b * climb <= energy                             (consistent).

The maximum of consistent bounds is consistent, and so is the minimum over several goal cells of the bound to each plus
what remains from there. b = 0 is the plain cheapest-metre bound; a large b counts the climb to a higher goal in full;
and where some prices are negative (regeneration), any b with a_b >= 0 is the height potential that makes
energy - b * climb >= 0 on every move, which is what Dijkstra needs (Johnson 1977; Sachenbacher et al., AAAI-11). Prices
come from metre-long slopes blended between cells, so on rough ground no b may do; then `moves.least_potential` takes
the place of the elevation, with a = 0 and b = 1, and the same proofs hold.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.moves import MoveTable


def energy_bounds(table: MoveTable) -> NDArray[np.float64]:
    """(B, 2) usable pairs (a_b [J/m], b [J per unit of climb]) for A*."""
    pairs = np.column_stack([table.bound_per_m, table.rate_j_per_m])
    usable = pairs[(pairs[:, 0] >= 0.0) & np.isfinite(pairs[:, 0])]
    return usable if usable.size else np.zeros((1, 2))  # no move at all


def dijkstra_bounds(table: MoveTable) -> NDArray[np.float64]:
    """(1, 2) the pair (0, b) that turns A* into Dijkstra: b = 0, or the least height potential that is needed."""
    usable = energy_bounds(table)
    return np.array([[0.0, usable[:, 1].min()]])
