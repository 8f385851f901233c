"""The leg integrator against closed forms and brute-force quadrature."""

import numpy as np
import pytest

from joulemap.model.errors import PointError
from joulemap.model.frames import heading_bins
from joulemap.model.robot import Robot
from joulemap.planner.pricing.integrator import (
    energy_per_m_at,
    interpolation_matrix,
    leg_prices,
    path_price,
    world_points,
)
from joulemap.planner.route import price_route
from tests.reference.lattices import ascii_lattice, plane_lattice, price_world_path, random_lattice
from tests.reference.quadrature import fourier_at, leg_energy_by_midpoints


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("regeneration", [0.0, 0.4])
def test_a_leg_is_the_line_integral_of_the_lattice(seed, regeneration):
    rng = np.random.default_rng(seed)
    lattice = random_lattice(rng, 30, 40, regeneration=regeneration, max_grade_deg=60.0, max_cross_slope_deg=60.0)
    lattice.blocked[:] = 0
    lattice.gradient[:] = 0.0  # no limits in the way
    for _ in range(5):
        start, end = rng.uniform([100, 170], [140, 200]), rng.uniform([100, 170], [140, 200])
        slow = leg_energy_by_midpoints(lattice, start, end)
        assert price_world_path(lattice, [start, end]) == pytest.approx(slow, rel=2e-6)


def test_cutting_or_joining_a_leg_leaves_its_energy():
    rng = np.random.default_rng(3)
    lattice = random_lattice(rng, 30, 40, regeneration=0.3, max_grade_deg=60.0, max_cross_slope_deg=60.0)
    lattice.blocked[:] = 0
    lattice.gradient[:] = 0.0
    start, end = np.array([101.3, 171.2]), np.array([138.9, 197.7])
    whole = price_world_path(lattice, [start, end])
    for cuts in ([0.5], [0.1, 0.11, 0.7], np.linspace(0.01, 0.99, 57)):
        parts = [start, *(start + c * (end - start) for c in cuts), end]
        assert price_world_path(lattice, parts) == pytest.approx(whole, rel=1e-12)


@pytest.mark.parametrize("rise", [(0.0, 0.0), (0.12, -0.05), (-0.2, 0.1)])
def test_a_tilted_plane_costs_weight_times_mu_length_plus_climb(rise):
    """science: E = m g (mu L + dh) + P_idle / v * L while nothing is clipped, L horizontal."""
    robot = Robot(rolling_resistance=0.3)
    lattice = plane_lattice(50, 60, *rise, robot=robot)
    start, end = np.array([3.2, 4.1]), np.array([55.0, 44.4])
    for a, b in ((start, end), (end, start)):
        length, climb = np.hypot(*(b - a)), (b - a) @ np.array(rise)
        expected = robot.weight_n * (0.3 * length + climb) + robot.hotel_per_m * length
        assert price_world_path(lattice, [a, b]) == pytest.approx(expected, rel=1e-6)


def test_a_descent_steeper_than_mu_is_free_but_for_the_hotel_load():
    """science: braking, E = 0 where tan(theta) <= -mu; with regeneration the share comes back."""
    for regeneration in (0.0, 0.5):
        robot = Robot(rolling_resistance=0.05, regeneration=regeneration)
        lattice = plane_lattice(40, 40, 0.0, 0.2, robot=robot)
        down = price_world_path(lattice, [[20.5, 35.0], [20.5, 5.0]])
        expected = 30.0 * (robot.hotel_per_m + regeneration * robot.weight_n * (0.05 - 0.2))
        assert down == pytest.approx(expected, rel=1e-6)


