"""The margin to closed ground: kept where another way exists, given up where none does, and then said."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

import joulemap as jm
from joulemap.model.errors import NoRouteError
from joulemap.model.robot import Robot
from joulemap.planner.any_angle.best import best_path
from joulemap.planner.pricing.integrator import (
    driven_prices,
    leg_prices_between,
    margin_cells,
    metres_within_margin,
    path_price,
)
from joulemap.planner.pricing.kernels import path_energy
from joulemap.planner.pricing.moves import move_table, with_margin
from joulemap.planner.route_planner import RouteOptions, RoutePlanner
from tests.reference.lattices import ascii_lattice, random_lattice

ROVER = Robot(idle_power_w=0.5, speed_mps=0.5, tracking_std_m=0.1)
WIDE = """
    ........................
    ........................
    .a......................
    ...........#............
    ########.###....########
    ...........#............
    ........................
    .b......................
    ........................
"""
TWO_NARROW = """
    ........................
    ........................
    .a......................
    ........................
    #.####.##....###########
    ........................
    ........................
    .b......................
    ........................
"""
BETWEEN_CENTRES = """
    ........................................
    .......a................................
    ........................................
    ........................................
    #######..###########################....
    #######..###########################....
    #######..###########################....
    #######..###########################....
    #######..###########################....
    #######..###########################....
    #######..###########################....
    #######..###########################....
    #######..###########################....
    #######..###########################....
    ........................................
    ........................................
    .......b................................
    ........................................
    """
"""Between the centres of two open columns a path keeps half a cell to both sides; no move over the grid does."""
NARROW = WIDE.replace("....########", "############")


def planned(drawing, robot, **how):
    lattice, at = ascii_lattice(drawing, robot=robot)
    return RoutePlanner(lattice).plan(at["a"], at["b"], RouteOptions(**how))


def test_a_wide_gap_is_taken_though_a_narrow_one_is_nearer():
    exact, kept = (planned(WIDE, replace(ROVER, tracking_std_m=std)) for std in (0.0, 0.1))
    assert exact.route.length_m < 17.0
    assert kept.route.length_m > exact.route.length_m + 2.0
    assert kept.route.notes == []
    assert metres_within_margin(*_as_points(WIDE, kept)) == 0.0
    assert kept.shortest.length_m == pytest.approx(kept.route.length_m, rel=0.02)  # it keeps the margin too


def test_a_passage_between_two_columns_of_centres_is_found():
    plan = planned(BETWEEN_CENTRES, ROVER)
    assert metres_within_margin(*_as_points(BETWEEN_CENTRES, plan)) == 0.0
    assert plan.route.length_m < 17.0  # and not around the wall, 68 m


def test_of_two_narrow_ways_the_shorter_one_is_taken():
    """Which of them is narrower, moves over the grid do not say."""
    drawing = np.full((60, 40), ".")
    drawing[10:50, :36] = "#"
    drawing[10:50, 4:6] = "."
    drawing[10:50, 38:] = "#"
    drawing[2, 5], drawing[57, 5] = "a", "b"
    plan = planned("\n".join(map("".join, drawing)), replace(ROVER, tracking_std_m=0.4))
    assert plan.route.length_m < 60.0  # by the other one it is 110 m


def test_the_edge_of_a_map_is_no_closed_ground():
    lattice, _ = ascii_lattice("\n".join(["." * 40] * 12), robot=replace(ROVER, tracking_std_m=0.5))
    along = np.array([[0.0, 4.0], [0.2, 30.0]])
    assert metres_within_margin(lattice, along) == 0.0
    assert path_energy(driven_prices(lattice, 10.0), along) == pytest.approx(path_price(lattice, along))


def test_the_shortest_path_does_not_replace_one_that_keeps_the_margin():
    """The same penalty decides between ways in the search and after it."""
    plan = planned(TWO_NARROW, ROVER, alternatives=2)
    assert metres_within_margin(*_as_points(TWO_NARROW, plan)) == 0.0
    assert plan.route.energy_j == pytest.approx(planned(TWO_NARROW, ROVER).route.energy_j)


def _as_points(drawing, plan):
    lattice, _ = ascii_lattice(drawing, robot=ROVER)
    return lattice, np.column_stack(lattice.frame.rowcol(*plan.route.points[:, :2].T))


def test_the_only_gap_is_taken_and_the_route_says_how_narrow_it_is():
    plan = planned(NARROW, ROVER)
    assert plan.route.length_m < 18.0
    (note,) = plan.route.notes
    assert "nearer than 0.5 m to ground that may not be driven" in note


def test_where_nothing_is_closed_paths_are_those_of_a_robot_that_tracks_exactly():
    drawing = "\n".join(["." * 30] * 12)
    lattices = [ascii_lattice(drawing, robot=replace(ROVER, tracking_std_m=std))[0] for std in (0.0, 0.2)]
    ends = np.array([3.2, 3.3]), np.array([9.7, 26.1])
    paths = [best_path(lattice, with_margin(move_table(lattice, neighbours=32), 0.5), *ends) for lattice in lattices]
    np.testing.assert_array_equal(paths[0].points, paths[1].points)


def test_a_path_that_keeps_the_margin_meets_no_closed_ground_when_it_is_driven_beside_its_line():
    rng, kept, exact = np.random.default_rng(4), [], []
    for seed in range(60):
        lattice = random_lattice(np.random.default_rng(seed), 60, 60, max_grade_deg=16.0, max_cross_slope_deg=16.0)
        robot = replace(lattice.robot, tracking_std_m=0.1)
        table, rover = move_table(lattice, neighbours=32), replace(lattice, robot=robot)
        ends = rng.integers(5, 55, (2, 2)).astype(float)
        with suppress(NoRouteError):
            path = best_path(rover, with_margin(table, margin_cells(rover)), *ends).points
            if metres_within_margin(rover, path) == 0.0:
                kept.append(share_closed(lattice, path, rng))
                exact.append(share_closed(lattice, best_path(lattice, table, *ends).points, rng))
    assert len(kept) > 3
    assert np.mean(exact) > 0.3
    assert np.mean(kept) < 0.02


def share_closed(lattice, path, rng):
    """The share of paths beside one, by 0.1 m (standard deviation), that may not be driven."""
    return np.mean([np.isnan(path_price(lattice, path + shift)) for shift in rng.normal(0.0, 0.1, (20, 2))])


@pytest.mark.parametrize(("std", "spacing"), [(0.1, 1.0), (0.4, 1.0), (0.1, 0.25), (5.0, 1.0)])
def test_the_price_of_a_driven_leg_is_the_mean_of_three_side_by_side(std, spacing):
    lattice = random_lattice(np.random.default_rng(1), 30, 30, tracking_std_m=std)
    lattice = replace(lattice, frame=replace(lattice.frame, resolution_m=spacing), gradient=0.0 * lattice.gradient)
    lattice.blocked[:] = 0
    margin = margin_cells(lattice)
    assert margin == pytest.approx(min(max(0.5, 3.0 * std / spacing), 3.0))
    leg = np.array([[12.0, 9.0], [15.0, 18.0]])
    along = np.diff(leg, axis=0)[0] / np.hypot(3.0, 9.0)
    across = np.array([along[1], -along[0]])
    longer = leg + margin * np.outer([-1.0, 1.0], along)
    sides = [longer + sign * margin * across for sign in (-1.0, 1.0)]
    exact, *beside = (leg_prices_between(lattice, line[:1], line[1:])[0] for line in (leg, *sides))
    share = np.hypot(3.0, 9.0) / (np.hypot(3.0, 9.0) + 2.0 * margin)
    weight = min(0.5 * (std / spacing / margin) ** 2, 1.0 / 3.0)
    expected = exact + weight * (share * sum(beside) - 2.0 * exact)
    assert path_energy(driven_prices(lattice, 10.0), leg) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("door", "clearance_m"), [(13, 0.0), (14, 0.0), (16, 0.05)])
def test_a_door_narrower_than_the_margin_is_driven_through_without_a_detour(door, clearance_m):
    heights = np.zeros((160, 160), dtype=np.float32)
    heights[78:82] = 1.0
    heights[78:82, 80 - door // 2 : 80 - door // 2 + door] = 0.0
    robot = jm.Robot(name="box", width_m=0.5, length_m=0.8, wheel_radius_m=0.06, clearance_m=clearance_m)
    costmap = jm.costmap(jm.heightmap(heights, resolution_m=0.05), robot=robot, model="physics", spacing_m=0.1)
    route = costmap.plan((4.0, 1.5), (4.0, 6.5))
    assert "nearer than 0.3 m" in " ".join(route.notes)
    assert route.energy_j < 1.015 * route.shortest.energy_j
