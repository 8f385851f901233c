"""The any-angle step: a straight leg is left where that pays, and a path that was improved has little left to gain."""

from dataclasses import replace

import numpy as np
import pytest

from joulemap.planner.edges import path_price
from joulemap.planner.moves import move_table
from joulemap.planner.refine import refine_path
from joulemap.planner.search import grid_search
from tests.reference.lattices import ascii_lattice, random_lattice


def test_a_straight_leg_bends_towards_cheaper_ground():
    lattice = ascii_lattice("\n".join(["." * 40] * 21))[0]
    cheaper = 1.0 - 0.5 * np.exp(-0.5 * ((np.arange(21.0) - 13.0) / 2.0) ** 2)
    traction = np.broadcast_to(10.0 * cheaper[:, None, None], lattice.traction_per_m.shape).astype(np.float32)
    lattice = replace(lattice, traction_per_m=traction)
    straight = np.array([(10.0, 2.0), (10.0, 37.0)])
    refined = refine_path(lattice, straight)
    np.testing.assert_array_equal(refined[[0, -1]], straight)
    assert path_price(lattice, refined) < 0.95 * path_price(lattice, straight)


@pytest.mark.parametrize("seed", [0, 5, 10])
def test_improving_an_improved_path_gains_next_to_nothing_where_limits_close_moves(seed):
    lattice = random_lattice(np.random.default_rng(seed), 70, 70, max_grade_deg=12.0, max_cross_slope_deg=12.0)
    free = np.argwhere(lattice.blocked == 0).astype(float)
    once = refine_path(lattice, grid_search(lattice, move_table(lattice, neighbours=32), free[3], free[-3]).points)
    assert path_price(lattice, refine_path(lattice, once)) > (1.0 - 5e-4) * path_price(lattice, once)
