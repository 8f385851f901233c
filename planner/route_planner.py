"""One question, one answer: the energy-optimal route with the shortest one beside it, or the cheapest round trip."""

from __future__ import annotations

import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import BlockedError, NoRouteError
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
from joulemap.planner.areas.energy_map import EnergyMap, energy_map
from joulemap.planner.areas.reach import ReachField, reach_field
from joulemap.planner.grid.fields import field_from, field_towards
from joulemap.planner.grid.search import grid_search, joining_legs
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.avoid import Polygon, checked_polygons, window_of, without
from joulemap.planner.places import end_point, free_places
from joulemap.planner.planners import PLANNERS, Options, planner_named
from joulemap.planner.pricing.integrator import Points, margin_cells, metres_within_margin, path_price
from joulemap.planner.pricing.move_prices import check_neighbours
from joulemap.planner.pricing.moves import MoveTable, distance_table, move_table, repriced, with_margin
from joulemap.planner.questions.alternatives import alternative_paths, improved_ways
from joulemap.planner.questions.bound import BoundTable, bound_table, energy_bound, quick_bound
from joulemap.planner.questions.matrix import Matrix, Place, energy_matrix
from joulemap.planner.questions.tours import cheapest_tour
from joulemap.planner.route import Route, price_route

SAMPLING_PLANNERS = tuple(name for name in PLANNERS if planner_named(name).uses_time_limit)

_KEPT_REACHES = 2
_KEPT_TOWARDS = 20  # of 4 bytes a cell


def distance_lattice(lattice: CostLattice) -> CostLattice:
    """Return the same ground and limits at a price of 1 J/m in every direction: its cheapest path is the shortest.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.

    Returns
    -------
    CostLattice
        The lattice of distances.
    """
    robot = replace(lattice.robot, idle_power_w=1.0, speed_mps=1.0, regeneration=0.0, turn_j_per_rad=0.0)
    known = np.einsum("ijk->ij", lattice.traction_per_m)  # NaN where one heading is
    flat = np.empty((*lattice.frame.shape, 4), np.float32)
    flat[...] = np.where(np.isnan(known), np.nan, 0.0)[:, :, None]
    return replace(lattice, robot=robot, traction_per_m=flat, std_j=None)


