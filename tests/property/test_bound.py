"""No route of any angles costs less than the bound: refined grids, improved paths and random polylines."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from joulemap.model.errors import NegativeCycleError, NoRouteError
from joulemap.model.robot import Robot
from joulemap.planner.any_angle.best import best_path
from joulemap.planner.pricing.integrator import path_price
from joulemap.planner.pricing.moves import move_table
from joulemap.planner.questions.bound import bound_table, energy_bound, quick_bound
from tests.reference.lattices import ascii_lattice, plane_lattice, random_lattice


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    regeneration=st.sampled_from([0.0, 0.0, 0.5]),
    limit=st.sampled_from([10.0, 30.0]),
    blocked=st.booleans(),
)
def test_no_path_costs_less_than_the_bound(seed, regeneration, limit, blocked):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, 14, 17, regeneration=regeneration, max_grade_deg=limit)
    if not blocked:
        lattice.blocked[:] = 0
    prices = bound_table(lattice)
    if prices is None:
        return
    start, goal = rng.uniform(-0.5, 13.5, (2, 2))
    try:
        best = best_path(lattice, move_table(lattice, neighbours=32), start, goal)
    except (NoRouteError, NegativeCycleError):
        return
    bound = max(energy_bound(lattice, prices, start, goal), quick_bound(lattice, start, goal))
    assert bound <= best.energy_j + 1e-6 * abs(best.energy_j)
    for _ in range(30):
        corners = rng.uniform(-0.5, 13.5, (int(rng.integers(0, 4)), 2))
        price = path_price(lattice, np.vstack([start, corners, goal]))
        assert not price < bound - 1e-6 * abs(bound)


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.05, 0.02)])
def test_on_a_plane_the_bound_is_within_that_of_eight_headings(slope):
    """The grid of 8 neighbours is 1.0824 dearer at worst, and here the rise is counted exactly."""
    lattice = plane_lattice(60, 60, *slope, robot=Robot())
    prices = bound_table(lattice)
    start = np.array([50.0, 10.0])
    for goal in ((10.0, 50.0), (10.0, 30.0), (50.0, 50.0), (20.5, 40.25)):
        straight = path_price(lattice, np.array([start, goal]))
        bound = energy_bound(lattice, prices, start, np.array(goal))
        assert 0.85 * straight <= bound <= straight


def test_a_wall_of_one_cell_holds_the_bound_off():
    lattice, at = ascii_lattice(
        "\n".join(["." * 21] * 8 + ["a" + "." * 9 + "#" + "." * 9 + "b"] + ["." * 10 + "#" + "." * 10] * 8)
    )
    lattice.blocked[1:8, 10] = 3
    start, goal = (np.array(lattice.frame.rowcol(*at[name])) for name in "ab")
    around = 2.0 * np.hypot(10.0, 8.0)
    assert energy_bound(lattice, bound_table(lattice), start, goal) >= 0.9 * around


def test_the_bound_goes_through_a_passage_of_one_cell():
    """No square between cell centres lies in it: routes go along the sides of squares alone."""
    wall = ["......#####......"] * 3
    lattice, at = ascii_lattice("\n".join([*wall, "a...............b", *wall]))
    ends = np.array([lattice.frame.rowcol(*at[name]) for name in "ab"])
    straight = path_price(lattice, ends)
    assert 0.85 * straight <= energy_bound(lattice, bound_table(lattice), *ends) <= straight


def test_a_limit_of_the_cross_slope_closes_headings_across_the_slope_and_no_others():
    """Uphill is 22 degrees north of east: to the north-east the ground tilts a robot little, to the south-east much."""
    along, across = np.array([[10.0, 2.0], [2.0, 10.0]]), np.array([[2.0, 2.0], [10.0, 10.0]])
    bounds = {}
    for most_deg in (20.0, 1.8):
        lattice = plane_lattice(13, 13, 0.06, 0.024, robot=Robot(max_cross_slope_deg=most_deg))
        prices = bound_table(lattice)
        ways = along, along[::-1], across, across[::-1]
        bounds[most_deg] = [energy_bound(lattice, prices, *ends) for ends in ways]
        assert np.isnan([path_price(lattice, ends) for ends in ways]).tolist() == [
            False,
            False,
            *(2 * [most_deg < 2.0]),
        ]
    assert bounds[1.8][:2] == pytest.approx(bounds[20.0][:2], rel=1e-6)
    assert bounds[1.8][2] > 1.05 * bounds[20.0][2]
    assert bounds[1.8][3] > 1.05 * bounds[20.0][3]
