"""The price of any straight leg or polyline: the one integrator that prices every search, planner and route."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError, PointError
from joulemap.model.frames import heading_of, heading_vector
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.kernels import (
    heading_memory,
    heading_weights,
    leg_energies,
    path_energy,
    polyline_energies,
)

Points = NDArray[np.float64]


def price_terms(lattice: CostLattice) -> NDArray[np.float64]:
    """Return what pricing kernels need beside the arrays.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.

    Returns
    -------
    ndarray of float, (6,)
        Side of a cell [m], idle energy per metre [J/m], regeneration share, tangents of the greatest grade and of the
        greatest cross slope, greatest traction [J/m].
    """
    robot = lattice.robot
    limits = *lattice.max_tangents, lattice.max_traction_per_m
    return np.array([lattice.frame.resolution_m, robot.hotel_per_m, robot.regeneration, *limits])


def price_arrays(lattice: CostLattice) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return the first arguments of every pricing kernel.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.

    Returns
    -------
    tuple of ndarray
        `traction_per_m` (rows, cols, headings) [J/m], `gradient` (rows, cols, 2), `blocked` (rows, cols), and
        `price_terms` (6,).
    """
    return lattice.traction_per_m, lattice.gradient, lattice.blocked, price_terms(lattice)


def world_points(lattice: CostLattice, xy: ArrayLike) -> Points:
    """Return world points as places of a lattice.

    Parameters
    ----------
    lattice : CostLattice
        Whose frame counts.
    xy : array_like, (n, 2 or more)
        World x, y [m]; further columns are not used.

    Returns
    -------
    ndarray of float, (n, 2)
        Fractional (row, col).

    Raises
    ------
    PointError
        If a point is not finite, or the array has another shape.
    """
    points = np.asarray(xy, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] < 2:
        raise PointError(f"a path is a list of [x, y] points, got an array of shape {points.shape}")
    bad = np.flatnonzero(~np.isfinite(points[:, :2]).all(axis=1))
    if bad.size:
        raise PointError(f"point {bad[0]} of the path is not finite: {points[bad[0]].tolist()}", index=int(bad[0]))
    row, col = lattice.frame.rowcol(points[:, 0], points[:, 1])
    return np.column_stack([row, col])


def leg_prices(lattice: CostLattice, points: Points) -> NDArray[np.float64]:
    """Return the energy of each leg of a polyline, without turns.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline.

    Returns
    -------
    ndarray of float, (n - 1,)
        Energy [J]; NaN where a leg may not be driven.
    """
    return polyline_energies(*price_arrays(lattice), np.ascontiguousarray(points, dtype=np.float64))


def leg_prices_between(lattice: CostLattice, starts: Points, ends: Points) -> NDArray[np.float64]:
    """Return the energy of straight legs.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    starts, ends : ndarray of float, (n, 2)
        Fractional (row, col).

    Returns
    -------
    ndarray of float, (n,)
        Energy [J]; NaN where a leg may not be driven.

    Notes
    -----
    The integral of the price hotel + max(t, 0) + regeneration * min(t, 0) along the leg, t the traction at the leg's
    heading, bilinear between cell centres. It is exact, so cutting a leg leaves its energy unchanged.
    """
    legs = np.ascontiguousarray(np.hstack([starts, ends]), dtype=np.float64)
    return leg_energies(*price_arrays(lattice), legs)


def path_price(lattice: CostLattice, points: Points) -> float:
    """Return the energy of a polyline with its turns.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    points : ndarray of float, (n, 2)
        (row, col) polyline.

    Returns
    -------
    float
        Energy [J]; NaN where a leg may not be driven.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    return float(path_energy(*price_arrays(lattice), lattice.robot.turn_j_per_rad, points))


def price_world_path(lattice: CostLattice, xy: ArrayLike) -> float:
    """Return the energy of a polyline of world points with its turns.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    xy : array_like, (n, 2 or 3)
        World x, y [m]; a third column is not used.

    Returns
    -------
    float
        Energy [J]; NaN where a leg may not be driven.

    Raises
    ------
    PointError
        If a point is not finite, or the array has another shape.
    """
    return path_price(lattice, world_points(lattice, xy))


def energy_per_m_at(lattice: CostLattice, x: float, y: float, headings_rad: ArrayLike) -> NDArray[np.float64]:
    """Return the price per metre at a world point for any headings.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    x, y : float
        World point [m].
    headings_rad : array_like, (n,)
        Headings [rad, clockwise from north].

    Returns
    -------
    ndarray of float, (n,)
        Price [J/m]; NaN where that heading is blocked or unknown.

    Raises
    ------
    PointError
        If the point is not finite or lies outside the map.

    Notes
    -----
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
    """Return the weights that interpolate values at heading bins to any headings.

    Parameters
    ----------
    headings_rad : array_like, (n,)
        Headings [rad, clockwise from north].
    bins : int
        Number of heading bins K, at least 4.

    Returns
    -------
    ndarray of float, (n, K)
        Weights; rows sum to 1.

    Raises
    ------
    InputError
        If there are fewer than 4 bins.

    References
    ----------
    Trigonometric interpolation, see `kernels.heading_weights`.
    """
    headings = np.atleast_1d(np.asarray(headings_rad, dtype=np.float64))
    if bins < 4:
        raise InputError(f"at least 4 heading bins are needed, got {bins}")
    memory = heading_memory(bins)
    matrix = np.empty((headings.size, bins))
    for k, (east, north) in enumerate(zip(*heading_vector(headings), strict=True)):
        heading_weights(east, north, memory)
        matrix[k] = memory[0]
    return matrix


def path_headings(points: Points) -> NDArray[np.float64]:
    """Return the heading of each leg of a polyline.

    Parameters
    ----------
    points : ndarray of float, (n, 2)
        (row, col) polyline.

    Returns
    -------
    ndarray of float, (n - 1,)
        Headings [rad, clockwise from north, 0..2 pi).
    """
    step = np.diff(points, axis=0)
    return heading_of(step[:, 1], -step[:, 0])
