"""A route: a priced polyline, leg by leg and metre by metre."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import BlockedError
from joulemap.model.frames import wrap_angle
from joulemap.model.terrain.heightmap import sample_bilinear
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import leg_prices, path_headings, path_price, world_points
from joulemap.planner.pricing.polylines import subdivided
from joulemap.planner.words import duration_words, energy_words, moved_words

PROFILE_STEP_M = 1.0
_ROUNDED = 0.99
"""Share of a robot's turning radius that a path keeps which a file has rounded."""
_STRAIGHT_RAD = 1e-6
"""A corner of less is rounding: a millimetre over a kilometre."""


@dataclass(frozen=True, eq=False, repr=False)
class Profile:
    """A route cut into pieces of at most a metre, never across a corner.

    Attributes
    ----------
    distance_m : ndarray of float, (n,)
        Horizontal distance from the start at the end of each piece [m].
    x, y, z : ndarray of float, (n,)
        World point at its end [m].
    heading_rad : ndarray of float, (n,)
        Heading of the piece [rad, clockwise from north].
    energy_j : ndarray of float, (n,)
        Energy of the piece, the turn at its beginning included [J].
    cumulative_j : ndarray of float, (n,)
        Energy from the start to its end [J].
    std_j : ndarray of float, (n,), or None
        Standard deviation of the energy of the piece alone [J]; None where the lattice has none.
    """

    distance_m: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    energy_j: NDArray[np.float64]
    cumulative_j: NDArray[np.float64]
    std_j: NDArray[np.float64] | None = None

    def __repr__(self) -> str:
        length = float(self.distance_m[-1]) if self.distance_m.size else 0.0
        energy = energy_words(float(self.energy_j.sum()))
        return f"Profile({self.distance_m.size} pieces over {length:.1f} m, {energy})"


@dataclass(frozen=True, eq=False, repr=False)
class Route:
    """A path with its price.

    Attributes
    ----------
    points : ndarray of float, (n, 3)
        World x, y, z [m]; z is NaN where no height near the point is known.
    energy_j : float
        Energy, priced by `edges`, turns included [J].
    length_m : float
        Horizontal length [m].
    duration_s : float
        Time at the robot's speed, turns not counted [s].
    climb_m, descent_m : float
        Sums of all ascents and of all descents along the profile, both at least 0 [m].
    profile : Profile
        The route metre by metre.
    crs : str or None
        Coordinate reference system of the points.
    notes : list of str
        What the caller should know of the route.
    goal_moved_m : float
        How far its end is from the place that was asked for [m].
    spread : mapping or None
        The model's record of its errors on runs left out, from the lattice; None where it has none.
    """

    points: NDArray[np.float64]
    energy_j: float
    length_m: float
    duration_s: float
    climb_m: float
    descent_m: float
    profile: Profile
    crs: str | None = None
    notes: list[str] = field(default_factory=list)
    goal_moved_m: float = 0.0
    spread: Mapping[str, Any] | None = None

    @cached_property
    def tightest_radius_m(self) -> float | None:
        """The radius of the largest arc that rounds every corner within its legs [m]; None for a straight line."""
        step = np.diff(self.points[:, :2], axis=0)
        step = step[np.any(step != 0.0, axis=1)]
        bend = np.abs(wrap_angle(np.diff(np.arctan2(step[:, 0], step[:, 1]))))
        tangent = np.concatenate([[0.0], np.tan(0.5 * bend), [0.0]])  # at each end of each leg, of a radius of 1
        needed, length = tangent[1:] + tangent[:-1], np.hypot(*step.T)
        bent = needed > 0.5 * _STRAIGHT_RAD
        return float((length[bent] / needed[bent]).min()) if bent.any() else None

    def in_words(self) -> str:
        """Return length, energy and duration in words and units, and how far the goal was moved."""
        words = f"{self.length_m:.1f} m, {energy_words(self.energy_j)}, {duration_words(self.duration_s)}"
        return words + moved_words(self.goal_moved_m)

    def __repr__(self) -> str:
        return f"Route({self.in_words()}, {self.climb_m:.1f} m up, {self.descent_m:.1f} m down)"

    def __str__(self) -> str:
        start, end = (f"({x:.2f}, {y:.2f})" for x, y in self.points[[0, -1], :2])
        lines = [
            f"route from {start} to {end}: {self.in_words()}",
            f"{self.climb_m:.1f} m up, {self.descent_m:.1f} m down, {len(self.points)} points",
            *(f"note: {note}" for note in self.notes),
        ]
        return "\n".join(lines)


