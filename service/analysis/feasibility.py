"""Whether a battery lasts for a task: a given path, or the best route between two places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from joulemap.model.battery import Battery
from joulemap.model.errors import InputError
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.obstacles import reach_m
from joulemap.planner.route import Route, in_sequence
from joulemap.planner.verdict.budget import Verdict, judge_course
from joulemap.planner.verdict.trajectory import course_of
from joulemap.service.analysis.route_uncertainty import odds_along
from joulemap.service.exports.clearance import price_given_path
from joulemap.service.places.coordinates import PlaceLike
from joulemap.service.places.places import Places

if TYPE_CHECKING:  # a cost map is made without them, and they take their time to load
    from joulemap.planner.route_planner import RoutePlanner
    from joulemap.service.analysis.objectives import Objective, Weighed


@dataclass(frozen=True, eq=False)
class Assessment:
    """Whether a battery lasts for a task, and the routes that this was decided with.

    Attributes
    ----------
    verdict : Verdict
        For all routes together.
    route_out : Route
        The way there.
    route_back : Route or None
        The way back of a round trip.
    weighed : Weighed or None
        How the routes do by their objective; None for the least expected energy, and for a given path.
    """

    verdict: Verdict
    route_out: Route
    route_back: Route | None = None
    weighed: Weighed | None = None

    @property
    def routes(self) -> list[Route]:
        """What is driven, in this order."""
        return [route for route in (self.route_out, self.route_back) if route is not None]


def assess(
    planner: RoutePlanner,
    *,
    battery: Battery,
    path: ArrayLike | Sequence[Any] | None = None,
    start: PlaceLike | None = None,
    goal: PlaceLike | None = None,
    round_trip: bool = False,
    snap: bool = False,
    objective: Objective | None = None,
) -> Assessment:
    """Return whether a battery lasts for a given path, or for the best route from start to goal.

    Give either `path`, or `start` and `goal`.

    `path` (n, 2): world points [m], or places as `Places.path` takes them, in the order of driving; `start`, `goal`:
    world x, y [m], or a place as `world_point` takes it. Raises BlockedError if start or goal is on blocked ground
    without `snap`, or if a leg of the path is; NoRouteError if no route joins start and goal, or a place that is
    practically the goal: a verdict is about the place that was asked for.
    """
    from joulemap.planner.route_planner import RouteOptions
    from joulemap.service.analysis.objectives import MEAN, best_routes

    if (path is None) == (start is None and goal is None) or (start is None) != (goal is None):
        raise InputError("give either `path`, or `start` and `goal`")
    back = None
    lattice = planner.lattice
    places = Places(lattice.frame)
    if path is not None:
        points = places.path(path)
        planner.read_along(points)
        out = price_given_path(lattice, points)
        if round_trip:
            back = price_given_path(lattice, points[::-1])
    else:
        assert start is not None
        assert goal is not None
        there, home = places(start, "start"), places(goal, "goal")
        # the outline reaches over the place that was asked for, or that is in the same cell or in one beside it
        near_m = max(reach_m(lattice.robot), 2.0**0.5 * lattice.frame.resolution_m)
        out = planner.plan(there, home, RouteOptions(snap=snap, furthest_m=near_m)).route
        if round_trip:
            if snap:  # back from where the way there ended, and to where it began
                there, home = ((float(x), float(y)) for x, y in out.points[[0, -1], :2])
            back = planner.plan(home, there, planner.on_from(out)).route
    ways, weighed = [route for route in (out, back) if route is not None], None
    routes = in_sequence(ways, lattice.robot.turn_j_per_rad)
    if path is None and objective is not None and objective.name != MEAN:
        routes, weighed = best_routes(planner, tuple(ways), objective, battery=battery)
    verdict = judge_routes(lattice, routes, battery)
    return Assessment(verdict, places.noted(routes[0]), routes[1] if round_trip else None, weighed)


def judge_routes(lattice: CostLattice, routes: Sequence[Route], battery: Battery) -> Verdict:
    """Return the verdict for routes that are driven one after another.

    Result: with a probability where the lattice's model knows its own uncertainty.
    """
    return judge_course(
        course_of(routes, weight_n=lattice.robot.weight_n),
        battery,
        nominal_voltage_v=lattice.robot.nominal_voltage_v,
        odds=odds_along(routes),
    )
