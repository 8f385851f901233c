"""OMPL's RRT*, Informed RRT* and BIT* on the lattice's own prices: directional, limits included, compiled.

The objectives count no turns (`ompl_problem`); the route that comes back is priced with them.

References: Karaman & Frazzoli 2011 (RRT*); Gammell, Srinivasa & Barfoot 2014 (Informed RRT*) and 2015 (BIT*); Sucan,
Moll & Kavraki 2012 (OMPL).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from joulemap.model.errors import InputError, NoRouteError
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, path_price
from joulemap.planner.sampling.ompl_problem import ompl_problem

MAX_TIME_LIMIT_S = 120.0
SLICE_S = 0.25
"""How often the best solution so far is recorded [s]."""
TREE_STEP_CELLS = 30.0
"""Longest leg that a tree planner adds. OMPL's own default, a fifth of the map, mostly ends on blocked ground."""


_ALGORITHMS = {"rrtstar": og.RRTstar, "informed_rrtstar": og.InformedRRTstar, "bitstar": og.BITstar}


def sample_route(
    lattice: CostLattice,
    start: Points,
    goal: Points,
    *,
    planner: str,
    time_limit_s: float,
    seed: int,
    progress: Callable[[float], None] | None,
) -> tuple[Points, dict[str, Any]]:
    """Return the path that a sampling planner finds within its time.

    `start`, `goal` (2,): fractional (row, col). Returns `points` (n, 2): (row, col) polyline from start to goal;
    `details`: JSON-able record: `sampling_seconds`, `legs_priced`, `seed`, `sampled_energy_j` [J], and `history`, the
    (seconds, energy [J]) of each best path. Raises NoRouteError if no path was found in time, which does not prove that
    there is none.
    """
    if not 0 <= seed < 2**31:
        raise InputError(f"`seed` must lie in 0..{2**31 - 1}, got {seed}", seed=str(seed))
    if not 0.0 < time_limit_s <= MAX_TIME_LIMIT_S:
        raise InputError(
            f"time_limit_s must lie in (0, {MAX_TIME_LIMIT_S:g}], got {time_limit_s}", time_limit_s=str(time_limit_s)
        )
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    ou.RNG.setSeed(seed + 1)  # OMPL takes no zero
    information, problem, legs_priced = ompl_problem(lattice, start, goal, in_ellipse=planner == "bitstar")
    solver = _ALGORITHMS[planner](information)
    if planner != "bitstar":
        solver.setRange(TREE_STEP_CELLS)
    solver.setProblemDefinition(problem)
    solver.setup()
    history: list[tuple[float, float]] = []
    points = None
    began = time.perf_counter()
    seconds = 0.0
    while seconds < time_limit_s:
        solver.solve(ob.timedPlannerTerminationCondition(min(SLICE_S, max(time_limit_s - seconds, 1e-3))))
        seconds = time.perf_counter() - began
        if progress is not None:
            progress(min(seconds / time_limit_s, 1.0))
        if problem.hasExactSolution():
            found = np.array([(s[0], s[1]) for s in problem.getSolutionPath().getStates()], dtype=np.float64)
            found[0], found[-1] = start, goal
            energy = path_price(lattice, found)
            if not history or energy < history[-1][1]:
                points = found
                history.append((round(seconds, 3), energy))
    if points is None:
        raise NoRouteError(
            f"{planner} found no route within {time_limit_s:g} s; allow more time, or use astar, which is complete",
            planner=planner,
            time_limit_s=time_limit_s,
        )
    return points, {
        "sampling_seconds": seconds,
        "legs_priced": legs_priced(),
        "seed": seed,
        "sampled_energy_j": path_price(lattice, points),
        "history": history,
    }
