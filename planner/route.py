"""Route: a priced polyline, leg by leg and metre by metre."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import BlockedError
from joulemap.model.frames import wrap_angle
from joulemap.model.terrain.heightmap import sample_bilinear
from joulemap.planner.edges import leg_prices, path_headings, path_price, world_points
from joulemap.planner.lattice import CostLattice

PROFILE_STEP_M = 1.0


@dataclass(frozen=True, eq=False, repr=False)
class Profile:
    """A route cut into pieces of at most a metre (never across a corner). All arrays (n,).

    distance_m : horizontal distance from the start at the piece's end; x, y, z [m] there; heading_rad of the piece;
    energy_j : energy of the piece, the turn at its beginning included; cumulative_j : energy from the start to its end;
    std_j : standard deviation of the energy of the piece alone, None where the lattice has none.
    """

    distance_m: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    heading_rad: NDArray[np.float64]
    energy_j: NDArray[np.float64]
    cumulative_j: NDArray[np.float64]
    std_j: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Route:
    """A path with its price.

    points : (n, 3) float64 world x, y, z [m]; length_m : horizontal; duration_s : at the robot's speed, turns not
    counted; energy_j : re-priced by `edges`, turns included; climb_m, descent_m : sums along the profile, both >= 0.
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


def price_route(lattice: CostLattice, xy: ArrayLike, *, notes: list[str] | None = None) -> Route:
    """The Route along world points (n >= 1, 2 or 3). Raises PointError; BlockedError on a forbidden leg."""
    points = world_points(lattice, xy)
    for k, (x, y) in enumerate(np.asarray(xy, dtype=np.float64)[:, :2]):
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
    rise = np.diff(np.append(z[0], profile.z))
    return Route(
        points=np.column_stack([x, y, z]),
        energy_j=float(energy),
        length_m=length,
        duration_s=length / lattice.robot.speed_mps,
        climb_m=float(rise[rise > 0].sum()),
        descent_m=float(-rise[rise < 0].sum()),
        profile=profile,
        crs=lattice.frame.crs,
        notes=list(notes or []),
    )


def elevation_at(lattice: CostLattice, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bilinear elevation [m] at (n, 2) fractional (row, col)."""
    return sample_bilinear(lattice.elevation_m, np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1]))


def geojson(route: Route, **properties: object) -> dict[str, object]:
    """The route as a GeoJSON Feature (a LineString with z) in the map's CRS, which RFC 7946 readers take from `crs`."""
    feature: dict[str, object] = {
        "type": "Feature",
        "geometry": {"type": "LineString", "coordinates": route.points.tolist()},
        "properties": {
            "energy_j": route.energy_j,
            "length_m": route.length_m,
            "duration_s": route.duration_s,
            **properties,
        },
    }
    if route.crs is not None:
        feature["crs"] = {"type": "name", "properties": {"name": route.crs}}
    return feature


def _profile(lattice: CostLattice, points: NDArray[np.float64]) -> Profile:
    spacing = lattice.frame.resolution_m
    length = np.hypot(*np.diff(points, axis=0).T) * spacing
    pieces = np.maximum(1, np.ceil(length / PROFILE_STEP_M - 1e-9)).astype(int)
    cuts = [points[:1]]
    for k, count in enumerate(pieces):
        share = np.arange(1, count + 1)[:, None] / count
        cuts.append(points[k] + share * (points[k + 1] - points[k]))
    fine = np.vstack(cuts)
    energy = leg_prices(lattice, fine)
    heading = path_headings(fine)
    driven = np.hypot(*np.diff(fine, axis=0).T) * spacing
    if lattice.robot.turn_j_per_rad > 0.0 and energy.size > 1:
        change = np.abs(wrap_angle(np.diff(heading)))
        moving = (driven[1:] > 0) & (driven[:-1] > 0)
        energy[1:] += lattice.robot.turn_j_per_rad * np.where(moving, change, 0.0)
    x, y = lattice.frame.xy(fine[1:, 0], fine[1:, 1])
    std = None if lattice.std_j is None else driven * _std_at(lattice.std_j, 0.5 * (fine[1:] + fine[:-1]), heading)
    return Profile(np.cumsum(driven), x, y, elevation_at(lattice, fine[1:]), heading, energy, np.cumsum(energy), std)


def _std_at(
    std_j: NDArray[np.float32], points: NDArray[np.float64], heading_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) standard deviation [J] of 1 m segments at (n, 2) (row, col): bilinear between cells, linear between headings
    (a wave through the bins could become negative).
    """
    last = np.array(std_j.shape[:2]) - 1
    place = np.clip(points, 0.0, last)
    corner = np.minimum(place.astype(np.int64), np.maximum(last - 1, 0))
    share = place - corner
    turn = heading_rad / (2.0 * np.pi) * std_j.shape[2]
    earlier = np.floor(turn).astype(np.int64)
    ahead = turn - earlier
    found = np.zeros(len(points))
    for row, col, bin_ in np.ndindex(2, 2, 2):
        weight = np.abs(1.0 - row - share[:, 0]) * np.abs(1.0 - col - share[:, 1]) * np.abs(1.0 - bin_ - ahead)
        cell = np.minimum(corner + np.array([row, col]), last)
        values = std_j[cell[:, 0], cell[:, 1], (earlier + bin_) % std_j.shape[2]]
        found += np.where(weight > 0.0, weight * values, 0.0)
    return found
