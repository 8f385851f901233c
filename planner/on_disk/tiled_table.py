"""The moves of a lattice that stays on disk: priced tile by tile, with bounds from its coarse level."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.frames import heading_of
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.planner.on_disk.coarse import CoarseLevel
from joulemap.planner.on_disk.lower_bound import fill_bounds, potentials_towards
from joulemap.planner.pricing.integrator import Points
from joulemap.planner.pricing.move_prices import MovePrices
from joulemap.planner.pricing.moves import MoveTable, penalty_j
from joulemap.planner.pricing.tiles import TILE_CELLS, Fill, Tiles

DEFAULT_MEMORY = 1_500_000_000
"""Most memory of a search [bytes] unless the user says so."""


def tiled_table(
    stored: StoredLattice,
    moves: MovePrices,
    coarse: CoarseLevel,
    *,
    margin: float = 0.0,
    memory_bytes: int = DEFAULT_MEMORY,
    tile_cells: int = TILE_CELLS,
) -> MoveTable:
    """Return the moves of a lattice for one question; searches weigh no turns with it.

    `margin`: how far beside a move the same move must be open [cells], see `integrator.margin_cells`. Raises InputError
    if prices are so far below zero that the coarse level proves nothing.
    """
    least = np.array([float(level.min()) for level in coarse.least_per_m])  # infinite where there is no move
    order = np.argsort(coarse.shares)
    if not (least >= 0.0).any():
        raise InputError(
            "the energy that comes back on descents is so large here that nothing can be proven from the coarse "
            "level: plan on this map in memory, or lower the robot's `regeneration`"
        )
    pays = bool(least[coarse.shares == 0.0][0] < 0.0)
    tiles = Tiles(
        partial(stored.window, what=("traction_per_m", "gradient", "blocked")),
        stored.frame.shape,
        moves,
        margin,
        memory_bytes=memory_bytes,
        side=tile_cells,
        surface=partial(stored.read, coarse.surface, 0.0) if pays else None,
    )
    length_m = moves.lengths_m(stored.frame.resolution_m)
    return MoveTable(
        moves.offsets,
        heading_of(moves.offsets[:, 1], -moves.offsets[:, 0]),
        length_m,
        tiles.energy,
        np.zeros(len(length_m)),
        tiles.surface,
        coarse.shares[order],
        least[order],
        near=tiles.near,
        narrow=tiles.narrow,
        near_j=penalty_j(coarse.typical_j, length_m) if margin > 0.0 else np.zeros(0),
        tiles=tiles,
        sampled_j=coarse.typical_j,
        lead=partial(_lead, stored, moves, coarse),
    )


def _lead(
    stored: StoredLattice,
    moves: MovePrices,
    coarse: CoarseLevel,
    goal: Points,
    targets: NDArray[np.int64],
    rest: NDArray[np.float64],
) -> Fill:
    """Bounds towards a goal, as `MoveTable.lead`."""
    unit = moves.offsets / np.hypot(moves.offsets[:, :1], moves.offsets[:, 1:])
    shares, nodes = potentials_towards(coarse, goal, unit, stored.frame.resolution_m)

    def _fill(out: NDArray[np.float64], row: int, col: int, constants: NDArray[np.float64]) -> None:
        surface = stored.read(coarse.surface, 0.0, row, row + out.shape[0], col, col + out.shape[1])
        fill_bounds(out, surface, row, col, nodes, shares, constants, coarse.block_cells)

    constants = np.zeros(len(shares))
    for k in range(len(shares)):  # the largest for which the bound is none too high at any target
        alone, here = np.full(len(shares), -np.inf), np.empty((1, 1))
        alone[k] = 0.0
        most = np.inf
        for (row, col), more in zip(np.column_stack(np.divmod(targets, stored.frame.cols)), rest, strict=True):
            _fill(here, int(row), int(col), alone)
            most = min(most, float(more - here[0, 0]))
        constants[k] = most if np.isfinite(most) else 0.0
    return partial(_fill, constants=constants)
