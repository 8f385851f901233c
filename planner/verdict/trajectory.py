"""What is driven one route after another, piece by piece: the course on which a battery is judged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.planner.route import Route

FloatArray = NDArray[np.float64]

NOTABLE = 0.1
"""A stretch is named where its share of the energy exceeds its share of the way by at least so much."""


@dataclass(frozen=True)
class Place:
    """A place on a course.

    Attributes
    ----------
    distance_m : float
        From the start of the course [m].
    time_s : float
        From its start, at the robot's speed [s].
    x, y : float
        World point [m].
    """

    distance_m: float
    time_s: float
    x: float
    y: float


@dataclass(frozen=True, eq=False)
class Stretch:
    """A part of a course that takes much energy.

    Attributes
    ----------
    start_m, end_m : float
        Distances from the start of its route [m].
    share : float
        Of the energy of the course.
    rise_m : float
        Height of its end above its start [m]; NaN where unknown.
    way : int
        Number of its route.
    """

    start_m: float
    end_m: float
    share: float
    rise_m: float
    way: int


@dataclass(frozen=True, eq=False)
class Course:
    """Pieces of at most a metre, in the order of driving, of one or more routes.

    Attributes
    ----------
    energy_j : ndarray of float, (n,)
        Energy of each piece [J].
    distance_m : ndarray of float, (n,)
        Distance from the start of the course to the end of each piece [m].
    duration_s : ndarray of float, (n,)
        Time of each piece at the robot's speed [s].
    x, y, z : ndarray of float, (n,)
        World point at its end [m].
    way : ndarray of int, (n,)
        Number of its route.
    start : tuple of float
        World x, y, z of the start [m].
    std_j : ndarray of float, (n,), or None
        Standard deviation of the energy of each piece alone [J]; None where the model gives none.
    weight_n : float or None
        Of the robot that drives it [N]; None where unknown.
    """

    energy_j: FloatArray
    distance_m: FloatArray
    duration_s: FloatArray
    x: FloatArray
    y: FloatArray
    z: FloatArray
    way: NDArray[np.int64]
    start: tuple[float, float, float]
    std_j: FloatArray | None = None
    weight_n: float | None = None

    def __len__(self) -> int:
        return int(self.energy_j.size)

    @property
    def driven_m(self) -> FloatArray:
        """Length of each piece [m], (n,)."""
        return np.diff(self.distance_m, prepend=0.0)

    @property
    def ways(self) -> int:
        """Number of routes."""
        return int(self.way[-1]) + 1 if len(self) else 0

    @property
    def returns(self) -> bool:
        """Whether it ends where it begins, to a centimetre."""
        return self.ways > 1 and math.dist((self.x[-1], self.y[-1]), self.start[:2]) < 0.01

    def place(self, piece: int, share: float) -> Place:
        """Return a place within a piece.

        Parameters
        ----------
        piece : int
            Its number.
        share : float
            Of the piece that is driven there, 0 to 1.

        Returns
        -------
        Place
            Where and when.
        """
        before_x, before_y = (self.x[piece - 1], self.y[piece - 1]) if piece else self.start[:2]
        return Place(
            float(self.distance_m[piece] - (1.0 - share) * self.driven_m[piece]),
            float(self.duration_s[:piece].sum() + share * self.duration_s[piece]),
            float(before_x + share * (self.x[piece] - before_x)),
            float(before_y + share * (self.y[piece] - before_y)),
        )

    def way_start_m(self, way: int) -> float:
        """Return the distance at which a route begins.

        Parameters
        ----------
        way : int
            Number of the route.

        Returns
        -------
        float
            From the start of the course [m].
        """
        before = self.distance_m[self.way < way]
        return float(before[-1]) if before.size else 0.0

    def dearest(self) -> Stretch | None:
        """Return the stretch whose energy lies most above the mean of the course.

        Returns
        -------
        Stretch or None
            Within one route; None where no stretch takes notably more than the rest.

        References
        ----------
        Bentley 1984, "Programming pearls: algorithm design techniques" (the subarray of the largest sum).
        """
        total, length = float(self.energy_j.sum()), float(self.distance_m[-1]) if len(self) else 0.0
        if total <= 0.0 or length <= 0.0:
            return None
        excess = self.energy_j - total / length * self.driven_m
        best = (0.0, 0, 0)
        for way in np.unique(self.way):
            mine = np.flatnonzero(self.way == way)
            sums = np.append(0.0, np.cumsum(excess[mine]))
            lowest = np.minimum.accumulate(sums)
            end = int(np.argmax(sums - lowest))
            start = int(np.argmin(sums[: end + 1]))
            best = max(best, (float(sums[end] - sums[start]), int(mine[0]) + start, int(mine[0]) + end))
        gained, first, last = best
        if gained < NOTABLE * total:
            return None
        way = int(self.way[first])
        heights = np.append(self.start[2], self.z)
        offset = self.way_start_m(way)
        begins = float(self.distance_m[first - 1]) if first else 0.0
        return Stretch(
            begins - offset,
            float(self.distance_m[last - 1]) - offset,
            float(self.energy_j[first:last].sum()) / total,
            float(heights[last] - heights[first]),
            way,
        )


def course_of(routes: Sequence[Route], *, weight_n: float | None = None) -> Course:
    """Return the course of routes that are driven one after another.

    `routes`: in the order of driving, at least one; `weight_n`: of the robot [N]. Result: of all their pieces.
    """
    profiles = [route.profile for route in routes]
    starts = np.cumsum([0.0, *(route.length_m for route in routes)])
    driven = [np.diff(p.distance_m, prepend=0.0) for p in profiles]
    slowness = [route.duration_s / route.length_m if route.length_m > 0.0 else 0.0 for route in routes]
    stds = [p.std_j for p in profiles if p.std_j is not None]
    x, y, z = routes[0].points[0].tolist()
    return Course(
        np.concatenate([p.energy_j for p in profiles]),
        np.concatenate([p.distance_m + start for p, start in zip(profiles, starts, strict=False)]),
        np.concatenate([d * s for d, s in zip(driven, slowness, strict=True)]),
        np.concatenate([p.x for p in profiles]),
        np.concatenate([p.y for p in profiles]),
        np.concatenate([p.z for p in profiles]),
        np.repeat(np.arange(len(profiles)), [p.energy_j.size for p in profiles]),
        (x, y, z),
        np.concatenate(stds) if len(stds) == len(profiles) else None,
        weight_n,
    )