def test_interpolation_reproduces_bins_and_every_fourier_series_below_half_their_number():
    rng = np.random.default_rng(0)
    for bins in (8, 16, 9):
        at_bins = interpolation_matrix(heading_bins(bins), bins)
        np.testing.assert_allclose(at_bins, np.eye(bins), atol=1e-12)
        headings = rng.uniform(-7, 7, 50)
        for order in range((bins + 1) // 2):
            values = np.cos(order * heading_bins(bins) + 0.7)
            np.testing.assert_allclose(
                interpolation_matrix(headings, bins) @ values, np.cos(order * headings + 0.7), atol=1e-12
            )
        values = rng.normal(size=bins)
        expected = [fourier_at(values, h) for h in headings]
        np.testing.assert_allclose(interpolation_matrix(headings, bins) @ values, expected, atol=1e-12)


def test_no_leg_leans_on_blocked_ground():
    lattice, at = ascii_lattice("""
        a..#...
        .......
        ..b.c..
    """)
    assert price_world_path(lattice, [at["b"], at["c"]]) == pytest.approx(2.0)
    assert np.isnan(price_world_path(lattice, [at["a"], [6.5, 2.5]]))  # through it
    assert np.isnan(price_world_path(lattice, [[2.5, 2.5], [3.5, 1.5]]))  # past its corner
    assert np.isfinite(price_world_path(lattice, [[2.5, 2.5], [2.5, 0.5], [4.5, 0.5], [4.5, 2.5]]))  # along its edge
    assert np.isnan(price_world_path(lattice, [[2.5, 2.5], [2.6, 2.5]]))  # next to it


def test_limits_hold_in_the_direction_of_the_leg():
    robot = Robot(max_grade_deg=10.0, max_cross_slope_deg=12.0)
    lattice = plane_lattice(20, 20, 0.0, np.tan(np.deg2rad(11.0)), robot=robot)
    middle = np.array([10.0, 10.0])
    for heading_deg, allowed in (
        (0, False),
        (180, False),
        (90, True),
        (20, False),
        (30, True),
        (-30, True),
        (150, True),
    ):
        step = np.array([np.sin(np.deg2rad(heading_deg)), np.cos(np.deg2rad(heading_deg))])
        assert np.isfinite(price_world_path(lattice, [middle, middle + 3 * step])) == allowed
    steep = plane_lattice(20, 20, 0.0, np.tan(np.deg2rad(13.0)), robot=robot)
    assert np.isnan(price_world_path(steep, [middle, middle + np.array([3.0, 0.0])]))  # across: 13 > 12 degrees


def test_price_at_a_point_is_the_limit_of_short_legs_and_equals_the_lattice_at_centres():
    rng = np.random.default_rng(1)
    lattice = random_lattice(rng, 12, 12)
    lattice.blocked[:] = 0
    lattice.gradient[:] = 0.0
    x, y = lattice.frame.xy(5, 6)
    prices = energy_per_m_at(lattice, float(x), float(y), heading_bins(lattice.headings))
    np.testing.assert_allclose(prices, lattice.energy_per_m[5, 6], rtol=0.02)
    x, y = lattice.frame.bounds[0], lattice.frame.bounds[3]
    assert np.isfinite(energy_per_m_at(lattice, x, y, [0.3])).all()


def test_turns_are_paid_by_the_radian():
    robot = Robot(turn_j_per_rad=100.0)
    lattice = plane_lattice(20, 20, robot=robot)
    path = np.array([[2.0, 2.0], [2.0, 10.0], [10.0, 10.0], [18.0, 18.0]])
    legs = leg_prices(lattice, world_points(lattice, path)).sum()
    assert price_world_path(lattice, path) - legs == pytest.approx(100.0 * (np.pi / 2 + np.pi / 4))


def test_bad_points_are_named():
    lattice = plane_lattice(5, 5, robot=Robot())
    with pytest.raises(PointError, match="point 1"):
        price_world_path(lattice, [[1.0, 1.0], [np.nan, 2.0]])
    with pytest.raises(PointError, match="shape"):
        price_world_path(lattice, [1.0, 2.0])
    assert np.isnan(price_world_path(lattice, [[1.0, 1.0], [1.0, 99.0]]))


def test_vertices_in_one_place_hide_no_turn():
    lattice = ascii_lattice("\n".join(["." * 20] * 20), robot=Robot(turn_j_per_rad=30.0))[0]
    corner = np.array([(4.0, 4.0), (4.0, 12.0), (12.0, 12.0)])
    repeated = corner[[0, 0, 1, 1, 1, 2, 2]]
    assert path_price(lattice, repeated) == pytest.approx(path_price(lattice, corner), rel=1e-12)
    routes = [price_route(lattice, np.column_stack(lattice.frame.xy(*path.T))) for path in (corner, repeated)]
    assert [route.energy_j for route in routes] == pytest.approx([path_price(lattice, corner)] * 2)
    for route in routes:
        assert route.profile.cumulative_j[-1] == pytest.approx(route.energy_j, rel=1e-9)
