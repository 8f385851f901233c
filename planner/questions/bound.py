"""A proven lower bound of the energy of every route of any angles, from a search over the squares between cell centres.

Proof. Within a square of four centres the traction is bilinear, so a straight piece of heading u costs at least
q(u) = hotel + response(least traction of the four at u) per metre there, response(t) = max(t, regeneration * t) being
monotone. Let w_j be prices per metre of the eight headings of the square's sides and diagonals with

    A w_j + B w_(j+1)  <=  q(u)     for all u = A v_j + B v_(j+1) between two neighbouring unit headings.      (1)

As 1 <= A + B <= 1 / cos(22.5 deg), all w_j may be cos(22.5 deg) times the least q of all headings, or that itself where
it is negative. Each is then raised as far as (1) lets it.

A route is cut where it crosses sides of squares. Let a point of a side stand for its two ends, weighted by its place. A
piece from one side to another then moves weight between corners: between opposite sides along two sides and a diagonal,
between adjacent ones along a diagonal and a side, on one side along it. In each case its displacement is that of the
piece, by the two headings next to it, so by (1) it costs at most what the piece costs. The pieces add up to a unit of
flow over sides and diagonals from start to goal, which costs at least the cheapest path over them. A side takes the
least price of its two squares, and of pieces along the side itself, which touch its two ends alone. A piece inside a
square touches all four corners, so a square with a blocked one has no inside. Places outside the outermost centres are
priced as the nearest place between them, as by `kernels.leg_energy`.

A start or goal elsewhere than at a centre: for a centre v beside the start s, least(v, g) <= price(v, s) + least(s, g).

The least of all headings follows from `SAMPLES` of them: between samples h apart a trigonometric polynomial f falls at
most h^2 / 8 max|f''| below them, and |f''| <= sum of n^2 times the amplitude of its n-th wave.

Prices are counted beyond the rise of a surface, which telescopes along every route: a quadratic spline through the
elevations, as smooth as the slopes that the prices come from, so that little is left that changes within a square. Both
the traction and the spline's slope lie between their coefficients in Bernstein's basis. The bound is still weak where
prices change much from cell to cell, because of every square the least counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import NegativeCycleError, NoRouteError
from joulemap.model.frames import heading_bins, heading_vector
from joulemap.model.threads import pieces, share_out
from joulemap.planner.grid.heuristics import energy_bounds, guide_towards
from joulemap.planner.grid.search import joining_legs
from joulemap.planner.grid.states import new_search, run_search
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.obstacles import MEETS
from joulemap.planner.pricing.integrator import Points, interpolation_matrix
from joulemap.planner.pricing.move_prices import move_offsets
from joulemap.planner.pricing.moves import MoveTable, table_of

FloatArray = NDArray[np.float64]

SAMPLES = 32
"""Headings that are priced, four to the angle between two of the eight."""
_STEP = 2.0 * math.pi / SAMPLES
_ROWS_AT_ONCE = 16
SHARES = (1.0, 0.5, 0.0)
"""Shares of the rise that are tried: the first that leaves no circle of prices below 0."""
_ROUNDING = 2e-6
"""Share by which energies are lowered for rounding to float32."""


@dataclass(frozen=True, eq=False, repr=False)
class BoundTable:
    """Lower bounds of prices beyond the rise of a surface, with a ring of squares around the map.

    Attributes
    ----------
    moves : MoveTable
        Eight moves from every centre, none below 0; cell (0, 0) is one row and column outside the map.
    surface : ndarray of float64, (rows + 2, cols + 2)
        What a rise is counted on [J].
    """

    moves: MoveTable
    surface: NDArray[np.float64]


def bound_table(lattice: CostLattice) -> BoundTable | None:
    """Return the prices that bounds of all questions to a lattice are made of.

    Result: the prices; None where they are so low on descents that a circle would fill the battery, so no bound
    follows.
    """
    for share in SHARES:
        middles = share * _middles(lattice)
        energy = _least_energies(lattice, middles)
        surface = 0.25 * (middles[:-1, :-1] + middles[1:, :-1] + middles[:-1, 1:] + middles[1:, 1:])
        try:
            moves = table_of(energy, move_offsets(8), np.zeros(surface.shape), spacing_m=lattice.frame.resolution_m)
        except NegativeCycleError:
            continue
        return BoundTable(moves, surface)
    return None


def _middles(lattice: CostLattice) -> FloatArray:
    """(rows + 3, cols + 3) [J]: robot weight times elevation in the middle of every square, with two rings around."""
    height = lattice.elevation_m.astype(np.float64)
    unknown = np.isnan(height)
    if unknown.all():
        height = np.zeros_like(height)
    elif unknown.any():
        from scipy.ndimage import distance_transform_edt  # loads slowly, and few maps need it

        nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
        height = height[tuple(nearest)]
    wide = np.pad(height, 2, mode="edge")
    return lattice.robot.weight_n * 0.25 * (wide[:-1, :-1] + wide[1:, :-1] + wide[:-1, 1:] + wide[1:, 1:])


def _least_energies(lattice: CostLattice, middles: FloatArray) -> NDArray[np.float32]:
    """(rows + 2, cols + 2, 8) [J]: energies beyond the rise of the moves from every centre, clockwise from north."""
    rows, cols = (size + 2 for size in lattice.frame.shape)
    square = np.full((rows + 1, cols + 1, 8), np.inf)  # square (i, j) is south-east of centre (i - 1, j - 1)
    share_out(
        lambda of: _price_squares(lattice, middles, of, square[of.start + 1 : of.stop + 1, 1:-1]),
        pieces(rows - 1, _ROWS_AT_ONCE),
    )
    north_west, north_east, south_west, south_east = square[:-1, :-1], square[:-1, 1:], square[1:, :-1], square[1:, 1:]
    energy = np.empty((rows, cols, 8))
    energy[..., ::2] = _along_sides(lattice, middles)
    sides = (north_west, north_east), (north_east, south_east), (south_east, south_west), (south_west, north_west)
    for k, beside in enumerate(sides):
        for of in beside:
            np.minimum(energy[..., 2 * k], of[..., 2 * k], out=energy[..., 2 * k])
    for k, of in zip((1, 3, 5, 7), (north_east, south_east, south_west, north_west), strict=True):
        energy[..., k] = of[..., k] * math.sqrt(2.0)
    energy *= lattice.frame.resolution_m
    energy[np.isinf(energy)] = np.nan
    return (energy - _ROUNDING * np.abs(energy)).astype(np.float32)


def _along_sides(lattice: CostLattice, middles: FloatArray) -> FloatArray:
    """(rows + 2, cols + 2, 4) [J/m]: to the north, east, south and west from every centre; infinite where closed."""
    north, east = (np.abs(lattice.gradient[..., axis]) for axis in (1, 0))
    grade, cross = (limit + 1e-9 for limit in lattice.max_tangents)
    closed = (lattice.blocked != 0) & (lattice.blocked != MEETS)
    closed = np.stack(
        2 * [closed | (north > grade) | (east > cross), closed | (east > grade) | (north > cross)], axis=2
    )
    traction = lattice.traction_per_m @ interpolation_matrix(heading_bins(4), lattice.headings).T
    east, north = np.diff(middles, axis=1), -np.diff(middles, axis=0)
    east, north = 0.5 * (east[:-1] + east[1:]), 0.5 * (north[:, :-1] + north[:, 1:])
    price = np.pad(np.where(closed, np.nan, lattice.robot.price_per_m(traction)), ((1, 1), (1, 1), (0, 0)), mode="edge")
    price -= np.stack([north, east, -north, -east], axis=2) / lattice.frame.resolution_m  # beyond the rise
    found = np.full(price.shape, np.inf)
    for k, (i, j) in enumerate(((-1, 0), (0, 1), (1, 0), (0, -1))):
        begin, end = (
            tuple(slice(max(way * step, 0), min(way * step, 0) or None) for step in (i, j)) for way in (-1, 1)
        )
        least = np.minimum(price[..., k][begin], price[..., k][end])  # NaN where one is closed
        found[..., k][begin] = np.where(np.isnan(least), np.inf, least)
    return found


def _price_squares(lattice: CostLattice, middles: FloatArray, of: slice, out: FloatArray) -> None:
    """Fill w_j [J/m] of the squares between centres of rows of.start to of.stop: (n, m, 8), infinite where closed."""
    (rows, cols), bins, robot = lattice.frame.shape, lattice.headings, lattice.robot
    near = np.ix_(np.clip(np.arange(of.start - 1, of.stop), 0, rows - 1), np.clip(np.arange(-1, cols + 1), 0, cols - 1))
    angle = (order := np.arange(1, bins // 2 + 1))[:, None] * heading_bins(bins)
    size = np.where(2 * order == bins, 1.0, 2.0)[:, None] / bins
    by_heading = lattice.traction_per_m[near].astype(np.float64)
    waves = np.hypot(by_heading @ (size * np.cos(angle)).T, by_heading @ (size * np.sin(angle)).T)
    bend = (waves * order**2).sum(axis=2)
    traction = by_heading @ interpolation_matrix(heading_bins(SAMPLES), bins).T
    to_east, to_north = (lattice.gradient[near][..., axis, None].astype(np.float64) for axis in (0, 1))
    east, north = heading_vector(heading_bins(SAMPLES) + 0.5 * _STEP)
    spare = np.hypot(to_east, to_north) * 0.5 * _STEP + 1e-9
    grade, cross = lattice.max_tangents
    free = (np.abs(to_east * east + to_north * north) <= grade + spare) & np.isin(lattice.blocked[near], (0, MEETS))[
        ..., None
    ]
    free &= np.abs(to_east * north - to_north * east) <= cross + spare
    east, north = heading_vector(heading_bins(SAMPLES))
    rise_east, rise_north = _slopes(middles[of.start : of.stop + 2] / lattice.frame.resolution_m)
    corners = {(i, j): np.s_[i : out.shape[0] + i, j : out.shape[1] + j] for i, j in np.ndindex(2, 2)}
    spent, returned = np.full((2, *out.shape[:2], SAMPLES), np.inf)
    for a, b in np.ndindex(3, 3):
        rise = rise_east[a, b][..., None] * east + rise_north[a, b][..., None] * north
        share = {(i, j): abs(1 - i - 0.5 * a) * abs(1 - j - 0.5 * b) for i, j in corners}
        here = sum(share[at] * traction[corner] for at, corner in corners.items() if share[at] > 0.0)
        np.minimum(spent, here - rise, out=spent)
        np.minimum(returned, robot.regeneration * here - rise, out=returned)
    allowed = np.logical_and.reduce([free[corner] for corner in corners.values()])
    most = np.maximum.reduce([bend[corner] for corner in corners.values()])
    steepest = np.hypot(rise_east, rise_north).max(axis=(0, 1))
    low = np.maximum(*(np.minimum(price, np.roll(price, -1, axis=2)) for price in (spent, returned)))
    dip = (most + steepest) * _STEP**2 / 8.0
    out[:] = _cones(np.where(allowed, robot.hotel_per_m + low - dip[..., None], np.inf))


def _slopes(middles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients of the rise per metre to east and north in Bernstein's basis of degree 2 x 2: (3, 3, n, m) each.

    Of the quadratic spline through the middles of squares, (n + 2, m + 2): the slope in a square lies between its least
    and its greatest coefficient.
    """
    z = np.stack(_thirds(np.stack(_thirds(middles, 0)), 2), axis=1)  # (3, 3, n, m): of the spline itself
    east = np.stack([2.0 * (z[:, 1] - z[:, 0]), z[:, 2] - z[:, 0], 2.0 * (z[:, 2] - z[:, 1])], axis=1)
    north = np.stack([2.0 * (z[0] - z[1]), z[0] - z[2], 2.0 * (z[1] - z[2])])
    return east, north