def price_route(lattice: CostLattice, xy: ArrayLike, *, notes: list[str] | None = None) -> Route:
    """Return the route along given world points.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    xy : array_like, (n, 2 or 3)
        World x, y [m] of n >= 1 points; a third column is not used.
    notes : list of str, optional
        What the caller should know of the route.

    Returns
    -------
    Route
        The route with its profile.

    Raises
    ------
    PointError
        If a point is not finite or lies outside the map.
    BlockedError
        If a leg may not be driven; the context has its number and its ends.
    """
    points = world_points(lattice, xy)
    west, south, east, north = lattice.frame.bounds
    given = np.asarray(xy, dtype=np.float64)[:, :2]
    inside = ((given >= (west, south)) & (given <= (east, north))).all(axis=1)
    for k in np.flatnonzero(~inside)[:1]:
        x, y = given[k]
        lattice.frame.cell_of(float(x), float(y), name=f"point {k} of the path")
    energy = path_price(lattice, points)
    if np.isnan(energy):
        bad = int(np.flatnonzero(np.isnan(leg_prices(lattice, points)))[0])
        x, y = lattice.frame.xy(points[bad : bad + 2, 0], points[bad : bad + 2, 1])
        raise BlockedError(
            f"the path may not be driven: leg {bad} from ({x[0]:.2f}, {y[0]:.2f}) to ({x[1]:.2f}, {y[1]:.2f}) crosses "
            "ground that is blocked or too steep in that direction",
            leg=bad,
            start=[float(x[0]), float(y[0])],
            end=[float(x[1]), float(y[1])],
        )
    profile = _profile(lattice, points)
    x, y = lattice.frame.xy(points[:, 0], points[:, 1])
    z = elevation_at(lattice, points)
    length = float(profile.distance_m[-1]) if profile.distance_m.size else 0.0
    heights = np.append(z[0], profile.z)
    rise = np.diff(heights[np.isfinite(heights)])
    route = Route(
        points=np.column_stack([x, y, z]),
        energy_j=float(energy),
        length_m=length,
        duration_s=length / lattice.robot.speed_mps,
        climb_m=float(rise[rise > 0].sum()),
        descent_m=abs(float(rise[rise < 0].sum())),
        profile=profile,
        crs=lattice.frame.crs,
        notes=list(notes or []),
        spread=lattice.provenance.get("model", {}).get("spread"),
    )
    least, tightest = lattice.robot.min_turning_radius_m, route.tightest_radius_m
    if tightest is not None and tightest < _ROUNDED * least:
        route.notes.append(
            f"the path has a curve of {tightest:.2g} m radius, which {lattice.robot.name} cannot drive: its turning "
            f"radius is {least:g} m"
        )
    return route


def in_sequence(routes: Sequence[Route], turn_j_per_rad: float) -> tuple[Route, ...]:
    """Return routes that are driven one after another, each with the turn from the end of the one before.

    Parameters
    ----------
    routes : sequence of Route
        In the order of driving.
    turn_j_per_rad : float
        Energy of turning on the spot [J/rad].

    Returns
    -------
    tuple of Route
        The same routes; the turn is in the first piece that moves.
    """
    driven, before = list[Route](), None
    for route in routes:
        cut = route.profile
        moving = np.flatnonzero(np.diff(cut.distance_m, prepend=0.0) > 0.0)
        if before is not None and moving.size:
            turn_j = turn_j_per_rad * abs(float(wrap_angle(cut.heading_rad[moving[0]] - before)))
            energy = cut.energy_j.copy()
            energy[moving[0]] += turn_j
            profile = replace(cut, energy_j=energy, cumulative_j=np.cumsum(energy))
            route = replace(route, energy_j=route.energy_j + turn_j, profile=profile)
        before = cut.heading_rad[moving[-1]] if moving.size else before
        driven.append(route)
    return tuple(driven)


