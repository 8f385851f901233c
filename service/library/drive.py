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
from joulemap.planner.route_planner import RoutePlanner
from joulemap.service.coordinates import world_point
from joulemap.service.driving.ahead import check_length, check_points, metres_of, prior_of
from joulemap.service.driving.forecast import Forecast, forecast
from joulemap.service.driving.tracking import Sample, Tracking
from joulemap.service.driving.updated import BetterRoute, better_route, updated_lattice
from joulemap.service.exports.clearance import price_given_path

if TYPE_CHECKING:
    from joulemap.model.battery import Battery
    from joulemap.service.coordinates import PlaceLike
    from joulemap.service.library.costmaps import CostMap


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

    def update(
        self,
        time_s: float,
        position: PlaceLike,
        *,
        power_w: float | None = None,
        voltage_v: float | None = None,
        current_a: float | None = None,
        charge: float | None = None,
    ) -> None:
        """Take in a moment of the drive.

        Parameters
        ----------
        time_s : float
            When, by any clock that runs on [s]. Samples may come in any order within five seconds; an older one, and
            one that was there already, is not used.
        position : point
            World x, y [m], or latitude, longitude.
        power_w : float, optional
            Power drawn from the battery [W].
        voltage_v, current_a : float, optional
            Voltage [V] and current [A], in place of the power.
        charge : float, optional
            State of charge as the battery says it, 0..1. Without it, that of the start less what was used.

        Raises
        ------
        InputError
            If a value is missing or not finite, or the sample comes more than an hour after the one before.
        """
        self.tracking.add(
            [self._sample(time_s, position, power_w=power_w, voltage_v=voltage_v, current_a=current_a, charge=charge)]
        )

    def take(self, samples: Iterable[Mapping[str, Any]]) -> None:
        """Take in moments that came together, in any order: late ones cost no more than others.

        Parameters
        ----------
        samples : iterable of mapping
            The parameters of `update` by name, for each moment.

        Raises
        ------
        InputError
            As `update` does; none of them is taken in then.
        """
        self.tracking.add([self._sample(**one) for one in samples])

    def _sample(
        self,
        time_s: float,
        position: PlaceLike,
        *,
        power_w: float | None = None,
        voltage_v: float | None = None,
        current_a: float | None = None,
        charge: float | None = None,
    ) -> Sample:
        if power_w is None:
            if voltage_v is None or current_a is None:
                raise InputError("a sample needs `power_w`, or `voltage_v` and `current_a`")
            power_w = voltage_v * current_a
        if charge is not None and not 0.0 <= charge <= 1.0:
            raise InputError(f"charge is {charge:g}; it lies between 0 and 1", charge=charge)
        place = world_point(self.lattice.frame, position, name="position")
        return Sample(float(time_s), place.x, place.y, float(power_w), math.nan if charge is None else float(charge))

    def forecast(self) -> Forecast:
        """Return what is expected of the rest.

        Returns
        -------
        Forecast
            With its interval, the probability that the battery lasts, and the cause that is seen.
        """
        return forecast(self.tracking, self._ahead, self.battery)

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
        updated = updated_lattice(self.lattice, self.tracking.known())
        return better_route(self.lattice, updated, self.tracking.known(), self.rest(), RoutePlanner(updated))

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
