"""The any-angle step: straight legs are left where that pays, all ways through a region compete, and turns count."""

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.errors import NoRouteError
from joulemap.model.robot import Robot
from joulemap.planner.any_angle.best import best_path, improved, tightened
from joulemap.planner.grid.search import grid_search
from joulemap.planner.lattice import Blocked
from joulemap.planner.pricing.integrator import path_price
from joulemap.planner.pricing.moves import move_table
from tests.reference.lattices import ascii_lattice, random_lattice, uniform_lattice

EXACT = Robot(tracking_std_m=0.0)


def test_a_straight_leg_bends_towards_cheaper_ground():
    lattice = ascii_lattice("\n".join(["." * 40] * 21))[0]
    cheaper = 1.0 - 0.5 * np.exp(-0.5 * ((np.arange(21.0) - 13.0) / 2.0) ** 2)
    traction = np.broadcast_to(10.0 * cheaper[:, None, None], lattice.traction_per_m.shape).astype(np.float32)
    lattice = replace(lattice, traction_per_m=traction)
    straight = np.array([(10.0, 2.0), (10.0, 37.0)])
    found = improved(lattice, straight)
    np.testing.assert_array_equal(found[[0, -1]], straight)
    assert path_price(lattice, found) < 0.95 * path_price(lattice, straight)
    best = best_path(lattice, move_table(lattice, neighbours=32), *straight)
    assert best.energy_j <= path_price(lattice, found) * (1.0 + 1e-4)


@pytest.mark.parametrize("seed", [0, 5, 10])
def test_improving_an_improved_path_gains_next_to_nothing_where_limits_close_moves(seed):
    lattice = random_lattice(np.random.default_rng(seed), 70, 70, max_grade_deg=12.0, max_cross_slope_deg=12.0)
    free = np.argwhere(lattice.blocked == 0).astype(float)
    once = improved(lattice, grid_search(lattice, move_table(lattice, neighbours=32), free[3], free[-3]).points)
    assert path_price(lattice, improved(lattice, once)) > (1.0 - 1e-3) * path_price(lattice, once)


ROWS, COLS = 25, 141
HIGH, MIDDLE, LOW = 1, 9, 18  # rows of gaps
GAPS = {35: (HIGH, LOW), 56: (MIDDLE,), 84: (MIDDLE,), 105: (HIGH, LOW)}  # of the wall in each of these columns


def through(first, second):
    """A path over cells through one gap of the first wall and of the last."""
    gaps = [(first, 34), (first, 36), (MIDDLE, 55), (MIDDLE, 85), (second, 104), (second, 106)]
    return np.array([(MIDDLE, 5), *gaps, (MIDDLE, 135)], dtype=float)


def test_between_walls_the_nearer_gap_of_each_is_taken():
    rows = [["."] * COLS for _ in range(ROWS)]
    for col, gaps in GAPS.items():
        for row in set(range(ROWS)) - set(gaps):
            rows[row][col] = "#"
    lattice = ascii_lattice("\n".join(map("".join, rows)))[0]
    best = best_path(lattice, move_table(lattice, neighbours=32), np.array([9.0, 5.0]), np.array([9.0, 135.0]))
    of_each = {
        (first, second): path_price(lattice, improved(lattice, through(first, second)))
        for first in (HIGH, LOW)
        for second in (HIGH, LOW)
    }
    assert min(of_each, key=of_each.get) == (HIGH, HIGH)
    assert best.energy_j == pytest.approx(of_each[HIGH, HIGH], rel=1e-4)


def test_a_passage_is_found_that_is_open_between_the_headings_of_moves():
    """A wall whose passage may be driven at 11 degrees only; the way around its end costs a tenth more."""
    lattice = uniform_lattice(31, 60, lambda heading: 1.0)
    lattice = replace(lattice, robot=replace(lattice.robot, max_cross_slope_deg=0.9, max_grade_deg=40.0))
    lattice.blocked[15, :32] = Blocked.STEP
    passage, heading = (15, slice(10, 12)), math.atan2(1.0, 5.0)
    lattice.blocked[passage] = Blocked.FREE
    lattice.gradient[passage] = 0.4 * math.sin(heading), 0.4 * math.cos(heading)
    start, goal = np.array([28.0, 20.0]), np.array([2.0, 20.0])
    around = grid_search(lattice, move_table(lattice, neighbours=32), start, goal).points
    through_it = improved(lattice, np.array([start, (16.2, 10.3), (13.8, 10.78), goal]))
    assert path_price(lattice, through_it) < 0.91 * path_price(lattice, around)


@pytest.mark.parametrize("robot", [EXACT, replace(EXACT, turn_j_per_rad=30.0), replace(EXACT, regeneration=0.5)])
def test_the_path_is_never_dearer_than_the_grid_and_keeps_its_ends(robot):
    answers = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        lattice = random_lattice(rng, 30, 30, max_grade_deg=12.0, max_cross_slope_deg=12.0)
        lattice = replace(lattice, robot=replace(robot, max_grade_deg=12.0, max_cross_slope_deg=12.0))
        table = move_table(lattice, neighbours=32)
        free = np.argwhere(lattice.blocked == 0).astype(float)
        start, goal = free[3] + 0.2, free[-3] - 0.3
        with suppress(NoRouteError):
            best = best_path(lattice, table, start, goal)
            answers += 1
            assert best.energy_j <= best.grid_energy_j + 1e-6 * abs(best.grid_energy_j)
            np.testing.assert_array_equal(best.points[[0, -1]], [start, goal])
    assert answers > 3


def test_where_turning_costs_no_answer_has_two_vertices_in_one_place():
    robot = Robot(turn_j_per_rad=20.0, max_grade_deg=15.0, max_cross_slope_deg=12.0)
    answers = 0
    for seed in range(12):
        lattice = replace(random_lattice(np.random.default_rng(seed), 60, 60), robot=robot)
        free = np.argwhere(lattice.blocked == 0).astype(float)
        with suppress(NoRouteError):
            best = best_path(lattice, move_table(lattice, neighbours=32), free[5], free[-5])
            answers += 1
            assert np.hypot(*np.diff(best.points, axis=0).T).min() > 1e-4
    assert answers > 3


def test_tightening_finds_the_straight_line_round_a_bulge():
    lattice = uniform_lattice(40, 40, lambda heading: 1.0)
    bulge = np.array([(20.0, 2.0), (8.0, 10.0), (6.0, 20.0), (9.0, 30.0), (20.0, 37.0)])
    assert path_price(lattice, tightened(lattice, bulge)) == pytest.approx(35.0, rel=1e-6)