def _thirds(values: FloatArray, axis: int) -> list[FloatArray]:
    """The means with the value before, the values themselves, and the means with the value after, along an axis."""
    before, here, after = (np.take(values, np.arange(k, values.shape[axis] - 2 + k), axis) for k in range(3))
    return [0.5 * (before + here), here, 0.5 * (here + after)]


def _cones(least: FloatArray) -> FloatArray:
    """(n, m, 8): the w_j that are the largest one after the other with (1), from the least prices between samples."""
    per = SAMPLES // 8
    shares = [np.sin((0.25 * math.pi - s * _STEP, s * _STEP)) / math.sin(0.25 * math.pi) for s in range(per + 1)]
    lowest = least.min(axis=2)
    w = np.repeat(np.where(lowest > 0.0, math.cos(math.pi / 8.0) * lowest, lowest)[..., None], 8, axis=2)
    with np.errstate(invalid="ignore"):  # where all headings beside one are closed
        for j in range(8):
            most = np.full(lowest.shape, np.inf)
            for s, end in np.ndindex(per, 2):
                for first, other, own, rest in ((j, j + 1, *shares[s + end]), (j - 1, j - 1, *shares[s + end][::-1])):
                    if own > 1e-6:
                        most = np.fmin(most, (least[..., per * (first % 8) + s] - rest * w[..., other % 8]) / own)
            w[..., j] = np.maximum(w[..., j], most)
        return np.where(np.isinf(w), w, w - np.abs(w) * _STEP**2 / 4.0)  # within an interval A + B is a little more


