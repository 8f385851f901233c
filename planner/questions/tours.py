"""Tours: from home to several places, and back, in the order that costs least or as given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import BusyError, InputError, NoRouteError
from joulemap.model.ranges import MAX_STOPS
from joulemap.planner.grid.fields import field_towards
from joulemap.planner.grid.search import GridPath
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points
from joulemap.planner.pricing.moves import MoveTable


@dataclass(frozen=True, eq=False, repr=False)
class Tour:
    """The cheapest tour over grid moves.

    Attributes
    ----------
    order : ndarray of int, (n,)
        Which stop is visited when, home (stop 0) first.
    paths : list of GridPath
        From each stop to the next, the last one back home unless the tour is one way.
    energy_j : float
        Their sum [J].
    bound_j : float
        Proven lower bound of a tour over these moves [J]; equal to `energy_j` (to rounding) when the order is proven
        to be the best, or was given.
    """

    order: NDArray[np.int64]
    paths: list[GridPath]
    energy_j: float
    bound_j: float


def cheapest_tour(
    lattice: CostLattice,
    table: MoveTable,
    stops: Points,
    *,
    in_order: bool = False,
    one_way: bool = False,
    time_limit_s: float = 10.0,
    progress: Callable[[float], None] | None = None,
) -> Tour:
    """Return the cheapest tour from the first stop over all others.

    What turning at a stop costs is not counted.

    `lattice`: prices and limits; `table`: priced moves of the lattice; `stops` (n, 2): fractional (row, col) of 2 to
    `MAX_STOPS` stops; `in_order`: visit them as they are given; `one_way`: end at the last of them and do not come
    home; `time_limit_s`: longest time for the search of the order [s]; `progress`: called with the share
    that is done, 0..1. Result: the order and the paths. Raises InputError if the number of stops is out of range, or
    OR-tools is not installed. Raises BlockedError if no leg reaches a stop. Raises NoRouteError if no route joins two
    stops; the message names them. Raises BusyError if the time limit leaves no tour.

    One energy field towards each stop gives the energies between all of them, which on a slope are not the same both
    ways. OR-tools' CP-SAT then finds the order over a circuit constraint, exactly unless the time runs out: the
    asymmetric travelling salesman problem.
    """
    if not 2 <= len(stops) <= MAX_STOPS:
        raise InputError(f"a tour has 2 to {MAX_STOPS} stops, got {len(stops)}", stops=len(stops), limit=[2, MAX_STOPS])
    last = len(stops) - 1
    energies = np.zeros((len(stops), len(stops)))
    paths: dict[tuple[int, int], GridPath] = {}
    for j, goal in enumerate(stops):
        before = [(j or last + 1) - 1] if in_order else [i for i in range(last + 1) if i != j]
        before = [i for i in before if not (one_way and j == 0)]
        field = field_towards(lattice, table, goal[None]) if before else None
        for i in before:
            assert field is not None
            try:
                paths[i, j] = field.path_from(stops[i])
            except NoRouteError as error:
                raise NoRouteError(
                    f"no route leads from stop {i} to stop {j} of the tour within the limits of {lattice.robot.name}",
                    stops=[i, j],
                ) from error
            energies[i, j] = paths[i, j].energy_j
        if progress is not None:
            progress((j + 1) / (len(stops) + 1))
    order, bound = (np.arange(last + 1), None) if in_order else _best_order(energies, time_limit_s, one_way=one_way)
    hops = zip(order, np.roll(order, -1), strict=True)
    legs = [paths[int(i), int(j)] for i, j in hops if (i, j) in paths]
    if progress is not None:
        progress(1.0)
    energy = float(sum(leg.energy_j for leg in legs))
    return Tour(order, legs, energy, energy if bound is None else bound)


def _best_order(
    energies_j: NDArray[np.float64], time_limit_s: float, *, one_way: bool
) -> tuple[NDArray[np.int64], float]:
    """The cheapest circuit from stop 0, and a lower bound of its energy [J]; `one_way`: the last stop closes it."""
    try:
        from ortools.sat.python import cp_model
    except ImportError as error:
        raise InputError("a tour needs OR-tools: install joulemap with its extra `tours`", extra="tours") from error
    n = len(energies_j)
    unit_j = max(float(np.abs(energies_j).max()), 1e-9) / 1e9  # CP-SAT counts in whole numbers
    model = cp_model.CpModel()
    arcs = [(i, j, model.new_bool_var(f"{i} to {j}")) for i in range(n) for j in range(n) if i != j]
    model.add_circuit(arcs)
    if one_way:
        model.add(sum(taken for i, j, taken in arcs if (i, j) == (n - 1, 0)) == 1)
    model.minimize(sum(round(energies_j[i, j] / unit_j) * taken for i, j, taken in arcs))
    solver = cp_model.CpSolver()
    solver.parameters.max_time_in_seconds = time_limit_s
    solver.parameters.num_workers = 1
    solver.parameters.random_seed = 0
    status = solver.solve(model)
    if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        raise BusyError(f"no tour was found within {time_limit_s:g} s: allow more time", retry_after_s=1)
    following = {i: j for i, j, taken in arcs if solver.value(taken)}
    order = [0]
    while following[order[-1]] != 0:
        order.append(following[order[-1]])
    return np.array(order), min(solver.best_objective_bound, solver.objective_value) * unit_j
