"""Closed forms from the literature: what the grid must answer, and what the continuous optimum is."""

import numpy as np
import pytest
from scipy.optimize import linprog

from joulemap.model.errors import NoRouteError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.planner.any_angle.best import improved
from joulemap.planner.grid.search import grid_search
from joulemap.planner.pricing.integrator import path_price
from joulemap.planner.pricing.move_prices import move_offsets
from joulemap.planner.pricing.moves import move_table
from joulemap.planner.route_planner import RouteOptions, RoutePlanner
from tests.reference.lattices import plane_lattice, surface_lattice, uniform_lattice


def gauge(price_per_m, headings, step):
    """Least energy of a displacement under a uniform directional price, from the given headings only.

    min sum a_i F(u_i) with sum a_i u_i = D, a_i >= 0: the gauge of the convex hull of u / F(u).
    """
    directions = np.array([np.sin(headings), np.cos(headings)])
    answer = linprog([price_per_m(h) for h in headings], A_eq=directions, b_eq=step)
    return answer.fun


PRICES = {
    "wind from the north": lambda h: 10.0 + 6.0 * np.cos(h),
    "furrows": lambda h: 10.0 + 8.0 * np.cos(2.0 * (h - 0.3)),  # 1 / F is not convex: zigzags pay
    "three good headings": lambda h: 10.0 - 7.0 * np.cos(3.0 * h),
}


