"""The table of a lattice's grid moves, 8, 16 or 32 from every cell, with what searches need beside their prices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import heading_of, wrap_angle
from joulemap.model.threads import both
from joulemap.planner.lattice import CostLattice
from joulemap.planner.pricing.integrator import MARGIN_PENALTY, Points
from joulemap.planner.pricing.margin_moves import beside_moves, near_closed
from joulemap.planner.pricing.move_prices import MovePrices
from joulemap.planner.pricing.potential import even_surface, spare_bounds
from joulemap.planner.pricing.tiles import Fill, Tiles

EVERY = 7
"""Prices of every seventh cell along rows and columns say what is typical of a map."""
RISE_SHARES = np.array([0.0, 1.0])
"""Shares of the surface's rise that `MoveTable.bound_per_m` is known for."""


Lead = Callable[[Points, NDArray[np.int64], NDArray[np.float64]], Fill]
"""Bounds towards a goal (row, col), which some flat cells are joined to at some energies [J]."""


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
    gap_j : ndarray of float64, (N,)
        Energy of turning from each move's heading to the next one's, clockwise [J].
    surface : ndarray of float64, (rows, cols)
        What a rise is counted on [J]: weight times elevation, smoothed (see `potential`).
    rise_share : ndarray of float64, (B,)
        Shares s of the rise, ascending from 0.
    bound_per_m : ndarray of float64, (B,)
        The largest a [J/m] with energy >= a * length + s * rise for every move of the map (up positive). The heuristics
        and the potential for negative prices are made of it.
    metric : bool
        Whether a search counts the length of every move [m] instead of its energy.
    near : ndarray of uint32, (cells,) or (0,)
        Bit n is set where move n leaves the cell nearer to ground that may not be driven than the robot's margin; empty
        where no margin is kept.
    narrow : ndarray of uint32, (cells,) or (0,)
        Likewise where no path beside the move, within a margin of it, keeps the margin either.
    near_j : ndarray of float64, (N,) or (0,)
        What such a move costs more in a search [J].
    tiles : Tiles, optional
        What prices the moves when a search reaches them; without it all are there.
    sampled_j : float
        Mean size of a price [J], 0 where a sample is to be taken of the map.
    lead : callable, optional
        Makes the lower bounds of tiles, see `Lead`.
    """

    offsets: NDArray[np.int64]
    heading_rad: NDArray[np.float64]
    length_m: NDArray[np.float64]
    energy: NDArray[np.float32]
    gap_j: NDArray[np.float64]
    surface: NDArray[np.float64]
    rise_share: NDArray[np.float64]
    bound_per_m: NDArray[np.float64]
    metric: bool = False
    near: NDArray[np.uint32] = field(default_factory=lambda: np.zeros(0, np.uint32))
    narrow: NDArray[np.uint32] = field(default_factory=lambda: np.zeros(0, np.uint32))
    near_j: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    tiles: Tiles | None = None
    sampled_j: float = 0.0
    lead: Lead | None = None

    @property
    def jump(self) -> NDArray[np.int64]:
        """Step of every move in flat cell indices: int64, (N,)."""
        return self.offsets @ np.array([self.energy.shape[1], 1], dtype=np.int64)

    @property
    def reach(self) -> int:
        """Rows or columns that the longest move spans."""
        return int(np.abs(self.offsets).max())

    @cached_property
    def typical_j(self) -> float:
        """Mean size of a price [J], or length, from a sample of the map; 1 where there is none."""
        if self.metric:
            return float(self.length_m.mean())
        if self.sampled_j > 0.0:
            return self.sampled_j
        sample = np.abs(self.energy[::EVERY, ::EVERY])
        return float(np.nanmean(sample)) or 1.0 if np.isfinite(sample).any() else 1.0

    @property
    def never_pays(self) -> bool:
        """Whether every price is known to be at least 0."""
        return bool(self.bound_per_m[0] >= 0.0)


def distance_table(table: MoveTable) -> MoveTable:
    """Return the same moves at 1 J per metre, without climbs and turns: its cheapest paths are the shortest.

    Result: the table of distances, which needs no memory of its own.
    """
    flat, penalty = np.zeros(1), MARGIN_PENALTY * table.length_m if table.near.size else table.near_j
    return replace(
        table,
        gap_j=np.zeros_like(table.gap_j),
        rise_share=flat,
        bound_per_m=flat + 1.0,
        metric=True,
        near_j=penalty,
        lead=None,
    )


def with_margin(table: MoveTable, margin: float) -> MoveTable:
    """Return the same moves, of which those near closed ones cost more.

    `margin`: how far beside a move the same move must be open [cells], see `integrator.margin_cells`. The result shares
    the energies; `table` itself where there is no margin or no closed move.

    Between centres, the moves from the cells around are looked at, so that a little more than the margin is kept.
    """
    if margin == 0.0:
        return table
    rows, cols = table.surface.shape
    beside = beside_moves(table.offsets, margin)
    near, narrow = near_closed(table.energy, table.offsets, beside, 0, 0, rows, cols)
    if not near.any():
        return table
    return replace(table, near=near.ravel(), narrow=narrow.ravel(), near_j=penalty_j(table.typical_j, table.length_m))


def penalty_j(typical_j: float, length_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what moves cost more within the margin, (N,) [J]."""
    return MARGIN_PENALTY * typical_j / float(length_m.mean()) * length_m


