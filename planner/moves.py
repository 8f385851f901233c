"""The price of every grid move: 8, 16 or 32 neighbours of every cell, priced as by `edges`, all at once."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.frames import heading_of, heading_vector, wrap_angle
from joulemap.model.threads import share_out
from joulemap.planner.edges import interpolation_matrix, price_terms
from joulemap.planner.kernels import mean_response
from joulemap.planner.lattice import CostLattice
from joulemap.planner.potential import ROUNDING_J, even_surface, parts_of, spare_per_m

NEIGHBOURS = (8, 16, 32)
RISE_SHARES = np.array([0.0, 0.5, 1.0])
"""Shares of the surface's rise that `MoveTable.bound_per_m` is known for."""


@dataclass(frozen=True, eq=False, repr=False)
class MoveTable:
    """Energies of all grid moves of a lattice.

    Attributes
    ----------
    offsets : ndarray of int64, (N, 2)
        (drow, dcol) of each move, clockwise from north.
    heading_rad, length_m : ndarray of float64, (N,)
        Heading [rad, clockwise from north] and length [m] of each move.
    energy : ndarray of float32, (rows, cols, N)
        Energy of the move that leaves a cell [J]; NaN where it may not be driven.
    turn_j : ndarray of float64, (N, N)
        Energy of turning from one move's heading (row) to another's (column) [J].
    surface : ndarray of float64, (rows, cols)
        What a rise is counted on [J]: weight times elevation, smoothed (see `potential`).
    rise_share : ndarray of float64, (B,)
        Shares s of the rise, ascending from 0.
    bound_per_m : ndarray of float64, (B,)
        The largest a [J/m] with energy >= a * length + s * rise for every move of the map (up positive). The heuristics
        and the potential for negative prices are made of it.
    """

    offsets: NDArray[np.int64]
    heading_rad: NDArray[np.float64]
    length_m: NDArray[np.float64]
    energy: NDArray[np.float32]
    turn_j: NDArray[np.float64]
    surface: NDArray[np.float64]
    rise_share: NDArray[np.float64]
    bound_per_m: NDArray[np.float64]

    @property
    def jump(self) -> NDArray[np.int64]:
        """Step of every move in flat cell indices: int64, (N,)."""
        return self.offsets @ np.array([self.energy.shape[1], 1], dtype=np.int64)

    @property
    def reach(self) -> int:
        """Rows or columns that the longest move spans."""
        return int(np.abs(self.offsets).max())

    @property
    def gap_j(self) -> NDArray[np.float64]:
        """Energy of turning from each move's heading to the next one's, clockwise: (N,) [J]."""
        return np.append(np.diagonal(self.turn_j, 1), self.turn_j[-1, 0])

    @cached_property
    def typical_j(self) -> float:
        """Mean size of a price [J], from a sample of the map; 1 where there is none."""
        sample = np.abs(self.energy[::7, ::7])
        return float(np.nanmean(sample)) or 1.0 if np.isfinite(sample).any() else 1.0

    @property
    def never_pays(self) -> bool:
        """Whether every price is known to be at least 0."""
        return bool(self.bound_per_m[0] >= 0.0)


def distance_table(table: MoveTable) -> MoveTable:
    """Return the same moves at 1 J per metre, without climbs and turns: its cheapest paths are the shortest.

    Parameters
    ----------
    table : MoveTable
        Priced moves.

    Returns
    -------
    MoveTable
        The table of distances.
    """
    length = np.where(np.isnan(table.energy), np.float32(np.nan), table.length_m.astype(np.float32))
    flat = np.zeros(1)
    return replace(table, energy=length, turn_j=np.zeros_like(table.turn_j), rise_share=flat, bound_per_m=flat + 1.0)


