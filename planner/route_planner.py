"""One question, one answer: the energy-optimal route with the shortest one beside it, or the cheapest round trip."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from joulemap.model.errors import BlockedError, InputError, NoRouteError
from joulemap.model.threads import both
from joulemap.planner.answers import Plan, RoundTrip
from joulemap.planner.any_angle.best import (
    ANY_ANGLE_NEIGHBOURS,
    best_path,
    driven_energy_j,
    improved,
    margin_notes,
    shorter_of,
    tightened,
)
from joulemap.planner.field_planner import FieldPlanner
from joulemap.planner.grid.curved_search import curved_path
from joulemap.planner.grid.fields import field_from
from joulemap.planner.grid.search import grid_search
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.avoid import Polygon, checked_polygons, window_of, without
from joulemap.planner.places import free_places
from joulemap.planner.planners import PLANNERS, Options, Planner, planner_named
from joulemap.planner.pricing.integrator import Points, metres_within_margin, path_headings, path_price
from joulemap.planner.pricing.move_prices import check_neighbours
from joulemap.planner.pricing.moves import MoveTable, repriced
from joulemap.planner.pricing.polylines import path_length
from joulemap.planner.questions.alternatives import alternative_paths, improved_ways
from joulemap.planner.questions.bound import bound_table, energy_bound, quick_bound
from joulemap.planner.questions.tours import cheapest_tour
from joulemap.planner.route import Route, in_sequence, price_route

SAMPLING_PLANNERS = tuple(name for name in PLANNERS if planner_named(name).uses_time_limit)


_STOP_HEADINGS_DEG = 45.0
"""Setting: between the headings that are tried at a stop of a tour, where the cheapest arrival leads nowhere."""


@dataclass(frozen=True, eq=False, repr=False)
class RouteOptions(Options):
    """How a route is looked for; what the planner's search uses comes from `Options`.

    Attributes
    ----------
    planner : str, default "astar"
        One of `PLANNERS`, or the name of a planner that was registered.
    neighbours : {16, 8, 32}
        Moves per cell of the grid planners without `refine`; with it they are 32.
    refine : bool, default True
        Whether to improve the path at any angle, which never makes it dearer.
    alternatives : int, default 0
        Most other routes to look for, see `alternative_paths`.
    snap : bool, default False
        Whether a start or goal on blocked ground is moved to the nearest free place, and a goal that cannot be reached
        to the nearest one that can; the route's notes say where.
    furthest_m : float, default inf
        Furthest that `snap` may move a start or a goal [m].
    start_heading_deg, goal_heading_deg : float, optional
        Headings at the start and at the goal [deg, clockwise from north] of a robot with a turning radius; any without
        them. A robot that turns on the spot may have any heading.
    bound : bool, default False
        Whether to search for a lower bound of every route's energy, which prices the whole map once. Without it the
        bound is that of the idle power over the straight distance.
    """

    planner: str = "astar"
    neighbours: int = 16
    refine: bool = True
    alternatives: int = 0
    snap: bool = False
    furthest_m: float = math.inf
    start_heading_deg: float | None = None
    goal_heading_deg: float | None = None
    bound: bool = False

    def __post_init__(self) -> None:
        planner_named(self.planner)
        check_neighbours(self.neighbours)

    @property
    def asked(self) -> Planner:
        """The planner of that name."""
        return planner_named(self.planner)


USUAL = RouteOptions()
"""How a route is looked for where nothing is said."""


class RoutePlanner(FieldPlanner):
    """Plans on one lattice; keeps what repeated questions share (the priced moves).

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    """

    def __init__(self, lattice: CostLattice) -> None:
        super().__init__(lattice)
        self._avoiding: tuple[tuple[Polygon, ...], RoutePlanner] | None = None

    def prepare(self, *, progress: Callable[[float], None] | None = None) -> None:
        """Price the moves of refined routes now, so that the first question does not wait for it.

        Parameters
        ----------
        progress : callable, optional
            For planners that tell it.
        """
        self._with_margin(ANY_ANGLE_NEIGHBOURS, distance=False)

    def avoiding(self, polygons: Sequence[Sequence[Sequence[float]]]) -> RoutePlanner:
        """Return the planner of the same map with the cells of some polygons blocked.

        The one that was asked for last is kept; only the moves around the polygons are priced again.

        Parameters
        ----------
        polygons : sequence of sequence of (x, y)
            Corners [m]; none of them returns this planner.

        Returns
        -------
        RoutePlanner
            It needs as much memory as this one.

        Raises
        ------
        InputError
            If a polygon has fewer than three corners, or all together have too many.
        PointError
            If a corner is not finite, or a polygon lies outside the map.
        """
        if not polygons:
            return self
        areas = checked_polygons(polygons, self.lattice.frame)
        with self._making:
            if self._avoiding is None or self._avoiding[0] != areas:
                self._avoiding = None  # its memory is given back first
                self._avoiding = areas, _Avoiding(self, areas)
            return self._avoiding[1]

    def plan(self, start_xy: tuple[float, float], goal_xy: tuple[float, float], how: RouteOptions = USUAL) -> Plan:
        """Return the energy-optimal and the shortest route from start to goal.

        Parameters
        ----------
        start_xy, goal_xy : tuple of float
            World x, y [m].
        how : RouteOptions, optional
            How the route is looked for.

        Returns
        -------
        Plan
            Both routes, priced by `edges`. The first costs no more than the second, unless that is nearer to closed
            ground than the robot's margin.

        Raises
        ------
        InputError
            If a setting of the planner is out of bounds.
        PointError
            If start or goal is not finite or lies outside the map.
        BlockedError
            If start or goal is on blocked ground; the context names the nearest free place.
        NoRouteError
            If no route was found.
        NegativeCycleError
            If driving in a circle would fill the battery.
        """
        lattice = self.lattice
        curved = lattice.robot.min_turning_radius_m > 0.0
        if curved and (how.planner != "astar" or not how.refine or how.alternatives):
            raise InputError(
                f"the turning radius of {lattice.robot.name} is only kept by the planner astar, with `refine` and "
                "without `alternatives`"
            )
        if not curved and (how.start_heading_deg, how.goal_heading_deg) != (None, None):
            raise InputError("headings are given for a robot with `min_turning_radius_m`; this one turns on the spot")
        notes: list[str] = []
        start, goal = (self._end(name, xy, notes, how.snap) for name, xy in (("start", start_xy), ("goal", goal_xy)))
        for name, xy, place in (("start", start_xy, start), ("goal", goal_xy, goal)):
            free_x, free_y = (float(v) for v in lattice.frame.xy(*place))
            if (away_m := math.dist((free_x, free_y), xy)) > how.furthest_m:
                raise BlockedError(
                    f"{name} ({xy[0]:.2f}, {xy[1]:.2f}) is on blocked ground, and the nearest free place is "
                    f"({free_x:.2f}, {free_y:.2f}), {away_m:.2f} m away: `snap` may move it by "
                    f"{how.furthest_m:.2f} m at most",
                    which=name,
                    nearest=[free_x, free_y],
                    nearest_m=away_m,
                    furthest_m=how.furthest_m,
                )
        began = time.perf_counter()
        try:
            shortest, best, found = self._ways(start, goal, how)
        except NoRouteError as error:
            near = self._reachable_near(start, goal) if how.snap else None
            x, y = (math.nan, math.nan) if near is None else lattice.frame.xy(*near)
            if near is None or math.dist((x, y), goal_xy) > how.furthest_m:
                raise self._closing(start, goal) or error from error
            notes.append(
                f"the goal cannot be reached and was moved to the nearest place that can, ({x:.2f}, {y:.2f}), "
                f"{math.dist((x, y), goal_xy):.2f} m away"
            )
            goal = near
            shortest, best, found = self._ways(start, goal, how)
        if lattice.robot.turn_j_per_rad > 0.0 and not how.asked.weighs_turning:
            notes.append(f"{how.planner} does not weigh turning while it searches; the energy given includes it")
        if curved:
            shortest = min(shortest, best, key=path_length)
        else:
            shortest = shorter_of(lattice, self._distances, shortest, best)

        def _energy_j(way: Points) -> float:
            return driven_energy_j(lattice, way, like=best) if how.refine else path_price(lattice, way)

        from_shortest = _energy_j(shortest) < _energy_j(best)
        points = best
        if from_shortest:
            points = improved(lattice, shortest) if how.refine and not curved else shortest
        ways = [points]
        if how.alternatives > 0:
            ways += self._others(start, goal, points, how)
            ways.sort(key=_energy_j)  # once improved, another one may be the cheapest
        details = {
            "planner": how.planner,
            "neighbours": self._neighbours(how),
            "refined": how.refine,
            **found,
            "from_shortest": from_shortest,
            "seconds": time.perf_counter() - began,
        }
        bound_j = self._bound_j(start, goal, how)
        if how.refine:
            notes += margin_notes(lattice, ways[0])
        saved = path_price(lattice, ways[0]) - path_price(lattice, shortest)
        if how.refine and saved > 0.001 * abs(path_price(lattice, shortest)):
            notes.append(
                f"the shortest path takes {saved:.3g} J less if it is driven exactly: with the robot's error to the "
                "sides and its margin to closed ground it is the dearer one"
            )
        route, *rest = (self._route(way, notes) for way in ways)
        route = replace(route, goal_moved_m=math.dist(route.points[-1, :2], goal_xy))
        return Plan(route, self._route(shortest, notes), how.planner, details, tuple(rest), bound_j)

    @staticmethod
    def _neighbours(how: RouteOptions) -> int:
        return max(how.neighbours, ANY_ANGLE_NEIGHBOURS) if how.refine else how.neighbours

    def _ways(self, start: Points, goal: Points, how: RouteOptions) -> tuple[Points, Points, dict[str, Any]]:
        """The shortest way, the best one, and details."""
        neighbours = self._neighbours(how)
        if self.lattice.robot.min_turning_radius_m > 0.0:
            return self._curved(start, goal, how)
        if how.refine and not how.asked.uses_time_limit:
            way, (best, details) = self._both(start, goal, neighbours)
            return way, best, details
        way = self._shortest(start, goal, neighbours, how.refine)
        table = self._table(neighbours, distance=False)
        best, details = how.asked.search(self.lattice, table, start, goal, how)
        return way, improved(self.lattice, best) if how.refine else best, details

    def _curved(self, start: Points, goal: Points, how: RouteOptions) -> tuple[Points, Points, dict[str, Any]]:
        """As `_ways`, with no curve that is tighter than the turning radius."""
        self.needs_memory("a route for a robot with a turning radius")
        ends = {
            name: None if heading is None else math.radians(heading)
            for name, heading in (("start_rad", how.start_heading_deg), ("goal_rad", how.goal_heading_deg))
        }
        distances, energies = (self._with_margin(ANY_ANGLE_NEIGHBOURS, distance=short) for short in (True, False))
        near, free = self._shortest(start, goal, ANY_ANGLE_NEIGHBOURS, True), self._best(start, goal)[0]
        (shortest, _), (best, expanded) = both(
            lambda: curved_path(self._distances, distances, start, goal, near, **ends),
            lambda: curved_path(self.lattice, energies, start, goal, free, **ends),
        )
        return shortest, best, {"expanded": expanded}

    def _others(self, start: Points, goal: Points, points: Points, how: RouteOptions) -> list[Points]:
        """Other good ways than one."""
        neighbours = self._neighbours(how)
        table = self._with_margin(neighbours, distance=False) if how.refine else self._table(neighbours, distance=False)
        found = alternative_paths(self.lattice, table, start, goal, count=how.alternatives + 1)
        others = [way.points for way in found[1:]]
        return improved_ways(self.lattice, points, others) if how.refine else others

    def _bound_j(self, start: Points, goal: Points, how: RouteOptions) -> float | None:
        """A proven lower bound of the energy [J]; None where nothing is known."""
        least = quick_bound(self.lattice, start, goal)
        if how.bound and (prices := self._once("bound", lambda: bound_table(self.lattice))) is not None:
            least = max(least, energy_bound(self.lattice, prices, start, goal))
        return least if math.isfinite(least) else None

    def _reachable_near(self, start: Points, goal: Points) -> Points | None:
        """The cell centre nearest to a goal that the start leads to; both are fractional (row, col), (2,)."""
        lattice = self.lattice
        there = np.isfinite(field_from(lattice, self._table(ANY_ANGLE_NEIGHBOURS, distance=False), start).energy_j)
        cells = np.argwhere(there & free_places(lattice)).astype(np.float64)
        return cells[np.argmin(np.hypot(*(cells - goal).T))] if len(cells) else None

    def tour(
        self,
        stops_xy: Sequence[tuple[float, float]],
        *,
        neighbours: int = 16,
        refine: bool = True,
        in_order: bool = False,
        one_way: bool = False,
        time_limit_s: float = 10.0,
        snap: bool = False,
        progress: Callable[[float], None] | None = None,
    ) -> RoundTrip:
        """Return the cheapest tour from the first stop over all others, in the order that costs least or as given.

        Parameters
        ----------
        stops_xy : sequence of tuple of float
            World x, y [m] of 2 to 60 stops; the first one is home.
        neighbours : {16, 8, 32}
            Moves per cell.
        refine : bool, default True
            Whether to improve each leg at any angle.
        in_order : bool, default False
            Whether the stops are visited in the order in which they are given.
        one_way : bool, default False
            Whether the tour ends at the last of the given stops.
        time_limit_s : float, default 10.0
            Longest time for the search of the order [s]; the paths between stops come before it.
        snap : bool, default False
            Whether a stop on blocked ground is moved to the nearest free place; the notes say where.
        progress : callable, optional
            Called with the share that is done, 0..1.

        Returns
        -------
        RoundTrip
            The routes in order.

        Raises
        ------
        InputError
            If the number of stops is out of range, or OR-tools (extra `tours`) is not installed.
        PointError
            If a stop is not finite or lies outside the map.
        BlockedError
            If a stop is on blocked ground; the context names the nearest free place.
        NoRouteError
            If no route joins two stops; the message names them.
        BusyError
            If the time limit leaves no tour.
        """
        self.needs_memory(f"a tour of {len(stops_xy)} stops")
        notes: list[str] = []
        stops = np.array([self._end(f"stop {k}", xy, notes, snap) for k, xy in enumerate(stops_xy)])
        table = self._table(neighbours, distance=False)
        found = cheapest_tour(
            self.lattice, table, stops, in_order=in_order, one_way=one_way, time_limit_s=time_limit_s, progress=progress
        )
        ways = self._legs([leg.points for leg in found.paths], refine)
        order = tuple(int(stop) for stop in found.order)
        legs = in_sequence([self._route(way, []) for way in ways], self.lattice.robot.turn_j_per_rad)
        return RoundTrip(legs, order, found.energy_j, found.bound_j, tuple(notes))

    def _legs(self, paths: list[Points], refine: bool) -> list[Points]:
        """The legs of a tour, improved; where curves are limited each begins with the heading in which it arrived."""
        if self.lattice.robot.min_turning_radius_m == 0.0:
            return [self._best(path[0], path[-1])[0] if refine else path for path in paths]
        ways, arrived = list[Points](), None
        for k, path in enumerate(paths):
            try:
                ways.append(self._curved(path[0], path[-1], RouteOptions(start_heading_deg=arrived))[1])
            except NoRouteError:  # as the leg before arrived it leads nowhere
                if not ways:
                    raise
                begun = None if k < 2 else math.degrees(path_headings(ways[-2])[-1])
                ways[-1:] = self._through(paths[k - 1], path, begun)
            arrived = math.degrees(path_headings(ways[-1])[-1])
        return ways

    def _through(self, before: Points, after: Points, begun_deg: float | None) -> list[Points]:
        """Two legs by the heading at the stop between them at which they take least. Raises NoRouteError if none is."""
        found = list[tuple[float, list[Points]]]()
        for at_stop in np.arange(0.0, 360.0, _STOP_HEADINGS_DEG).tolist():
            arriving = RouteOptions(start_heading_deg=begun_deg, goal_heading_deg=at_stop)
            hows = arriving, RouteOptions(start_heading_deg=at_stop)
            with suppress(NoRouteError):
                legs = [self._curved(leg[0], leg[-1], how)[1] for leg, how in zip((before, after), hows, strict=True)]
                found.append((sum(path_price(self.lattice, leg) for leg in legs), legs))
        if not found:
            x, y = (float(value) for value in self.lattice.frame.xy(*after[0]))
            raise NoRouteError(
                f"no tour leads through the stop ({x:.2f}, {y:.2f}): there is no heading at which one leg can arrive "
                f"and the next one leave, with curves of at least {self.lattice.robot.min_turning_radius_m:g} m radius"
            )
        return min(found, key=lambda one: one[0])[1]

    def on_from(self, route: Route) -> RouteOptions:
        """Return options of a route that goes on from another, in its last heading where curves are limited.

        Parameters
        ----------
        route : Route
            What is driven before.

        Returns
        -------
        RouteOptions
            All else as usual.
        """
        if self.lattice.robot.min_turning_radius_m == 0.0 or len(route.points) < 2:
            return RouteOptions()
        dx, dy = np.diff(route.points[-2:, :2], axis=0)[0]
        return RouteOptions(start_heading_deg=math.degrees(math.atan2(dx, dy)) % 360.0)

    def _best(self, start: Points, goal: Points) -> tuple[Points, dict[str, Any]]:
        """The best path of any angles that we find, for every kind of question."""
        best = best_path(self.lattice, self._with_margin(ANY_ANGLE_NEIGHBOURS, distance=False), start, goal)
        return best.points, {
            "expanded": best.expanded,
            "grid_energy_j": best.grid_energy_j,
        }

    def _both(self, start: Points, goal: Points, neighbours: int) -> tuple[Points, tuple[Points, dict[str, Any]]]:
        """The shortest path, and the best one."""
        return both(lambda: self._shortest(start, goal, neighbours, True), lambda: self._best(start, goal))

    def _shortest(self, start: Points, goal: Points, neighbours: int, refine: bool) -> Points:
        """The shortest path within the limits and the margin: the straight line where it is free."""
        straight = np.vstack([start, goal])
        free = refine and np.isfinite(path_price(self._distances, straight))
        if free and metres_within_margin(self._distances, straight) == 0.0:
            return straight
        table = self._with_margin(neighbours, distance=True) if refine else self._table(neighbours, distance=True)
        points = self._grid(table, self._distances, start, goal)
        return tightened(self._distances, points) if refine else points

    def _grid(self, table: MoveTable, lattice: CostLattice, start: Points, goal: Points) -> Points:
        """The best path over grid moves."""
        return grid_search(lattice, table, start, goal).points

    def _route(self, points: Points, notes: list[str]) -> Route:
        x, y = self.lattice.frame.xy(points[:, 0], points[:, 1])
        return price_route(self.lattice, np.column_stack([x, y]), notes=notes)


class _Avoiding(RoutePlanner):
    """A planner whose moves are those of another one, but for some areas."""

    def __init__(self, whole: RoutePlanner, areas: tuple[Polygon, ...]) -> None:
        super().__init__(without(whole.lattice, areas))
        self._whole, self._areas = whole, areas

    def _priced(self, neighbours: int) -> MoveTable:
        table = self._whole._table(neighbours, distance=False)
        table = replace(table, energy=table.energy.copy())
        for area in self._areas:
            table = repriced(table, self.lattice, window_of(self.lattice.frame, area))
        return table
