"""A question to the lattice as OMPL's planners need it: where they may sample, and what the legs between samples cost.

Costs are in units of the lattice's cheapest cell length, so that a straight line is a lower bound of every cost: BIT*
may then sample inside the ellipse of its best solution. A turn cost is not among them, because OMPL adds up motions and
a turn belongs to two of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ompl import base as ob

from joulemap.model.frames import heading_bins
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, exact_prices, interpolation_matrix
from joulemap.planner.pricing.kernels import leg_energy

_HEADINGS_PER_BIN = 8
_DIP = (math.pi / _HEADINGS_PER_BIN) ** 2 / 8.0


def price_floor_per_m(lattice: CostLattice) -> float:
    """Return a proven lower bound of the price per metre, over all places and all continuous headings.

    Result: the bound [J/m].

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
        self._prices = exact_prices(lattice)
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
        energy = leg_energy(self._prices, leg)
        cost = energy / self.unit_j if energy == energy else math.inf
        self._last = leg, cost
        return cost

    def least(self, a: Any, b: Any) -> float:
        """Lower bound of the cost from one state to another."""
        return self.bound * math.hypot(b[0] - a[0], b[1] - a[1])


class _TreeObjective(ob.OptimizationObjective):
    """For RRT* and Informed RRT*: leg prices that are not the same both ways.

    The binding cannot set a cost-to-go. Both planners ask for heuristics from the start only, to judge a whole solution
    through a state, so from the start the bound goes on to the goal.
    """

    def __init__(self, space_information: Any, pricer: _Pricer) -> None:
        super().__init__(space_information)
        self._pricer = pricer

    def isSymmetric(self) -> bool:
        return False

    def stateCost(self, state):
        return ob.Cost(0.0)

    def motionCost(self, a, b):
        return ob.Cost(self._pricer.cost(a, b))

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


def ompl_problem(
    lattice: CostLattice, start: Points, goal: Points, *, in_ellipse: bool
) -> tuple[Any, Any, Callable[[], int]]:
    """Return the problem of a cheapest path for a planner of OMPL.

    `start`, `goal` (2,): fractional (row, col); `in_ellipse`: for BIT*. Returns `information`: the space of (row, col),
    and what may be driven; `problem`: start, goal and objective; `legs_priced`: returns how many legs were priced.
    """
    free = lattice.blocked == 0
    space = ob.RealVectorStateSpace(2)
    bounds = ob.RealVectorBounds(2)
    for axis, cells in enumerate(np.nonzero(free)):
        bounds.setLow(axis, float(min(cells.min() - 0.5, start[axis], goal[axis])))
        bounds.setHigh(axis, float(max(cells.max() + 0.5, start[axis], goal[axis])))
    space.setBounds(bounds)
    information = ob.SpaceInformation(space)
    pricer = _Pricer(lattice, start, goal)
    information.setStateValidityChecker(_validity(free))
    information.setMotionValidator(_Limits(information, pricer))
    information.setup()
    problem = ob.ProblemDefinition(information)
    problem.setStartAndGoalStates(_state(space, start), _state(space, goal), 1e-6)
    problem.setOptimizationObjective((_EllipseObjective if in_ellipse else _TreeObjective)(information, pricer))
    return information, problem, lambda: pricer.legs


def _validity(free: NDArray[np.bool_]) -> Callable[[Any], bool]:
    """A check whether a state lies on a free cell."""
    last_row, last_col, width, mask = free.shape[0] - 1, free.shape[1] - 1, free.shape[1], free.tobytes()

    def valid(state: Any) -> bool:
        row = min(max(int(state[0] + 0.5), 0), last_row)
        return mask[row * width + min(max(int(state[1] + 0.5), 0), last_col)] == 1

    return valid


def _state(space: Any, point: Points) -> Any:
    state = space.allocState()
    state[0], state[1] = float(point[0]), float(point[1])
    return state