def elevation_at(lattice: CostLattice, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the elevation of the ground at places of a lattice.

    Parameters
    ----------
    lattice : CostLattice
        Elevations at cell centres.
    points : ndarray of float, (n, 2)
        Fractional (row, col).

    Returns
    -------
    ndarray of float, (n,)
        Elevation [m], bilinear between cell centres and continued linearly in the outer half cell. Next to unknown
        ground it is the mean of the known ones of the four centres around, by their bilinear weights; NaN where none
        of them is known.
    """
    found = sample_bilinear(lattice.elevation_m, np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1]))
    unknown = np.isnan(found)
    if unknown.any():
        found[unknown] = _known_elevation(lattice.elevation_m, points[unknown])
    return found


def _known_elevation(elevation_m: NDArray[np.float32], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) mean [m] of the known centres around (n, 2) points, weighted as in bilinear interpolation."""
    total, weights = np.zeros(len(points)), np.zeros(len(points))
    for cell, share in _centres_around(points, elevation_m.shape):
        height = elevation_m[cell]
        weight = share + 1e-9  # a centre that is known counts where its weight is 0: it is the nearest height there is
        known = np.isfinite(height)
        total += np.where(known, weight * height, 0.0)
        weights += np.where(known, weight, 0.0)
    return np.where(weights > 0.0, total / np.where(weights > 0.0, weights, 1.0), np.nan)


def _centres_around(
    points: NDArray[np.float64], shape: tuple[int, ...]
) -> Iterator[tuple[tuple[NDArray[np.int64], NDArray[np.int64]], NDArray[np.float64]]]:
    """The (rows, cols) of the four centres around (n, 2) points, one after the other, and their bilinear weights."""
    last = np.array(shape[:2]) - 1
    place = np.clip(points, 0.0, last)
    corner = np.minimum(place.astype(np.int64), np.maximum(last - 1, 0))
    share = place - corner
    for row, col in np.ndindex(2, 2):
        cell = np.minimum(corner + np.array([row, col]), last)
        yield (cell[:, 0], cell[:, 1]), np.abs(1.0 - row - share[:, 0]) * np.abs(1.0 - col - share[:, 1])


@dataclass(frozen=True, eq=False)
class Pieces:
    """A polyline cut into pieces of at most a metre, never across a corner.

    Attributes
    ----------
    points : ndarray of float, (n + 1, 2)
        Fractional (row, col) of their ends.
    driven_m : ndarray of float, (n,)
        Length of each [m].
    heading_rad : ndarray of float, (n,)
        Heading of each [rad, clockwise from north].
    energy_j : ndarray of float, (n,)
        Energy of each, the turn at its beginning included [J]; NaN where it may not be driven.
    """

    points: NDArray[np.float64]
    driven_m: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    energy_j: NDArray[np.float64]


def pieces_of(lattice: CostLattice, points: NDArray[np.float64]) -> Pieces:
    """Return the pieces of a polyline.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline.

    Returns
    -------
    Pieces
        Priced.
    """
    spacing = lattice.frame.resolution_m
    fine = subdivided(points, PROFILE_STEP_M / spacing)
    energy = leg_prices(lattice, fine)
    heading = path_headings(fine)
    driven = np.hypot(*np.diff(fine, axis=0).T) * spacing
    if lattice.robot.turn_j_per_rad > 0.0 and energy.size > 1:
        moving = np.flatnonzero(driven > 0.0)  # a point that repeats the one before it hides no turn
        energy[moving[1:]] += lattice.robot.turn_j_per_rad * np.abs(wrap_angle(np.diff(heading[moving])))
    return Pieces(fine, driven, heading, energy)


def _profile(lattice: CostLattice, points: NDArray[np.float64]) -> Profile:
    cut = pieces_of(lattice, points)
    fine, driven, heading, energy = cut.points, cut.driven_m, cut.heading_rad, cut.energy_j
    x, y = lattice.frame.xy(fine[1:, 0], fine[1:, 1])
    std = None if lattice.std_j is None else driven * _std_at(lattice.std_j, 0.5 * (fine[1:] + fine[:-1]), heading)
    return Profile(np.cumsum(driven), x, y, elevation_at(lattice, fine[1:]), heading, energy, np.cumsum(energy), std)


def _std_at(
    std_j: NDArray[np.float32], points: NDArray[np.float64], heading_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) standard deviation [J] of 1 m segments at (n, 2) (row, col): bilinear between cells, linear between headings
    (a wave through the bins could become negative).
    """
    turn = heading_rad / (2.0 * np.pi) * std_j.shape[2]
    earlier = np.floor(turn).astype(np.int64)
    ahead = turn - earlier
    found = np.zeros(len(points))
    for cell, share in _centres_around(points, std_j.shape):
        for bin_, weight in ((earlier, share * (1.0 - ahead)), (earlier + 1, share * ahead)):
            found += np.where(weight > 0.0, weight * std_j[(*cell, bin_ % std_j.shape[2])], 0.0)
    return found
