"""How far along a given path a robot may go and still come home, or still reach a place to charge."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import leg_prices_between
from joulemap.planner.verdict.energy_distribution import EnergyOdds
from joulemap.planner.verdict.trajectory import Course, Place

FloatArray = NDArray[np.float64]

Odds = Callable[[FloatArray], EnergyOdds | None]
"""Returns the distribution of expected energies [J]; None where the model does not know its uncertainty."""

_NEAR = 2.0  # cells
_STEP = 8  # points of a path between two that are looked at first


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


class WaysFrom:
    """The least energies from places of a path to goals of energy fields.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        Fractional (row, col) of the places.

    Notes
    -----
    The cheapest of the straight legs to the centres of the cells around, and from there by the field, or of the leg to
    a goal in the next cell; infinite where there is no way. Turning into the first move is not counted. The legs to the
    centres are priced once for all goals.
    """

    def __init__(self, lattice: CostLattice, points: FloatArray) -> None:
        self._lattice, self._points = lattice, points
        self._legs = np.full((len(points), 4), np.nan)
        self._priced = np.zeros(len(points), dtype=np.bool_)
        last = np.array(lattice.frame.shape) - 1
        low = np.clip(np.floor(points), 0, last).astype(np.int64)
        self._cells = np.minimum(low[:, None] + np.array([(0, 0), (0, 1), (1, 0), (1, 1)]), last)  # (n, 4, 2)

    def energies(self, field_j: NDArray[np.float32], goal: tuple[float, float], of: NDArray[np.int64]) -> FloatArray:
        """Return the least energies to a goal.

        Parameters
        ----------
        field_j : ndarray of float32, (rows, cols)
            Least energy from each cell to the goal [J]; infinite where there is no way.
        goal : tuple of float
            World x, y of the goal [m].
        of : ndarray of int, (m,)
            Numbers of places.

        Returns
        -------
        ndarray of float, (m,)
            Energy [J]; infinite where there is no way.
        """
        new = of[~self._priced[of]]
        if new.size:
            ends = self._cells[new].reshape(-1, 2).astype(np.float64)
            legs = leg_prices_between(self._lattice, np.repeat(self._points[new], 4, axis=0), ends)
            self._legs[new] = legs.reshape(-1, 4)
            self._priced[new] = True
        cells, points = self._cells[of], self._points[of]
        total = self._legs[of] + field_j[cells[..., 0], cells[..., 1]]
        found = np.where(np.isnan(total), np.inf, total).min(axis=1, initial=np.inf)
        end = np.array(self._lattice.frame.rowcol(*goal)).ravel()
        near = np.flatnonzero(np.abs(points - end).max(axis=1, initial=0.0) < _NEAR)
        straight = leg_prices_between(self._lattice, points[near], np.repeat(end[None], near.size, axis=0))
        found[near] = np.fmin(found[near], straight)  # a leg that may not be driven is NaN
        return found


def last_place(
    course: Course,
    rest_j: Callable[[NDArray[np.int64]], FloatArray],
    available_j: float,
    *,
    odds: Odds,
    confidence: float | None,
) -> Bail:
    """Return until where a path may be driven so that the battery still lasts for the way to a place.

    Parameters
    ----------
    course : Course
        The rest of the path, from here.
    rest_j : callable
        Returns the least energy to the place [J], infinite where there is no way, of points of the course: 0 is here,
        k the end of piece k - 1.
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

    Notes
    -----
    Whoever can drive on to a point and go from there can go from every point before. So the last point is sought among
    every `_STEP`-th one from the end, and then among those up to the next of these.
    """
    spent = np.append(0.0, np.cumsum(course.energy_j))
    marks = np.unique(np.append(np.arange(0, len(course) + 1, _STEP), len(course)))

    def _asked(points: NDArray[np.int64]) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        """(n,) energies on from these points, what is needed up to the place [J], and the odds of it."""
        rest = rest_j(points)
        total = spent[points] + rest
        known = np.isfinite(total)
        there = odds(np.where(known, total, 0.0)) if known.any() else None
        sure = total if there is None or confidence is None else there.quantile(confidence)
        lasts = None if there is None else there.lasts(available_j)
        return rest, np.where(known, sure, np.inf), lasts

    rest, needed, likely = _asked(marks)
    lasts = needed <= available_j
    reachable = bool(lasts[0])
    stop = cheapest = 0
    if reachable:
        last = int(np.flatnonzero(lasts)[-1])
        stop = int(marks[last])
        between = np.arange(stop + 1, marks[min(last + 1, len(marks) - 1)])
        if between.size:
            held = np.flatnonzero(_asked(between)[1] <= available_j)
            stop = int(between[held[-1]]) if held.size else stop
        best = int(np.argmin(rest[: last + 1]))
        around = np.arange(marks[max(best - 1, 0)], min(marks[min(best + 1, len(marks) - 1)], stop) + 1)
        cheapest = int(around[np.argmin(rest_j(around))])
    return Bail(
        energy_j=float(rest[0]),
        needed_j=float(needed[0]),
        probability=None if likely is None or not np.isfinite(rest[0]) else float(likely[0]),
        reachable=reachable,
        last=_end_of(course, stop) if reachable and stop < len(course) else None,
        whole_path=reachable and stop == len(course),
        cheapest=_end_of(course, cheapest) if reachable else None,
        cheapest_j=float(rest_j(np.array([cheapest]))[0]) if reachable else np.inf,
    )


def _end_of(course: Course, point: int) -> Place:
    """The start of a course, or the end of a piece."""
    if point > 0:
        return course.place(point - 1, 1.0)
    return Place(0.0, 0.0, course.start[0], course.start[1])
