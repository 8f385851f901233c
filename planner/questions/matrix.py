"""Energies and lengths between many places: one energy field for each start or goal, not one search for each pair."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import NoRouteError
from joulemap.planner.grid.fields import field_from, field_towards
from joulemap.planner.grid.search import GridPath
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points
from joulemap.planner.pricing.moves import MoveTable

Place = Points | str
"""A start or a goal: fractional (row, col), or why no route begins or ends there."""
_DEARER = "another goal takes less energy, and only the cheapest one was asked for"


@dataclass(frozen=True, eq=False)
class Matrix:
    """Ways from n starts to m goals over grid moves.

    Attributes
    ----------
    energies_j : ndarray of float, (n, m)
        Least energy [J]; infinite where there is no way, or none was asked for.
    lengths_m : ndarray of float, (n, m)
        Horizontal length of that way [m]; likewise.
    reasons : list of list of str or None, (n, m)
        Why an energy is infinite.
    """

    energies_j: NDArray[np.float64]
    lengths_m: NDArray[np.float64]
    reasons: list[list[str | None]]


def energy_matrix(
    lattice: CostLattice,
    table: MoveTable,
    starts: Sequence[Place],
    goals: Sequence[Place],
    *,
    only_cheapest: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Matrix:
    """Return the least energies between starts and goals.

    `lattice`: prices and limits; `table`: priced moves of the lattice; `starts`, `goals` (2,): fractional (row, col);
    or why no route begins or ends there; `only_cheapest`: whether only the goal of least energy is found for each
    start, by a single search; `progress`: called with the share of the searches that is done, 0..1. Result: energies
    [J], lengths [m] and reasons.
    """
    energies, lengths = (np.full((len(starts), len(goals)), np.inf) for _ in range(2))
    begin, end = ({k: place for k, place in enumerate(some) if not isinstance(place, str)} for some in (starts, goals))
    if only_cheapest:
        ways = _cheapest(lattice, table, begin, end)
    elif len(end) <= len(begin):
        ways = _towards(lattice, table, begin, end)
    else:
        ways = _from(lattice, table, begin, end)
    searches = min(1 if only_cheapest else len(end), len(begin))
    for done, found in enumerate(ways, 1):
        for i, j, path in found:
            energies[i, j] = path.energy_j
            lengths[i, j] = lattice.frame.resolution_m * np.hypot(*np.diff(path.points, axis=0).T).sum()
        if progress is not None:
            progress(done / searches)

    def _reason(i: int, j: int) -> str | None:
        if np.isfinite(energies[i, j]):
            return None
        blocked = next((place for place in (starts[i], goals[j]) if isinstance(place, str)), None)
        if blocked is None and only_cheapest and np.isfinite(energies[i]).any():
            return _DEARER
        return blocked or f"no way leads from start {i} to goal {j} within the limits of {lattice.robot.name}"

    return Matrix(energies, lengths, [[_reason(i, j) for j in range(len(goals))] for i in range(len(starts))])


_Ways = Iterator[list[tuple[int, int, GridPath]]]
_Ends = dict[int, Points]


def _towards(lattice: CostLattice, table: MoveTable, starts: _Ends, goals: _Ends) -> _Ways:
    """By a field towards each goal."""
    for j, goal in goals.items():
        field = field_towards(lattice, table, goal[None])
        yield [(i, j, path) for i, start in starts.items() if (path := _way(field.path_from, start)) is not None]


def _from(lattice: CostLattice, table: MoveTable, starts: _Ends, goals: _Ends) -> _Ways:
    """By a field from each start."""
    for i, start in starts.items():
        field = field_from(lattice, table, start)
        yield [(i, j, path) for j, goal in goals.items() if (path := _way(field.path_to, goal)) is not None]


def _cheapest(lattice: CostLattice, table: MoveTable, starts: _Ends, goals: _Ends) -> _Ways:
    """By one field towards the nearest of all goals, in energy."""
    if not starts or not goals:
        return
    numbers, places = list(goals), np.array(list(goals.values()))
    field = field_towards(lattice, table, places)
    ways = {i: path for i, start in starts.items() if (path := _way(field.path_from, start)) is not None}
    yield [(i, numbers[int(np.argmin(np.abs(places - path.points[-1]).max(axis=1)))], path) for i, path in ways.items()]


def _way(traced: Callable[[Points], GridPath], place: Points) -> GridPath | None:
    try:
        return traced(place)
    except NoRouteError:
        return None
