"""Routes that never draw more than some power: headings that would take more at the robot's speed are blocked."""

from __future__ import annotations

import math
import threading
from dataclasses import replace
from weakref import WeakKeyDictionary

from joulemap.model.errors import InputError, NoRouteError
from joulemap.planner.answers import Plan
from joulemap.planner.grid.search import grid_search
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points, path_price
from joulemap.planner.route_planner import USUAL, RouteOptions, RoutePlanner

_MAKING = threading.Lock()
_MADE: WeakKeyDictionary[RoutePlanner, PowerLimited] = WeakKeyDictionary()


def within_power(planner: RoutePlanner, max_power_w: float | None) -> RoutePlanner:
    """Return the planner of the same map whose routes draw at most some power.

    The one that was asked for last is kept with each planner.

    `planner`: of a cost map in memory; `max_power_w`: most power at the robot's speed [W]; None returns this planner.
    Result: it needs as much memory for its moves as the one that was given. Raises InputError if it takes as much
    without moving.
    """
    if max_power_w is None:
        return planner
    robot = planner.lattice.robot
    if not max_power_w > robot.idle_power_w:  # false for NaN
        raise InputError(
            f"max_power_w is {max_power_w:g}; {robot.name} takes {robot.idle_power_w:g} W without moving: give more",
            max_power_w=float(max_power_w),
        )
    with _MAKING:
        made = _MADE.get(planner)
        if made is None or made.max_power_w != max_power_w:
            made = _MADE[planner] = PowerLimited(planner.lattice, max_power_w)
        return made


class PowerLimited(RoutePlanner):
    """A planner of what may be driven with some power.

    The power of a heading in a cell is its energy per metre times the robot's speed. Starting, stopping and turning on
    the spot are not counted.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    max_power_w : float
        Most power [W].
    """

    def __init__(self, lattice: CostLattice, max_power_w: float) -> None:
        most = max_power_w / lattice.robot.speed_mps - lattice.robot.hotel_per_m
        super().__init__(replace(lattice, max_traction_per_m=most))
        self.max_power_w = max_power_w

    def plan(self, start_xy: tuple[float, float], goal_xy: tuple[float, float], how: RouteOptions = USUAL) -> Plan:
        """Return routes within the power, as `RoutePlanner.plan`.

        `start_xy`, `goal_xy`: world x, y [m]; `how`: as there. Result: both routes draw at most this power. Raises
        NoRouteError if there is none; the message names the power.
        """
        try:
            return super().plan(start_xy, goal_xy, how)
        except NoRouteError as error:
            raise NoRouteError(
                f"with at most {self.max_power_w:g} W {error.message}", **error.context, max_power_w=self.max_power_w
            ) from error

    def _shortest(self, start: Points, goal: Points, neighbours: int, refine: bool) -> Points:
        """The shortest path. Prices of distance know the limit on moves only: it may keep the corners of the grid."""
        points = super()._shortest(start, goal, neighbours, refine)
        if math.isnan(path_price(self.lattice, points)):
            points = grid_search(self._distances, self._table(neighbours, distance=True), start, goal).points
        if math.isnan(path_price(self.lattice, points)):
            points = self._best(start, goal)[0]
        return points