def quick_bound(lattice: CostLattice, start: Points, goal: Points) -> float:
    """Return a lower bound that takes no time: the idle power over the straight distance.

    `start`, `goal` (2,): fractional (row, col). Result: energy [J]; minus infinity where descents may return energy.
    """
    robot = lattice.robot
    if robot.regeneration > 0.0:
        return -math.inf
    return robot.hotel_per_m * math.dist(start, goal) * lattice.frame.resolution_m


def energy_bound(lattice: CostLattice, table: BoundTable, start: Points, goal: Points) -> float:
    """Return a lower bound of the energy of every route between two places, whatever its angles; turns count nothing.

    `start`, `goal` (2,): fractional (row, col). Result: energy [J]; minus infinity where nothing is known.
    """
    ends, before = [], 0.0
    for point, outward in ((start, False), (goal, True)):
        cells, energy = joining_legs(lattice, point, outward=outward)
        if not np.isfinite(energy).any():
            return -math.inf
        best = int(np.nanargmin(energy))
        before += float(energy[best])
        ends.append(cells[best])
    moves = table.moves
    cols = moves.energy.shape[1]
    first, last = (np.array([(row + 1) * cols + col + 1]) for row, col in ends)
    guide = guide_towards(moves, energy_bounds(moves), ends[1] + 1.0, last, np.zeros(1), lattice.frame.resolution_m)
    search = new_search(moves, 1, first, np.zeros((1, 1)), backward=False)
    found, total, _ = run_search(search, moves, first, guide, last, np.zeros((1, 1)))
    if found < 0:
        raise NoRouteError("no route: the bound's search does not reach the goal", reached=0)
    rise = table.surface.ravel()[last[0]] - table.surface.ravel()[first[0]]
    return float(total) + float(rise) - before
