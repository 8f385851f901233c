"""Detours a few cells beside a path, found by dynamic programming over a ribbon around it.

Stations at equal distances along the path are shifted to its sides, each by any of many offsets. The cheapest chain of
straight legs from station to station, of all combinations of offsets (Viterbi 1967), leaves the path where another way
beside it is cheaper, over ridges that no small shift crosses. Searched from both ends, the ribbon gives the cheapest
chain through each of its places: the valleys of these prices are further ways, a little dearer as chains of straight
legs, which may be cheaper once their vertices have settled. Work and memory are proportional to the path's length.
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
from joulemap.planner.polylines import stretches

CHAINS = 10
"""Most chains through a ribbon: the cheapest, and those through the lowest valleys."""
LEAST_DISTANCE = 1.0
"""Least distance of a valley from the path and from chains that were found before [cells]: within it, vertices settle
by themselves."""
_CHANGES = np.array([0, *(sign * lanes for lanes in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32) for sign in (1, -1))])
"""Changes of the lane from one station to the next: the steeper a leg, the less it matters how steep exactly."""


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


def ways_beside(
    lattice: CostLattice, vertices: Points, ribbon: Ribbon, *, slack_j: float = 0.0
) -> list[tuple[int, int, Points]]:
    """Return where the cheapest chain through a ribbon leaves its path, and where chains through its valleys do.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    vertices : ndarray of float, (n, 2)
        (row, col) polyline, its vertices about equally far from each other.
    ribbon : Ribbon
        Where the stations may go.
    slack_j : float, default 0
        Most energy of a chain beyond that of the cheapest [J]; with 0 the cheapest is the only one.

    Returns
    -------
    list of (int, int, ndarray of float, (m, 2))
        Of each way the vertices at which it leaves and joins the path, and its (row, col) polyline between them, both
        included; ways may overlap. Turns are not counted.
    """
    count = max(round((len(vertices) - 1) / ribbon.spacing), 1)
    places = np.round(np.linspace(0, len(vertices) - 1, count + 1)).astype(np.int64)
    if places.size < 3:
        return []
    offsets = int(ribbon.half_width / ribbon.step)
    stations = vertices[places]
    legs, side = _leg_prices(
        *price_arrays(lattice),
        stations,
        offsets,
        ribbon.step,
        ribbon.slope,
        slack_j,
        lattice.robot.regeneration == 0.0,
    )
    shifts = _chains(legs, offsets, slack_j, max(int(LEAST_DISTANCE / ribbon.step), 1)) - offsets
    ways: dict[tuple[int, int, bytes], Points] = {}
    for shift in shifts:
        for first, after in stretches(shift != 0):
            part = slice(first - 1, after + 1)  # with a station on the path at either end
            way = stations[part] + (shift[part] * ribbon.step)[:, None] * side[part]
            ways[int(places[first - 1]), int(places[after]), shift[part].tobytes()] = way
    return [(first, last, way) for (first, last, _), way in ways.items()]


@njit(cache=True, nogil=True)
def _leg_prices(traction, gradient, blocked, terms, stations, offsets, step, slope, slack_j, never_pays):
    """Energies of legs between neighbouring stations [J], (n, width, most legs), and the direction to the side, (n, 2).

    Of a leg to station s: [s, lane from, lane to - lane from + reach], infinite where it may not be driven or is in no
    chain that is cheap enough. offsets : their number to either side; never_pays : no price is negative.
    """
    n, width = stations.shape[0], 2 * offsets + 1
    side, longest = np.zeros((n, 2)), 0.0
    turn_sides(stations, side, 0.0, 0, n)
    for s in range(1, n):
        longest = max(longest, math.hypot(stations[s, 0] - stations[s - 1, 0], stations[s, 1] - stations[s - 1, 1]))
    reach = max(int(slope * longest / step), 1)
    legs = np.full((n, width, 2 * reach + 1), np.inf)
    memory = heading_memory(traction.shape[2])
    least = np.full(width, np.inf)
    least[offsets] = 0.0
    for s in range(1, n):
        ahead = np.full(width, np.inf)
        for a in range(width):
            if least[a] == np.inf:
                continue
            row0, col0 = _shifted(stations, side, s - 1, (a - offsets) * step)
            for change in _CHANGES:
                b = a + change
                if not -reach <= change <= reach or not 0 <= b < width or (s == n - 1 and b != offsets):
                    continue  # the end stays where it is
                row1, col1 = _shifted(stations, side, s, (b - offsets) * step)
                most = ahead[b] + slack_j - least[a] if never_pays else math.inf
                energy = leg_energy_with(memory, traction, gradient, blocked, terms, row0, col0, row1, col1, most)
                if energy <= most:  # not where the leg may not be driven: NaN
                    legs[s, a, change + reach] = energy
                    ahead[b] = min(ahead[b], least[a] + energy)
        least = ahead
    return legs, side


@njit(cache=True, nogil=True)
def _chains(legs, offsets, slack_j, distance):
    """Lanes of the cheapest chain and of those through valleys, (k, n); lane `offsets` is the path itself.

    offsets : lanes to either side of the path; distance : least number of lanes between two valleys.
    """
    n, width, reach = legs.shape[0], legs.shape[1], legs.shape[2] // 2
    came = np.full((n, width), offsets, dtype=np.int64)
    gone = came.copy()
    through, back = np.full((n, width), np.inf), np.full((n, width), np.inf)
    through[0, offsets] = back[n - 1, offsets] = 0.0
    for s in range(1, n):
        for a in range(width):
            for b in range(max(a - reach, 0), min(a + reach + 1, width)):
                total = through[s - 1, a] + legs[s, a, b - a + reach]
                if total < through[s, b]:
                    through[s, b], came[s, b] = total, a
    for s in range(n - 1, 0, -1):
        for a in range(width):
            for b in range(max(a - reach, 0), min(a + reach + 1, width)):
                total = legs[s, a, b - a + reach] + back[s, b]
                if total < back[s - 1, a]:
                    back[s - 1, a], gone[s - 1, a] = total, b
    through += back
    lanes = np.full((CHAINS, n), offsets, dtype=np.int64)
    near = np.zeros((n, width), dtype=np.bool_)  # a chain that was found, or the path
    near[:, max(offsets - distance, 0) : offsets + distance + 1] = True
    if through[0, offsets] == np.inf:
        return lanes[:0]
    most, at, lane = through[0, offsets] + slack_j, n - 1, offsets
    for k in range(CHAINS):
        lanes[k, at] = lane
        for s in range(at, 0, -1):
            lanes[k, s - 1] = came[s, lanes[k, s]]
        for s in range(at, n - 1):
            lanes[k, s + 1] = gone[s, lanes[k, s]]
        for s in range(n):
            near[s, max(lanes[k, s] - distance, 0) : lanes[k, s] + distance + 1] = True
        at, lowest = -1, most
        for s in range(1, n - 1):
            for a in range(width):
                here = through[s, a]
                if here < lowest and not near[s, a]:
                    left = through[s, a - 1] if a > 0 else np.inf
                    right = through[s, a + 1] if a < width - 1 else np.inf
                    if left >= here and right >= here:
                        lowest, at, lane = here, s, a
        if at < 0:
            return lanes[: k + 1]
    return lanes


@njit(cache=True)
def _shifted(stations, side, s, offset):
    return stations[s, 0] + offset * side[s, 0], stations[s, 1] + offset * side[s, 1]
