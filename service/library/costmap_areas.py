"""Questions to a cost map about areas and places: how far a charge reaches, energies everywhere, prices at a place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from joulemap.planner.areas.energy_map import EnergyMap
from joulemap.planner.areas.reach_map import ReachMap
from joulemap.service.analysis.homeward import Homeward
from joulemap.service.analysis.point_costs import PointCosts
from joulemap.service.library.costmap_base import CostMapBase
from joulemap.service.questions import at, field, homeward, reach
from joulemap.service.questions.asking import asks
from joulemap.service.questions.field import FieldRequest
from joulemap.service.questions.given import battery_with
from joulemap.service.questions.homeward import ReturnRequest
from joulemap.service.questions.reach import ReachRequest


class AreaQuestions(CostMapBase):
    """What holds everywhere on a cost map, or at one place of it."""

    @asks(ReachRequest, "charges", complete=False)
    def reach(
        self,
        wanted: dict[str, Any],
        *,
        charge: float | Sequence[float] | None = None,
        reserve: float | None = None,
        capacity_wh: float | None = None,
    ) -> ReachMap:
        """Say where the battery lasts to from a place, or where it lasts to and back.

        Parameters
        ----------
        charge : float or sequence of float, optional
            State of charge at the start, 0..1, by default that of the battery; several are answered one by one.
        reserve, capacity_wh : float, optional
            As the fields of `battery`, which then must not say otherwise.

        Returns
        -------
        ReachMap
            What is left at every cell [J], with `polygons`, `area_m2`, `margin_at`, `geotiff` and `to_xarray`.

        Raises
        ------
        InputError
            If a share lies outside 0..1, or a confidence is asked of a model that does not know its uncertainty.
        PointError
            If the start lies outside the map.
        BlockedError
            If the start lies on blocked ground, and `snap` is false.
        """
        charges = [charge] if isinstance(charge, int | float) else charge
        battery = battery_with(wanted.pop("battery", None), reserve=reserve, capacity_wh=capacity_wh)
        return reach.ask(self.planner, ReachRequest.of(**wanted, charges=charges, battery=battery))

    @asks(ReturnRequest)
    def homeward(self, wanted: ReturnRequest) -> Homeward:
        """Say until where a robot may follow the rest of its path and still come home: the point of no return.

        Returns
        -------
        Homeward
            Answers again about the same home come from kept energies, in milliseconds.

        Raises
        ------
        InputError
            If there are too many places to charge, or the map is not in memory.
        PointError
            If a place lies outside the map.
        BlockedError
            If home or a place to charge is on blocked ground, or the path crosses it.
        """
        return homeward.ask(self.planner, wanted)

    @asks(FieldRequest, "within_percent")
    def field(self, wanted: FieldRequest) -> EnergyMap:
        """Give the least energy from a start to every cell, from every cell to a goal, or over every cell between both.

        Returns
        -------
        EnergyMap
            An array [J], with `to_xarray`, `geotiff` and `corridor`. With start and goal, the energy of a cell is that
            of the best route over it. For a map that changes, `planner.replan.Replanner` repairs the field instead of
            making it anew.

        Raises
        ------
        InputError
            Without start and goal.
        PointError
            If a place lies outside the map.
        BlockedError
            If a place lies on blocked ground, and `snap` is false.
        NoRouteError
            If no route joins the two.
        """
        return field.ask(self.planner, wanted).energies

    def at(self, x: float, y: float) -> PointCosts:
        """Say what driving costs at one place, in every direction.

        Parameters
        ----------
        x, y : float
            World x, y [m].

        Returns
        -------
        PointCosts
            Energy per metre [J/m] by heading, and the reason where a heading is blocked.

        Raises
        ------
        PointError
            If the place lies outside the map.
        """
        return at.ask(self.planner, at.AtRequest.of(place=(x, y))).costs
