"""The prices of the grid moves of a lattice or a window of it, those of `edges`, in compiled loops over whole rows."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.frames import heading_of, heading_vector
from joulemap.model.threads import share_out
from joulemap.planner.lattice import CostLattice
from joulemap.planner.lattice.obstacles import MEETS, close_moves
from joulemap.planner.pricing.integrator import interpolation_matrix
from joulemap.planner.pricing.kernels import mean_response
from joulemap.planner.pricing.potential import parts_of

NEIGHBOURS = (8, 16, 32)


def check_neighbours(neighbours: int) -> None:
    """Check a number of moves per cell."""
    if neighbours not in NEIGHBOURS:
        raise InputError(f"neighbours must be 8, 16 or 32, got {neighbours}", neighbours=neighbours)


def move_offsets(neighbours: int) -> NDArray[np.int64]:
    """Return the shortest moves of different heading. Result (N, 2): (drow, dcol), clockwise from north."""
    check_neighbours(neighbours)
    reach = {8: 1, 16: 2, 32: 3}[neighbours]
    steps = [(r, c) for r in range(-reach, reach + 1) for c in range(-reach, reach + 1) if math.gcd(r, c) == 1]
    steps.sort(key=lambda s: float(heading_of(s[1], -s[0])))
    return np.array(steps, dtype=np.int64)


class MovePrices:
    """Prices the moves of windows of one lattice. `offsets` (N, 2): (drow, dcol) of each move, clockwise from north."""

    def __init__(self, bins: int, neighbours: int = 16) -> None:
        self.offsets = move_offsets(neighbours)
        self.reach = int(np.abs(self.offsets).max())
        headings = heading_of(self.offsets[:, 1], -self.offsets[:, 0])
        self._east, self._north = (part.astype(np.float32) for part in heading_vector(headings))
        self._matrix = interpolation_matrix(headings, bins).astype(np.float32)  # (N, K)
        self._matrix[np.abs(self._matrix) < 1e-6] = 0.0  # rounding, at headings that are a bin
        pieces = [_pieces(0.0, 0.0, float(r), float(c)) for r, c in self.offsets]
        self._stencils = _stack_stencils(pieces)
        self._pieces = _stack_pieces(pieces)

    def lengths_m(self, spacing_m: float) -> NDArray[np.float64]:
        """Return the length of each move. Result (N,): horizontal lengths [m]."""
        return np.hypot(self.offsets[:, 0], self.offsets[:, 1]) * spacing_m

    def energies(self, part: CostLattice) -> NDArray[np.float32]:
        """Return the energy of each move of a window.

        Result (N, rows, cols): energy of the move that leaves a cell [J]; NaN where it may not be driven, or leaves the
        window.
        """
        return self._priced(part, part.traction_per_m, self._matrix, part.robot.hotel_per_m)

    def by_cell(self, lattice: CostLattice) -> NDArray[np.float32]:
        """Return the energies of the moves of a lattice, those of a cell side by side; rows are shared out to threads.

        Result (rows, cols, N): energy of the move that leaves a cell [J]; NaN where it may not be driven, or leaves the
        lattice.
        """
        rows, cols = lattice.frame.shape
        out = np.empty((rows, cols, len(self.offsets)), np.float32)

        def _fill(part: slice) -> None:
            top = max(part.start - self.reach, 0)
            planes = self.energies(lattice.window(top, min(part.stop + self.reach, rows)))
            _by_cell(planes, part.start - top, out[part])

        share_out(_fill, parts_of(rows, cols))
        return out

    def _priced(
        self, part: CostLattice, traction: NDArray[np.float32], matrix: NDArray[np.float32], hotel_per_m: float
    ) -> NDArray[np.float32]:
        grade, cross = part.max_tangents
        energy = _energies(
            _at_moves(
                traction,
                part.gradient,
                part.blocked,
                matrix,
                self._east,
                self._north,
                grade,
                cross,
                np.float32(part.max_traction_per_m),
            ),
            self.offsets,
            self.lengths_m(part.frame.resolution_m),
            hotel_per_m,
            part.robot.regeneration,
            *self._stencils,
            *self._pieces,
        )
        if part.obstacles is not None:
            close_moves(part.closed, self.offsets, energy)
        return energy


@njit(cache=True, nogil=True)
def _at_moves(traction, gradient, blocked, matrix, east, north, max_grade, max_cross, max_traction):
    """(N, rows, cols) float32 [J/m]: the traction at the headings of the moves; NaN where that may not be driven."""
    rows, cols, bins = traction.shape
    moves = matrix.shape[0]
    out = np.zeros((moves, rows, cols), dtype=np.float32)
    by_bin = np.empty((bins, cols), dtype=np.float32)
    steep_east, steep_north = np.empty(cols, dtype=np.float32), np.empty(cols, dtype=np.float32)
    for i in range(rows):
        for j in range(cols):
            for k in range(bins):
                by_bin[k, j] = traction[i, j, k]
            free = blocked[i, j] == 0 or blocked[i, j] == MEETS
            steep_east[j] = gradient[i, j, 0] if free else np.nan
            steep_north[j] = gradient[i, j, 1] if free else np.nan
        for n in range(moves):
            row = out[n, i]
            for k in range(bins):
                weight = matrix[n, k]
                if weight != 0.0:
                    of = by_bin[k]
                    for j in range(cols):
                        row[j] += weight * of[j]
            for j in range(cols):
                along = steep_east[j] * east[n] + steep_north[j] * north[n]
                across = steep_east[j] * north[n] - steep_north[j] * east[n]
                if not (abs(along) <= max_grade and abs(across) <= max_cross and row[j] <= max_traction):
                    row[j] = np.nan
    return out


@njit(cache=True, nogil=True)
def _energies(traction, offsets, length_m, hotel, regeneration, cells, share, part, corner, blend):
    """(N, rows, cols) float32 [J]; traction : (N, rows, cols), NaN where that heading may not be driven."""
    moves, rows, cols = traction.shape
    energy = np.full((moves, rows, cols), np.nan, dtype=np.float32)
    mean, least = np.empty(cols, dtype=np.float32), np.empty(cols, dtype=np.float32)
    for n in range(moves):
        down, right = offsets[n, 0], offsets[n, 1]
        col0, col1 = max(0, -right), min(cols, cols - right)
        for i in range(max(0, -down), min(rows, rows - down)):
            mean[:] = np.float32(0.0)
            least[:] = np.float32(0.0)
            for s in range(cells.shape[1]):
                if share[n, s] < 0.0:
                    break
                of = traction[n, i + cells[n, s, 0], col0 + cells[n, s, 1] : col1 + cells[n, s, 1]]
                _add(mean, least, np.float32(share[n, s]), of)
            out = energy[n, i, col0:col1]
            for j in range(out.size):
                out[j] = (hotel + mean[j]) * length_m[n]
            for j in range(out.size):
                if least[j] < np.float32(0.0) and not math.isnan(mean[j]):
                    response = _response(traction, n, i, j + col0, part, corner, blend, regeneration)
                    out[j] = (hotel + response) * length_m[n]
    return energy


@njit(cache=True, nogil=True)
def _add(mean, least, weight, values):
    """Add weighted values to `mean` and take the lesser ones into `least`; in this form as vector operations."""
    for j in range(values.size):
        value, low = values[j], least[j]
        mean[j] += weight * value
        if value < low:
            low = value
        least[j] = low


@njit(cache=True, nogil=True)
def _by_cell(planes, first, out):
    """Fill (rows, cols, N) with rows of (N, rows, cols), from row `first` of the planes on."""
    rows, cols, moves = out.shape
    for i in range(rows):
        for j in range(cols):
            for n in range(moves):
                out[i, j, n] = planes[n, first + i, j]


@njit(cache=True)
def _response(traction, n, i, j, part, corner, blend, regeneration):
    """Mean price of motion along move n from a cell, of which the traction is negative somewhere."""
    mean = 0.0
    for p in range(part.shape[1]):
        if part[n, p] <= 0.0:
            break
        t0 = tm = t1 = 0.0
        for q in range(4):
            t = traction[n, i + corner[n, p, q, 0], j + corner[n, p, q, 1]]
            t0 += blend[n, p, 0, q] * t
            tm += blend[n, p, 1, q] * t
            t1 += blend[n, p, 2, q] * t
        mean += part[n, p] * mean_response(t0, tm, t1, regeneration)
    return mean


def _pieces(
    row: float, col: float, drow: float, dcol: float
) -> list[tuple[float, NDArray[np.int64], NDArray[np.float64]]]:
    """A leg from (row, col), cut where it crosses lines of cell centres.

    Each piece: its share of the leg, its four cells (4, 2), and their bilinear weights at start, middle, end (3, 4).
    """
    cuts = {0.0, 1.0}
    for at, span in ((row, drow), (col, dcol)):
        first, last = sorted((at, at + span))
        cuts |= {(line - at) / span for line in range(math.floor(first) + 1, math.ceil(last))}
    edges = sorted(cuts)
    out = []
    for t0, t1 in zip(edges[:-1], edges[1:], strict=True):
        middle = 0.5 * (t0 + t1)
        i, j = math.floor(row + middle * drow), math.floor(col + middle * dcol)
        cells = np.array([(i, j), (i, j + 1), (i + 1, j), (i + 1, j + 1)], dtype=np.int64)
        blend = np.empty((3, 4))
        for k, t in enumerate((t0, middle, t1)):
            u, v = row + t * drow - i, col + t * dcol - j
            blend[k] = (1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v
        out.append((t1 - t0, cells, blend))
    return out


def leg_stencils(legs: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the cells that straight legs touch, and what each of them adds to the mean traction.

    `legs` (n, 4): row, col of the start, and the step to the end [cells]. Returns `cells` (n, S, 2): (row, col) of each
    cell; `shares` (n, S): its share of the mean of the traction along the leg, -1 where a leg touches fewer cells.
    """
    return _stack_stencils([_pieces(*leg) for leg in legs.tolist()])