def move_table(lattice: CostLattice, *, neighbours: int = 16) -> MoveTable:
    """Price all grid moves of a lattice.

    O(rows * cols * N) time, two compiled passes.
    """
    prices = MovePrices(lattice.headings, neighbours)
    lifted = lattice.robot.weight_n * np.nan_to_num(lattice.elevation_m.astype(np.float64))
    return table_of(
        prices.by_cell(lattice),
        prices.offsets,
        lifted,
        spacing_m=lattice.frame.resolution_m,
        turn_j_per_rad=lattice.robot.turn_j_per_rad,
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

    `energy` (rows, cols, N): energy of the move that leaves a cell [J], NaN where it may not be driven; `offsets` (N,
    2): (drow, dcol) of each move, clockwise from north; `lifted` (rows, cols): robot weight times elevation [J].
    Result: the moves, with the surface and the bounds that searches need.
    """
    headings = heading_of(offsets[:, 1], -offsets[:, 0])
    length_m = np.hypot(offsets[:, 0], offsets[:, 1]) * spacing_m
    gap = turn_j_per_rad * np.abs(wrap_angle(np.roll(headings, -1) - headings))
    flat, surface = both(  # most of the surface is found on one thread
        lambda: spare_bounds(energy, offsets, length_m, lifted, RISE_SHARES[:1]),
        lambda: even_surface(energy, offsets, length_m, lifted),
    )
    bounds = np.append(flat, spare_bounds(energy, offsets, length_m, surface, RISE_SHARES[1:]))
    return MoveTable(offsets, headings, length_m, energy, gap, surface, RISE_SHARES, bounds)


def repriced(table: MoveTable, lattice: CostLattice, window: tuple[int, int, int, int]) -> MoveTable:
    """Return the moves of a lattice that differs in one window only from the one that a table was made of.

    Result: the surface stays and the bounds hold for both lattices; where the prices need another surface, everything
    is priced again.
    """
    row0, row1, col0, col1 = window
    rows, cols = lattice.frame.shape
    reach = table.reach
    inner = slice(max(row0 - reach, 0), row1 + reach), slice(max(col0 - reach, 0), col1 + reach)
    top, left = max(row0 - 2 * reach, 0), max(col0 - 2 * reach, 0)
    around = slice(top, min(row1 + 2 * reach, rows)), slice(left, min(col1 + 2 * reach, cols))
    part = lattice.window(around[0].start, around[0].stop, around[1].start, around[1].stop)
    energy = MovePrices(part.headings, len(table.offsets)).by_cell(part)
    surface = np.ascontiguousarray(table.surface[around])
    bounds = spare_bounds(energy, table.offsets, table.length_m, surface, table.rise_share)
    bounds = np.minimum(table.bound_per_m, bounds)
    if not (bounds >= 0.0).any():
        return move_table(lattice, neighbours=len(table.offsets))
    height, width = table.energy[inner].shape[:2]
    down, right = inner[0].start - top, inner[1].start - left
    table.energy[inner] = energy[down : down + height, right : right + width]
    return replace(table, bound_per_m=bounds)
