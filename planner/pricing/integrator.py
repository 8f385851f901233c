"""The price of any straight leg or polyline: the one integrator that prices every search, planner and route."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError, PointError
from joulemap.model.frames import heading_of, heading_vector
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.obstacles import Closed
from joulemap.planner.pricing.kernels import (
    heading_memory,
    heading_weights,
    leg_energies,
    path_energy,
    polyline_energies,
)
from joulemap.planner.pricing.polylines import Points, subdivided

LEAST_MARGIN_CELLS, MOST_MARGIN_CELLS = 0.5, 3.0
"""Least and largest margin to ground that may not be driven, for a robot that does not keep to its path exactly. Within
a wider one every leg would take long to price; a coarser map keeps it."""
MARGIN_PENALTY, SHAPE_PENALTY = 10.0, 1.0
"""A leg within the margin counts as if it were so much longer: a move where passages are chosen between, over the grid,
and a leg where the path's shape is. Three times as much keeps no more of the margin on a real hillside
(`python -m tests.bench.margin`), and goes 100 m around a door of 3 m. A half circle around a corner is 0.57 diameters
longer than the way through, so a shape keeps the margin at any penalty above; much above, metres are bought that leave
a door narrower than the margin a little sooner."""


def price_terms(lattice: CostLattice) -> NDArray[np.float64]:
    """Return what pricing kernels need beside the arrays.

    `lattice`: prices and limits. Result (9,): side of a cell [m], idle energy per metre [J/m], regeneration share,
    tangents of the greatest grade and of the greatest cross slope, greatest traction [J/m]; and three zeros: every leg
    is driven exactly.
    """
    robot = lattice.robot
    limits = *lattice.max_tangents, lattice.max_traction_per_m
    return np.array([lattice.frame.resolution_m, robot.hotel_per_m, robot.regeneration, *limits, 0.0, 0.0, 0.0])


def margin_cells(lattice: CostLattice) -> float:
    """Return how far paths keep from ground that may not be driven.

    `lattice`: with its robot. Result: three standard deviations of the robot's tracking, within `LEAST_MARGIN_CELLS`
    and `MOST_MARGIN_CELLS`; 0 for one that keeps to its path exactly [cells].
    """
    std = lattice.robot.tracking_std_m / lattice.frame.resolution_m
    return min(max(LEAST_MARGIN_CELLS, 3.0 * std), MOST_MARGIN_CELLS) if std > 0.0 else 0.0


class Prices(NamedTuple):
    """What every kernel that prices a leg reads."""

    traction: NDArray[np.float32]  # (rows, cols, K): of the lattice [J/m]
    gradient: NDArray[np.float32]  # (rows, cols, 2): rise per metre towards east and north
    blocked: Closed  # of the lattice
    terms: NDArray[np.float64]  # (9,): see `price_terms`
    turn_j_per_rad: float  # energy of turning on the spot


def exact_prices(lattice: CostLattice) -> Prices:
    """Return the prices of paths that are driven exactly.

    `lattice`: prices and limits. Result: no margin is kept.
    """
    arrays = lattice.traction_per_m, lattice.gradient, lattice.closed, price_terms(lattice)
    return Prices(*arrays, lattice.robot.turn_j_per_rad)


def driven_prices(lattice: CostLattice, cell_j: float, *, penalty: float = MARGIN_PENALTY) -> Prices:
    """Return the prices of paths as the robot will drive them: with an error to the sides, and a margin.

    `lattice`: prices and limits; `cell_j`: energy of a typical cell's length [J]. Result: the last three terms are the
    margin [cells], the weight of a leg that far to either side in the mean, and the penalty of a leg within the margin
    [J per cell].
    """
    prices, margin = exact_prices(lattice), margin_cells(lattice)
    if margin > 0.0:
        std = lattice.robot.tracking_std_m / lattice.frame.resolution_m
        weight = min(0.5 * (std / margin) ** 2, 1.0 / 3.0)  # at most the plain mean of the three legs
        prices.terms[6:] = margin, weight, penalty * cell_j
    return prices


def metres_within_margin(lattice: CostLattice, points: Points) -> float:
    """Return how much of a polyline is nearer to ground that may not be driven than the robot's margin.

    `lattice`: prices and limits; `points` (n, 2): (row, col) polyline. Result: length of the stretches of
    `within_margin` [m].
    """
    return sum(within_margin(lattice, points)) * lattice.frame.resolution_m


def within_margin(lattice: CostLattice, points: Points) -> list[float]:
    """Return the stretches of a polyline that are nearer to ground that may not be driven than the robot's margin.

    `lattice`: prices and limits; `points` (n, 2): (row, col) polyline. Result: their lengths [cells]: of the legs, cut
    to half a cell, those beside or ahead of which a leg at the margin may not be driven.
    """
    margin = margin_cells(lattice)
    if margin == 0.0 or len(points) < 2 or not _closed_beside(lattice, points, margin).any():
        return []
    fine = subdivided(points, 0.5)
    step, closed = np.diff(fine, axis=0), _closed_beside(lattice, fine, margin)
    stretch = np.cumsum(np.diff(closed, prepend=False) & closed)
    return np.bincount(stretch[closed], np.hypot(*step[closed].T))[1:].tolist() if closed.any() else []


def _closed_beside(lattice: CostLattice, points: Points, margin: float) -> NDArray[np.bool_]:
    """Whether ground within a margin [cells] beside or ahead of each leg of a polyline may not be driven, (n - 1,)."""
    step = np.diff(points, axis=0)
    along = margin * step / np.maximum(np.hypot(*step.T), 1e-12)[:, None]
    side = np.column_stack([along[:, 1], -along[:, 0]])
    closed = np.zeros(len(step), dtype=np.bool_)
    for share in np.linspace(-1.0, 1.0, math.ceil(2.0 * margin) + 1):
        ends = points[:-1] + share * side - along, points[1:] + share * side + along
        inside = (np.clip(end, -0.5, np.array(lattice.frame.shape) - 0.5) for end in ends)  # beyond nothing is known
        closed |= np.isnan(leg_prices_between(lattice, *inside))
    return closed


def world_points(lattice: CostLattice, xy: ArrayLike) -> Points:
    """Return world points as places of a lattice.

    `lattice`: whose frame counts; `xy` (n, 2 or more): world x, y [m]; further columns are not used. Result (n, 2):
    fractional (row, col). Raises PointError if a point is not finite, or the array has another shape.
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

    `lattice`: prices and limits; `points` (n, 2): (row, col) polyline. Result (n - 1,): energy [J]; NaN where a leg may
    not be driven.
    """
    return polyline_energies(exact_prices(lattice), np.ascontiguousarray(points, dtype=np.float64))


def leg_prices_between(lattice: CostLattice, starts: Points, ends: Points) -> NDArray[np.float64]:
    """Return the energy of straight legs.

    `lattice`: prices and limits; `starts`, `ends` (n, 2): fractional (row, col). Result (n,): energy [J]; NaN where a
    leg may not be driven.

    The integral of the price hotel + max(t, 0) + regeneration * min(t, 0) along the leg, t the traction at the leg's
    heading, bilinear between cell centres. It is exact, so cutting a leg leaves its energy unchanged.
    """
    legs = np.ascontiguousarray(np.hstack([starts, ends]), dtype=np.float64)
    return leg_energies(exact_prices(lattice), legs)


def path_price(lattice: CostLattice, points: Points) -> float:
    """Return the energy of a polyline with its turns.

    `lattice`: prices and limits; `points` (n, 2): (row, col) polyline. Result: energy [J]; NaN where a leg may not be
    driven.
    """
    return float(path_energy(exact_prices(lattice), np.ascontiguousarray(points, dtype=np.float64)))


def energy_per_m_at(lattice: CostLattice, x: float, y: float, headings_rad: ArrayLike) -> NDArray[np.float64]:
    """Return the price per metre at a world point for any headings.

    `lattice`: prices and limits; `x`, `y`: world point [m]; `headings_rad` (n,): headings [rad, clockwise from north].
    Result (n,): price [J/m]; NaN where that heading is blocked or unknown. Raises PointError if the point is not finite
    or lies outside the map.

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
    return leg_energies(exact_prices(lattice), legs) / (step * lattice.frame.resolution_m)


def interpolation_matrix(headings_rad: ArrayLike, bins: int) -> NDArray[np.float64]:
    """Return the weights that interpolate values at heading bins to any headings.

    `headings_rad` (n,): headings [rad, clockwise from north]; `bins`: number of heading bins K, at least 4. Result (n,
    K): weights; rows sum to 1. Raises InputError if there are fewer than 4 bins.

    Reference: Trigonometric interpolation, see `kernels.heading_weights`.
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

    `points` (n, 2): (row, col) polyline. Result (n - 1,): headings [rad, clockwise from north, 0..2 pi).
    """
    step = np.diff(points, axis=0)
    return heading_of(step[:, 1], -step[:, 0])
