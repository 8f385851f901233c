"""Lower bounds in joules for the energy that is still to come.

Every move of a `MoveTable` satisfies  energy >= a_b * length + b * climb  for each tabulated rate b [J per metre of
climb], with a_b = bound_per_m the largest such number. Summed along any grid path from n to a cell m, the climbs
telescope to z_m - z_n and the lengths are at least the straight distance, so for a_b >= 0

    h_b(n) = a_b * |n - m| + b * (z_m - z_n)  <=  energy of every grid path from n to m                  (admissible)

and for a move n -> k, h_b(n) - h_b(k) <= a_b * length + b * climb <= energy                             (consistent).

The maximum of consistent bounds is consistent, and so is the minimum over several goal cells of the bound to each plus
what remains from there. b = 0 is the plain cheapest-metre bound; a large b counts the climb to a higher goal in full;
and where some prices are negative (regeneration), any b with a_b >= 0 is the height potential that makes
energy - b * climb >= 0 on every move, which is what Dijkstra needs (Johnson 1977; Sachenbacher et al., AAAI-11).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.errors import NegativeCycleError
from planner.moves import MoveTable


def energy_bounds(table: MoveTable) -> NDArray[np.float64]:
    """(B, 2) usable pairs (a_b [J/m], b [J per metre of climb]) for A*.

    Raises NegativeCycleError when no pair is usable: then no height potential makes the prices non-negative.
    """
    pairs = np.column_stack([table.bound_per_m, table.rate_j_per_m])
    usable = pairs[(pairs[:, 0] >= 0.0) & np.isfinite(pairs[:, 0])]
    if usable.size == 0 and np.isfinite(table.bound_per_m).any():
        cell = np.unravel_index(np.nanargmin(table.energy / table.length_m.astype(np.float32)), table.energy.shape)
        raise NegativeCycleError(
            "regeneration returns more than driving costs, whatever part of it is credited to height: "
            f"{table.energy[cell]:.1f} J for a move of {table.length_m[cell[2]]:.2f} m leaving row {cell[0]}, "
            f"column {cell[1]}; lower the robot's `regeneration`",
            row=int(cell[0]), col=int(cell[1]),
        )  # fmt: skip
    return usable if usable.size else np.zeros((1, 2))


def dijkstra_bounds(table: MoveTable) -> NDArray[np.float64]:
    """(1, 2) the pair (0, b) that turns A* into Dijkstra: b = 0, or the least height potential that is needed."""
    usable = energy_bounds(table)
    return np.array([[0.0, usable[:, 1].min()]])
