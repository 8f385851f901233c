"""Routes on a lattice that stays on disk: the search over tiles, then the any-angle step around what it found.

Where the surroundings of the path that was found are small enough they are read, and searched as a lattice in memory
is: the answer is the one that the whole map gives in memory. A longer path is improved where it is.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError
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
from joulemap.planner.grid.search import grid_search
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.avoid import checked_polygons
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.planner.on_disk.coarse import CoarseLevel, coarse_level
from joulemap.planner.on_disk.strip import Strip
from joulemap.planner.on_disk.tiled_search import DEFAULT_MEMORY, TiledSearch
from joulemap.planner.places import end_point
from joulemap.planner.pricing.integrator import Points, margin_cells, metres_within_margin, path_price
from joulemap.planner.pricing.move_prices import MovePrices
from joulemap.planner.pricing.moves import MoveTable, distance_table, move_table, with_margin
from joulemap.planner.questions.bound import quick_bound
from joulemap.planner.route import Route, price_route

MARGIN_CELLS = 48
"""How far beside the grid's path the any-angle step may go."""
SURROUNDINGS_CELLS = 1_000_000
"""Most cells around a path that are read and searched as a lattice in memory is, in about a second and 0.3 GB."""
_BYTES_PER_CELL = 400
"""What such a cell takes: prices by heading, those of moves, and labels [bytes]."""
_ENDS_CELLS = 128
"""How far around start and goal free places are looked for."""
_MOST_STRIP = 400_000_000
"""Memory [bytes] of what was read along earlier paths before it is given back."""


