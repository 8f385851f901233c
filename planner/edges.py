"""The price of any straight leg or polyline: the one integrator by which every search, planner and route is judged."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError, PointError
from joulemap.model.frames import heading_of
from joulemap.planner.kernels import heading_weights, leg_energies, path_energy
from joulemap.planner.lattice import CostLattice

Points = NDArray[np.float64]


def price_terms(lattice: CostLattice) -> NDArray[np.float64]:
    """What kernels need beside the arrays: spacing [m], hotel [J/m], regeneration, grade and cross-slope tangents."""
    robot = lattice.robot
    return np.array([lattice.frame.resolution_m, robot.hotel_per_m, robot.regeneration, *lattice.max_tangents])


def price_arrays(lattice: CostLattice) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """The leading arguments of every pricing kernel."""
    return lattice.traction_per_m, lattice.gradient, lattice.blocked, price_terms(lattice)


def world_points(lattice: CostLattice, xy: ArrayLike) -> Points:
    """(n, 2) world points as (n, 2) fractional (row, col). Raises PointError when not finite or of another shape."""
    points = np.asarray(xy, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] < 2:
        raise PointError(f"a path is a list of [x, y] points, got an array of shape {points.shape}")
    bad = np.flatnonzero(~np.isfinite(points[:, :2]).all(axis=1))
    if bad.size:
        raise PointError(f"point {bad[0]} of the path is not finite: {points[bad[0]].tolist()}", index=int(bad[0]))
    row, col = lattice.frame.rowcol(points[:, 0], points[:, 1])
    return np.column_stack([row, col])


def leg_prices(lattice: CostLattice, points: Points) -> NDArray[np.float64]:
    """(n - 1,) energy [J] of the legs of a (row, col) polyline, turns apart; NaN where a leg may not be driven."""
    return leg_prices_between(lattice, points[:-1], points[1:])


def leg_prices_between(lattice: CostLattice, starts: Points, ends: Points) -> NDArray[np.float64]:
    """(n,) energy [J] of the straight legs from `starts` to `ends`, both (n, 2) (row, col); NaN where not allowed."""
    legs = np.ascontiguousarray(np.hstack([starts, ends]), dtype=np.float64)
    return leg_energies(*price_arrays(lattice), legs)


def path_price(lattice: CostLattice, points: Points) -> float:
    """Energy [J] of a (row, col) polyline with its turns; NaN when some leg may not be driven."""
    points = np.ascontiguousarray(points, dtype=np.float64)
    return float(path_energy(*price_arrays(lattice), lattice.robot.turn_j_per_rad, points))


def price_world_path(lattice: CostLattice, xy: ArrayLike) -> float:
    """Energy [J] of a polyline of world points (n, 2 or 3); NaN when some leg may not be driven."""
    return path_price(lattice, world_points(lattice, xy))


def energy_per_m_at(lattice: CostLattice, x: float, y: float, headings_rad: ArrayLike) -> NDArray[np.float64]:
    """Price per metre [J/m] at a world point for any headings; NaN where that heading is blocked or unknown.

    The limit of a leg's energy over its length as the leg shrinks to the point.
    """
    lattice.frame.cell_of(x, y)
    headings = np.atleast_1d(np.asarray(headings_rad, dtype=np.float64))
    step = 1e-3
    centre = np.array(lattice.frame.rowcol(x, y)).ravel()
    limit = np.array(lattice.frame.shape) - 0.5 - step
    row, col = np.clip(centre, -0.5 + step, limit)
    d_row, d_col = -np.cos(headings) * step / 2, np.sin(headings) * step / 2
    legs = np.column_stack([row - d_row, col - d_col, row + d_row, col + d_col])
    return leg_energies(*price_arrays(lattice), legs) / (step * lattice.frame.resolution_m)


def interpolation_matrix(headings_rad: ArrayLike, bins: int) -> NDArray[np.float64]:
    """(n, bins) weights that take bin values to the given headings [rad]; rows sum to 1."""
    headings = np.atleast_1d(np.asarray(headings_rad, dtype=np.float64))
    if bins < 4:
        raise InputError(f"at least 4 heading bins are needed, got {bins}")
    matrix = np.empty((headings.size, bins))
    for k, heading in enumerate(headings):
        heading_weights(float(heading), matrix[k])
    return matrix


def path_headings(points: Points) -> NDArray[np.float64]:
    """(n - 1,) heading [rad, 0..2 pi) of each leg of a (row, col) polyline."""
    step = np.diff(points, axis=0)
    return heading_of(step[:, 1], -step[:, 0])