@pytest.mark.parametrize("name", PRICES)
@pytest.mark.parametrize("neighbours", [8, 16, 32])
def test_uniform_directional_price_costs_the_gauge_of_its_hull(name, neighbours):
    price = PRICES[name]
    lattice = uniform_lattice(130, 130, price)
    offsets = move_offsets(neighbours)
    headings = np.arctan2(offsets[:, 1], -offsets[:, 0])
    table = move_table(lattice, neighbours=neighbours)
    # Multiples of 60 are whole combinations of any two of the 16 moves: their determinants are 1..5.
    for d_row, d_col in ((-60, 0), (60, 60), (0, -60)):
        start = np.array([64.0 - d_row // 2, 64.0 - d_col // 2])
        goal = start + np.array([d_row, d_col])
        grid = grid_search(lattice, table, start, goal).energy_j
        predicted = gauge(price, headings, [d_col, -d_row])
        assert grid == pytest.approx(predicted, rel=1e-6 if neighbours < 32 else 0.01)
        start_xy, goal_xy = (tuple(float(v) for v in lattice.frame.xy(*p)) for p in (start, goal))
        plan = RoutePlanner(lattice).plan(start_xy, goal_xy, RouteOptions(neighbours=neighbours))
        continuous = gauge(price, np.linspace(0, 2 * np.pi, 14_400, endpoint=False), [d_col, -d_row])
        assert continuous * (1 - 1e-5) <= plan.route.energy_j <= continuous * 1.005


def test_isotropic_worst_case_of_the_grids():
    """science: 8 neighbours 1.0824 (at 22.5 deg), 16 neighbours 1.0275; off every axis the refined path is straight."""
    robot = Robot(rolling_resistance=0.0, idle_power_w=0.5)
    lattice = plane_lattice(130, 130, robot=robot)
    start = np.array([124.0, 5.0])
    for neighbours, worst in ((8, 1.0824), (16, 1.0275)):
        table = move_table(lattice, neighbours=neighbours)
        ratios = []
        for angle in np.deg2rad(np.linspace(2, 44, 22)):
            goal = start + np.rint(110 * np.array([-np.cos(angle), np.sin(angle)]))
            found = grid_search(lattice, table, start, goal)
            straight = np.hypot(*(goal - start))
            ratios.append(found.energy_j / straight)
            assert path_price(lattice, improved(lattice, found.points)) == pytest.approx(straight, rel=1e-9)
        assert max(ratios) == pytest.approx(worst, abs=1.5e-3)


@pytest.fixture(scope="module")
def switchback():
    """A 20 deg plane under a 12 deg pitch limit, mu = 0.2, goal straight up (Rowe & Ross 1990, Sun & Reif 2005)."""
    robot = Robot(rolling_resistance=0.2, max_grade_deg=12.0, max_cross_slope_deg=60.0, idle_power_w=0.0)
    planner = RoutePlanner(plane_lattice(120, 120, 0.0, np.tan(np.deg2rad(20.0)), robot=robot))
    climb = 60.0 * np.tan(np.deg2rad(20.0))
    optimum = robot.weight_n * climb * (0.2 / np.tan(np.deg2rad(12.0)) + 1.0)
    return planner, optimum


def test_switchbacks_8_neighbours_find_no_path(switchback):
    planner, _ = switchback
    with pytest.raises(NoRouteError, match="12 deg"):
        planner.plan((60.5, 30.5), (60.5, 90.5), RouteOptions(neighbours=8, refine=False))


@pytest.mark.parametrize(("neighbours", "dearer"), [(16, 0.148), (32, 0.0256)])
def test_switchbacks_cost_the_limit_whatever_the_lateral_offset(switchback, neighbours, dearer):
    """E* = m g dh (mu / tan(theta_m) + 1). Grid: steepest permitted move at 63.4 (16) and 56.3 deg (32) off the fall
    line, so mu / cos in place of mu / cos(54.3 deg): 14.8 % and 2.56 % dearer (science says about 14 and 2.4).
    """
    planner, optimum = switchback
    for offset in (0.0, 20.0):
        ends = (60.5, 30.5), (60.5 + offset, 90.5)
        grid = planner.plan(*ends, RouteOptions(neighbours=neighbours, refine=False))
        leftover = 1e-3 if offset == 0.0 else 1e-2  # whole moves do not add up to every offset
        assert grid.route.energy_j == pytest.approx(optimum * (1 + dearer), rel=leftover)
        plan = planner.plan(*ends, RouteOptions(neighbours=neighbours))
        assert optimum * (1 - 1e-5) <= plan.route.energy_j <= optimum * 1.005


def test_partial_descents_across_a_braking_slope():
    """Energy is free where tan(theta) <= -mu: inside that cone a goal costs nothing, outside the straight line wins."""
    robot = Robot(rolling_resistance=0.1, max_grade_deg=60.0, max_cross_slope_deg=60.0, idle_power_w=0.0)
    planner = RoutePlanner(plane_lattice(100, 100, 0.0, 0.3, robot=robot))
    inside = planner.plan((20.5, 60.5), (40.5, 50.5))  # heading with slope -0.3 * 10 / 22.4 = -0.134 < -mu
    assert inside.route.energy_j == pytest.approx(0.0, abs=1e-9)
    outside = planner.plan((20.5, 60.5), (60.5, 50.5))
    length = np.hypot(40.0, 10.0)
    expected = robot.weight_n * (0.1 * length - 0.3 * 10.0)
    assert outside.route.energy_j == pytest.approx(expected, rel=1e-5)
    grid = planner.plan((20.5, 60.5), (60.5, 50.5), RouteOptions(refine=False))
    assert grid.route.energy_j > 1.5 * expected  # what 16 neighbours alone would have claimed


def test_regenerated_energy_makes_negative_edges_and_stays_exact():
    """Down a 0.3 slope with mu = 0.1 and regeneration r, the straight line returns r m g (0.3 - 0.1) per metre."""
    robot = Robot(
        rolling_resistance=0.1, regeneration=0.6, idle_power_w=0.0, max_grade_deg=60.0, max_cross_slope_deg=60.0
    )
    planner = RoutePlanner(plane_lattice(60, 60, 0.0, 0.3, robot=robot))
    plan = planner.plan((30.5, 50.5), (30.5, 10.5))
    assert plan.route.energy_j == pytest.approx(-40.0 * 0.6 * robot.weight_n * 0.2, rel=1e-6)


def test_a_hill_is_rounded_when_that_is_cheaper_and_never_dearer_than_the_straight_line():
    frame = GridFrame(0.0, 100.0, 1.0, 100, 100)
    x, y = np.meshgrid(*frame.centres())
    bump = 8.0 * np.exp(-((x - 50) ** 2 + (y - 50) ** 2) / 200.0)
    gradient = (-bump * (x - 50) / 100.0, -bump * (y - 50) / 100.0)
    robot = Robot(rolling_resistance=0.05, max_grade_deg=60.0, max_cross_slope_deg=60.0)
    plan = RoutePlanner(surface_lattice(frame, bump, gradient, robot)).plan((10.0, 50.0), (90.0, 50.0))
    assert plan.shortest.length_m == pytest.approx(80.0, rel=1e-9)
    assert plan.route.energy_j < 0.9 * plan.shortest.energy_j
    assert np.abs(plan.route.points[:, 1] - 50).max() > 5.0