class StoredPlanner:
    """Answers questions to a lattice of any size within a given memory, as `RoutePlanner` does in memory.

    Parameters
    ----------
    path : str or Path
        The lattice's folder.
    memory_bytes : int, optional
        Most memory of a search [bytes]. What the process needs else, about 0.4 GB, comes on top.
    """

    def __init__(self, path: str | Path, *, memory_bytes: int = DEFAULT_MEMORY) -> None:
        self.stored = StoredLattice(path)
        self._memory = memory_bytes
        self._strip = Strip(self.stored)
        self._levels: dict[int, tuple[MovePrices, CoarseLevel]] = {}

    @property
    def lattice(self) -> CostLattice:
        """The lattice, of which only what earlier questions needed was read; blocked as unknown elsewhere."""
        return self._strip.lattice

    def prepare(self, neighbours: int = 16, *, progress: Callable[[float], None] | None = None) -> None:
        """Make the coarse level now, so that the first question does not wait for it.

        Parameters
        ----------
        neighbours : {16, 8, 32}
            Moves per cell.
        progress : callable, optional
            Called with the share that is done, 0..1.
        """
        self._level(neighbours, progress)

    def _level(
        self, neighbours: int, progress: Callable[[float], None] | None = None
    ) -> tuple[MovePrices, CoarseLevel]:
        if neighbours not in self._levels:
            moves = MovePrices(self.stored.headings, neighbours)
            self._levels[neighbours] = moves, coarse_level(self.stored, moves, progress=progress)
        return self._levels[neighbours]

    def avoiding(self, polygons: Sequence[Sequence[Sequence[float]]]) -> StoredPlanner:
        """Return the planner of the same map with the cells of some polygons blocked.

        Parameters
        ----------
        polygons : sequence of sequence of (x, y)
            Corners [m]; none of them returns this planner.

        Returns
        -------
        StoredPlanner
            It shares the coarse level, whose bounds hold for less ground too.

        Raises
        ------
        InputError
            If a polygon has fewer than three corners, or all together have too many.
        PointError
            If a corner is not finite, or a polygon lies outside the map.
        """
        if not polygons:
            return self
        other = copy(self)
        other.stored = self.stored.avoiding(checked_polygons(polygons, self.stored.frame))
        other._strip = Strip(other.stored)
        return other

    def read_along(self, xy: ArrayLike) -> None:
        """Read what a polyline needs to be priced on `lattice`.

        Parameters
        ----------
        xy : array_like, (n, 2)
            World x, y [m].
        """
        points = np.asarray(xy, dtype=np.float64)
        if points.ndim == 2 and np.isfinite(points).all():
            row, col = self.stored.frame.rowcol(points[:, 0], points[:, 1])
            inside = np.clip(np.column_stack([row, col]), 0.0, np.array(self.stored.frame.shape) - 1.0)
            self._strip.read_along(inside, cells=4)

    def plan(
        self,
        start_xy: tuple[float, float],
        goal_xy: tuple[float, float],
        *,
        planner: str = "astar",
        neighbours: int = 16,
        refine: bool = True,
        alternatives: int = 0,
        snap: bool = False,
        bound: bool = False,
        progress: Callable[[float], None] | None = None,
        **_: Any,
    ) -> Plan:
        """Return the energy-optimal and the shortest route from start to goal.

        Parameters
        ----------
        start_xy, goal_xy : tuple of float
            World x, y [m].
        planner : {"astar"}
            Other planners need the lattice in memory.
        neighbours : {16, 8, 32}
            Moves per cell.
        refine : bool, default True
            Whether to improve the paths at any angle.
        alternatives : int, default 0
            Must be 0: alternatives need the lattice in memory.
        snap : bool, default False
            Whether a start or goal on blocked ground is moved to the nearest free place.
        bound : bool, default False
            Must be false: a sharper bound needs the lattice in memory.
        progress : callable, optional
            Called with the share that is done, 0..1; an exception that it raises ends the search.
        **_
            Settings of other planners; they change nothing.

        Returns
        -------
        Plan
            Both routes. `details` has `grid_energy_j`, the energy over grid moves with turns; `grid_bound_j`, below
            which no path over grid moves can be [J]; and `grid_gap`, the share of the first above the second.

        Raises
        ------
        InputError
            If another planner, alternatives or a bound are wanted.
        PointError
            If start or goal is not finite or lies outside the map.
        BlockedError
            If start or goal is on blocked ground; the context names the nearest free place.
        NoRouteError
            If no route was found.
        TooLargeError
            If the search needs more memory than it may use.
        """
        if planner != "astar" or alternatives > 0 or bound:
            wanted = "looking for alternatives" if alternatives > 0 else "a sharper bound"
            raise InputError(
                f"{wanted if planner == 'astar' else f'the planner {planner}'} needs the whole cost map in memory, and "
                "this one is planned on from disk: use the planner astar without alternatives and bound, or a cost map "
                "with a coarser spacing",
                planner=planner,
            )
        if self._strip.bytes_read > _MOST_STRIP:
            self._strip = Strip(self.stored)
        began = time.perf_counter()
        notes: list[str] = []
        start, goal = (self._end(name, xy, notes, snap) for name, xy in (("start", start_xy), ("goal", goal_xy)))
        report = _Shares(progress)
        half = 0.1 if neighbours in self._levels else 0.5  # the coarse level, where it is made now
        straight = self._straight(start, goal) if refine else None
        shortest = straight
        if shortest is None:
            shortest = self._searched(start, goal, neighbours, None, refine, report.part(0.0, 0.1))[0]
        level = self._level(neighbours, report.part(0.1, half))[1]
        points, details = self._searched(start, goal, neighbours, level, refine, report.part(half, 1.0))
        if refine:
            window = self._window(points)
            points = self._best(window, start, goal, points)
            shortest = self._shortest(window, start, goal, shortest) if straight is None else straight
        details |= {"planner": planner, "neighbours": neighbours, "refined": refine, "tiled": True}
        shortest = shorter_of(self.lattice, _of_distances(self.lattice), shortest, points)
        self._strip.read_along(shortest, cells=MARGIN_CELLS if refine else 4)
        if refine:
            energies = [driven_energy_j(self.lattice, way, like=points) for way in (shortest, points)]
        else:
            energies = [path_price(self.lattice, way) for way in (shortest, points)]
        details["from_shortest"] = energies[0] < energies[1]
        if details["from_shortest"]:
            points = improved(self.lattice, shortest) if refine else shortest
        details["grid_gap"] = _gap(details["grid_energy_j"], details["grid_bound_j"])
        details["seconds"] = time.perf_counter() - began
        if refine:
            notes += margin_notes(self.lattice, points)
        least = quick_bound(self.lattice, start, goal)
        bound_j = least if math.isfinite(least) else None
        return Plan(self._route(points, notes), self._route(shortest, notes), planner, details, (), bound_j)

    def tour(self, stops_xy: Sequence[tuple[float, float]], **_: Any) -> RoundTrip:
        """Refuse: a tour needs the lattice in memory.

        Parameters
        ----------
        stops_xy : sequence of tuple of float
            World x, y [m].
        **_
            Settings.

        Returns
        -------
        RoundTrip
            Never.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError(
            f"a tour of {len(stops_xy)} stops needs the whole cost map in memory, and this one is planned on from "
            "disk: make a cost map with a coarser spacing"
        )

    def _straight(self, start: Points, goal: Points) -> Points | None:
        """The straight line, where it is free and keeps the margin."""
        points = np.vstack([start, goal])
        self._strip.read_along(points, cells=4)
        distances = _of_distances(self.lattice)
        free = math.isfinite(path_price(distances, points)) and metres_within_margin(distances, points) == 0.0
        return points if free else None

    def _searched(
        self,
        start: Points,
        goal: Points,
        neighbours: int,
        level: CoarseLevel | None,
        refine: bool,
        progress: Callable[[float], None] | None,
    ) -> tuple[Points, dict[str, Any]]:
        """The best path over grid moves, or the shortest one where no coarse level is given."""
        moves = (
            self._levels[neighbours][0] if neighbours in self._levels else MovePrices(self.stored.headings, neighbours)
        )
        search = TiledSearch(self.stored, moves, level, memory_bytes=self._memory, progress=progress)
        found = search.run(start, goal)
        del search
        self._strip.read_along(found.points, cells=MARGIN_CELLS if refine else 4)
        lattice = self.lattice
        details = {
            "grid_energy_j": path_price(lattice, found.points),
            "grid_bound_j": found.bound_j,
            "expanded": found.expanded,
            "tiles": found.tiles,
        }
        return found.points, details

    def _window(self, points: Points) -> _Window | None:
        """The map around a path, where that is small enough to be searched as a map in memory is."""
        shape = self.stored.frame.shape
        low = np.maximum(np.floor(points.min(axis=0)).astype(np.int64) - MARGIN_CELLS, 0)
        high = np.minimum(np.ceil(points.max(axis=0)).astype(np.int64) + MARGIN_CELLS + 1, shape)
        if int(np.prod(high - low)) > min(SURROUNDINGS_CELLS, self._memory // _BYTES_PER_CELL):
            return None
        around = self.stored.window(int(low[0]), int(high[0]), int(low[1]), int(high[1]))
        table = move_table(around, neighbours=ANY_ANGLE_NEIGHBOURS)
        return _Window(low, around, with_margin(table, margin_cells(around)))

    def _best(self, window: _Window | None, start: Points, goal: Points, points: Points) -> Points:
        """The best path of a window at any angle, else what becomes of a path over grid moves."""
        if window is None:
            return improved(self.lattice, points)
        found = best_path(window.lattice, window.table, start - window.low, goal - window.low).points + window.low
        self._strip.read_along(found, cells=4)
        return found

    def _shortest(self, window: _Window | None, start: Points, goal: Points, points: Points) -> Points:
        """The shortest path of a window that holds one over grid moves, else what becomes of that."""
        if window is not None and window.holds(points):
            distances = _of_distances(window.lattice)
            within = grid_search(distances, distance_table(window.table), start - window.low, goal - window.low).points
            return tightened(distances, within) + window.low
        return tightened(_of_distances(self.lattice), points)

    def _end(self, name: str, xy: tuple[float, float], notes: list[str], snap: bool) -> Points:
        x, y = float(xy[0]), float(xy[1])
        self.stored.frame.cell_of(x, y, name=name)
        row, col = self.stored.frame.rowcol(x, y)
        self._strip.read_along(np.array([[float(row), float(col)]]), cells=_ENDS_CELLS)
        point, note = end_point(self.lattice, x, y, name=name, snap=snap)
        if note is not None:
            notes.append(note)
        return point

    def _route(self, points: Points, notes: list[str]) -> Route:
        self._strip.read_along(points, cells=2)
        x, y = self.lattice.frame.xy(points[:, 0], points[:, 1])
        return price_route(self.lattice, np.column_stack([x, y]), notes=notes)


class _Window(NamedTuple):
    """A part of the map in memory: its first (row, col), its lattice and the priced moves of that."""

    low: NDArray[np.int64]
    lattice: CostLattice
    table: MoveTable

    def holds(self, points: Points) -> bool:
        """Whether all of a (row, col) polyline is in it."""
        return bool(((points >= self.low) & (points <= self.low + np.array(self.lattice.frame.shape) - 1)).all())


def _gap(energy_j: float, bound_j: float) -> float | None:
    """By which share of a bound an energy lies above it; None for a bound of 0 or less."""
    return max(energy_j / bound_j - 1.0, 0.0) if bound_j > 0.0 else None


class _Shares:
    """Parts of one progress."""

    def __init__(self, progress: Callable[[float], None] | None) -> None:
        self._progress = progress

    def part(self, low: float, high: float) -> Callable[[float], None] | None:
        """What a part of the work calls with its own share."""
        progress = self._progress
        return None if progress is None else lambda share: progress(low + (high - low) * share)


def _of_distances(lattice: CostLattice) -> CostLattice:
    """The same limits at a price of 1 J/m everywhere; no prices are read."""
    robot = replace(lattice.robot, idle_power_w=1.0, speed_mps=1.0, regeneration=0.0, turn_j_per_rad=0.0)
    flat = np.broadcast_to(np.zeros(1, dtype=np.float32), (*lattice.frame.shape, 4))
    return replace(lattice, robot=robot, traction_per_m=flat, std_j=None)
