"""Reach: where the battery lasts to, and where it lasts to and back.

An energy field over grid moves is a little dearer than the routes that a planner improves at any angle, and the
difference grows with the distance. So the routes to some cells (anchors) at certain energies of the field are improved
as a planner does it. Their ratios of energy needed to energy of the field, interpolated between them, correct the field
everywhere. Which cells are anchors depends on the field alone: what one battery reaches, a larger one reaches too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.threads import both, share_out
from joulemap.planner.any_angle.best import improved
from joulemap.planner.grid.fields import EnergyField, field_from, field_towards
from joulemap.planner.grid.search import joined_points
from joulemap.planner.grid.states import Search
from joulemap.planner.grid.traces import state_before
from joulemap.planner.lattice import CostLattice
from joulemap.planner.places import free_places
from joulemap.planner.pricing.integrator import Points
from joulemap.planner.pricing.moves import MoveTable
from joulemap.planner.pricing.potential import parts_of
from joulemap.planner.route import Route, in_sequence, price_route

Need = Callable[[Sequence[Route]], float]
"""Returns the energy [J] that a battery must have above its reserve for routes driven one after another."""

ANCHORS = 32
"""Of a ring: one for each heading of the moves, whose bias they correct."""
_STEP = 0.5 * math.log(2.0)
"""Step of the rings' energies, as a natural logarithm."""
_FIRST = 4
"""The nearest ring, in steps above the mean energy of a move."""


def peak_need(routes: Sequence[Route]) -> float:
    """Return the energy that must be there at the start of some routes, in the mean.

    `routes`: in the order of driving. Result: their energy [J], or more where energy that is regenerated comes too
    late.
    """
    spent = np.cumsum(np.concatenate([route.profile.energy_j for route in routes]))
    return float(max(spent.max(initial=0.0), spent[-1] if spent.size else 0.0))


@dataclass(frozen=True, eq=False)
class _Ring:
    """The anchors at one energy of the field.

    cells : (A, 2) row, col; ways : (A,) the routes to each of them; base_j : (A,) its energy in the field.
    """

    cells: NDArray[np.float64]
    ways: list[tuple[Route, ...]]
    base_j: NDArray[np.float64]


