"""The planner of a lattice that stays on disk: that of one in memory, of which only what a question needs is read.

Moves are priced tile by tile when the search reaches them (`pricing.tiles`), led by the lower bounds of a coarse level;
what follows the search works on a `Strip`, in which the cells around its paths were read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError
from joulemap.planner.answers import Plan
from joulemap.planner.any_angle.best import ANY_ANGLE_NEIGHBOURS, best_path
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.avoid import checked_polygons
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.planner.on_disk.coarse import CoarseLevel, coarse_level
from joulemap.planner.on_disk.strip import Strip
from joulemap.planner.on_disk.tiled_table import DEFAULT_MEMORY, tiled_table
from joulemap.planner.pricing.integrator import Points, margin_cells
from joulemap.planner.pricing.move_prices import MovePrices
from joulemap.planner.pricing.moves import MoveTable, distance_table
from joulemap.planner.route import Route
from joulemap.planner.route_planner import USUAL, RouteOptions, RoutePlanner

MARGIN_CELLS = 48
"""How far beside a path the lattice is read before it is improved."""
TURNING_CELLS = 1_000_000
"""Where turning costs, most cells around a path that are searched again as a lattice in memory is, turns weighed."""
_BYTES_PER_CELL = 800
"""What a cell takes among whose line points the best path is looked for [bytes]."""
_BESIDE_CELLS = 10
"""How far beside such cells the lattice is read."""
_ENDS_CELLS = 128
"""How far around start and goal free places are looked for."""
_MOST_STRIP = 400_000_000
"""Memory [bytes] of what was read along earlier paths before it is given back."""


class StoredPlanner(RoutePlanner):
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
        self._priced_moves: MoveTable | None = None
        self._progress: Callable[[float], None] | None = None

    @property
    def lattice(self) -> CostLattice:  # type: ignore[override]
        """The lattice, of which only what earlier questions needed was read; blocked as unknown elsewhere."""
        return self._strip.lattice

    @property
    def ground(self) -> StoredLattice:
        """The whole lattice, on disk."""
        return self.stored

    @property
    def _distances(self) -> CostLattice:  # type: ignore[override]
        """The same limits at a price of 1 J/m everywhere; no prices are read."""
        robot = replace(self.lattice.robot, idle_power_w=1.0, speed_mps=1.0, regeneration=0.0, turn_j_per_rad=0.0)
        flat = np.broadcast_to(np.zeros(1, dtype=np.float32), (*self.lattice.frame.shape, 4))
        return replace(self.lattice, robot=robot, traction_per_m=flat, std_j=None)

    def prepare(self, *, progress: Callable[[float], None] | None = None) -> None:
        """Make the coarse level now, so that the first question does not wait for it.

        Parameters
        ----------
        progress : callable, optional
            Called with the share that is done, 0..1.
        """
        self._level(ANY_ANGLE_NEIGHBOURS, progress)

    def _level(
        self, neighbours: int, progress: Callable[[float], None] | None = None
    ) -> tuple[MovePrices, CoarseLevel]:
        if neighbours not in self._levels:
            moves = MovePrices(self.stored.headings, neighbours)
            self._levels[neighbours] = moves, coarse_level(self.stored, moves, progress=progress)
        return self._levels[neighbours]

    def avoiding(self, polygons: Sequence[Sequence[Sequence[float]]]) -> StoredPlanner:
        """Return the planner of the same map with the cells of some polygons blocked, as `RoutePlanner.avoiding`.

        Parameters
        ----------
        polygons : sequence of sequence of (x, y)
            Corners [m]; none of them returns this planner.

        Returns
        -------
        StoredPlanner
            It shares the coarse level, whose bounds hold for less ground too.
        """
        if not polygons:
            return self
        other = copy(self)
        other.stored = self.stored.avoiding(checked_polygons(polygons, self.stored.frame))
        other._strip = Strip(other.stored)
        return other

    def needs_memory(self, what: str) -> None:
        """Refuse what needs the whole lattice in memory.

        Parameters
        ----------
        what : str
            What was asked for.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError(
            f"{what} needs the whole cost map in memory, and this one is planned on from disk: make a cost map with a "
            "coarser spacing, or cut out a part of it"
        )

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

    def plan(self, start_xy: tuple[float, float], goal_xy: tuple[float, float], how: RouteOptions = USUAL) -> Plan:
        """Return the energy-optimal and the shortest route from start to goal, as `RoutePlanner.plan`.

        Parameters
        ----------
        start_xy, goal_xy : tuple of float
            World x, y [m].
        how : RouteOptions, optional
            Planners other than "astar", alternatives and a bound need the lattice in memory. `progress` is called with
            the share of the whole search; an exception that it raises ends it.

        Returns
        -------
        Plan
            Both routes. `details` has `tiles`, the number of tiles that were priced.

        Raises
        ------
        InputError
            If another planner, alternatives or a bound are wanted.
        TooLargeError
            If the search needs more memory than it may use.
        """
        if how.planner != "astar":
            self.needs_memory(f"the planner {how.planner}")
        if how.alternatives > 0 or how.bound:
            self.needs_memory("looking for alternatives" if how.alternatives > 0 else "a sharper bound")
        if self._strip.bytes_read > _MOST_STRIP:
            self._strip = Strip(self.stored)
        self._progress = how.progress
        try:
            plan = super().plan(start_xy, goal_xy, how)
            tiles = self._priced_moves.tiles if self._priced_moves is not None else None
            plan.details.update(tiled=True, tiles=0 if tiles is None else tiles.priced)
        finally:
            self._priced_moves = None
        return plan

    def _table(self, neighbours: int, *, distance: bool) -> MoveTable:
        return self._moves(neighbours, 0.0, distance=distance)

    def _with_margin(self, neighbours: int, *, distance: bool) -> MoveTable:
        return self._moves(neighbours, margin_cells(self.lattice), distance=distance)

    def _moves(self, neighbours: int, margin: float, *, distance: bool) -> MoveTable:
        """The moves of the present question."""
        if self._priced_moves is None:
            half = 0.1 if neighbours in self._levels else 0.5
            report = self._progress
            moves, level = self._level(neighbours, None if report is None else lambda share: report(half * share))
            self._priced_moves = tiled_table(self.stored, moves, level, margin=margin, memory_bytes=self._memory)
            tiles = self._priced_moves.tiles
            if report is not None and tiles is not None:
                tiles.progress = lambda share: report(half + (1.0 - half) * share)
        return distance_table(self._priced_moves) if distance else self._priced_moves

    def _end(self, name: str, xy: tuple[float, float], notes: list[str], snap: bool) -> Points:
        x, y = float(xy[0]), float(xy[1])
        self.stored.frame.cell_of(x, y, name=name)
        row, col = self.stored.frame.rowcol(x, y)
        self._strip.read_along(np.array([[float(row), float(col)]]), cells=_ENDS_CELLS)
        return super()._end(name, xy, notes, snap)

    def _both(self, start: Points, goal: Points, neighbours: int) -> tuple[Points, tuple[Points, dict[str, Any]]]:
        return self._shortest(start, goal, neighbours, True), self._best(start, goal)  # they share the tiles

    def _shortest(self, start: Points, goal: Points, neighbours: int, refine: bool) -> Points:
        self._strip.read_along(np.vstack([start, goal]), cells=4)
        return super()._shortest(start, goal, neighbours, refine)

    def _best(self, start: Points, goal: Points) -> tuple[Points, dict[str, Any]]:
        table = self._with_margin(ANY_ANGLE_NEIGHBOURS, distance=False)
        found = best_path(self.lattice, table, start, goal, read=self._read_cells)
        details = {"expanded": found.expanded, "grid_energy_j": found.grid_energy_j}
        if self.lattice.robot.turn_j_per_rad > 0.0:  # which the search over tiles does not weigh
            points = np.vstack([found.points, start, goal])
            low = np.maximum(np.floor(points.min(axis=0)).astype(np.int64) - MARGIN_CELLS, 0)
            high = np.ceil(points.max(axis=0)).astype(np.int64) + MARGIN_CELLS + 1
            high = np.minimum(high, self.stored.frame.shape)
            if int(np.prod(high - low)) <= min(TURNING_CELLS, self._memory // _BYTES_PER_CELL):
                around = self.stored.window(int(low[0]), int(high[0]), int(low[1]), int(high[1]))
                points, details = RoutePlanner(around)._best(start - low, goal - low)
                self._strip.read_along(points + low, cells=MARGIN_CELLS)
                return points + low, details
        return found.points, details

    def _read_cells(self, cells: NDArray[np.bool_], points: Points) -> bool:
        """Read what a search over line points needs, or along the path where that is too much."""
        places = np.flatnonzero(cells)
        if places.size * _BYTES_PER_CELL > self._memory:
            self._strip.read_along(points, cells=MARGIN_CELLS)
            return False
        self._strip.read_around(places, beside=_BESIDE_CELLS)
        return True

    def _reachable_near(self, start: Points, goal: Points) -> None:
        """No other place: a search from the start to everywhere needs the whole lattice in memory."""

    def _closing(self, start: Points, goal: Points) -> None:
        """Not known: most of the map was not read."""

    def _grid(self, table: MoveTable, lattice: CostLattice, start: Points, goal: Points) -> Points:
        points = super()._grid(table, lattice, start, goal)
        self._strip.read_along(points, cells=MARGIN_CELLS)
        return points

    def _route(self, points: Points, notes: list[str]) -> Route:
        self._strip.read_along(points, cells=2)
        return super()._route(points, notes)
