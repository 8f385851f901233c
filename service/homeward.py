"""A robot on its way: whether it still comes home, until where, and where it could charge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from joulemap.model.battery import Battery
from joulemap.model.errors import InputError
from joulemap.model.ranges import MAX_CHARGING
from joulemap.planner.pricing.integrator import world_points
from joulemap.planner.route import pieces_of, price_route
from joulemap.planner.route_planner import RoutePlanner
from joulemap.planner.stored_planner import StoredPlanner
from joulemap.planner.verdict.energy_distribution import class_of
from joulemap.planner.verdict.point_of_no_return import Bail, WaysFrom, last_place
from joulemap.planner.verdict.trajectory import course_of_pieces
from joulemap.planner.words import energy_words, probability_words
from joulemap.service.route_uncertainty import odds_of_energies


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
        if self.home.probability is None:
            return "yes" if self.home.reachable else "no"
        return class_of(self.home.probability)

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
            words += f"; charging place {self.best_charging} is {energy_words(best.cheapest_j)} from the path"
        elif self.charging:
            words += "; no charging place can be reached"
        return words + "."


def homeward(
    planner: RoutePlanner | StoredPlanner,
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
    is on the safe side. The uncertainty of a way is that of its energy on ground of the map's mean. Of the battery its
    energy counts, not its voltage under load.
    """
    if isinstance(planner, StoredPlanner):
        raise InputError(
            "this cost map is too large for energies home from everywhere: cut out the part around the path"
        )
    if len(charging) > MAX_CHARGING:
        raise InputError(
            f"{len(charging)} places to charge are too many: give at most {MAX_CHARGING}", limit=MAX_CHARGING
        )
    lattice = planner.lattice
    row, col = lattice.frame.cell_of(*position, name="position")
    xy = np.array([position]) if path is None else np.vstack([position, np.asarray(path, dtype=np.float64)[:, :2]])
    apart = np.append(True, np.abs(np.diff(xy, axis=0)).max(axis=1) > 1e-9)
    points = world_points(lattice, xy)[apart]
    cut = pieces_of(lattice, points)
    if np.isnan(cut.energy_j).any():
        price_route(lattice, xy[apart])  # says which leg it is, or which point is outside
    course = course_of_pieces(lattice, cut, (*position, float(lattice.elevation_m[row, col])))
    ways, odds = WaysFrom(lattice, cut.points), partial(odds_of_energies, lattice)

    def _bail(place: tuple[float, float], name: str) -> Bail:
        rest = partial(ways.energies, planner.energies_towards(place, name=name), place)
        return last_place(course, rest, battery.available_j, odds=odds, confidence=confidence)

    bails = tuple(_bail(place, f"charging place {k}") for k, place in enumerate(charging))
    reached = [k for k, bail in enumerate(bails) if bail.reachable]
    return Homeward(
        _bail(home, "home"),
        bails,
        min(reached, key=lambda k: bails[k].cheapest_j) if reached else None,
        float(course.energy_j.sum()),
        battery.available_j,
        float(course.distance_m[-1]) if len(course) else 0.0,
    )