def move_offsets(neighbours: int) -> NDArray[np.int64]:
    """Return the shortest moves of different heading.

    Parameters
    ----------
    neighbours : {8, 16, 32}
        Number of moves N.

    Returns
    -------
    ndarray of int64, (N, 2)
        (drow, dcol), clockwise from north.

    Raises
    ------
    InputError
        If `neighbours` is another number.
    """
    if neighbours not in NEIGHBOURS:
        raise InputError(f"neighbours must be 8, 16 or 32, got {neighbours}", neighbours=neighbours)
    reach = {8: 1, 16: 2, 32: 3}[neighbours]
    steps = [(r, c) for r in range(-reach, reach + 1) for c in range(-reach, reach + 1) if math.gcd(r, c) == 1]
    steps.sort(key=lambda s: float(heading_of(s[1], -s[0])))
    return np.array(steps, dtype=np.int64)


def move_table(lattice: CostLattice, *, neighbours: int = 16) -> MoveTable:
    """Price all grid moves of a lattice.

    Parameters
    ----------
    lattice : CostLattice
        Prices and limits.
    neighbours : {16, 8, 32}
        Moves per cell N.

    Returns
    -------
    MoveTable
        The priced moves.

    Raises
    ------
    InputError
        If `neighbours` is another number.
    NegativeCycleError
        If driving in a circle would fill the battery.

    Notes
    -----
    O(rows * cols * N) time, two compiled passes.
    """
    offsets = move_offsets(neighbours)
    headings = heading_of(offsets[:, 1], -offsets[:, 0])
    length_m = np.hypot(offsets[:, 0], offsets[:, 1]) * lattice.frame.resolution_m
    energy = _priced(lattice, offsets, headings, length_m)
    lifted = lattice.robot.weight_n * np.nan_to_num(lattice.elevation_m.astype(np.float64))
    return table_of(
        energy, offsets, lifted, spacing_m=lattice.frame.resolution_m, turn_j_per_rad=lattice.robot.turn_j_per_rad
    )


def table_of(
    energy: NDArray[np.float32],
    offsets: NDArray[np.int64],
    lifted: NDArray[np.float64],
    *,
    spacing_m: float,
    turn_j_per_rad: float = 0.0,
) -> MoveTable:
    """Return the table of moves that are priced already.

    Parameters
    ----------
    energy : ndarray of float32, (rows, cols, N)
        Energy of the move that leaves a cell [J]; NaN where it may not be driven.
    offsets : ndarray of int64, (N, 2)
        (drow, dcol) of each move, clockwise from north.
    lifted : ndarray of float64, (rows, cols)
        Robot weight times elevation [J].
    spacing_m : float
        Side of a cell [m].
    turn_j_per_rad : float, default 0.0
        Energy of turning [J/rad].

    Returns
    -------
    MoveTable
        The moves, with the surface and the bounds that searches need.

    Raises
    ------
    NegativeCycleError
        If driving in a circle would fill the battery.
    """
    headings = heading_of(offsets[:, 1], -offsets[:, 0])
    length_m = np.hypot(offsets[:, 0], offsets[:, 1]) * spacing_m
    turn = turn_j_per_rad * np.abs(wrap_angle(headings[None, :] - headings[:, None]))
    surface = even_surface(energy, offsets, length_m, lifted)
    bounds = _bounds(energy, offsets, length_m, surface, RISE_SHARES)
    return MoveTable(offsets, headings, length_m, energy, turn, surface, RISE_SHARES, bounds)


