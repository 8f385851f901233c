"""Shaken paths: the same for the same path, never dearer, cheaper where there are many local optima."""

import math
from dataclasses import replace

import numpy as np

from joulemap.planner.beside import MOST_CELLS
from joulemap.planner.edges import path_price
from joulemap.planner.lattice import Blocked
from joulemap.planner.moves import move_table
from joulemap.planner.refine import refine_path
from joulemap.planner.scattered import with_scattered
from joulemap.planner.search import grid_search
from joulemap.planner.shaken import _moved, shaken
from tests.reference.lattices import ascii_lattice, random_lattice, uniform_lattice


def improved(seed):
    """A lattice whose limits close many moves, and a path over it after the any-angle step."""
    lattice = random_lattice(np.random.default_rng(seed), 70, 70, max_grade_deg=12.0, max_cross_slope_deg=12.0)
    free = np.argwhere(lattice.blocked == 0).astype(float)
    found = grid_search(lattice, move_table(lattice, neighbours=32), free[3], free[-3])
    return lattice, refine_path(lattice, found.points)


def test_it_gains_where_limits_close_moves_and_is_the_same_again():
    gains = []
    for seed in (0, 5, 10):
        lattice, path = improved(seed)
        once = shaken(lattice, path)
        np.testing.assert_array_equal(once[[0, -1]], path[[0, -1]])
        np.testing.assert_array_equal(once, shaken(lattice, path))
        gains.append(1.0 - path_price(lattice, once) / path_price(lattice, path))
    assert min(gains) >= 0.0
    assert max(gains) > 5e-4


def test_a_copy_can_be_driven_and_has_moved():
    lattice, path = improved(5)
    for seed in range(5):
        copy = _moved(lattice, path, np.random.default_rng(seed))
        assert math.isfinite(path_price(lattice, copy))
        np.testing.assert_array_equal(copy[[0, -1]], path[[0, -1]])
        assert len(copy) > 2
        assert not np.array_equal(copy, _moved(lattice, path, np.random.default_rng(seed + 1)))


def test_long_paths_and_a_path_without_length_stay_as_they_are():
    cols = int(MOST_CELLS) + 7
    lattice = ascii_lattice("\n".join(["." * cols] * 5))[0]
    path = np.array([(2.0, 2.0), (2.0, cols - 3.0)])
    assert shaken(lattice, path) is path
    nowhere = np.array([(2.0, 2.0), (2.0, 2.0)])
    np.testing.assert_array_equal(shaken(lattice, nowhere)[[0, -1]], nowhere)


def test_a_passage_that_is_open_to_long_legs_of_one_heading_is_found():
    """Two steep cells that may be driven at 98 degrees only, and dear ground around them."""
    lattice = uniform_lattice(9, 20, lambda heading: 1.0)
    lattice = replace(lattice, robot=replace(lattice.robot, max_cross_slope_deg=0.9, max_grade_deg=40.0))
    lattice.blocked[[0, 1, 2, 3, 6, 7, 8], 9:11] = Blocked.STEP
    lattice.traction_per_m[5, 9:11] = 8.0
    heading = math.radians(98.0)
    lattice.gradient[4, 9:11] = 0.4 * math.sin(heading), 0.4 * math.cos(heading)
    path = np.array([(4.0, 2.0), (4.0, 7.0), (5.0, 8.0), (5.0, 12.0), (4.0, 13.0), (4.0, 17.0)])
    usual = path_price(lattice, path)
    prices = [path_price(lattice, with_scattered(lattice, path, np.random.default_rng(k))) for k in range(5)]
    assert max(prices) <= usual
    assert min(prices) < 0.7 * usual


def test_no_place_is_scattered_on_open_ground():
    lattice = uniform_lattice(20, 40, lambda heading: 1.0)
    path = np.array([(10.0, 5.0), (4.0, 20.0), (10.0, 35.0)])
    assert with_scattered(lattice, path, np.random.default_rng(0)) is path
