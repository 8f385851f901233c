"""OMPL's RRT*, Informed RRT* and BIT* on the lattice's own prices: directional, limits included, compiled.

The objectives count no turns (`ompl_problem`); the route that comes back is priced with them. Started from the grid,
RRT* samples only where the grid's two energy fields leave room for a better path, and BIT* in a corridor around the
grid's path, then in ever narrower ones around its own.

References: Karaman & Frazzoli 2011 (RRT*); Gammell, Srinivasa & Barfoot 2014 (Informed RRT*) and 2015 (BIT*); Sucan,
Moll & Kavraki 2012 (OMPL).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from joulemap.model.errors import InputError, NoRouteError
from joulemap.planner.grid.fields import field_from, field_towards
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, path_price
from joulemap.planner.pricing.moves import MoveTable
from joulemap.planner.pricing.polylines import subdivided
from joulemap.planner.sampling.ompl_problem import ompl_problem

MAX_TIME_LIMIT_S = 120.0
SUBSET_MARGIN = 0.03
"""The grid's best path through a place of a better any-angle path costs at most this share more than its best path: on
even ground 16 headings are 2.75 % longer than any angle."""
CORRIDORS_CELLS = (2.0, 1.0, 0.5)
"""Half widths of the corridors in which BIT* is started from the grid, each for an equal share of the time."""
_CORRIDOR_CUTS, _CORRIDOR_BATCH = 4, 300
"""Pieces that a cell's side is cut into to draw a corridor, and the number of samples in a batch of BIT* in one."""
SLICE_S = 0.25
"""How often the best solution so far is recorded [s]."""
TREE_STEP_CELLS = 30.0
"""Longest leg that a tree planner adds. OMPL's own default, a fifth of the map, mostly ends on blocked ground."""


_ALGORITHMS = {"rrtstar": og.RRTstar, "informed_rrtstar": og.InformedRRTstar, "bitstar": og.BITstar}


def informed_subset(lattice: CostLattice, table: MoveTable, start: Points, goal: Points) -> NDArray[np.bool_]:
    """Return the cells through which the grid's best path costs at most `SUBSET_MARGIN` more than its best path of all.

    `start`, `goal` (2,): fractional (row, col). The result is (rows, cols).

    Reference: Gammell et al. 2014, where the informed subset is an ellipse of lengths; here it is one of energies.
    """
    via = field_from(lattice, table, start).energy_j + field_towards(lattice, table, goal[None]).energy_j
    least = via.min()
    return (lattice.blocked == 0) & (via <= least + SUBSET_MARGIN * abs(least))


def corridor(lattice: CostLattice, points: Points, half_width: float) -> NDArray[np.bool_]:
    """Return the quarter cells near a polyline.

    `points` (n, 2): (row, col) polyline; `half_width`: half the width of the corridor [cells]. The result is (4 rows, 4
    cols).
    """
    reach = round(half_width * _CORRIDOR_CUTS)
    along = np.arange(-reach, reach + 1)
    disc = np.argwhere(np.hypot(*np.meshgrid(along, along)) <= reach) - reach
    shape = np.array(lattice.frame.shape) * _CORRIDOR_CUTS
    centres = np.floor((subdivided(points, 1.0 / _CORRIDOR_CUTS) + 0.5) * _CORRIDOR_CUTS).astype(int)
    near = np.clip((centres[:, None] + disc).reshape(-1, 2), 0, shape - 1)
    mask = np.zeros(shape, dtype=bool)
    mask[near[:, 0], near[:, 1]] = True
    return mask


def sample_along(
    lattice: CostLattice,
    path: Points,
    *,
    time_limit_s: float = 5.0,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> tuple[Points, dict[str, Any]]:
    """Return what BIT* finds in a corridor around a path, then in ever narrower ones around what it found.

    `path` (n, 2): (row, col) polyline to begin with. Returns `points` (m, 2): the best (row, col) polyline; `details`:
    a record as that of `sample_route`. Raises NoRouteError if it found no path at all.
    """
    share = time_limit_s / len(CORRIDORS_CELLS)
    centre, best, least = path, None, math.inf
    details: dict[str, Any] = {"sampling_seconds": 0.0, "legs_priced": 0, "seed": seed, "history": []}
    for stage, half_width in enumerate(CORRIDORS_CELLS):
        try:
            centre, found = sample_route(
                lattice,
                path[0],
                path[-1],
                planner="bitstar",
                time_limit_s=share,
                seed=seed + stage,
                places=corridor(lattice, centre, half_width),
            )
        except NoRouteError:
            found = None  # in so short a time; the next corridor is narrower
        if found is not None:
            details["sampling_seconds"] += found["sampling_seconds"]
            details["legs_priced"] += found["legs_priced"]
            details["history"] += [
                (round(stage * share + second, 3), energy) for second, energy in found["history"] if energy < least
            ]
            if found["sampled_energy_j"] < least:
                best, least = centre, found["sampled_energy_j"]
        if progress is not None:
            progress((stage + 1) / len(CORRIDORS_CELLS))
    if best is None:
        raise NoRouteError(f"bitstar found no route along the grid's within {time_limit_s:g} s; allow more time")
    return best, details | {"sampled_energy_j": least}


def sample_route(
    lattice: CostLattice,
    start: Points,
    goal: Points,
    *,
    planner: str,
    time_limit_s: float = 5.0,
    seed: int = 0,
    places: NDArray[np.bool_] | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[Points, dict[str, Any]]:
    """Return the path that a sampling planner finds within its time.

    `start`, `goal` (2,): fractional (row, col); `places` (k rows, k cols). Returns `points` (n, 2): (row, col) polyline
    from start to goal; `details`: JSON-able record: `sampling_seconds`, `legs_priced`, `seed`, `sampled_energy_j` [J],
    and `history`, the (seconds, energy [J]) of each best path. Raises NoRouteError if no path was found in time, which
    does not prove that there is none.
    """
    if planner not in _ALGORITHMS:
        raise InputError(f"planner must be one of {', '.join(_ALGORITHMS)}, got {planner!r}", planner=planner)
    if not 0.0 < time_limit_s <= MAX_TIME_LIMIT_S:
        raise InputError(
            f"time_limit_s must lie in (0, {MAX_TIME_LIMIT_S:g}], got {time_limit_s}", time_limit_s=str(time_limit_s)
        )
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    ou.RNG.setSeed(seed + 1)  # OMPL takes no zero
    information, problem, legs_priced = ompl_problem(
        lattice,
        start,
        goal,
        places=lattice.blocked == 0 if places is None else places,
        objective="tree" if planner != "bitstar" else "ellipse" if places is None else "corridor",
    )
    solver = _ALGORITHMS[planner](information)
    if planner != "bitstar":
        solver.setRange(TREE_STEP_CELLS)
    elif places is not None:
        solver.setSamplesPerBatch(_CORRIDOR_BATCH)
        solver.setUseKNearest(True)  # the radius that BIT* would compute is that of an open square
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
