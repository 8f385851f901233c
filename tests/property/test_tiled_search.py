"""The search over tiles of a stored lattice = the search in memory: mazes, gaps of one cell, limits, regeneration."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.errors import InputError, JoulemapError, NegativeCycleError, NoRouteError
from joulemap.planner.grid.search import grid_search
from joulemap.planner.lattice.io import save_lattice
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.planner.on_disk.coarse import coarse_level
from joulemap.planner.on_disk.tiled_search import TiledSearch
from joulemap.planner.pricing.integrator import path_price
from joulemap.planner.pricing.move_prices import MovePrices
from joulemap.planner.pricing.moves import move_table
from tests.reference.lattices import random_lattice

SHAPE = (37, 45)


def walled(lattice, rng):
    """Walls from edge to edge, two cells thick, each with a gap of one cell: no block of 4 cells is open throughout."""
    rows, cols = lattice.frame.shape
    for row in range(5, rows - 3, 8):
        lattice.blocked[row : row + 2] = 2
        lattice.blocked[row : row + 2, int(rng.integers(0, cols))] = 0
    return lattice


def searched(lattice, folder, start, goal, *, neighbours=16):
    """The tiled answer, in little blocks and tiles and with as few price slots as there may be."""
    save_lattice(lattice, folder)
    stored = StoredLattice(folder)
    moves = MovePrices(stored.headings, neighbours)
    level = coarse_level(stored, moves, block_cells=4)
    return TiledSearch(stored, moves, level, tile_cells=8, memory_bytes=2_000_000).run(start, goal)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    neighbours=st.sampled_from([8, 16, 32]),
    regeneration=st.sampled_from([0.0, 0.0, 0.5]),
    limit=st.sampled_from([12.0, 30.0]),
    idle=st.sampled_from([0.0, 12.0]),
    walls=st.booleans(),
)
def test_tiles_find_what_the_search_in_memory_finds(
    tmp_path_factory, seed, neighbours, regeneration, limit, idle, walls
):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, *SHAPE, regeneration=regeneration, max_grade_deg=limit, idle_power_w=idle)
    if walls:
        walled(lattice, rng)
    start, goal = rng.integers(0, SHAPE), rng.integers(0, SHAPE)
    lattice.blocked[tuple(start)] = lattice.blocked[tuple(goal)] = 0
    start, goal = (np.clip(p + rng.uniform(-0.4, 0.4, 2), 0, np.array(SHAPE) - 1.0) for p in (start, goal))
    try:
        expected = grid_search(lattice, move_table(lattice, neighbours=neighbours), start, goal)
    except NegativeCycleError:
        return
    except NoRouteError:
        expected = None
    folder = tmp_path_factory.mktemp("tiles") / "a.zarr"
    try:
        found = searched(lattice, folder, start, goal, neighbours=neighbours)
    except NoRouteError:
        assert expected is None
        return
    except InputError:
        if regeneration > 0.0:  # nothing is proven of prices far below zero
            return
        raise
    assert expected is not None
    assert found.energy_j == pytest.approx(expected.energy_j, rel=1e-6, abs=1e-3)
    assert found.bound_j <= expected.energy_j + 1e-9
    assert found.bound_j >= found.energy_j - 1e-3 * abs(found.energy_j) - 1e-2
    assert path_price(lattice, found.points) == pytest.approx(found.energy_j, rel=1e-6, abs=1e-3)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_the_shortest_path_over_tiles_is_that_in_memory(tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    lattice = walled(random_lattice(rng, *SHAPE), rng)
    start, goal = rng.integers(0, SHAPE).astype(float), rng.integers(0, SHAPE).astype(float)
    for place in (start, goal):
        lattice.blocked[tuple(place.astype(int))] = 0
    metre = replace(lattice.robot, idle_power_w=1.0, speed_mps=1.0)
    distances = replace(lattice, robot=metre, traction_per_m=np.zeros_like(lattice.traction_per_m))
    try:
        expected = grid_search(distances, move_table(distances), start, goal)
    except JoulemapError as error:
        expected = error
    folder = tmp_path_factory.mktemp("tiles") / "a.zarr"
    save_lattice(lattice, folder)
    stored = StoredLattice(folder)
    search = TiledSearch(stored, MovePrices(stored.headings), None, tile_cells=8)
    if isinstance(expected, JoulemapError):
        with pytest.raises(NoRouteError):
            search.run(start, goal)
    else:
        assert search.run(start, goal).energy_j == pytest.approx(expected.energy_j, rel=1e-6, abs=1e-4)