def repriced(table: MoveTable, lattice: CostLattice, window: tuple[int, int, int, int]) -> MoveTable:
    """Return the moves of a lattice that differs in one window only from the one that a table was made of.

    Parameters
    ----------
    table : MoveTable
        Moves of the lattice before; prices are written into its `energy`.
    lattice : CostLattice
        The lattice now.
    window : tuple of int
        (row0, row1, col0, col1) that holds every changed cell.

    Returns
    -------
    MoveTable
        The moves now. The surface stays and the bounds hold for both lattices; where the prices need another surface,
        everything is priced again.

    Raises
    ------
    NegativeCycleError
        If driving in a circle would fill the battery now.
    """
    row0, row1, col0, col1 = window
    rows, cols = lattice.frame.shape
    reach = table.reach
    inner = slice(max(row0 - reach, 0), row1 + reach), slice(max(col0 - reach, 0), col1 + reach)
    top, left = max(row0 - 2 * reach, 0), max(col0 - 2 * reach, 0)
    around = slice(top, min(row1 + 2 * reach, rows)), slice(left, min(col1 + 2 * reach, cols))
    part = lattice.window(around[0].start, around[0].stop, around[1].start, around[1].stop)
    energy = _priced(part, table.offsets, table.heading_rad, table.length_m)
    surface = np.ascontiguousarray(table.surface[around])
    bounds = _bounds(energy, table.offsets, table.length_m, surface, table.rise_share)
    bounds = np.minimum(table.bound_per_m, bounds)
    if not (bounds >= 0.0).any():
        return move_table(lattice, neighbours=len(table.offsets))
    height, width = table.energy[inner].shape[:2]
    down, right = inner[0].start - top, inner[1].start - left
    table.energy[inner] = energy[down : down + height, right : right + width]
    return replace(table, bound_per_m=bounds)