@dataclass(eq=False, repr=False)
class ReachField:
    """What it takes to drive from one place to every cell, or there and back; answers any battery.

    Attributes
    ----------
    lattice : CostLattice
        Prices and limits.
    base_j : ndarray of float64, (rows, cols)
        Energy over grid moves that must be there at the start [J]; inf where there is no route.
    out, back : EnergyField
        From the place, and towards it; `back` is None without a way back.
    """

    lattice: CostLattice
    base_j: NDArray[np.float64]
    out: EnergyField
    back: EnergyField | None
    _rings: dict[int, _Ring] = field(default_factory=dict)

    def margin_j(self, available_j: float, *, need: Need = peak_need) -> NDArray[np.float32]:
        """Return what is left of a battery at every cell, or after coming back from it.

        Parameters
        ----------
        available_j : float
            Energy above the reserve at the start [J].
        need : callable, optional
            What counts for a route; the mean energy by default. With a quantile of the energy, the battery lasts with
            that probability.

        Returns
        -------
        ndarray of float32, (rows, cols)
            Energy [J]: negative where the battery does not last, NaN where no route leads.
        """
        reachable = np.isfinite(self.base_j)
        needed = self.base_j * self._ratio(available_j, need)
        return np.where(reachable, available_j - needed, np.nan).astype(np.float32)

    def _ratio(self, available_j: float, need: Need) -> NDArray[np.float64]:
        """(rows, cols): energy needed over energy of the field, known around the border of the reach."""
        unit, out = self.out.table.typical_j, np.ones(self.base_j.shape)
        if available_j <= 0.0:
            return out
        nearest = np.empty(self.base_j.shape, dtype=np.float32)
        parts = parts_of(*self.lattice.frame.shape)

        def _number(part: slice) -> None:
            nearest[part] = np.rint(np.log(np.maximum(self.base_j[part], 1e-300) / unit) / _STEP)

        share_out(_number, parts)
        border = math.log(available_j / unit) / _STEP
        known: dict[int, NDArray[np.float64]] = {}
        low = high = max(round(border), _FIRST)
        while True:  # until every ring is known in which the ratios may put the border
            known |= {k: self._needs(k, need) for k in range(low, high + 1) if k not in known}
            ratios = np.concatenate([*known.values(), [1.0]])
            first = max(round(border - math.log(ratios.max()) / _STEP), _FIRST)
            last = max(round(border - math.log(max(ratios.min(), 1e-6)) / _STEP), _FIRST)
            if low <= first and last <= high:
                break
            low, high = min(low, first), max(high, last)
        rings = sorted(k for k, ratio in known.items() if ratio.size)

        def _fill(part: slice) -> None:
            for k in rings:
                low = k if k > rings[0] else -np.inf
                high = k if k < rings[-1] else np.finfo(np.float32).max
                inside = (nearest[part] >= low) & (nearest[part] <= high)
                _interpolate(self._rings[k].cells, known[k], inside, part.start, out[part])

        share_out(_fill, parts)
        return out

    def _needs(self, k: int, need: Need) -> NDArray[np.float64]:
        """(A,): energy needed over energy of the field at the anchors of a ring."""
        if k not in self._rings:
            self._rings[k] = self._ring(self.out.table.typical_j * math.exp(k * _STEP))
        ring = self._rings[k]
        return np.array([need(ways) for ways in ring.ways]) / ring.base_j

    def _ring(self, energy_j: float) -> _Ring:
        """Anchors, evenly spread over the cells just beyond an energy of the field, with their improved routes."""
        cells = _beyond(self.base_j, energy_j)
        if not len(cells):
            return _Ring(np.empty((0, 2)), [], np.empty(0))
        taken = cells[_spread(cells, ANCHORS)]
        return _Ring(taken.astype(np.float64), self._improved(taken), self.base_j[tuple(taken.T)])

    def _improved(self, cells: NDArray[np.int64]) -> list[tuple[Route, ...]]:
        """The improved routes to some cells, and back from them."""
        fields = [self.out] if self.back is None else [self.out, self.back]
        legs = [(cell, ways) for cell in cells for ways in fields]

        def _improve(leg: tuple[NDArray[np.int64], EnergyField]) -> Route:
            cell, ways = leg
            return self._route(improved(self.lattice, _way(ways, cell)))

        routes = share_out(_improve, legs)
        turn, each = self.lattice.robot.turn_j_per_rad, len(fields)
        return [in_sequence(routes[k : k + each], turn) for k in range(0, len(legs), each)]

    def _route(self, points: Points) -> Route:
        x, y = self.lattice.frame.xy(points[:, 0], points[:, 1])
        return price_route(self.lattice, np.column_stack([x, y]))


def reach_field(lattice: CostLattice, table: MoveTable, start: Points, *, round_trip: bool = False) -> ReachField:
    """Return what it takes to drive from one place to every cell, or there and back.

    `lattice`: prices and limits; `table`: priced moves of the lattice; `start` (2,): fractional (row, col);
    `round_trip`: whether it must come back to the start, by the best way back. Result: for any battery. Raises
    BlockedError if a round trip is asked for and no leg leads back to the start.
    """
    if round_trip:
        out, back = both(lambda: field_from(lattice, table, start), lambda: field_towards(lattice, table, start[None]))
        needed = np.asarray(out.energy_j + back.energy_j)
        if not table.never_pays:
            needed = np.maximum(_peaks(out), needed - _troughs(back))
    else:
        out, back = field_from(lattice, table, start), None
        needed = _peaks(out)
    return ReachField(lattice, np.where(free_places(lattice), needed, np.inf), out, back)