class RoutePlanner:
    """Plans on one lattice; keeps what repeated questions share (the priced moves).

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    """

    def __init__(self, lattice: CostLattice) -> None:
        self.lattice = lattice
        self._distances = distance_lattice(lattice)
        self._tables: dict[tuple[bool, int], MoveTable] = {}
        self._margins: dict[int, MoveTable] = {}
        self._bounds: tuple[BoundTable | None] | None = None
        self._reaching = threading.Lock()
        self._making = threading.RLock()  # what is kept is made once; questions then share it without a lock
        self._avoiding: tuple[tuple[Polygon, ...], RoutePlanner] | None = None
        self._towards: OrderedDict[tuple[float, float], NDArray[np.float32]] = OrderedDict()
        self._reaches: OrderedDict[tuple[tuple[float, ...], bool], ReachField] = OrderedDict()

    def prepare(self) -> None:
        """Price the moves of refined routes now, so that the first question does not wait for it."""
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

    def reach(
        self, start_xy: tuple[float, float], *, round_trip: bool = False, snap: bool = False
    ) -> tuple[ReachField, list[str]]:
        """Return what it takes to drive from one place to every cell, or there and back.

        Those that were asked for last are kept.

        Parameters
        ----------
        start_xy : tuple of float
            World x, y [m].
        round_trip : bool, default False
            Whether it must come back to the start, by the best way back.
        snap : bool, default False
            Whether a start on blocked ground is moved to the nearest free place.

        Returns
        -------
        field : ReachField
            For any battery.
        notes : list of str
            Where the start was moved to, if it was.

        Raises
        ------
        PointError
            If the start is not finite or lies outside the map.
        BlockedError
            If the start is on blocked ground.
        """
        notes: list[str] = []
        start = self._end("start", start_xy, notes, snap)
        table = self._table(ANY_ANGLE_NEIGHBOURS, distance=False)
        key = tuple(start.tolist()), round_trip
        with self._reaching:
            if key not in self._reaches:
                while len(self._reaches) >= _KEPT_REACHES:
                    self._reaches.popitem(last=False)
                self._reaches[key] = reach_field(self.lattice, table, start, round_trip=round_trip)
            self._reaches.move_to_end(key)
            return self._reaches[key], notes

    def field(
        self,
        *,
        start: tuple[float, float] | None = None,
        goal: tuple[float, float] | None = None,
        neighbours: int = 16,
        snap: bool = False,
    ) -> tuple[EnergyMap, list[str]]:
        """Return the least energy from a start to every cell, from every cell to a goal, or over every cell.

        Parameters
        ----------
        start, goal : tuple of float, optional
            World x, y [m]; at least one of them.
        neighbours : {16, 8, 32}
            Moves per cell.
        snap : bool, default False
            Whether a place on blocked ground is moved to the nearest free one.

        Returns
        -------
        energies : EnergyMap
            Energies [J].
        notes : list of str
            Where places were moved to.
        """
        notes: list[str] = []
        here, there = (
            None if xy is None else self._end(name, xy, notes, snap) for name, xy in (("start", start), ("goal", goal))
        )
        table = self._table(neighbours, distance=False)
        out = None if here is None else field_from(self.lattice, table, here)
        back = None if there is None else field_towards(self.lattice, table, there[None])
        return energy_map(out, back), notes

    def matrix(
        self,
        starts_xy: Sequence[tuple[float, float]],
        goals_xy: Sequence[tuple[float, float]],
        *,
        neighbours: int = ANY_ANGLE_NEIGHBOURS,
        snap: bool = False,
        only_cheapest: bool = False,
        progress: Callable[[float], None] | None = None,
    ) -> tuple[Matrix, list[str]]:
        """Return the least energies between starts and goals.

        A place on blocked ground is no error: its ways have that reason.

        Parameters
        ----------
        starts_xy, goals_xy : sequence of tuple of float
            World x, y [m].
        neighbours : {32, 8, 16}
            Moves per cell.
        snap : bool, default False
            Whether places on blocked ground are moved to the nearest free ones.
        only_cheapest : bool, default False
            Whether only the goal of least energy is found for each start.
        progress : callable, optional
            Called with the share that is done, 0..1.

        Returns
        -------
        matrix : Matrix
            Energies [J], lengths [m] and reasons.
        notes : list of str
            Where places were moved to.

        Raises
        ------
        PointError
            If a place is not finite or lies outside the map.
        """
        notes: list[str] = []

        def _places(name: str, places_xy: Sequence[tuple[float, float]], *, outward: bool) -> list[Place]:
            found: list[Place] = []
            for k, xy in enumerate(places_xy):
                try:
                    point = self._end(f"{name} {k}", xy, notes, snap)
                    joined = np.isfinite(joining_legs(self.lattice, point, outward=outward)[1]).any()
                    found.append(point if joined else f"{name} {k} is next to blocked ground: no leg joins it")
                except BlockedError as error:
                    found.append(error.message)
            return found

        ends = _places("start", starts_xy, outward=True), _places("goal", goals_xy, outward=False)
        table = self._table(neighbours, distance=False)
        return energy_matrix(self.lattice, table, *ends, only_cheapest=only_cheapest, progress=progress), notes

    def _priced(self, neighbours: int) -> MoveTable:
        return move_table(self.lattice, neighbours=neighbours)

    def _table(self, neighbours: int, *, distance: bool) -> MoveTable:
        key = (distance, neighbours)
        if key not in self._tables:
            with self._making:
                if key not in self._tables:
                    self._tables[key] = (
                        distance_table(self._table(neighbours, distance=False))
                        if distance
                        else self._priced(neighbours)
                    )
        return self._tables[key]

    def _with_margin(self, neighbours: int, *, distance: bool) -> MoveTable:
        """The moves of refined routes, which keep the robot's margin to closed ground where another way exists."""
        if neighbours not in self._margins:
            with self._making:
                if neighbours not in self._margins:
                    table = self._table(neighbours, distance=False)
                    self._margins[neighbours] = with_margin(table, margin_cells(self.lattice))
        table = self._margins[neighbours]
        return distance_table(table) if distance else table

    def plan(
        self,
        start_xy: tuple[float, float],
        goal_xy: tuple[float, float],
        *,
        planner: str = "astar",
        neighbours: int = 16,
        refine: bool = True,
        time_limit_s: float = 5.0,
        seed: int = 0,
        from_grid: bool = False,
        alternatives: int = 0,
        snap: bool = False,
        bound: bool = False,
        progress: Callable[[float], None] | None = None,
    ) -> Plan:
        """Return the energy-optimal and the shortest route from start to goal.

        Parameters
        ----------
        start_xy, goal_xy : tuple of float
            World x, y [m].
        planner : str, default "astar"
            One of `PLANNERS`, or the name of a planner that was registered.
        neighbours : {16, 8, 32}
            Moves per cell of the grid planners without `refine`; with it they are 32.
        refine : bool, default True
            Whether to improve the path at any angle, which never makes it dearer.
        time_limit_s : float, default 5.0
            How long the sampling planners search [s].
        seed : int, default 0
            Seed of the sampling planners.
        from_grid : bool, default False
            Whether the sampling planners sample only near the grid's path, or where a path could be cheaper than it,
            and return the grid's path if they find no better one.
        alternatives : int, default 0
            Most other routes to look for, see `alternative_paths`.
        snap : bool, default False
            Whether a start or goal on blocked ground is moved to the nearest free place, and a goal that cannot be
            reached to the nearest one that can; the route's notes say where.
        bound : bool, default False
            Whether to search for a lower bound of every route's energy, which prices the whole map once. Without it the
            bound is that of the idle power over the straight distance.
        progress : callable, optional
            Called with the share of the sampling planners' time that is over, 0..1.

        Returns
        -------
        Plan
            Both routes, priced by `edges`. The first costs no more than the second, unless that is nearer to closed
            ground than the robot's margin.

        Raises
        ------
        InputError
            If the planner or a setting is unknown.
        PointError
            If start or goal is not finite or lies outside the map.
        BlockedError
            If start or goal is on blocked ground; the context names the nearest free place.
        NoRouteError
            If no route was found.
        NegativeCycleError
            If driving in a circle would fill the battery.
        """
        asked = planner_named(planner)
        check_neighbours(neighbours)
        lattice = self.lattice
        notes: list[str] = []
        start, goal = (self._end(name, xy, notes, snap) for name, xy in (("start", start_xy), ("goal", goal_xy)))
        began = time.perf_counter()
        if refine:
            neighbours = max(neighbours, ANY_ANGLE_NEIGHBOURS)

        def _found(goal: Points) -> tuple[Points, Points, dict[str, Any]]:
            """The shortest way, the best one, and details."""
            if refine and not asked.uses_time_limit:
                way, (best, details) = both(
                    lambda: self._shortest(start, goal, neighbours, refine), lambda: self._best(start, goal)
                )
                return way, best, details
            way = self._shortest(start, goal, neighbours, refine)
            table = self._table(neighbours, distance=False)
            options = Options(time_limit_s, seed, from_grid, progress)
            best, details = asked.search(lattice, table, start, goal, options)
            return way, improved(lattice, best) if refine else best, details

        try:
            shortest, points, found = _found(goal)
        except NoRouteError:
            if not snap or (near := self._reachable_near(start, goal)) is None:
                raise
            x, y = lattice.frame.xy(*near)
            notes.append(
                f"the goal cannot be reached and was moved to the nearest place that can, ({x:.2f}, {y:.2f}), "
                f"{math.dist((x, y), goal_xy):.2f} m away"
            )
            goal = near
            shortest, points, found = _found(goal)
        if lattice.robot.turn_j_per_rad > 0.0 and not asked.weighs_turning:
            notes.append(f"{planner} does not weigh turning while it searches; the energy given includes it")
        details: dict[str, Any] = {"planner": planner, "neighbours": neighbours, "refined": refine, **found}
        shortest = shorter_of(lattice, self._distances, shortest, points)
        best = points

        def _energy_j(way: Points) -> float:
            return driven_energy_j(lattice, way, like=best) if refine else path_price(lattice, way)

        details["from_shortest"] = _energy_j(shortest) < _energy_j(points)
        if details["from_shortest"]:
            points = improved(lattice, shortest) if refine else shortest
        ways = [points]
        if alternatives > 0:
            table = self._table(neighbours, distance=False)
            others = [w.points for w in alternative_paths(lattice, table, start, goal, count=alternatives + 1)[1:]]
            ways += improved_ways(lattice, points, others) if refine else others
            ways.sort(key=_energy_j)  # once improved, another one may be the cheapest
        details["seconds"] = time.perf_counter() - began
        least = quick_bound(lattice, start, goal)
        if bound and (prices := self._bound_prices()) is not None:
            least = max(least, energy_bound(lattice, prices, start, goal))
        bound_j = least if math.isfinite(least) else None
        if refine:
            notes += margin_notes(lattice, ways[0])
        route, *rest = (self._route(way, notes) for way in ways)
        return Plan(route, self._route(shortest, notes), planner, details, tuple(rest), bound_j)

    def _reachable_near(self, start: Points, goal: Points) -> Points | None:
        """The cell centre nearest to a goal that the start leads to; both are fractional (row, col), (2,)."""
        lattice = self.lattice
        there = np.isfinite(field_from(lattice, self._table(ANY_ANGLE_NEIGHBOURS, distance=False), start).energy_j)
        cells = np.argwhere(there & free_places(lattice)).astype(np.float64)
        return cells[np.argmin(np.hypot(*(cells - goal).T))] if len(cells) else None

    def keeps_energies_towards(self, goal_xy: tuple[float, float]) -> bool:
        """Return whether `energies_towards` answers without a search.

        Parameters
        ----------
        goal_xy : tuple of float
            World x, y [m].

        Returns
        -------
        bool
            Whether the energies are kept.
        """
        return (float(goal_xy[0]), float(goal_xy[1])) in self._towards

    def energies_towards(self, goal_xy: tuple[float, float], *, name: str = "goal") -> NDArray[np.float32]:
        """Return the least energy from every cell to one place, over grid moves.

        Those that were asked for last are kept, so that a robot on its way may ask every second.

        Parameters
        ----------
        goal_xy : tuple of float
            World x, y [m].
        name : str, default "goal"
            What messages call it.

        Returns
        -------
        ndarray of float32, (rows, cols)
            Energy [J]; infinite where there is no way.

        Raises
        ------
        PointError
            If the place is not finite or lies outside the map.
        BlockedError
            If it is on blocked ground.
        """
        key = (float(goal_xy[0]), float(goal_xy[1]))
        with self._reaching:
            if key not in self._towards:
                goal = self._end(name, key, [], False)
                found = field_towards(self.lattice, self._table(ANY_ANGLE_NEIGHBOURS, distance=False), goal[None])
                while len(self._towards) >= _KEPT_TOWARDS:
                    self._towards.popitem(last=False)
                self._towards[key] = found.energy_j.astype(np.float32)
            self._towards.move_to_end(key)
            return self._towards[key]

    def tour(
        self,
        stops_xy: Sequence[tuple[float, float]],
        *,
        neighbours: int = 16,
        refine: bool = True,
        time_limit_s: float = 10.0,
        snap: bool = False,
        progress: Callable[[float], None] | None = None,
    ) -> RoundTrip:
        """Return the cheapest round trip from the first stop over all others, in the order that costs least.

        Parameters
        ----------
        stops_xy : sequence of tuple of float
            World x, y [m] of 2 to 60 stops; the first one is home.
        neighbours : {16, 8, 32}
            Moves per cell.
        refine : bool, default True
            Whether to improve each leg at any angle.
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
        notes: list[str] = []
        stops = np.array([self._end(f"stop {k}", xy, notes, snap) for k, xy in enumerate(stops_xy)])
        table = self._table(neighbours, distance=False)
        found = cheapest_tour(self.lattice, table, stops, time_limit_s=time_limit_s, progress=progress)
        ways = (self._best(leg.points[0], leg.points[-1])[0] if refine else leg.points for leg in found.paths)
        order = tuple(int(stop) for stop in found.order)
        legs = tuple(self._route(way, []) for way in ways)
        return RoundTrip(legs, order, found.energy_j, found.bound_j, tuple(notes))

    def _end(self, name: str, xy: tuple[float, float], notes: list[str], snap: bool) -> Points:
        """Where a route begins or ends for a world point; a note where that is another place."""
        point, note = end_point(self.lattice, float(xy[0]), float(xy[1]), name=name, snap=snap)
        if note is not None:
            notes.append(note)
        return point

    def _bound_prices(self) -> BoundTable | None:
        with self._making:
            if self._bounds is None:
                self._bounds = (bound_table(self.lattice),)
        return self._bounds[0]

    def _best(self, start: Points, goal: Points) -> tuple[Points, dict[str, Any]]:
        """The best path of any angles that we find, for every kind of question."""
        best = best_path(self.lattice, self._with_margin(ANY_ANGLE_NEIGHBOURS, distance=False), start, goal)
        return best.points, {
            "expanded": best.expanded,
            "grid_energy_j": best.grid_energy_j,
        }

    def _shortest(self, start: Points, goal: Points, neighbours: int, refine: bool) -> Points:
        """The shortest path within the limits and the margin: the straight line where it is free."""
        straight = np.vstack([start, goal])
        free = refine and np.isfinite(path_price(self._distances, straight))
        if free and metres_within_margin(self._distances, straight) == 0.0:
            return straight
        table = self._with_margin(neighbours, distance=True) if refine else self._table(neighbours, distance=True)
        points = grid_search(self._distances, table, start, goal).points
        return tightened(self._distances, points) if refine else points

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