def _bounds(
    energy: NDArray[np.float32],
    offsets: NDArray[np.int64],
    length_m: NDArray[np.float64],
    surface: NDArray[np.float64],
    shares: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(B,) `MoveTable.bound_per_m` for some shares of the rise; inf where there are no moves."""
    bounds = np.array([spare_per_m(energy, offsets, length_m, share * surface).min() for share in shares])
    return np.where(np.abs(bounds) * length_m.min() < 2.0 * ROUNDING_J, 0.0, bounds)


def _priced(
    lattice: CostLattice, offsets: NDArray[np.int64], headings: NDArray[np.float64], length_m: NDArray[np.float64]
) -> NDArray[np.float32]:
    """(rows, cols, N) float32 [J] energies of all moves."""
    matrix = interpolation_matrix(headings, lattice.headings).astype(np.float32)
    at_moves = lattice.traction_per_m.reshape(-1, lattice.headings) @ matrix.T  # (cells, N)
    pieces = [_pieces(int(r), int(c)) for r, c in offsets]
    cells, share = _stack_stencils(offsets, pieces)
    piece_share, piece_cell, piece_blend = _stack_pieces(pieces)
    rows, cols = lattice.frame.shape
    allowed = np.zeros((rows, cols), dtype=np.int64)
    limits = (*heading_vector(headings), *lattice.max_tangents)
    parts = parts_of(rows, cols)
    gradient, blocked = np.ascontiguousarray(lattice.gradient), np.ascontiguousarray(lattice.blocked)
    share_out(lambda p: _allowed_moves(gradient[p], blocked[p], *limits, allowed[p]), parts)
    at_moves = at_moves.reshape(rows, cols, -1)
    energy = np.full(at_moves.shape, np.nan, dtype=np.float32)
    fixed = (offsets, length_m, price_terms(lattice), cells, share, piece_share, piece_cell, piece_blend)
    share_out(lambda p: _price_moves(at_moves, allowed, *fixed, p.start, p.stop, energy), parts)
    return energy


def _pieces(drow: int, dcol: int) -> list[tuple[float, NDArray[np.int64], NDArray[np.float64]]]:
    """A move from (0, 0), cut where it crosses lines of cell centres.

    Each piece: its share of the move, its four cells (4, 2), and their bilinear weights at start, middle, end (3, 4).
    """
    cuts = {0.0, 1.0}
    for span in (drow, dcol):
        cuts |= {k / abs(span) for k in range(1, abs(span))}
    edges = sorted(cuts)
    out = []
    for t0, t1 in zip(edges[:-1], edges[1:], strict=True):
        middle = 0.5 * (t0 + t1)
        i, j = math.floor(middle * drow), math.floor(middle * dcol)
        cells = np.array([(i, j), (i, j + 1), (i + 1, j), (i + 1, j + 1)], dtype=np.int64)
        blend = np.empty((3, 4))
        for k, t in enumerate((t0, middle, t1)):
            u, v = t * drow - i, t * dcol - j
            blend[k] = (1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v
        out.append((t1 - t0, cells, blend))
    return out


def _stack_stencils(offsets, pieces):
    """Per move, the cells it touches (N, S, 2) and their shares of the mean traction (N, S); padded with share -1."""
    stencils = []
    for move in pieces:
        total: dict[tuple[int, int], float] = {}
        for share, cells, blend in move:
            simpson = share * (blend[0] + 4.0 * blend[1] + blend[2]) / 6.0
            for cell, weight, touched in zip(cells.tolist(), simpson, blend.max(axis=0), strict=True):
                if touched > 1e-9:
                    total[tuple(cell)] = total.get(tuple(cell), 0.0) + weight
        stencils.append(total)
    width = max(len(s) for s in stencils)
    cells = np.zeros((len(offsets), width, 2), dtype=np.int64)
    shares = np.full((len(offsets), width), -1.0)
    for n, stencil in enumerate(stencils):
        for k, (cell, share) in enumerate(stencil.items()):
            cells[n, k] = cell
            shares[n, k] = share
    return cells, shares


def _stack_pieces(pieces):
    width = max(len(move) for move in pieces)
    share = np.zeros((len(pieces), width))
    cell = np.zeros((len(pieces), width, 4, 2), dtype=np.int64)
    blend = np.zeros((len(pieces), width, 3, 4))
    for n, move in enumerate(pieces):
        for k, (part, cells, weights) in enumerate(move):
            share[n, k], cell[n, k], blend[n, k] = part, cells, weights
    return share, cell, blend


@njit(cache=True, nogil=True)
def _allowed_moves(gradient, blocked, east, north, max_grade, max_cross, allowed):
    """Fill the bit sets (rows, cols) of the moves whose heading a cell's slope allows; 0 where blocked."""
    rows, cols = blocked.shape
    for i in range(rows):
        for j in range(cols):
            if blocked[i, j] != 0:
                continue
            bits = 0
            for k in range(east.size):
                along = gradient[i, j, 0] * east[k] + gradient[i, j, 1] * north[k]
                across = gradient[i, j, 0] * north[k] - gradient[i, j, 1] * east[k]
                if abs(along) <= max_grade and abs(across) <= max_cross:
                    bits |= 1 << k
            allowed[i, j] = bits


@njit(cache=True, nogil=True)
def _price_moves(
    traction, allowed, offsets, length_m, terms, cells, share, piece_share, piece_cell, piece_blend, first, end, energy
):
    """Fill the energies (rows, cols, N) [J] of some rows. traction : (rows, cols, N) at the moves' headings."""
    rows, cols, moves = traction.shape
    hotel, regeneration = terms[1], terms[2]
    for i in range(first, end):
        for j in range(cols):
            if allowed[i, j] == 0:
                continue
            for n in range(moves):
                row, col = i + offsets[n, 0], j + offsets[n, 1]
                if not (0 <= row < rows and 0 <= col < cols):
                    continue
                mean = 0.0
                lowest = np.inf
                free = True
                for s in range(cells.shape[1]):
                    if share[n, s] < 0.0:
                        break
                    r, c = i + cells[n, s, 0], j + cells[n, s, 1]
                    if (allowed[r, c] >> n) & 1 == 0:
                        free = False
                        break
                    t = traction[r, c, n]
                    mean += share[n, s] * t
                    lowest = min(lowest, t)
                if not free:
                    continue
                if lowest < 0.0:
                    mean = 0.0
                    for p in range(piece_share.shape[1]):
                        if piece_share[n, p] > 0.0:
                            t0 = tm = t1 = 0.0
                            for q in range(4):
                                if max(piece_blend[n, p, 0, q], piece_blend[n, p, 1, q], piece_blend[n, p, 2, q]) > 0.0:
                                    t = traction[i + piece_cell[n, p, q, 0], j + piece_cell[n, p, q, 1], n]
                                    t0 += piece_blend[n, p, 0, q] * t
                                    tm += piece_blend[n, p, 1, q] * t
                                    t1 += piece_blend[n, p, 2, q] * t
                            mean += piece_share[n, p] * mean_response(t0, tm, t1, regeneration)
                energy[i, j, n] = (hotel + mean) * length_m[n]
