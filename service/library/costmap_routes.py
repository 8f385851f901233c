"""Questions to a cost map about routes: the best one, tours, whether the battery lasts, how fast to drive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from joulemap.model.battery import Battery
from joulemap.model.errors import InputError
from joulemap.planner.route import Route
from joulemap.service.exports.clearance import price_given_path
from joulemap.service.feasibility import assess, judge_routes
from joulemap.service.library.costmap_base import CostMapBase, Point
from joulemap.service.library.feasibility import Feasibility
from joulemap.service.library.planned_route import PlannedRoute
from joulemap.service.library.planned_tour import PlannedTour
from joulemap.service.models import DEFAULT_MODEL, find_predictor
from joulemap.service.objectives import Objective, limited, plan_by
from joulemap.service.places import Places

if TYPE_CHECKING:
    from joulemap.service.library.heightmaps import GroundLike
    from joulemap.service.library.models import ModelLike
    from joulemap.service.speeds import Speeds


class RouteQuestions(CostMapBase):
    """Routes over a cost map, and verdicts on them."""

    def plan(
        self,
        start: Point,
        goal: Point,
        *,
        planner: str = "astar",
        neighbours: int = 16,
        refine: bool = True,
        alternatives: int = 0,
        snap: bool = False,
        bound: bool = False,
        time_limit_s: float = 5.0,
        seed: int = 0,
        avoid: Sequence[Sequence[Point]] = (),
        objective: str = "mean",
        quantile: float = 0.95,
        max_power_w: float | None = None,
        battery: Battery | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> PlannedRoute:
        """Find the route of least energy, and the shortest one beside it.

        Parameters
        ----------
        start, goal : sequence of float
            World x, y [m].
        planner : str, optional
            One of `joulemap.planner.route_planner.PLANNERS`.
        neighbours : int, optional
            Directions of a step on the grid: 8, 16 or 32.
        refine : bool, optional
            Whether the grid's path is improved to any angle.
        alternatives : int, optional
            Most other routes to look for.
        snap : bool, optional
            Whether a start or goal on blocked ground is moved to the nearest free place.
        bound : bool, optional
            Whether to search for a sharper lower bound of the energy (`found.bound_j`), which takes some seconds once
            per map. Without it the bound is that of the idle power over the straight distance.
        time_limit_s : float, optional
            For the sampling planners [s].
        seed : int, optional
            For the sampling planners.
        avoid : sequence of sequence of points, optional
            Areas that no route may touch: the corners of each, world x, y [m].
        objective : str, optional
            What the route is chosen by: "mean" energy, energy at a "quantile", or probability of "arrival" with the
            reserve of the battery.
        quantile : float, optional
            Share of drives that take no more than the energy that is made least, 0.5 to 0.99.
        max_power_w : float, optional
            Most power at the robot's speed [W]: what takes more is blocked.
        battery : Battery, optional
            For "arrival".
        progress : callable, optional
            Called with the share done, 0..1.

        Returns
        -------
        PlannedRoute
            Energies in J. Its `objective` says how well it does by another objective than the mean.

        Raises
        ------
        InputError
            If the model does not know its uncertainty, and the objective is not the mean.
        PointError
            If a point or an area lies outside the map.
        BlockedError
            If a point lies on blocked ground, and `snap` is false.
        NoRouteError
            If no route joins the two.
        """
        places = Places(self.lattice.frame)
        router = limited(self.planner.avoiding(places.areas(avoid)), max_power_w)
        found = plan_by(
            router,
            places(start, "start"),
            places(goal, "goal"),
            Objective(objective, quantile),
            battery=battery,
            planner=planner,
            neighbours=neighbours,
            refine=refine,
            alternatives=alternatives,
            snap=snap,
            bound=bound,
            time_limit_s=time_limit_s,
            seed=seed,
            progress=progress,
        )
        return PlannedRoute(places.noted(found), router.lattice)

    def tour(
        self,
        stops: Sequence[Point],
        *,
        neighbours: int = 16,
        refine: bool = True,
        snap: bool = False,
        time_limit_s: float = 10.0,
        avoid: Sequence[Sequence[Point]] = (),
        progress: Callable[[float], None] | None = None,
    ) -> PlannedTour:
        """Visit all stops and come home to the first one, in the order that takes least energy.

        Parameters
        ----------
        stops : sequence of points
            World x, y [m]; the first is home.
        neighbours : int, optional
            Directions of a step on the grid: 8, 16 or 32.
        refine : bool, optional
            Whether the legs are improved to any angle.
        snap : bool, optional
            Whether a stop on blocked ground is moved to the nearest free place.
        time_limit_s : float, optional
            For the search of the order [s].
        avoid : sequence of sequence of points, optional
            Areas that no leg may touch: the corners of each, world x, y [m].
        progress : callable, optional
            Called with the share done, 0..1.

        Returns
        -------
        PlannedTour
            Legs with energies in J. Needs the extra `tours`.

        Raises
        ------
        PointError, BlockedError, NoRouteError
            As `plan`; the two stops are named.
        """
        places = Places(self.lattice.frame)
        router = self.planner.avoiding(places.areas(avoid))
        found = router.tour(
            [places(stop, f"stop {k}") for k, stop in enumerate(stops)],
            neighbours=neighbours,
            refine=refine,
            snap=snap,
            time_limit_s=time_limit_s,
            progress=progress,
        )
        return PlannedTour(places.noted(found), router.lattice)

    def feasibility(
        self,
        route: PlannedRoute | PlannedTour | Sequence[Point],
        *,
        charge: float = 1.0,
        reserve: float = 0.0,
        capacity_wh: float | None = None,
        round_trip: bool = False,
        battery: Battery | None = None,
    ) -> Feasibility:
        """Say whether the battery lasts for a route, how likely that is, and what would make it sure.

        Parameters
        ----------
        route : PlannedRoute, PlannedTour or sequence of points
            What is driven; points are world x, y [m].
        charge : float, optional
            State of charge at the start, 0..1.
        reserve : float, optional
            Share of the capacity that must remain, 0..1.
        capacity_wh : float, optional
            Energy of the full battery [Wh]. By default that of the robot.
        round_trip : bool, optional
            Whether the way back is driven too: the best one back to the start of a planned route, the same points in
            reverse otherwise.
        battery : Battery, optional
            With its charge and reserve, where more is known of it than its energy; the other three then do not count.

        Returns
        -------
        Feasibility
            True in a condition exactly when the battery lasts.

        Raises
        ------
        InputError
            If charge or reserve lie outside 0..1, or a tour, which comes home already, is to be a round trip.
        BlockedError
            If points cross blocked ground.
        """
        warnings = tuple(self.warnings)
        if battery is None:
            full = self.robot.battery_wh if capacity_wh is None else capacity_wh
            battery = Battery(full, charge=charge, reserve=reserve)
        if isinstance(route, PlannedTour):
            if round_trip:
                raise InputError("a tour comes home already: leave out `round_trip`")
            return Feasibility(judge_routes(self.lattice, route.legs, battery), route.legs[0], warnings=warnings)
        if isinstance(route, PlannedRoute):
            back = None
            if round_trip:
                here, there = ((float(p[0]), float(p[1])) for p in (route.points[0], route.points[-1]))
                back = self.planner.plan(there, here).route
            driven = [route.route] if back is None else [route.route, back]
            verdict, volts = judge_routes(self.lattice, driven, battery), self.robot.nominal_voltage_v
            return Feasibility(verdict, route.route, back, warnings, battery, volts)
        points = Places(self.lattice.frame).path(list(route))
        judged = assess(self.planner, battery=battery, path=points, round_trip=round_trip)
        ways = judged.route_out, judged.route_back
        return Feasibility(judged.verdict, *ways, warnings, battery, self.robot.nominal_voltage_v)

    def speeds(
        self,
        route: PlannedRoute | Route | Sequence[Point],
        heightmap: GroundLike,
        *,
        model: ModelLike = DEFAULT_MODEL,
    ) -> Speeds:
        """Give the cheapest cruising speed of a route, and its energy against its time.

        Parameters
        ----------
        route : PlannedRoute, Route or sequence of points
            What is driven; points are world x, y [m]. It stays the same at every speed.
        heightmap : Heightmap, str or Path
            What the cost map was made of.
        model : str, Path or Model, optional
            Of the cost map.

        Returns
        -------
        Speeds
            At the speeds that the model learned from, and no others.

        Raises
        ------
        InputError
            If the heightmap is another one, or the model does not know what speed costs.
        """
        if isinstance(route, PlannedRoute):
            route = route.route
        if not isinstance(route, Route):
            route = price_given_path(self.lattice, Places(self.lattice.frame).path(list(route)))
        # readers and models load slowly, and most questions to a cost map need none
        from joulemap.service.library.heightmaps import ground_of
        from joulemap.service.library.models import model_folder
        from joulemap.service.speeds import speeds_along

        return speeds_along(route, self.lattice, ground_of(heightmap), find_predictor(model_folder(model)))
