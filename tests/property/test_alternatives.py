"""Other ways: each drivable, priced as it claims, truly another one, and the obvious ones are found."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.errors import NoRouteError
from joulemap.model.robot import Robot
from joulemap.planner.grid.search import grid_search
from joulemap.planner.pricing.integrator import path_price
from joulemap.planner.pricing.moves import move_table
from joulemap.planner.questions.alternatives import STRETCH, alternative_paths, improved_ways
from joulemap.planner.route_planner import RouteOptions, RoutePlanner
from tests.reference.lattices import ascii_lattice, random_lattice

ISLANDS = """
    .........................
    .........................
    .....###############.....
    .....###############.....
    .....###############.....
    a.......................b
    .....###############.....
    .....###############.....
    .....###############.....
    .........................
"""


@pytest.mark.parametrize("turn", [0.0, 0.01])
def test_the_ways_round_two_islands_are_three(turn):
    lattice, at = ascii_lattice(
        ISLANDS, robot=Robot(idle_power_w=0.5, speed_mps=0.5, turn_j_per_rad=turn, tracking_std_m=0.0)
    )
    ends = [np.array(lattice.frame.rowcol(*at[name])) for name in "ab"]
    paths = alternative_paths(lattice, move_table(lattice), *ends, count=5)
    through = [next(int(row) for row, col in path.points if abs(col - 12) <= 1) for path in paths]
    assert through[0] == 5
    assert sorted(through[1:3]) == [1, 9]  # north and south of both, hugging them
    assert len(paths) == 3


@pytest.mark.parametrize("turn", [0.0, 0.01])
def test_the_any_angle_step_draws_no_other_way_into_the_best(turn):
    lattice, at = ascii_lattice(
        ISLANDS, robot=Robot(idle_power_w=0.5, speed_mps=0.5, turn_j_per_rad=turn, tracking_std_m=0.0)
    )
    plan = RoutePlanner(lattice).plan(at["a"], at["b"], RouteOptions(alternatives=4))
    north_or_south = 2.0 * np.hypot(5.0, 4.0) + 14.0  # along the outer corners of both islands
    assert [way.length_m for way in plan.others] == pytest.approx([north_or_south] * 2, rel=0.02)


def test_where_bends_cost_more_than_any_detour_saves_there_is_one_way():
    plain, at = ascii_lattice("\n".join(["." * 30] * 9 + ["a" + "." * 28 + "b"] + ["." * 30] * 9))
    prices = np.random.default_rng(3).uniform(40.0, 50.0, plain.traction_per_m.shape).astype(np.float32)
    lattice = replace(plain, robot=replace(plain.robot, turn_j_per_rad=2000.0), traction_per_m=prices)
    plan = RoutePlanner(lattice).plan(at["a"], at["b"], RouteOptions(alternatives=4))
    assert plan.route.length_m == pytest.approx(29.0)
    assert plan.others == ()


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), turn=st.sampled_from([0.0, 20.0]), regeneration=st.sampled_from([0.0, 0.4]))
def test_other_ways_are_drivable_and_priced_as_claimed(seed, turn, regeneration):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, 30, 30, turn_j_per_rad=turn, regeneration=regeneration)
    table = move_table(lattice)
    start, goal = rng.uniform(0.0, 29.0, (2, 2))
    try:
        paths = alternative_paths(lattice, table, start, goal, count=4)
    except NoRouteError:
        return
    best = grid_search(lattice, table, start, goal)
    assert paths[0].energy_j == best.energy_j
    for path in paths:
        assert path.energy_j <= max(STRETCH * best.energy_j, best.energy_j)
        price = path_price(lattice, path.points)
        assert price == pytest.approx(path.energy_j, rel=1e-6, abs=1e-3)
        np.testing.assert_array_equal(path.points[[0, -1]], [start, goal])


@pytest.mark.parametrize("border", [-0.5, 19.5])
def test_a_path_along_the_border_of_the_map_has_alternatives_too(border):
    """It passes an island on the side of the border, the alternative on the other side."""
    free, island = "." * 40, "." * 12 + "#" * 16 + "." * 12
    rows = [free] * 14 + [island] * 3 + [free] * 3
    lattice, _ = ascii_lattice("\n".join(rows if border > 10.0 else rows[::-1]))
    along = np.array([(border, 1.5), (border, 38.5)])
    inside = 13.0 if border > 10.0 else 6.0
    other = np.array([along[0], (inside, 11.0), (inside, 29.0), along[1]])
    (way,) = improved_ways(lattice, along, [other])
    assert path_price(lattice, along) < path_price(lattice, way) <= path_price(lattice, other)
