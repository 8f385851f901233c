"""Questions to a cost map about routes: the best one, tours, whether the battery lasts, how fast to drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from joulemap.model.battery import Battery
from joulemap.model.errors import InputError
from joulemap.planner.route import Route
from joulemap.service.analysis.feasibility import assess, judge_routes
from joulemap.service.exports.clearance import price_given_path
from joulemap.service.library.costmap_base import CostMapBase, Point
from joulemap.service.library.drive import Drive
from joulemap.service.library.feasibility import Feasibility
from joulemap.service.library.planned_route import PlannedRoute
from joulemap.service.library.planned_tour import PlannedTour
from joulemap.service.models import DEFAULT_MODEL
from joulemap.service.places.places import Places
from joulemap.service.questions import charging, matrix, path, tour
from joulemap.service.questions.asking import asks
from joulemap.service.questions.charging import ChargedWay, ChargingRequest
from joulemap.service.questions.drive import DriveRequest
from joulemap.service.questions.given import battery_with, checked
from joulemap.service.questions.matrix import EnergyMatrix, MatrixRequest
from joulemap.service.questions.parts import BatteryIn, battery_of
from joulemap.service.questions.path import PathRequest
from joulemap.service.questions.speeds import SpeedsRequest
from joulemap.service.questions.tour import TourRequest

if TYPE_CHECKING:
    from joulemap.service.analysis.speeds import Speeds
    from joulemap.service.library.heightmaps import GroundLike
    from joulemap.service.library.models import ModelLike


class RouteQuestions(CostMapBase):
    """Routes over a cost map, and verdicts on them."""

    @asks(PathRequest)
    def plan(self, wanted: PathRequest, *, progress: Callable[[float], None] | None = None) -> PlannedRoute:
        """Find the route of least energy, and the shortest one beside it.

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
        found = path.ask(self.planner, wanted, progress=progress)
        return PlannedRoute(found.plan, found.lattice)

    @asks(TourRequest, "battery")
    def tour(self, wanted: TourRequest, *, progress: Callable[[float], None] | None = None) -> PlannedTour:
        """Visit all stops, in the order that takes least energy or as given, and come home unless it is one way.

        Returns
        -------
        PlannedTour
            Legs with energies in J. Needs the extra `tours`, unless `in_order`.

        Raises
        ------
        PointError, BlockedError, NoRouteError
            As `plan`; the two stops are named.
        """
        found = tour.ask(self.planner, wanted, progress=progress)
        return PlannedTour(found.trip, found.lattice)

    @asks(MatrixRequest)
    def matrix(self, wanted: MatrixRequest, *, progress: Callable[[float], None] | None = None) -> EnergyMatrix:
        """Say what it takes to drive from each start to each goal, by one search for each start or goal.

        Returns
        -------
        EnergyMatrix
            Arrays with a row for each start; infinite where there is no way, with the reason.

        Raises
        ------
        PointError
            If a place lies outside the map.
        """
        return matrix.ask(self.planner, wanted, progress=progress)

    @asks(ChargingRequest)
    def charging(self, wanted: ChargingRequest, *, progress: Callable[[float], None] | None = None) -> ChargedWay:
        """Find the cheapest way that never falls below the reserve, charging where it may.

        Returns
        -------
        ChargedWay
            Its legs with what is charged before each; without legs, why there is no such way.

        Raises
        ------
        PointError
            If a place lies outside the map.
        """
        return charging.ask(self.planner, wanted, progress=progress)

    def feasibility(
        self,
        route: PlannedRoute | PlannedTour | Sequence[Point],
        *,
        charge: float | None = None,
        reserve: float | None = None,
        capacity_wh: float | None = None,
        round_trip: bool = False,
        battery: Battery | Mapping[str, Any] | None = None,
    ) -> Feasibility:
        """Say whether the battery lasts for a route, how likely that is, and what would make it sure.

        Parameters
        ----------
        route : PlannedRoute, PlannedTour or sequence of points
            What is driven; points are world x, y [m].
        charge : float, optional
            State of charge at the start, 0..1. By default 1.
        reserve : float, optional
            Share of the capacity that must remain, 0..1. By default 0.
        capacity_wh : float, optional
            Energy of the full battery [Wh]. By default that of the robot.
        round_trip : bool, optional
            Whether the way back is driven too: the best one back to the start of a planned route, the same points in
            reverse otherwise.
        battery : Battery or mapping, optional
            With its charge and reserve, where more is known of it than its energy. The other three must not say
            otherwise.

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
        known = battery_with(battery, charge=charge, reserve=reserve, capacity_wh=capacity_wh)
        battery = battery_of(checked(BatteryIn, known or {}), self.robot)
        if isinstance(route, PlannedTour):
            if round_trip:
                raise InputError("a tour comes home already: leave out `round_trip`")
            return Feasibility(judge_routes(self.lattice, route.legs, battery), route.legs[0], warnings=warnings)
        if isinstance(route, PlannedRoute):
            back = None
            if round_trip:
                here, there = ((float(p[0]), float(p[1])) for p in (route.points[0], route.points[-1]))
                back = self.planner.plan(there, here, self.planner.on_from(route.route)).route
            driven = [route.route] if back is None else [route.route, back]
            verdict, volts = judge_routes(self.lattice, driven, battery), self.robot.nominal_voltage_v
            return Feasibility(verdict, route.route, back, warnings, battery, volts)
        points = Places(self.lattice.frame).path(list(route))
        judged = assess(self.planner, battery=battery, path=points, round_trip=round_trip)
        ways = judged.route_out, judged.route_back
        return Feasibility(judged.verdict, *ways, warnings, battery, self.robot.nominal_voltage_v)

    def drive(self, route: PlannedRoute | Route | Sequence[Point], *, battery: Battery | None = None) -> Drive:
        """Follow a drive along a route: what the log says while driving corrects the forecast of the rest.

        Parameters
        ----------
        route : PlannedRoute, Route or sequence of points
            What is driven; points are world x, y [m].
        battery : Battery, optional
            At the start; by default the robot's own, full and without a reserve.

        Returns
        -------
        Drive
            With `update` and `forecast`.

        Raises
        ------
        InputError
            If the route is no path, is shorter than 1 cm or longer than 20 km, or the battery is none.
        """
        if isinstance(route, PlannedRoute):
            route = route.route
        path = route.points[:, :2] if isinstance(route, Route) else route
        wanted = checked(DriveRequest, {"path": path, "battery": battery})
        if not isinstance(battery, Battery):
            battery = battery_of(wanted.battery, self.robot)
        if isinstance(route, Route):
            return Drive(self.lattice, route, battery)
        return Drive.along(self.lattice, Places(self.lattice.frame).path(wanted.path), battery)

    def speeds(
        self,
        route: PlannedRoute | Route | Sequence[Point],
        heightmap: GroundLike,
        *,
        model: ModelLike = DEFAULT_MODEL,
        by_stretch: bool = False,
        deadline_s: float | None = None,
    ) -> Speeds:
        """Give the cheapest cruising speed of a route, its energy against its time, and a speed for each stretch.

        Parameters
        ----------
        route : PlannedRoute, Route or sequence of points
            What is driven; points are world x, y [m]. It stays the same at every speed.
        heightmap : Heightmap, str or Path
            What the cost map was made of.
        model : str, Path or Model, optional
            Of the cost map.
        by_stretch : bool, optional
            Also find a speed for each stretch, of least energy; changes of speed are paid for.
        deadline_s : float, optional
            Time in which the route is driven [s]; gives a speed for each stretch.

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
        ends = route.points[[0, -1], :2] if isinstance(route, Route) else route
        wanted = checked(SpeedsRequest, {"path": ends, "by_stretch": by_stretch, "deadline_s": deadline_s})
        if not isinstance(route, Route):
            route = price_given_path(self.lattice, Places(self.lattice.frame).path(list(route)))
        # readers and models load slowly, and most questions to a cost map need none
        from joulemap.service.analysis.speeds import speeds_along
        from joulemap.service.library.heightmaps import ground_of
        from joulemap.service.library.models import predictor_of

        made_of, predictor = ground_of(heightmap), predictor_of(model)
        deadline_s = wanted.deadline_s
        return speeds_along(
            route, self.lattice, made_of, predictor, by_stretch=wanted.by_stretch, deadline_s=deadline_s
        )
