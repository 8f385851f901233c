"""A robot on its way: whether it still comes home, until where, and where it could charge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.battery import Battery
from joulemap.model.errors import InputError, NoRouteError
from joulemap.model.ranges import MAX_CHARGING
from joulemap.planner.grid.fields import EnergyField
from joulemap.planner.pricing.integrator import path_price, world_points
from joulemap.planner.route import Route, pieces_of, price_route
from joulemap.planner.route_planner import RoutePlanner
from joulemap.planner.verdict.budget import Verdict
from joulemap.planner.verdict.trajectory import Course, Place, course_of
from joulemap.planner.words import energy_words, probability_words
from joulemap.service.analysis.feasibility import judge_routes
from joulemap.service.analysis.route_uncertainty import odds_along


@dataclass(frozen=True, eq=False)
class Bail:
    """Leaving a path for a place.

    Attributes
    ----------
    energy_j : float
        Energy from here straight to the place [J]; infinite where no way leads there.
    needed_j : float
        The same at the confidence that was asked for [J].
    probability : float or None
        That the battery lasts for it; None where the model does not know its uncertainty.
    verdict : str
        Class of the verdict for it: "yes", "likely", "marginal" or "no".
    reachable : bool
        Whether it lasts, at the confidence that was asked for.
    way : ndarray of float, (n, 2)
        World x, y of the way from here [m]; empty where there is none.
    last : Place or None
        Where the path must be left at the latest; None where it need not be left, or the place cannot be reached from
        here.
    whole_path : bool
        Whether the place can be reached from the end of the path.
    cheapest : Place or None
        Where the way from the path to the place takes least; None where it cannot be reached.
    cheapest_j : float
        Energy of that way [J].
    """

    energy_j: float
    needed_j: float
    probability: float | None
    verdict: str
    reachable: bool
    way: NDArray[np.float64]
    last: Place | None
    whole_path: bool
    cheapest: Place | None
    cheapest_j: float


@dataclass(frozen=True, eq=False)
class Homeward:
    """Until where a robot may follow its path.

    Attributes
    ----------
    home : Bail
        Leaving the path for home. Its `last` place is the point of no return.
    charging : tuple of Bail
        Leaving it for each place to charge.
    best_charging : int or None
        Number of the place to charge whose way from the path takes least, among those that can be reached.
    path_j : float
        Energy of the rest of the path [J].
    available_j : float
        Energy above the reserve now [J].
    length_m : float
        Length of the rest of the path [m].
    notes : tuple of str
        What the user should know of the places.
    """

    home: Bail
    charging: tuple[Bail, ...]
    best_charging: int | None
    path_j: float
    available_j: float
    length_m: float
    notes: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """Class of coming home from here: "yes", "likely", "marginal" or "no"."""
        return self.home.verdict

    def __str__(self) -> str:
        home = self.home
        if not np.isfinite(home.energy_j):
            words = "No way leads home from here"
        else:
            odds = "" if home.probability is None else f", {probability_words(home.probability)} likely"
            still = "It still comes home from here" if home.reachable else "It no longer comes home from here"
            if odds and not home.reachable:
                still = "It is not sure enough to come home from here"
            there = (
                f"of {energy_words(self.available_j)}"
                if self.available_j >= 0.0
                else "and the charge is below the reserve"
            )
            words = f"{still}{odds} ({energy_words(home.energy_j)} {there})"
        if home.last is not None:
            words += f"; the point of no return is {home.last.distance_m:.0f} m ahead"
        elif home.whole_path and self.length_m > 0.0:
            words += f"; it may follow its path to the end ({self.length_m:.0f} m)"
        if self.best_charging is not None:
            best = self.charging[self.best_charging]
            words += f"; charging place {self.best_charging + 1} is {energy_words(best.cheapest_j)} from the path"
        elif self.charging:
            words += "; no charging place can be reached"
        return words + "."


def homeward(
    planner: RoutePlanner,
    position: tuple[float, float],
    home: tuple[float, float],
    battery: Battery,
    *,
    path: ArrayLike | None = None,
    charging: Sequence[tuple[float, float]] = (),
    confidence: float | None = 0.95,
) -> Homeward:
    """Return until where a robot may follow the rest of its path and still come home.

    `position`: where the robot is, world x, y [m]; `home`: world x, y [m]; `path` (n, 2): the rest of its path, world
    x, y [m]; `confidence`: probability with which the battery must last, None where the expected energy decides. Raises
    BlockedError if home or a place to charge is on blocked ground, or the path crosses it.

    The ways home are those over grid moves, which take a little more than routes at any angle: the point of no return
    is on the safe side. Path and way are judged as a given path is, by `judge_routes`.
    """
    planner.needs_memory("the energy home from everywhere")
    if len(charging) > MAX_CHARGING:
        raise InputError(
            f"{len(charging)} places to charge are too many: give at most {MAX_CHARGING}", limit=MAX_CHARGING
        )
    lattice = planner.lattice
    lattice.frame.cell_of(*position, name="position")
    xy = np.array([position]) if path is None else np.vstack([position, np.asarray(path, dtype=np.float64)[:, :2]])
    route = price_route(lattice, xy[np.append(True, np.abs(np.diff(xy, axis=0)).max(axis=1) > 1e-9)])
    leaving = _Leaving(planner, route, battery, confidence)
    bails = tuple(leaving.bail(place, f"charging place {k}") for k, place in enumerate(charging, 1))
    reached = [k for k, bail in enumerate(bails) if bail.reachable]
    return Homeward(
        leaving.bail(home, "home"),
        bails,
        min(reached, key=lambda k: bails[k].cheapest_j) if reached else None,
        route.energy_j,
        battery.available_j,
        route.length_m,
    )


class _Leaving:
    """A path that may be left at the start and at the end of each of its n pieces."""

    def __init__(self, planner: RoutePlanner, route: Route, battery: Battery, confidence: float | None) -> None:
        self._planner, self._battery, self._confidence = planner, battery, confidence
        self._course: Course = course_of([route])
        cut = pieces_of(planner.lattice, world_points(planner.lattice, route.points))
        self._points = cut.points  # (n + 1, 2) fractional (row, col)

    def bail(self, place: tuple[float, float], name: str) -> Bail:
        """Until where the path may be driven so that the battery still lasts for the way to a place.

        Whoever can drive on to a point and go from there can go from every point before: the last one is found by
        bisection.
        """
        ways = self._planner.ways_towards(place, name=name)
        here = self._left_at(0, ways)
        if here is None:
            return Bail(np.inf, np.inf, None, "no", False, np.empty((0, 2)), None, False, None, np.inf)
        way, verdict = here
        odds = odds_along([way])
        needed = way.energy_j if odds is None or self._confidence is None else odds.final_quantile(self._confidence)
        found = way.energy_j, needed, verdict.probability, verdict.verdict
        if not self._lasts(verdict):
            return Bail(*found, False, way.points[:, :2], None, False, None, np.inf)
        last, beyond = 0, len(self._points)
        while beyond - last > 1:
            middle = len(self._points) - 1 if beyond == len(self._points) else (last + beyond) // 2
            left = self._left_at(middle, ways)
            last, beyond = (middle, beyond) if left is not None and self._lasts(left[1]) else (last, middle)
        whole = last == len(self._points) - 1
        cheapest, least_j = self._cheapest(ways, last)
        rest = (None if whole else self._place(last)), whole, self._place(cheapest)
        return Bail(*found, True, way.points[:, :2], *rest, least_j)

    def _cheapest(self, ways: EnergyField, last: int) -> tuple[int, float]:
        """The point up to the last one from which the way on takes least, and its energy [J]."""
        points = self._points[: last + 1]
        edge = np.array(ways.lattice.frame.shape) - 1
        roughly = ways.energy_j[tuple(np.clip(np.rint(points), 0, edge).astype(np.int64).T)]  # of the next centre
        near = np.flatnonzero(np.abs(points - points[np.argmin(roughly)]).max(axis=1) <= 1.0)
        energies = {int(k): path_price(ways.lattice, way) for k in near if (way := self._way(int(k), ways)) is not None}
        best = min(energies, key=lambda k: energies[k])
        return best, float(energies[best])

    def _left_at(self, point: int, ways: EnergyField) -> tuple[Route, Verdict] | None:
        """The path up to a point and the way on from there, and whether the battery lasts; None without a way."""
        if (way := self._way(point, ways)) is None:
            return None
        route = self._priced(np.vstack([self._points[:point], way]))
        return route, judge_routes(self._planner.lattice, [route], self._battery)

    def _way(self, point: int, ways: EnergyField) -> NDArray[np.float64] | None:
        try:
            return ways.path_from(self._points[point]).points
        except NoRouteError:
            return None

    def _priced(self, points: NDArray[np.float64]) -> Route:
        return price_route(self._planner.lattice, np.column_stack(self._planner.lattice.frame.xy(*points.T)))

    def _lasts(self, verdict: Verdict) -> bool:
        if verdict.probability is None or self._confidence is None:
            return verdict.feasible
        return verdict.probability >= self._confidence

    def _place(self, point: int) -> Place:
        """The start of the path, or the end of a piece."""
        if point > 0:
            return self._course.place(point - 1, 1.0)
        return Place(0.0, 0.0, *self._course.start[:2])
