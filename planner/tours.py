"""Round trips: from home to several places and back, in the order that costs least."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import BusyError, InputError, NoRouteError
from joulemap.planner.edges import Points
from joulemap.planner.fields import field_towards
from joulemap.planner.lattice import CostLattice
from joulemap.planner.moves import MoveTable
from joulemap.planner.search import GridPath

MAX_STOPS = 60


@dataclass(frozen=True, eq=False, repr=False)
class Tour:
    """The cheapest round trip over grid moves.

    order : (n,) which stop is visited when, home (stop 0) first. paths : n, from each stop to the next, the last one
    back home. energy_j : their sum. bound_j : what no tour over these moves costs less than; equal to `energy_j` (to
    rounding) when the order is proven. energies_j : (n, n) [J] from each stop (row) to each other one.
    """

    order: NDArray[np.int64]
    paths: list[GridPath]
    energy_j: float
    bound_j: float
    energies_j: NDArray[np.float64]


def cheapest_tour(
    lattice: CostLattice,
    table: MoveTable,
    stops: Points,
    *,
    time_limit_s: float = 10.0,
    progress: Callable[[float], None] | None = None,
) -> Tour:
    """Visit all stops (n, 2) (row, col) and come home to the first one.

    One energy field towards each stop gives the energies between all of them, which on a slope are not the same both
    ways; OR-tools' CP-SAT then finds the order over a circuit constraint, exactly unless the time runs out. What
    turning on arrival at a stop costs is not counted. Raises NoRouteError naming two stops that no route joins,
    InputError on a bad number of stops, BusyError where the time limit leaves no tour, BlockedError.
    """
    if not 2 <= len(stops) <= MAX_STOPS:
        raise InputError(f"a tour has 2 to {MAX_STOPS} stops, got {len(stops)}", stops=len(stops), limit=[2, MAX_STOPS])
    energies = np.zeros((len(stops), len(stops)))
    paths: dict[tuple[int, int], GridPath] = {}
    for j, goal in enumerate(stops):
        field = field_towards(lattice, table, goal[None])
        for i, start in enumerate(stops):
            if i == j:
                continue
            try:
                paths[i, j] = field.path_from(start)
            except NoRouteError as error:
                raise NoRouteError(
                    f"no route leads from stop {i} to stop {j} of the tour within the limits of {lattice.robot.name}",
                    stops=[i, j],
                ) from error
            energies[i, j] = paths[i, j].energy_j
        if progress is not None:
            progress((j + 1) / (len(stops) + 1))
    order, bound = _best_order(energies, time_limit_s)
    legs = [paths[int(i), int(j)] for i, j in zip(order, np.roll(order, -1), strict=True)]
    if progress is not None:
        progress(1.0)
    return Tour(order, legs, float(sum(leg.energy_j for leg in legs)), bound, energies)


def _best_order(energies_j: NDArray[np.float64], time_limit_s: float) -> tuple[NDArray[np.int64], float]:
    """The cheapest circuit from stop 0, and a proven lower bound of its energy [J]."""
    try:
        from ortools.sat.python import cp_model
    except ImportError as error:
        raise InputError("a tour needs OR-tools: install joulemap with its extra `tours`", extra="tours") from error
    n = len(energies_j)
    unit_j = max(float(np.abs(energies_j).max()), 1e-9) / 1e9  # CP-SAT counts in whole numbers
    model = cp_model.CpModel()
    arcs = [(i, j, model.new_bool_var(f"{i} to {j}")) for i in range(n) for j in range(n) if i != j]
    model.add_circuit(arcs)
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
