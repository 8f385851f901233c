"""A drive as a Python user follows it: samples of the log in, forecasts of the rest out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from joulemap.model.errors import InputError
from joulemap.model.loop.drive_filter import Ahead
from joulemap.planner.lattice import CostLattice
from joulemap.planner.route import Route
from joulemap.service.driving.ahead import check_length, check_points, metres_of, prior_of
from joulemap.service.driving.forecast import ChargeAt, Forecast, charge_along, forecast
from joulemap.service.driving.tracking import Sample, Tracking
from joulemap.service.driving.updated import BetterRoute, better_route, updated_lattice
from joulemap.service.exports.clearance import price_given_path
from joulemap.service.places.coordinates import world_point
from joulemap.service.questions.asking import asks
from joulemap.service.questions.drive import SampleIn
from joulemap.service.questions.given import checked

if TYPE_CHECKING:
    from joulemap.model.battery import Battery
    from joulemap.service.library.costmaps import CostMap

_LEAST_S = 10.0
"""Setting: no battery gives or takes all its energy in less time; cells of the highest rates need half a minute."""


class Drive:
    """A drive along a route while it lasts.

    Parameters
    ----------
    lattice : CostLattice
        The cost map.
    route : Route
        What is driven.
    battery : Battery
        At the start.

    Raises
    ------
    InputError
        If the route is shorter than 1 cm or longer than 20 km.
    """

    def __init__(self, lattice: CostLattice, route: Route, battery: Battery) -> None:
        check_length(route.length_m)
        self.lattice, self.route, self.battery = lattice, route, battery
        metres = metres_of(lattice, route)
        prior = prior_of(lattice, metres)
        self._ahead = Ahead.of(prior, metres.columns, metres.std_j)
        self.tracking = Tracking(metres, prior, lattice.robot.idle_power_w, lattice.robot.speed_mps)

    @classmethod
    def along(cls, lattice: CostLattice, points: np.ndarray, battery: Battery) -> Drive:
        """Follow a drive along world points.

        Parameters
        ----------
        lattice : CostLattice
            The cost map.
        points : ndarray of float, (n, 2)
            World x, y of the route [m].
        battery : Battery
            At the start.

        Returns
        -------
        Drive
            At its start.

        Raises
        ------
        InputError
            If the route is shorter than 1 cm or longer than 20 km.
        """
        check_points(points)  # before they are priced
        return cls(lattice, price_given_path(lattice, points), battery)

    @asks(SampleIn)
    def update(self, wanted: SampleIn) -> None:
        """Take in a moment of the drive.

        Samples may come in any order within five seconds; an older one, and one that was there already, is not used.

        Raises
        ------
        InputError
            If a value is missing or not finite, or the power is more than any battery of that capacity has, or the
            sample comes more than an hour after the one before.
        """
        self.take([wanted])

    def take(self, samples: Iterable[SampleIn | Mapping[str, Any]]) -> None:
        """Take in moments that came together, in any order: late ones cost no more than others.

        Parameters
        ----------
        samples : iterable of SampleIn or mapping
            The parameters of `update` by name, for each moment.

        Raises
        ------
        InputError
            As `update` does; none of them is taken in then.
        """
        given = (one if isinstance(one, SampleIn) else checked(SampleIn, one) for one in samples)
        self.tracking.add([self._sample(one) for one in given])

    def _sample(self, one: SampleIn) -> Sample:
        power_w = one.power_w
        if power_w is None:
            assert one.voltage_v is not None
            assert one.current_a is not None
            power_w = one.voltage_v * one.current_a
        most_w = self.battery.full_j / _LEAST_S
        if abs(power_w) > most_w:
            raise InputError(
                f"a power of {power_w:.4g} W would empty or fill the battery in less than {_LEAST_S:g} s; at most "
                f"{most_w:.4g} W can be true: is it in watts, and is the battery's capacity right?",
                power_w=power_w,
                limit=most_w,
            )
        place = world_point(self.lattice.frame, one.position, name="position")
        return Sample(one.time_s, place.x, place.y, power_w, math.nan if one.charge is None else one.charge)

    def forecast(self) -> Forecast:
        """Return what is expected of the rest.

        Returns
        -------
        Forecast
            With its interval, the probability that the battery lasts, and the cause that is seen.
        """
        return forecast(self.tracking, self._ahead, self.battery)

    def charge_along(self) -> list[ChargeAt]:
        """Return the state of charge along the route.

        Returns
        -------
        list of ChargeAt
            What it was behind the robot; ahead of it what is expected, with its 90 % interval, and what was planned.
        """
        return charge_along(self.tracking, self.battery)

    def costmap(self) -> CostMap:
        """Return the cost map at what driving costs in this run, without predicting anything anew.

        Returns
        -------
        CostMap
            For every question: routes, reach, the way home and the point of no return.
        """
        from joulemap.service.library.costmaps import CostMap

        return CostMap(updated_lattice(self.lattice, self.tracking.known()))

    def better_route(self) -> BetterRoute | None:
        """Look for another way to the goal.

        Returns
        -------
        BetterRoute or None
            Where it has become cheaper by more than its uncertainty.
        """
        return better_route(self.lattice, self.tracking.known(), self.rest())

    def rest(self) -> Route:
        """Return the rest of the route, priced as planned.

        Returns
        -------
        Route
            From where the robot is on it.

        Raises
        ------
        InputError
            If the robot has arrived.
        """
        metres, at = self.tracking.metres, self.tracking.state.at_m
        if at >= metres.length_m:
            raise InputError("the robot has arrived: no route is left")
        after = metres.corners[metres.corners_m > at]
        return price_given_path(self.lattice, np.vstack([[metres.point(at)], after]))

    def as_dict(self) -> dict[str, Any]:
        """Return all that another process needs to go on.

        Returns
        -------
        dict
            JSON-able, of bounded size.
        """
        return self.tracking.as_dict()

    def restore(self, values: Mapping[str, Any]) -> None:
        """Go on from what `as_dict` returned for the same route and cost map.

        Parameters
        ----------
        values : mapping
            The state.
        """
        self.tracking.restore(values)

    def __repr__(self) -> str:
        return f"<Drive: {self.tracking.state.at_m:.0f} of {self.tracking.metres.length_m:.0f} m>"