def _way(ways: EnergyField, cell: NDArray[np.int64]) -> Points:
    """The route of a field between its place and a cell, over grid moves, in the direction of driving."""
    search, cols = ways.search, ways.lattice.frame.cols
    flat = int(cell[0]) * cols + int(cell[1])
    states = search.energy_j[flat * search.layers : (flat + 1) * search.layers]
    path = search.trace(ways.table, flat * search.layers + int(np.argmin(states))) // search.layers
    here = cell.astype(np.float64)
    if search.backward:
        return joined_points(ways.lattice, here, path, ways.places[0])
    return joined_points(ways.lattice, ways.places[0], path[::-1], here)


def _beyond(energy_j: NDArray[np.float64], level_j: float) -> NDArray[np.int64]:
    """(n, 2): cells with a route that take more than an energy, next to cells that take less."""
    less = energy_j <= level_j
    near = np.zeros_like(less)
    near[1:] |= less[:-1]
    near[:-1] |= less[1:]
    near[:, 1:] |= less[:, :-1]
    near[:, :-1] |= less[:, 1:]
    return np.argwhere(near & ~less & np.isfinite(energy_j))


def _spread(cells: NDArray[np.int64], count: int) -> list[int]:
    """At most `count` of some cells: each time the one that is furthest from those taken before."""
    taken = [int(np.argmax(np.hypot(*(cells - cells.mean(axis=0)).T)))]
    away = np.full(len(cells), np.inf)
    while len(taken) < min(count, len(cells)):
        away = np.minimum(away, np.hypot(*(cells - cells[taken[-1]]).T))
        taken.append(int(np.argmax(away)))
    return taken


@njit(cache=True, nogil=True)
def _interpolate(cells, values, where, first, out):
    """Fill rows `first` and after by values at cells, weighted by the inverse fourth power of the distance.

    Reference: Shepard 1968.
    """
    rows, cols = out.shape
    for i in range(rows):
        for j in range(cols):
            if not where[i, j]:
                continue
            total, weight = 0.0, 0.0
            for k in range(values.size):
                square = (cells[k, 0] - first - i) ** 2 + (cells[k, 1] - j) ** 2 + 1.0
                share = 1.0 / (square * square)
                total += share * values[k]
                weight += share
            out[i, j] = total / weight


def _peaks(ways: EnergyField) -> NDArray[np.float64]:
    """(rows, cols): the largest energy used so far anywhere on the way from the place to a cell [J]."""
    return _extremes(ways, largest=True)


def _troughs(ways: EnergyField) -> NDArray[np.float64]:
    """(rows, cols): the least energy still to come anywhere on the way from a cell to the place [J]."""
    return _extremes(ways, largest=False)


def _extremes(ways: EnergyField, *, largest: bool) -> NDArray[np.float64]:
    search: Search = ways.search
    if ways.table.never_pays:
        return ways.energy_j if largest else np.where(np.isfinite(ways.energy_j), 0.0, np.inf)
    sign = 1.0 if largest else -1.0
    values = sign * _along(sign * search.energy_j, search.pred, ways.table.jump, search.layers, search.backward)
    states = values.reshape(-1, search.layers)
    best = search.energy_j.reshape(-1, search.layers).argmin(axis=1)
    return np.asarray(states[np.arange(len(states)), best].reshape(ways.lattice.frame.shape))


@njit(cache=True, nogil=True)
def _along(values, pred, jump, layers, backward):
    """(states,): the largest of 0 and the values on the way from the seed to each state; inf where there is none."""
    out = np.full(values.size, np.nan)
    way = np.empty(values.size, dtype=np.int64)
    for state in range(values.size):
        if not np.isfinite(values[state]):
            out[state] = np.inf
        depth = 0
        at = state
        while np.isnan(out[at]):
            before = state_before(pred, at, jump, layers, backward)
            if before < 0:
                out[at] = max(values[at], 0.0)
                break
            way[depth] = at
            depth += 1
            at = before
        for k in range(depth - 1, -1, -1):
            out[way[k]] = max(out[at], values[way[k]])
            at = way[k]
    return out
