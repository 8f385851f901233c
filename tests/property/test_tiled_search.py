"""The search over tiles of a stored lattice = the search in memory: mazes, gaps of one cell, limits, regeneration."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.errors import InputError, JoulemapError, NegativeCycleError
from joulemap.planner.any_angle.region import region_between
from joulemap.planner.grid.search import grid_search
from joulemap.planner.lattice.folder import save_lattice
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.planner.on_disk.coarse import coarse_level
from joulemap.planner.on_disk.tiled_table import tiled_table
from joulemap.planner.pricing.integrator import path_price
from joulemap.planner.pricing.move_prices import MovePrices
from joulemap.planner.pricing.moves import distance_table, move_table, with_margin
from tests.reference.lattices import random_lattice

SHAPE = (45, 53)


def walled(lattice, rng):
    """Walls from edge to edge, two cells thick, each with a gap of one cell: no block of 4 cells is open throughout."""
    rows, cols = lattice.frame.shape
    for row in range(5, rows - 3, 8):
        lattice.blocked[row : row + 2] = 2
        lattice.blocked[row : row + 2, int(rng.integers(0, cols))] = 0
    return lattice


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    neighbours=st.sampled_from([8, 16, 32]),
    robot=st.fixed_dictionaries(
        {
            "regeneration": st.sampled_from([0.0, 0.0, 0.5]),
            "max_grade_deg": st.sampled_from([12.0, 30.0]),
            "idle_power_w": st.sampled_from([0.0, 12.0]),
        }
    ),
    walls=st.booleans(),
    margin=st.sampled_from([0.0, 0.5, 1.2]),
    shortest=st.booleans(),
)
def test_tiles_find_what_the_search_in_memory_finds(tmp_path_factory, seed, neighbours, robot, walls, margin, shortest):
    """In tiles of 8 cells and as few of them as there may be: the same path, and the same cells around it."""
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, *SHAPE, **robot)
    if walls:
        walled(lattice, rng)
    start, goal = rng.integers(0, SHAPE), rng.integers(0, SHAPE)
    lattice.blocked[tuple(start)] = lattice.blocked[tuple(goal)] = 0
    start, goal = (np.clip(p + rng.uniform(-0.4, 0.4, 2), 0, np.array(SHAPE) - 1.0) for p in (start, goal))
    save_lattice(lattice, folder := tmp_path_factory.mktemp("tiles") / "a.zarr")
    stored, moves = StoredLattice(folder), MovePrices(lattice.headings, neighbours)
    level = coarse_level(stored, moves, block_cells=4)
    try:
        whole = with_margin(move_table(lattice, neighbours=neighbours), margin)
        tiled = tiled_table(stored, moves, level, margin=margin, tile_cells=8, memory_bytes=5_000_000)
    except NegativeCycleError:
        return
    except InputError:
        assert robot["regeneration"] > 0.0  # nothing is proven of prices far below zero
        return
    assert tiled.typical_j == pytest.approx(whole.typical_j, rel=1e-5)
    if shortest:
        whole, tiled = distance_table(whole), distance_table(tiled)
    try:
        expected = region_between(lattice, whole, start, goal)
    except JoulemapError as error:
        with pytest.raises(type(error)):
            region_between(lattice, tiled, start, goal)
        return
    found = region_between(lattice, tiled, start, goal)
    assert found.grid.energy_j == pytest.approx(expected.grid.energy_j, rel=1e-6, abs=1e-6)
    assert grid_search(lattice, tiled, start, goal).energy_j == pytest.approx(
        expected.grid.energy_j, rel=1e-6, abs=1e-6
    )
    if not shortest and margin == 0.0:
        assert path_price(lattice, found.grid.points) == pytest.approx(found.grid.energy_j, rel=1e-6, abs=1e-3)
    if expected.cells is not None:
        assert (found.cells == expected.cells).all()
    assert (found.beside_closed, found.any_closed) == (expected.beside_closed, expected.any_closed)
