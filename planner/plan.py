"""One question, one answer: the energy-optimal route with the shortest one beside it, or the cheapest round trip."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from joulemap.model.errors import InputError, NoRouteError
from joulemap.planner.alternatives import alternative_paths, improved_ways
from joulemap.planner.edges import Points, path_price
from joulemap.planner.landmarks import Landmarks, make_landmarks
from joulemap.planner.lattice import CostLattice
from joulemap.planner.moves import MoveTable, distance_table, move_table
from joulemap.planner.refine import LEVELS, refine_path
from joulemap.planner.route import Route, price_route
from joulemap.planner.search import PLANNERS as GRID_PLANNERS
from joulemap.planner.search import grid_search, standing_point
from joulemap.planner.tours import cheapest_tour

SAMPLING_PLANNERS = ("rrtstar", "informed_rrtstar", "bitstar")
PLANNERS = (*GRID_PLANNERS, *SAMPLING_PLANNERS)


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """The answer to one question.

    route : least energy found; shortest : least length within the same limits, priced the same way; details : JSON-able
    record of how it was found (seconds, expanded, grid_energy_j, ...); others : other good ways, cheapest first.
    """

    route: Route
    shortest: Route
    planner: str
    details: dict[str, Any]
    others: tuple[Route, ...] = ()

    @property
    def saving_j(self) -> float:
        """Energy [J] that the route saves against the shortest path; never negative."""
        return self.shortest.energy_j - self.route.energy_j


@dataclass(frozen=True, eq=False, repr=False)
class RoundTrip:
    """A tour of several stops.

    legs : n, from each stop to the next and home from the last; order : (n,) which stop is visited when, home (stop 0)
    first; grid_energy_j, bound_j : energy of the tour over grid moves, and what no order of the stops costs less than
    over them; notes : what was done to the stops.
    """

    legs: tuple[Route, ...]
    order: tuple[int, ...]
    grid_energy_j: float
    bound_j: float
    notes: tuple[str, ...]

    @property
    def energy_j(self) -> float:
        """Energy [J] of all legs; turning on arrival at a stop is not counted."""
        return sum(leg.energy_j for leg in self.legs)

    @property
    def proven(self) -> bool:
        """Whether no other order costs less over grid moves."""
        return self.grid_energy_j <= self.bound_j + 1e-6 * abs(self.bound_j) + 1e-3


def distance_lattice(lattice: CostLattice) -> CostLattice:
    """The same ground and limits at a price of 1 per metre in every direction: its cheapest path is the shortest."""
    robot = replace(lattice.robot, idle_power_w=1.0, speed_mps=1.0, regeneration=0.0, turn_j_per_rad=0.0)
    flat = np.where(np.isnan(lattice.traction_per_m), lattice.traction_per_m, np.float32(0.0))
    return replace(lattice, robot=robot, traction_per_m=flat)


class RoutePlanner:
    """Plans on one lattice; keeps what repeated questions share (the priced moves)."""

    def __init__(self, lattice: CostLattice) -> None:
        self.lattice = lattice
        self._distances = distance_lattice(lattice)
        self._tables: dict[tuple[bool, int], MoveTable] = {}
        self._landmarks: dict[int, Landmarks] = {}

    def prepare(self, neighbours: int = 16, *, landmarks: bool = False) -> None:
        """Price the moves now, so that the first question does not wait for it.

        landmarks : make them too; they cost eight energy fields and spare every further A* most of its search.
        """
        self._table(neighbours, distance=True)
        if landmarks and neighbours not in self._landmarks:
            self._landmarks[neighbours] = make_landmarks(self._table(neighbours, distance=False))

    def _table(self, neighbours: int, *, distance: bool) -> MoveTable:
        key = (distance, neighbours)
        if key not in self._tables:
            self._tables[key] = (
                distance_table(self._table(neighbours, distance=False))
                if distance
                else move_table(self.lattice, neighbours=neighbours)
            )
        return self._tables[key]

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
        progress: Callable[[float], None] | None = None,
    ) -> Plan:
        """The energy-optimal and the shortest route from start to goal (world x, y [m]).

        planner : one of `PLANNERS`; neighbours : 8, 16 or 32 (grid planners); refine : any-angle improvement of the
        path found; time_limit_s, seed : for the sampling planners, which with `from_grid` sample only near the grid's
        path, or where the grid leaves hope of a better way, and answer with the grid's if they find none;
        alternatives : most other ways to look for (`alternative_paths`). Raises PointError, BlockedError, NoRouteError.
        """
        if planner not in PLANNERS:
            raise InputError(f"planner must be one of {', '.join(PLANNERS)}, got {planner!r}", planner=planner)
        lattice = self.lattice
        notes: list[str] = []
        start, goal = (self._standing(name, xy, notes) for name, xy in (("start", start_xy), ("goal", goal_xy)))
        began = time.perf_counter()
        shortest, _ = self._grid_route(start, goal, neighbours, refine, "astar", distance=True)
        details: dict[str, Any] = {"planner": planner, "neighbours": neighbours, "refined": refine}
        if planner in GRID_PLANNERS:
            points, found = self._grid_route(start, goal, neighbours, refine, planner, distance=False)
        else:
            points, found = self._sampled_route(
                start, goal, planner, time_limit_s, seed, neighbours if from_grid else None, progress
            )
            points = refine_path(lattice, points) if refine else points
            if lattice.robot.turn_j_per_rad > 0.0:
                notes.append(f"{planner} does not weigh turning while it searches; the energy given includes it")
        details |= found
        details["from_shortest"] = path_price(lattice, shortest) < path_price(lattice, points)
        if details["from_shortest"]:  # the route never costs more than the shortest path
            points = refine_path(lattice, shortest) if refine else shortest
        ways = [points]
        if alternatives > 0:
            table = self._table(neighbours, distance=False)
            others = [w.points for w in alternative_paths(lattice, table, start, goal, count=alternatives + 1)[1:]]
            ways += improved_ways(lattice, points, others) if refine else others
            ways.sort(key=lambda way: path_price(lattice, way))  # once improved, another one may be the cheapest
        details["seconds"] = time.perf_counter() - began
        route, *rest = (self._route(way, notes) for way in ways)
        return Plan(route, self._route(shortest, notes), planner, details, tuple(rest))

    def tour(
        self,
        stops_xy: Sequence[tuple[float, float]],
        *,
        neighbours: int = 16,
        refine: bool = True,
        time_limit_s: float = 10.0,
        progress: Callable[[float], None] | None = None,
    ) -> RoundTrip:
        """Visit all stops (world x, y [m]) and come home to the first one, in the order that costs least.

        time_limit_s : for the order, not for the ways. Needs the extra `tours`. Raises PointError, BlockedError,
        NoRouteError naming two stops, InputError, BusyError.
        """
        notes: list[str] = []
        stops = np.array([self._standing(f"stop {k}", xy, notes) for k, xy in enumerate(stops_xy)])
        table = self._table(neighbours, distance=False)
        found = cheapest_tour(self.lattice, table, stops, time_limit_s=time_limit_s, progress=progress)
        ways = (refine_path(self.lattice, leg.points) if refine else leg.points for leg in found.paths)
        order = tuple(int(stop) for stop in found.order)
        legs = tuple(self._route(way, []) for way in ways)
        return RoundTrip(legs, order, found.energy_j, found.bound_j, tuple(notes))

    def _standing(self, name: str, xy: tuple[float, float], notes: list[str]) -> Points:
        """Where a way may begin or end for a world point; a note where that is another place."""
        point, moved = standing_point(self.lattice, float(xy[0]), float(xy[1]), name=name)
        if moved:
            x, y = self.lattice.frame.xy(*point)
            notes.append(f"{name} leans on blocked ground and was moved to the centre of its cell, ({x:.2f}, {y:.2f})")
        return point

    def _grid_route(
        self, start: Points, goal: Points, neighbours: int, refine: bool, planner: str, *, distance: bool
    ) -> tuple[Points, dict[str, Any]]:
        lattice = self._distances if distance else self.lattice
        found = grid_search(
            lattice,
            self._table(neighbours, distance=distance),
            start,
            goal,
            planner=planner,
            landmarks=None if distance or planner != "astar" else self._landmarks.get(neighbours),
        )
        assert found.points is not None
        levels = LEVELS[:2] if distance else LEVELS  # a taut string needs no small zigzags
        points = refine_path(lattice, found.points, levels=levels) if refine else found.points
        return points, {"expanded": found.expanded, "grid_energy_j": found.energy_j}

    def _sampled_route(
        self,
        start: Points,
        goal: Points,
        planner: str,
        time_limit_s: float,
        seed: int,
        from_grid: int | None,
        progress: Callable[[float], None] | None,
    ) -> tuple[Points, dict[str, Any]]:
        from joulemap.planner import sampling  # OMPL is loaded only where it is asked for

        lattice = self.lattice
        options: dict[str, Any] = {"time_limit_s": time_limit_s, "seed": seed, "progress": progress}
        if from_grid is None:
            return sampling.sample_route(lattice, start, goal, planner=planner, **options)
        table = self._table(from_grid, distance=False)
        grid = grid_search(lattice, table, start, goal)
        details: dict[str, Any] = {"grid_energy_j": grid.energy_j}
        try:
            if planner == "bitstar":
                points, found = sampling.sample_along(lattice, grid.points, **options)
            else:
                places = sampling.hopeful_places(lattice, table, start, goal)
                points, found = sampling.sample_route(lattice, start, goal, planner=planner, places=places, **options)
        except NoRouteError:
            return grid.points, details
        better = path_price(lattice, points) < path_price(lattice, grid.points)
        return points if better else grid.points, details | found

    def _route(self, points: Points, notes: list[str]) -> Route:
        x, y = self.lattice.frame.xy(points[:, 0], points[:, 1])
        return price_route(self.lattice, np.column_stack([x, y]), notes=notes)
