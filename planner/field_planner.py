"""Questions about a whole map: energies from a place or to it, how far a battery lasts, energies between places."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from joulemap.model.errors import BlockedError, NoRouteError
from joulemap.planner.any_angle.best import ANY_ANGLE_NEIGHBOURS
from joulemap.planner.areas.energy_map import EnergyMap, energy_map
from joulemap.planner.areas.reach import ReachField, reach_field
from joulemap.planner.grid.fields import EnergyField, field_from, field_towards
from joulemap.planner.grid.search import joining_legs
from joulemap.planner.kept_moves import KeptMoves
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import Points
from joulemap.planner.questions.closed_way import way_is_closed
from joulemap.planner.questions.matrix import Matrix, Place, energy_matrix

_KEPT_REACHES = 2
_KEPT_TOWARDS = 20  # of 5 bytes a cell
_KEPT_TURNING = 4  # of 5 bytes for each heading of a cell


class FieldPlanner(KeptMoves):
    """Answers questions about a whole map; keeps the energies that were asked for last.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    """

    def __init__(self, lattice: CostLattice) -> None:
        super().__init__(lattice)
        self._reaching = threading.Lock()
        self._towards: OrderedDict[tuple[float, float], EnergyField] = OrderedDict()
        self._reaches: OrderedDict[tuple[tuple[float, ...], bool], ReachField] = OrderedDict()

    @property
    def turning_notes(self) -> list[str]:
        """What energies over a map leave out, for a robot with a turning radius; empty for others."""
        robot = self.lattice.robot
        if robot.min_turning_radius_m == 0.0:
            return []
        return [
            f"the turning radius of {robot.name}, {robot.min_turning_radius_m:g} m, is not kept: these energies are of "
            "ways that turn on the spot; a route between two places keeps it"
        ]

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
            Where the start was moved to, if it was, and that a turning radius is not kept, if there is one.

        Raises
        ------
        PointError
            If the start is not finite or lies outside the map.
        BlockedError
            If the start is on blocked ground.
        """
        self.needs_memory("a map of reach")
        notes = self.turning_notes
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
            Where places were moved to, and that a turning radius is not kept, if there is one.
        """
        self.needs_memory("a map of energies")
        notes = self.turning_notes
        here, there = (
            None if xy is None else self._end(name, xy, notes, snap) for name, xy in (("start", start), ("goal", goal))
        )
        table = self._table(neighbours, distance=False)
        out = None if here is None else field_from(self.lattice, table, here)
        back = None if there is None else field_towards(self.lattice, table, there[None])
        try:
            return energy_map(out, back), notes
        except NoRouteError as error:
            if here is None or there is None:
                raise
            raise self._closing(here, there) or error from error

    def no_way(
        self, start_xy: tuple[float, float], goal_xy: tuple[float, float], *, snap: bool = False
    ) -> NoRouteError:
        """Return the error of two places between which no way leads, which names what closes it.

        Parameters
        ----------
        start_xy, goal_xy : tuple of float
            World x, y [m].
        snap : bool, default False
            Whether a place on blocked ground is moved to the nearest free one.

        Returns
        -------
        NoRouteError
            For the caller to raise.

        Raises
        ------
        BlockedError
            If a place is on blocked ground, so that this is the reason.
        """
        start, goal = (self._end(name, xy, [], snap) for name, xy in (("start", start_xy), ("goal", goal_xy)))
        return self._closing(start, goal) or NoRouteError("no way leads from start to goal")

    def _closing(self, start: Points, goal: Points) -> NoRouteError | None:
        """What closes the way between two places; None where that is not known."""
        return way_is_closed(self.lattice, start, goal)

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
            Where places were moved to, and that a turning radius is not kept, if there is one.

        Raises
        ------
        PointError
            If a place is not finite or lies outside the map.
        """
        self.needs_memory("a matrix of energies")
        notes = self.turning_notes

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

    def keeps_ways_towards(self, goal_xy: tuple[float, float]) -> bool:
        """Return whether `ways_towards` answers without a search.

        Parameters
        ----------
        goal_xy : tuple of float
            World x, y [m].

        Returns
        -------
        bool
            Whether the ways are kept.
        """
        return (float(goal_xy[0]), float(goal_xy[1])) in self._towards

    def ways_towards(self, goal_xy: tuple[float, float], *, name: str = "goal") -> EnergyField:
        """Return the cheapest ways over grid moves from every cell to one place.

        Those that were asked for last are kept, so that a robot on its way may ask every second.

        Parameters
        ----------
        goal_xy : tuple of float
            World x, y [m].
        name : str, default "goal"
            What messages call it.

        Returns
        -------
        EnergyField
            Its energies are rounded to float32.

        Raises
        ------
        PointError
            If the place is not finite or lies outside the map.
        BlockedError
            If it is on blocked ground, or next to it.
        """
        self.needs_memory("the energy from everywhere to a place")
        key = (float(goal_xy[0]), float(goal_xy[1]))
        with self._reaching:
            if key not in self._towards:
                goal = self._end(name, key, [], False)
                found = field_towards(self.lattice, self._table(ANY_ANGLE_NEIGHBOURS, distance=False), goal[None])
                most = _KEPT_TOWARDS if found.search.layers == 1 else _KEPT_TURNING
                while len(self._towards) >= most:
                    self._towards.popitem(last=False)
                lighter: Any = found.search.energy_j.astype(np.float32)
                light = replace(found.search, energy_j=lighter)
                self._towards[key] = replace(found, search=light)
            self._towards.move_to_end(key)
            return self._towards[key]
