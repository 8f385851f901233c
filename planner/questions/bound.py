"""A proven lower bound of the energy of every route of any angles, from a search over the squares between cell centres.

Proof. Within a square of four centres the traction is bilinear, so a straight piece of heading u costs at least
q(u) = hotel + response(least traction of the four at u) per metre there, response(t) = max(t, regeneration * t) being
monotone. Let w_j be prices per metre of the eight headings of the square's sides and diagonals with

    A w_j + B w_(j+1)  <=  q(u)     for all u = A v_j + B v_(j+1) between two neighbouring unit headings.      (1)

A route is cut where it crosses sides of squares. Let a point of a side stand for its two ends, weighted by its place. A
piece from one side to another then moves weight between corners: between opposite sides along two sides and a diagonal,
between adjacent ones along a diagonal and a side, on one side along it. In each case its displacement is that of the
piece, by the two headings next to it, so by (1) it costs at most what the piece costs. The pieces add up to a unit of
flow over sides and diagonals from start to goal, which costs at least the cheapest path over them. A side takes the
least price of its two squares, and of pieces along the side itself, which touch its two ends alone. A piece inside a
square touches all four corners, so a square with a blocked one has no inside. Places outside the outermost centres are
priced as the nearest place between them, as by `kernels.leg_energy`.

A start or goal elsewhere than at a centre: for a centre v beside the start s, least(v, g) <= price(v, s) + least(s, g).

(1) is proven for all headings from `SAMPLES` of them: between samples h apart a trigonometric polynomial f falls at
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
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import NegativeCycleError, NoRouteError
from joulemap.model.frames import heading_bins
from joulemap.model.threads import pieces, share_out
from joulemap.planner.grid.heuristics import energy_bounds, guide_towards
from joulemap.planner.grid.search import joining_legs
from joulemap.planner.grid.states import new_search, run_search
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.obstacles import MEETS
from joulemap.planner.pricing.integrator import Points, interpolation_matrix, price_terms
from joulemap.planner.pricing.move_prices import move_offsets
from joulemap.planner.pricing.moves import MoveTable, table_of

SAMPLES = 32
"""Headings at which (1) is checked, four to a cone."""
_STEP = 2.0 * math.pi / SAMPLES
_ROWS_AT_ONCE = 64
SHARES = (1.0, 0.5, 0.0)
"""Shares of the rise that are tried: the first that leaves no circle of prices below 0."""
_ROUNDING = 2e-6
"""Share by which prices are lowered for rounding to float32."""


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
    bins = lattice.headings
    samples = interpolation_matrix(heading_bins(SAMPLES), bins)
    order = np.arange(1, bins // 2 + 1)
    angle = order[:, None] * heading_bins(bins)[None, :]
    size = np.where(2 * order == bins, 1.0, 2.0)[:, None] / bins
    waves = np.vstack([size * np.cos(angle), size * np.sin(angle)])
    matrix = np.vstack([samples, waves]).astype(np.float32)  # (SAMPLES + 2 orders, K)
    for share in SHARES:
        middles = share * _middles(lattice)
        energy = _least_energies(lattice, matrix, middles)
        surface = 0.25 * (middles[:-1, :-1] + middles[1:, :-1] + middles[:-1, 1:] + middles[1:, 1:])
        try:
            moves = table_of(energy, move_offsets(8), np.zeros(surface.shape), spacing_m=lattice.frame.resolution_m)
        except NegativeCycleError:
            continue
        return BoundTable(moves, surface)
    return None


def _middles(lattice: CostLattice) -> NDArray[np.float64]:
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


def _least_energies(
    lattice: CostLattice, matrix: NDArray[np.float32], middles: NDArray[np.float64]
) -> NDArray[np.float32]:
    """(rows + 2, cols + 2, 8) [J]: energies beyond the rise."""
    rows, cols = lattice.frame.shape
    bins = lattice.headings
    square = np.empty((rows + 1, cols + 1, 8), dtype=np.float32)
    along = np.full((rows + 2, cols + 2, 4), np.nan, dtype=np.float32)
    col = np.clip(np.arange(-1, cols + 1), 0, cols - 1)

    def _part(of: slice) -> None:
        row = np.clip(np.arange(of.start - 1, of.stop), 0, rows - 1)
        near = np.ix_(row, col)
        traction = lattice.traction_per_m[near].reshape(-1, bins) @ matrix.T
        _bound_squares(
            traction.reshape(row.size, col.size, -1),
            lattice.gradient[near],
            lattice.blocked[near],
            middles[of.start : of.stop + 2] / lattice.frame.resolution_m,
            price_terms(lattice),
            square[of.start : of.stop],
            along[of.start : of.stop + 1],
            of.stop == rows + 1,
        )

    share_out(_part, pieces(rows + 1, _ROWS_AT_ONCE))
    return _moves_of(square, along, lattice.frame.resolution_m)


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


def _moves_of(square: NDArray[np.float32], along: NDArray[np.float32], spacing_m: float) -> NDArray[np.float32]:
    """(rows + 2, cols + 2, 8) float32 [J]: the moves from every centre, clockwise from north."""
    rows, cols = along.shape[:2]
    around = np.full(
        (rows + 1, cols + 1, 8), np.nan, dtype=np.float32
    )  # square (i, j) is south-east of centre (i-1, j-1)
    around[1:-1, 1:-1] = square
    north_west, north_east = around[:-1, :-1], around[:-1, 1:]
    south_west, south_east = around[1:, :-1], around[1:, 1:]
    energy = np.empty((rows, cols, 8), dtype=np.float32)
    sides = (
        (0, north_west, north_east),
        (2, north_east, south_east),
        (4, south_east, south_west),
        (6, south_west, north_west),
    )
    for k, one, other in sides:
        energy[..., k] = np.fmin(np.fmin(one[..., k], other[..., k]), along[..., k // 2])
    for k, one in ((1, north_east), (3, south_east), (5, south_west), (7, north_west)):
        energy[..., k] = one[..., k] * np.float32(math.sqrt(2.0))
    energy *= np.float32(spacing_m)
    energy -= np.float32(_ROUNDING) * np.abs(energy)
    return energy


@njit(cache=True, nogil=True)
def _bound_squares(traction, gradient, blocked, middles, terms, square, along, last):
    """Fill w_j [J/m] of the squares between some rows of centres, NaN where there is none, and of their sides.

    traction : (n + 1, m + 1, SAMPLES + 2 orders) at the samples, then the amplitudes of all waves; square : (n, m, 8);
    along : (n + 1, m + 1, 4) from a centre to the north, east, south and west. Of the last row of centres the sides to
    the east and west are filled where `last`: else they belong to the next part.
    """
    hotel, regeneration = terms[1], terms[2]
    rows, nodes = blocked.shape
    orders = (traction.shape[2] - SAMPLES) // 2
    bits = np.zeros((rows, nodes), dtype=np.uint64)
    dips = np.zeros((rows, nodes))
    east, north = np.empty(SAMPLES), np.empty(SAMPLES)
    for s in range(SAMPLES):
        east[s], north[s] = math.sin((s + 0.5) * _STEP), math.cos((s + 0.5) * _STEP)
    for i in range(rows):
        for j in range(nodes):
            if blocked[i, j] != 0 and blocked[i, j] != MEETS:
                continue
            bend = 0.0
            for n in range(orders):
                a, b = traction[i, j, SAMPLES + n], traction[i, j, SAMPLES + orders + n]
                bend += (n + 1.0) ** 2 * math.sqrt(a * a + b * b)
            dips[i, j] = bend * _STEP * _STEP / 8.0 + 1e-6 * bend
            u, v = np.float64(gradient[i, j, 0]), np.float64(gradient[i, j, 1])
            spare = math.sqrt(u * u + v * v) * 0.5 * _STEP + 1e-9
            allowed = np.uint64(0)
            for s in range(SAMPLES):
                steep = abs(u * east[s] + v * north[s]) > terms[3] + spare
                tilted = abs(u * north[s] - v * east[s]) > terms[4] + spare
                if not steep and not tilted:
                    allowed |= np.uint64(1) << np.uint64(s)
            bits[i, j] = allowed
    shares = np.empty((SAMPLES // 8 + 1, 2))
    for s in range(SAMPLES // 8 + 1):
        shares[s, 0] = math.sin(0.25 * math.pi - s * _STEP) / math.sin(0.25 * math.pi)
        shares[s, 1] = math.sin(s * _STEP) / math.sin(0.25 * math.pi)
    directions = np.empty((SAMPLES + 1, 2))
    for s in range(SAMPLES + 1):
        directions[s, 0], directions[s, 1] = math.sin(s * _STEP), math.cos(s * _STEP)
    q, w, low = np.empty(SAMPLES), np.empty(8), np.empty((SAMPLES, 2))
    rise, coefficient = np.empty((9, 2)), np.empty(9)
    for i in range(rows):
        for j in range(nodes):
            for step in range(2):  # to the east, and to the south
                r, c = i + step, j + 1 - step
                if r >= rows or c >= nodes or (step == 0 and i == rows - 1 and not last):
                    continue
                for way in range(2):
                    n = 2 * step + 2 + 4 * way
                    n = n if n < 8 else n - 8
                    s = SAMPLES // 8 * n
                    near = (np.uint64(1) << np.uint64(s)) | (np.uint64(1) << np.uint64(s - 1 if s > 0 else SAMPLES - 1))
                    if bits[i, j] & bits[r, c] & near == 0:
                        continue
                    price = np.inf
                    for end in range(2):
                        y, x = (i, j) if end == 0 else (r, c)
                        # rise per metre of the surface at a centre, towards the side's other end
                        to_col = 0.5 * (middles[y, x + 1] - middles[y, x] + middles[y + 1, x + 1] - middles[y + 1, x])
                        to_row = 0.5 * (middles[y + 1, x] - middles[y, x] + middles[y + 1, x + 1] - middles[y, x + 1])
                        ahead = (to_col if step == 0 else to_row) * (1.0 - 2.0 * way)
                        least = traction[y, x, s] - dips[y, x]
                        price = min(price, hotel + max(least, regeneration * least) - ahead)
                    if way == 0:
                        along[i, j, n // 2] = price
                    else:
                        along[r, c, n // 2] = price
    for i in range(rows - 1):
        for j in range(nodes - 1):
            square[i, j] = np.nan
            allowed = bits[i, j] & bits[i, j + 1] & bits[i + 1, j] & bits[i + 1, j + 1]
            if allowed == 0:
                continue
            dip = max(max(dips[i, j], dips[i, j + 1]), max(dips[i + 1, j], dips[i + 1, j + 1]))
            _slopes(middles[i : i + 3, j : j + 3], rise)
            steepest = 0.0
            for k in range(9):
                steepest = max(steepest, rise[k, 0] * rise[k, 0] + rise[k, 1] * rise[k, 1])
            dip += math.sqrt(steepest) * _STEP * _STEP / 8.0
            for s in range(SAMPLES):
                a, b = traction[i, j, s], traction[i, j + 1, s]
                c, d = traction[i + 1, j, s], traction[i + 1, j + 1, s]
                coefficient[0], coefficient[2], coefficient[6], coefficient[8] = a, b, c, d
                coefficient[1], coefficient[3], coefficient[5], coefficient[7] = a + b, a + c, b + d, c + d
                for k in range(1, 8, 2):
                    coefficient[k] *= 0.5
                coefficient[4] = 0.25 * (a + b + c + d)
                low[s, 0], low[s, 1] = np.inf, np.inf
                for k in range(9):
                    fall = rise[k, 0] * directions[s, 0] + rise[k, 1] * directions[s, 1]
                    low[s, 0] = min(low[s, 0], coefficient[k] - fall)
                    low[s, 1] = min(low[s, 1], regeneration * coefficient[k] - fall)
            for s in range(SAMPLES):
                after = s + 1 if s + 1 < SAMPLES else 0
                least = max(min(low[s, 0], low[after, 0]), min(low[s, 1], low[after, 1])) - dip
                free = (allowed >> np.uint64(s)) & np.uint64(1)
                q[s] = hotel + least if free else np.inf
            _cones(q, w, shares)
            for k in range(8):
                square[i, j, k] = w[k] - abs(w[k]) * _STEP * _STEP / 4.0 if w[k] < np.inf else np.nan


@njit(cache=True, nogil=True)
def _slopes(middles, rise):
    """Fill the rise per metre to east and north of the quadratic spline through the middles of 3 x 3 squares.

    rise : (9, 2), the coefficients of the slope in the middle square in Bernstein's basis of degree 2 x 2, row by row:
    the slope lies between the least and the greatest of them.
    """
    z = np.empty((3, 3))
    half = np.empty((3, 3))
    for b in range(3):
        half[0, b] = 0.5 * (middles[0, b] + middles[1, b])
        half[1, b] = middles[1, b]
        half[2, b] = 0.5 * (middles[1, b] + middles[2, b])
    for a in range(3):
        z[a, 0] = 0.5 * (half[a, 0] + half[a, 1])
        z[a, 1] = half[a, 1]
        z[a, 2] = 0.5 * (half[a, 1] + half[a, 2])
    for a in range(3):
        rise[3 * a, 0] = 2.0 * (z[a, 1] - z[a, 0])
        rise[3 * a + 2, 0] = 2.0 * (z[a, 2] - z[a, 1])
        rise[3 * a + 1, 0] = 0.5 * (rise[3 * a, 0] + rise[3 * a + 2, 0])
    for b in range(3):
        rise[b, 1] = -2.0 * (z[1, b] - z[0, b])
        rise[6 + b, 1] = -2.0 * (z[2, b] - z[1, b])
        rise[3 + b, 1] = 0.5 * (rise[b, 1] + rise[6 + b, 1])


@njit(cache=True, nogil=True)
def _cones(q, w, shares):
    """Fill eight w_j with (1) from the least prices q of the intervals of headings."""
    per = SAMPLES // 8
    least = q.min()
    w[:] = least * (math.cos(0.125 * math.pi) if least > 0.0 else 1.0)
    for j in range(8):
        most = np.inf
        before, after = j - 1 if j > 0 else 7, j + 1 if j < 7 else 0
        for s in range(per):
            for end in range(2):
                a, b = shares[s + end, 0], shares[s + end, 1]
                price = q[per * j + s]
                if price < np.inf and a > 1e-6 and w[after] < np.inf:
                    most = min(most, (price - b * w[after]) / a)
                price = q[per * before + s]
                if price < np.inf and b > 1e-6 and w[before] < np.inf:
                    most = min(most, (price - a * w[before]) / b)
        w[j] = max(w[j], most)
