"""OMPL's RRT*, Informed RRT* and BIT* on the lattice's own prices: directional, limits included, compiled.

Costs are handed to OMPL in units of the lattice's cheapest cell length, so that a straight line is a lower bound of
every cost: BIT* may then sample inside the ellipse of its best solution. A turn cost is not part of the objective,
because OMPL adds up motions and a turn belongs to two of them; the route that comes back is priced with its turns.
Started from the grid, RRT* samples only where the grid's two energy fields leave room for a better path, and BIT* in a
corridor around the grid's path, then in ever narrower ones around its own.

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
from joulemap.model.frames import heading_bins
from joulemap.planner.edges import Points, interpolation_matrix, path_price, price_arrays
from joulemap.planner.fields import field_from, field_towards
from joulemap.planner.kernels import leg_energy
from joulemap.planner.lattice import CostLattice
from joulemap.planner.moves import MoveTable
from joulemap.planner.polylines import subdivided

MAX_TIME_LIMIT_S = 120.0
_HEADINGS_PER_BIN = 8
_DIP = (math.pi / _HEADINGS_PER_BIN) ** 2 / 8.0
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


def price_floor_per_m(lattice: CostLattice) -> float:
    """Return a proven lower bound of the price per metre, over all places and all continuous headings.

    Parameters
    ----------
    lattice : CostLattice
        Prices.

    Returns
    -------
    float
        The bound [J/m].

    Notes
    -----
    Traction is bilinear between cells, so its least value is at a cell. In heading it is a trigonometric polynomial of
    order at most K / 2. Between samples with a step of 2 pi / (8 K) it falls at most `_DIP` = (pi / 8)^2 / 8 = 1.93 %
    of its largest magnitude below them (Bernstein's inequality for the second derivative).
    """
    bins = lattice.headings
    matrix = interpolation_matrix(heading_bins(_HEADINGS_PER_BIN * bins), bins).astype(np.float32).T
    cells = lattice.traction_per_m.reshape(-1, bins)
    lowest, largest = math.inf, 0.0
    for chunk in range(0, len(cells), 65_536):
        part = cells[chunk : chunk + 65_536]
        part = part[np.isfinite(part).all(axis=1)] @ matrix
        if part.size:
            lowest = min(lowest, float(part.min()))
            largest = max(largest, float(np.abs(part).max()))
    floor = lowest - _DIP * largest / (1.0 - _DIP)
    return float(lattice.robot.price_per_m(floor))


class _Pricer:
    """Leg prices in OMPL's units, and the bound that goes with them."""

    def __init__(self, lattice: CostLattice, start: Points, goal: Points) -> None:
        self._arrays = price_arrays(lattice)
        floor = price_floor_per_m(lattice) * lattice.frame.resolution_m  # [J per cell length]
        self.unit_j = floor if floor > 1e-6 else 1.0
        self.bound = 1.0 if floor > 1e-6 else 0.0
        self.start = (float(start[0]), float(start[1]))
        self.goal = (float(goal[0]), float(goal[1]))
        self.legs = 0
        self._last: tuple[tuple[float, float, float, float], float] | None = None

    def cost(self, a: Any, b: Any) -> float:
        """Cost of the leg between two OMPL states, inf when it may not be driven."""
        leg = (a[0], a[1], b[0], b[1])
        if self._last is not None and self._last[0] == leg:  # its validity was asked for first
            return self._last[1]
        self.legs += 1
        energy = leg_energy(*self._arrays, *leg)
        cost = energy / self.unit_j if energy == energy else math.inf
        self._last = leg, cost
        return cost

    def least(self, a: Any, b: Any) -> float:
        """Lower bound of the cost from one state to another."""
        return self.bound * math.hypot(b[0] - a[0], b[1] - a[1])


class _DirectedObjective(ob.OptimizationObjective):
    """Leg prices that are not the same both ways, without bounds: in a corridor they cost BIT* more than they save."""

    def __init__(self, space_information: Any, pricer: _Pricer) -> None:
        super().__init__(space_information)
        self._pricer = pricer

    def isSymmetric(self) -> bool:
        return False

    def stateCost(self, state):
        return ob.Cost(0.0)

    def motionCost(self, a, b):
        return ob.Cost(self._pricer.cost(a, b))


class _TreeObjective(_DirectedObjective):
    """For RRT* and Informed RRT*.

    The binding cannot set a cost-to-go. Both planners ask for heuristics from the start only, to judge a whole solution
    through a state, so from the start the bound goes on to the goal.
    """

    def motionCostHeuristic(self, a, b):
        onward = self._pricer.least(b, self._pricer.goal) if (a[0], a[1]) == self._pricer.start else 0.0
        return ob.Cost(self._pricer.least(a, b) + onward)


class _EllipseObjective(ob.PathLengthOptimizationObjective):
    """For BIT*, which never assumes symmetry: derived from path length, so that it samples inside the ellipse."""

    def __init__(self, space_information: Any, pricer: _Pricer) -> None:
        super().__init__(space_information)
        self._pricer = pricer

    def motionCost(self, a, b):
        return ob.Cost(self._pricer.cost(a, b))

    def motionCostHeuristic(self, a, b):
        return ob.Cost(self._pricer.least(a, b))

    def motionCostBestEstimate(self, a, b):
        return ob.Cost(self._pricer.least(a, b))


class _Limits(ob.MotionValidator):
    def __init__(self, space_information: Any, pricer: _Pricer) -> None:
        super().__init__(space_information)
        self._pricer = pricer

    def checkMotion(self, a: Any, b: Any, *last_valid: Any) -> bool:
        return math.isfinite(self._pricer.cost(a, b))


_ALGORITHMS = {
    "rrtstar": (og.RRTstar, _TreeObjective),
    "informed_rrtstar": (og.InformedRRTstar, _TreeObjective),
    "bitstar": (og.BITstar, _EllipseObjective),
}


def informed_subset(lattice: CostLattice, table: MoveTable, start: Points, goal: Points) -> NDArray[np.bool_]:
    """Return the cells through which the grid's best path costs at most `SUBSET_MARGIN` more than its best path of all.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    table : MoveTable
        Priced moves of the lattice.
    start, goal : ndarray of float, (2,)
        Fractional (row, col).

    Returns
    -------
    ndarray of bool, (rows, cols)
        Where a better path may lie.

    References
    ----------
    Gammell et al. 2014, where the informed subset is an ellipse of lengths; here it is one of energies.
    """
    via = field_from(lattice, table, start).energy_j + field_towards(lattice, table, goal[None]).energy_j
    least = via.min()
    return (lattice.blocked == 0) & (via <= least + SUBSET_MARGIN * abs(least))


def corridor(lattice: CostLattice, points: Points, half_width: float) -> NDArray[np.bool_]:
    """Return the quarter cells near a polyline.

    Parameters
    ----------
    lattice : CostLattice
        Whose cells these are.
    points : ndarray of float, (n, 2)
        (row, col) polyline.
    half_width : float
        Half the width of the corridor [cells].

    Returns
    -------
    ndarray of bool, (4 rows, 4 cols)
        Whether each quarter cell lies in the corridor.
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

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    path : ndarray of float, (n, 2)
        (row, col) polyline to begin with.
    time_limit_s : float, default 5.0
        How long to search in all corridors together [s].
    seed : int, default 0
        Seed of the samples.
    progress : callable, optional
        Called with the share that is done, 0..1.

    Returns
    -------
    points : ndarray of float, (m, 2)
        The best (row, col) polyline.
    details : dict
        A record as that of `sample_route`.

    Raises
    ------
    NoRouteError
        If it found no path at all.
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

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    start, goal : ndarray of float, (2,)
        Fractional (row, col).
    planner : {"rrtstar", "informed_rrtstar", "bitstar"}
        OMPL's algorithm.
    time_limit_s : float, default 5.0
        How long to search [s], at most 120.
    seed : int, default 0
        Seed of the samples.
    places : ndarray of bool, (k rows, k cols), optional
        The only k-th parts of cells to sample in, see `informed_subset` and `corridor`.
    progress : callable, optional
        Called with the share of the time that is over, 0..1.

    Returns
    -------
    points : ndarray of float, (n, 2)
        (row, col) polyline from start to goal.
    details : dict
        JSON-able record: `sampling_seconds`, `legs_priced`, `seed`, `sampled_energy_j` [J], and `history`, the
        (seconds, energy [J]) of each best path.

    Raises
    ------
    InputError
        If a setting is unknown or out of range.
    NoRouteError
        If no path was found in time, which does not prove that there is none.
    """
    if planner not in _ALGORITHMS:
        raise InputError(f"planner must be one of {', '.join(_ALGORITHMS)}, got {planner!r}", planner=planner)
    if not 0.0 < time_limit_s <= MAX_TIME_LIMIT_S:
        raise InputError(
            f"time_limit_s must lie in (0, {MAX_TIME_LIMIT_S:g}], got {time_limit_s}", time_limit_s=str(time_limit_s)
        )
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    ou.RNG.setSeed(seed + 1)  # OMPL takes no zero
    free = lattice.blocked == 0 if places is None else places
    cuts = free.shape[0] // lattice.frame.rows
    space = ob.RealVectorStateSpace(2)
    bounds = ob.RealVectorBounds(2)
    for axis, parts in enumerate(np.nonzero(free)):
        bounds.setLow(axis, float(min(parts.min() / cuts - 0.5, start[axis], goal[axis])))
        bounds.setHigh(axis, float(max((parts.max() + 1) / cuts - 0.5, start[axis], goal[axis])))
    space.setBounds(bounds)
    info = ob.SpaceInformation(space)
    pricer = _Pricer(lattice, start, goal)
    info.setStateValidityChecker(_validity(free, cuts))
    info.setMotionValidator(_Limits(info, pricer))
    info.setup()
    make_planner, make_objective = _ALGORITHMS[planner]
    if places is not None and planner == "bitstar":
        make_objective = _DirectedObjective
    problem = ob.ProblemDefinition(info)
    problem.setStartAndGoalStates(_state(space, start), _state(space, goal), 1e-6)
    problem.setOptimizationObjective(make_objective(info, pricer))
    solver = make_planner(info)
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
        "legs_priced": pricer.legs,
        "seed": seed,
        "sampled_energy_j": path_price(lattice, points),
        "history": history,
    }


def _validity(free: NDArray[np.bool_], cuts: int) -> Callable[[Any], bool]:
    """A check whether a state lies on a True of `free`, which has `cuts` entries to a cell's side."""
    last_row, last_col, width, mask = free.shape[0] - 1, free.shape[1] - 1, free.shape[1], free.tobytes()

    def valid(state: Any) -> bool:
        row = min(max(int((state[0] + 0.5) * cuts), 0), last_row)
        return mask[row * width + min(max(int((state[1] + 0.5) * cuts), 0), last_col)] == 1

    return valid


def _state(space: Any, point: Points) -> Any:
    state = space.allocState()
    state[0], state[1] = float(point[0]), float(point[1])
    return state
