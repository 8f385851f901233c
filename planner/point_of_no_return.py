"""How far along a given path a robot may go and still come home, or still reach a place to charge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.course import Course, Place
from joulemap.planner.edges import leg_prices_between, world_points
from joulemap.planner.lattice import CostLattice
from joulemap.planner.odds import EnergyOdds

FloatArray = NDArray[np.float64]

Odds = Callable[[FloatArray], EnergyOdds | None]
"""Returns the distribution of expected energies [J]; None where the model does not know its uncertainty."""

_NEAR = 2.0  # cells


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
    reachable : bool
        Whether it lasts, at the confidence that was asked for.
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
    reachable: bool
    last: Place | None
    whole_path: bool
    cheapest: Place | None
    cheapest_j: float


def energies_from(
    lattice: CostLattice, energy_j: NDArray[np.float32], goal: tuple[float, float], x: FloatArray, y: FloatArray
) -> FloatArray:
    """Return the least energies from any places of a map to the goal of an energy field.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    energy_j : ndarray of float32, (rows, cols)
        Least energy from each cell to the goal [J]; infinite where there is no way.
    goal : tuple of float
        World x, y of the goal [m].
    x, y : ndarray of float, (n,)
        World places [m].

    Returns
    -------
    ndarray of float, (n,)
        The cheapest of the straight legs to the centres of the cells around, and from there by the field, or of the leg
        to a goal in the next cell [J]; infinite where there is no way. Turning into the first move is not counted.
    """
    points, end = (world_points(lattice, np.column_stack(xy)) for xy in ((x, y), ([goal[0]], [goal[1]])))
    last = np.array(lattice.frame.shape) - 1
    low = np.clip(np.floor(points), 0, last)
    found = np.full(len(points), np.inf)
    for offset in ((0, 0), (0, 1), (1, 0), (1, 1)):
        cell = np.minimum(low + offset, last)
        legs = leg_prices_between(lattice, points, cell)
        total = legs + energy_j[cell[:, 0].astype(int), cell[:, 1].astype(int)]
        found = np.fmin(found, total)  # a leg that may not be driven is NaN
    near = np.flatnonzero(np.abs(points - end).max(axis=1) < _NEAR)
    found[near] = np.fmin(found[near], leg_prices_between(lattice, points[near], np.repeat(end, near.size, axis=0)))
    return found


def last_place(course: Course, rest_j: FloatArray, available_j: float, *, odds: Odds, confidence: float | None) -> Bail:
    """Return until where a path may be driven so that the battery still lasts for the way to a place.

    Parameters
    ----------
    course : Course
        The rest of the path, from here.
    rest_j : ndarray of float, (n + 1,)
        Least energy to the place from here, and from the end of each piece [J]; infinite where there is no way.
    available_j : float
        Energy above the reserve now [J].
    odds : callable
        Of energies.
    confidence : float or None
        Probability with which the battery must last; None where the expected energy decides.

    Returns
    -------
    Bail
        With the place.
    """
    spent = np.append(0.0, np.cumsum(course.energy_j))
    total = spent + rest_j
    known = np.isfinite(total)
    finite = np.where(known, total, 0.0)
    there = odds(finite) if known.any() else None
    needed = total
    if there is not None and confidence is not None:
        needed = np.where(known, there.quantile(confidence), np.inf)
    lasts = needed <= available_j
    gone = np.flatnonzero(~lasts)
    stop = int(gone[0]) if gone.size else len(lasts)  # first point from where it is too far
    reachable = bool(lasts[0])
    cheapest = int(np.argmin(np.where(lasts, rest_j, np.inf)[:stop])) if reachable else None
    return Bail(
        energy_j=float(rest_j[0]),
        needed_j=float(needed[0]),
        probability=None if there is None or not known[0] else float(there.lasts(available_j)[0]),
        reachable=reachable,
        last=_end_of(course, stop - 1) if reachable and gone.size else None,
        whole_path=not gone.size,
        cheapest=None if cheapest is None else _end_of(course, cheapest),
        cheapest_j=np.inf if cheapest is None else float(rest_j[cheapest]),
    )


def _end_of(course: Course, point: int) -> Place:
    """The start of a course, or the end of a piece."""
    if point > 0:
        return course.place(point - 1, 1.0)
    return Place(0.0, 0.0, course.start[0], course.start[1])
