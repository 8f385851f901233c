"""A route by the metre: what a drive over it is expected to take, and where on it the robot is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.uncertainty import LEAST_SHARE, USUAL_SPREAD, Spread
from joulemap.model.errors import InputError
from joulemap.model.loop.drive_filter import DrivePrior
from joulemap.model.loop.drive_prior import UNKNOWN, cause_columns, prior_of_spread, unfitted
from joulemap.model.ranges import Range
from joulemap.planner.lattice import CostLattice
from joulemap.planner.route import Route

FloatArray = NDArray[np.float64]

BACK_M = 5.0
"""How far behind the last place the robot is looked for [m]: the error of a usual fix. Source: van Diggelen & Enge
2015, "The world's first GPS MOOC and worldwide laboratory using smartphones": 4.9 m under open sky."""
LENGTH_M = Range(0.01, 20_000.0)
"""Setting: limits of the length of a route that is followed [m]. A metre takes about 200 bytes of memory, a route of
that length 4 MB."""
FASTEST = 3.0
"""Setting: times its declared speed that it may have come on since."""


@dataclass(frozen=True, eq=False)
class Metres:
    """A route cut into metres, the last perhaps shorter.

    Attributes
    ----------
    marks_m : ndarray of float, (n + 1,)
        Distances of their ends from the start [m].
    sums : ndarray of float, (n + 1, k + 2)
        Up to each end: the columns of causes [J], squared standard deviations [J2], and duration [s].
    corners : ndarray of float, (c, 2)
        World x, y of the route [m].
    corners_m : ndarray of float, (c,)
        Their distances from the start [m].
    """

    marks_m: FloatArray
    sums: FloatArray
    corners: FloatArray
    corners_m: FloatArray

    @property
    def columns(self) -> FloatArray:
        """Of each metre, (n, k) [J]."""
        return np.diff(self.sums[:, :-2], axis=0)

    @property
    def std_j(self) -> FloatArray:
        """Of each metre, (n,) [J]."""
        return np.sqrt(np.diff(self.sums[:, -2]))

    @property
    def length_m(self) -> float:
        """Of the route [m]."""
        return float(self.marks_m[-1])

    def up_to(self, at_m: float) -> FloatArray:
        """Return the sums up to a place on the route, (k + 2,)."""
        place = min(max(at_m, 0.0), self.length_m)
        k = min(int(place), len(self.marks_m) - 2)
        share = (place - self.marks_m[k]) / (self.marks_m[k + 1] - self.marks_m[k])
        return np.asarray((1.0 - share) * self.sums[k] + share * self.sums[k + 1])

    def point(self, at_m: float) -> tuple[float, float]:
        """Return the world x, y of a place on the route [m]."""
        return tuple(float(np.interp(at_m, self.corners_m, axis)) for axis in self.corners.T)  # type: ignore[return-value]

    def nearest(self, x: float, y: float, low_m: float, high_m: float) -> tuple[float, float]:
        """Return the place between two distances that is nearest to a point, and how far off that is [m]."""
        first = max(int(np.searchsorted(self.corners_m, low_m, side="right")) - 1, 0)
        last = min(int(np.searchsorted(self.corners_m, high_m)) + 1, len(self.corners_m))
        starts, ends = self.corners[first : last - 1], self.corners[first + 1 : last]
        along = ends - starts
        length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-12)
        away = np.array([x, y]) - starts
        driven = np.clip((away * along).sum(axis=1) / length, 0.0, length)
        places = np.clip(self.corners_m[first : last - 1] + driven, low_m, high_m)
        driven = places - self.corners_m[first : last - 1]
        off = np.hypot(*(away - driven[:, None] * along / length[:, None]).T)
        best = int(np.argmin(off))
        return float(places[best]), float(off[best])


def check_length(length_m: float) -> None:
    """Raise InputError if a route is too short or too long to be followed."""
    if length_m not in LENGTH_M:
        limit = LENGTH_M.low if length_m < LENGTH_M.low else LENGTH_M.high
        words = f"a drive needs a route of {LENGTH_M} m, this one has {length_m:g} m: follow a longer one in parts"
        raise InputError(words, found=length_m, limit=limit)


def check_points(points: FloatArray) -> None:
    """Raise InputError if a path of world points (n, 2) is too short or too long to be followed."""
    check_length(float(np.hypot(*np.diff(points[:, :2], axis=0).T).sum()))


def metres_of(lattice: CostLattice, route: Route) -> Metres:
    """Return a route by the metre, priced as it was planned."""
    robot, profile = lattice.robot, route.profile
    length = np.diff(profile.distance_m, prepend=0.0)
    rise = np.nan_to_num(np.diff(profile.z, prepend=route.points[0, 2]))
    at_rest, level = robot.hotel_per_m * length, robot.rolling_resistance * robot.weight_n * length
    pulling = np.where(profile.energy_j > at_rest, 1.0, robot.regeneration)
    columns = cause_columns(profile.energy_j, pulling * level, pulling * robot.weight_n * rise, at_rest)
    std = profile.std_j
    if std is None:
        std = USUAL_SPREAD * np.maximum(profile.energy_j, LEAST_SHARE * (level + at_rest))
    duration = length / robot.speed_mps
    by_piece = np.vstack([np.zeros(columns.shape[1] + 2), np.column_stack([columns, std, duration]).cumsum(axis=0)])
    ends = np.append(0.0, profile.distance_m)
    marks = np.append(np.arange(max(math.ceil(route.length_m - 1e-9), 1)), route.length_m)
    sums = np.column_stack([np.interp(marks, ends, along) for along in by_piece.T])
    # the error within a metre is common to all of it, as in `odds_along`
    sums[1:, -2] = np.cumsum(np.diff(sums[:, -2]) ** 2)
    corners = route.points[:, :2]
    steps = np.hypot(*np.diff(corners, axis=0).T)
    return Metres(marks, sums, corners, np.append(0.0, np.cumsum(steps)))


def prior_of(lattice: CostLattice, metres: Metres) -> DrivePrior:
    """Return what the model of a cost map knows of a drive before it: fitted to runs, or by its spread."""
    model = lattice.provenance.get("model", {})
    if (fitted := model.get("drive_prior")) is not None:
        return DrivePrior.from_dict(fitted)
    if model.get("spread") is not None:
        return unfitted(prior_of_spread(Spread.from_dict(model["spread"]), metres.columns, metres.std_j))
    start = prior_of_spread(UNKNOWN, metres.columns, metres.std_j)
    return replace(start, passing=USUAL_SPREAD)  # what differs between runs is all of the error that is assumed