def _stack_stencils(pieces):
    """Per leg, the cells it touches (N, S, 2) and their shares of the mean traction (N, S); padded with share -1."""
    stencils = []
    for leg in pieces:
        total: dict[tuple[int, int], float] = {}
        for share, cells, blend in leg:
            simpson = share * (blend[0] + 4.0 * blend[1] + blend[2]) / 6.0
            for cell, weight, touched in zip(cells.tolist(), simpson, blend.max(axis=0), strict=True):
                if touched > 1e-9:
                    total[tuple(cell)] = total.get(tuple(cell), 0.0) + weight
        stencils.append(total)
    width = max(len(s) for s in stencils)
    cells = np.zeros((len(stencils), width, 2), dtype=np.int64)
    shares = np.full((len(stencils), width), -1.0)
    for n, stencil in enumerate(stencils):
        for k, (cell, share) in enumerate(stencil.items()):
            cells[n, k] = cell
            shares[n, k] = share
    return cells, shares


def _stack_pieces(pieces):
    """Per move and piece: its part of the move, its four cells, and their weights at its start, middle and end.

    A cell that the piece does not touch is replaced by one that it does, with weight 0; part 0 where there is no piece.
    """
    size = len(pieces), max(len(move) for move in pieces)
    part, corner, blend = np.zeros(size), np.zeros((*size, 4, 2), dtype=np.int64), np.zeros((*size, 3, 4))
    for n, move in enumerate(pieces):
        for k, (share, cells, weights) in enumerate(move):
            touched = weights.max(axis=0) > 1e-9
            part[n, k], blend[n, k] = share, weights * touched
            corner[n, k] = np.where(touched[:, None], cells, cells[touched][0])
    return part, corner, blend
