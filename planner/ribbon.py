"""Detours a few cells beside a path, found by dynamic programming over a ribbon around it.

Stations at equal distances along the path are shifted to its sides, each by any of many offsets. The cheapest chain of
straight legs from station to station, of all combinations of offsets (Viterbi 1967), leaves the path where another way
beside it is cheaper, over ridges that no small shift crosses. Work and memory are proportional to the path's length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from joulemap.planner.deform import turn_sides
from joulemap.planner.edges import Points, price_arrays
from joulemap.planner.kernels import heading_memory, leg_energy_with
from joulemap.planner.lattice import CostLattice


@dataclass(frozen=True)
class Ribbon:
    """Where the stations of a path may go.

    Attributes
    ----------
    spacing : int
        Distance of the stations [vertices].
    half_width : float
        Largest offset to either side [cells].
    step : float
        Distance of two offsets [cells].
    slope : float
        Most change of the offset between two stations, as a share of their distance.
    """

    spacing: int
    half_width: float
    step: float
    slope: float


def ways_beside(lattice: CostLattice, vertices: Points, ribbon: Ribbon) -> list[tuple[int, int, Points]]:
    """Return where the cheapest chain through a ribbon leaves its path.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    vertices : ndarray of float, (n, 2)
        (row, col) polyline, its vertices about equally far from each other.
    ribbon : Ribbon
        Where the stations may go.

    Returns
    -------
    list of (int, int, ndarray of float, (m, 2))
        Of each way the vertices at which it leaves and joins the path, and its (row, col) polyline between them, both
        included. Turns are not counted.
    """
    count = max(round((len(vertices) - 1) / ribbon.spacing), 1)
    places = np.round(np.linspace(0, len(vertices) - 1, count + 1)).astype(np.int64)
    if places.size < 3:
        return []
    offsets = int(ribbon.half_width / ribbon.step)
    never_pays = lattice.robot.regeneration == 0.0
    chain, shifted = _cheapest(*price_arrays(lattice), vertices[places], offsets, ribbon.step, ribbon.slope, never_pays)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], shifted, [False]]).astype(np.int8)))
    return [
        (int(places[first - 1]), int(places[after]), chain[first - 1 : after + 1])
        for first, after in zip(edges[::2], edges[1::2], strict=True)
    ]


@njit(cache=True, nogil=True)
def _cheapest(traction, gradient, blocked, terms, stations, offsets, step, slope, never_pays):
    """The cheapest chain, (n, 2), and where it is shifted, (n,).

    offsets : their number to either side; never_pays : no price is negative.
    """
    n, width = stations.shape[0], 2 * offsets + 1
    side = np.zeros((n, 2))
    turn_sides(stations, side, 0.0, 0, n)
    memory = heading_memory(traction.shape[2])
    least = np.full(width, np.inf)
    least[offsets] = 0.0
    came = np.full((n, width), offsets, dtype=np.int64)
    for s in range(1, n):
        ahead = np.full(width, np.inf)
        length = math.hypot(stations[s, 0] - stations[s - 1, 0], stations[s, 1] - stations[s - 1, 1])
        reach = max(int(slope * length / step), 1)
        for a in range(width):
            if least[a] == np.inf:
                continue
            row0, col0 = _shifted(stations, side, s - 1, (a - offsets) * step)
            low, high = (offsets, offsets + 1) if s == n - 1 else (max(a - reach, 0), min(a + reach + 1, width))
            for b in range(low, high):
                row1, col1 = _shifted(stations, side, s, (b - offsets) * step)
                most = ahead[b] - least[a] if never_pays else math.inf
                energy = leg_energy_with(memory, traction, gradient, blocked, terms, row0, col0, row1, col1, most)
                if least[a] + energy < ahead[b]:  # not where the leg may not be driven: NaN
                    ahead[b], came[s, b] = least[a] + energy, a
        least = ahead
    chain, shifted = stations.copy(), np.zeros(n, dtype=np.bool_)
    if least[offsets] == np.inf:
        return chain, shifted
    a = offsets
    for s in range(n - 1, 0, -1):
        a = came[s, a]
        shifted[s - 1] = a != offsets
        chain[s - 1] = _shifted(stations, side, s - 1, (a - offsets) * step)
    return chain, shifted


@njit(cache=True)
def _shifted(stations, side, s, offset):
    return stations[s, 0] + offset * side[s, 0], stations[s, 1] + offset * side[s, 1]
