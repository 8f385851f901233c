"""Plans: what is asked, what is refused, and what comes back beside the route."""

from dataclasses import replace

import numpy as np
import pytest

from joulemap.model.battery import Battery
from joulemap.model.errors import BlockedError, InputError, NegativeCycleError, NoRouteError, PointError
from joulemap.model.robot import Robot
from joulemap.planner.any_angle.best import shorter_of
from joulemap.planner.kept_moves import distance_lattice
from joulemap.planner.pricing.integrator import path_price
from joulemap.planner.pricing.polylines import path_length
from joulemap.planner.route import price_route
from joulemap.planner.route_planner import PLANNERS, RouteOptions, RoutePlanner
from joulemap.planner.sampling.ompl_problem import price_floor_per_m
from joulemap.planner.verdict.budget import judge
from tests.reference.lattices import ascii_lattice, plane_lattice, price_world_path, random_lattice, uniform_lattice

ROOM = """
    ..........
    .a..#.....
    ....#...b.
    ....#.....
    ..........
"""


@pytest.mark.parametrize("planner", PLANNERS)
def test_every_planner_goes_round_the_wall(planner):
    lattice, at = ascii_lattice(ROOM)
    plan = RoutePlanner(lattice).plan(at["a"], at["b"], RouteOptions(planner=planner, time_limit_s=1.5, seed=4))
    assert plan.route.energy_j == pytest.approx(price_world_path(lattice, plan.route.points), rel=1e-9)
    np.testing.assert_allclose(plan.route.points[[0, -1], :2], [at["a"], at["b"]])
    straight = np.hypot(7, 1)
    assert straight < plan.shortest.energy_j <= plan.route.energy_j * (1 + 1e-9)  # 1 J/m: shortest is cheapest
    assert plan.route.energy_j < 1.06 * plan.shortest.energy_j
    assert plan.details["planner"] == planner


def test_a_sampling_planner_reports_its_progress_and_ever_better_paths():
    lattice, at = ascii_lattice(ROOM)
    seen: list[float] = []
    plan = RoutePlanner(lattice).plan(
        at["a"], at["b"], RouteOptions(planner="bitstar", time_limit_s=0.8, progress=seen.append)
    )
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    energies = [energy for _, energy in plan.details["history"]]
    assert energies == sorted(energies, reverse=True)


def test_what_cannot_be_asked_is_refused_by_name():
    lattice, at = ascii_lattice(ROOM)
    planner = RoutePlanner(lattice)
    with pytest.raises(BlockedError, match=r"start .* step"):
        planner.plan((4.5, 2.5), at["b"])
    with pytest.raises(BlockedError, match="goal"):
        planner.plan(at["a"], (4.5, 2.5))
    with pytest.raises(PointError, match=r"goal .* outside"):
        planner.plan(at["a"], (99.0, 2.5))
    with pytest.raises(PointError, match="finite"):
        planner.plan((np.nan, 1.0), at["b"])
    with pytest.raises(PointError, match="finite"):
        planner.plan(at["a"], (np.inf, 1.0))
    with pytest.raises(InputError, match="planner"):
        planner.plan(at["a"], at["b"], RouteOptions(planner="magic"))
    with pytest.raises(InputError, match="neighbours"):
        planner.plan(at["a"], at["b"], RouteOptions(neighbours=4))
    with pytest.raises(InputError, match="time_limit_s"):
        planner.plan(at["a"], at["b"], RouteOptions(planner="bitstar", time_limit_s=0.0))


def test_walled_in_there_is_no_route():
    lattice, at = ascii_lattice("""
        ..#....
        .a#..b.
        ..#....
    """)
    for planner in ("astar", "rrtstar"):  # the grid search proves it before any sampling
        with pytest.raises(NoRouteError, match="wall"):
            RoutePlanner(lattice).plan(at["a"], at["b"], RouteOptions(planner=planner, time_limit_s=60.0))


def test_a_start_next_to_blocked_ground_moves_to_its_cell_centre_and_says_so():
    lattice, at = ascii_lattice("""
        .....
        .#...
        ....b
    """)
    plan = RoutePlanner(lattice).plan((2.05, 1.5), at["b"])  # free cell, but a hand's breadth from the block
    np.testing.assert_allclose(plan.route.points[0, :2], [2.5, 1.5])
    assert any("start is next to blocked ground" in note for note in plan.route.notes)


def test_a_route_adds_up():
    lattice = plane_lattice(40, 40, 0.05, 0.1, robot=Robot(turn_j_per_rad=20.0))
    path = [[5.0, 5.0], [20.0, 30.0], [35.0, 8.0]]
    route = price_route(lattice, path)
    profile = route.profile
    assert route.energy_j == pytest.approx(profile.energy_j.sum(), rel=1e-9)
    assert route.energy_j == pytest.approx(profile.cumulative_j[-1], rel=1e-12)
    assert route.length_m == pytest.approx(np.hypot(15, 25) + np.hypot(15, 22))
    assert route.duration_s == pytest.approx(route.length_m / 0.5)
    assert np.diff(profile.distance_m, prepend=0.0).max() <= 1.0 + 1e-9
    z = lambda p: 0.05 * p[0] + 0.1 * p[1]  # noqa: E731
    assert route.climb_m - route.descent_m == pytest.approx(z(path[2]) - z(path[0]), abs=1e-4)
    np.testing.assert_allclose(route.points[:, 2], [z(p) for p in path], atol=1e-4)


def test_turning_is_planned_for_not_only_paid():
    """On flat ground with dear turns a route takes fewer radians than the grid's staircase, at any price of turning."""
    free = RoutePlanner(plane_lattice(30, 30, robot=Robot())).plan((3.5, 3.5), (26.5, 12.5), RouteOptions(refine=False))
    dear_robot = Robot(turn_j_per_rad=500.0)
    dear = RoutePlanner(plane_lattice(30, 30, robot=dear_robot)).plan(
        (3.5, 3.5), (26.5, 12.5), RouteOptions(refine=False)
    )

    def radians(points):
        heading = np.arctan2(*np.diff(points[:, :2], axis=0).T)
        return np.abs(np.angle(np.exp(1j * np.diff(heading)))).sum()

    assert radians(dear.route.points) <= radians(free.route.points) + 1e-9
    assert radians(dear.route.points) < 0.5  # one turn between two moves
    assert dear.details["grid_energy_j"] == pytest.approx(dear.route.energy_j, rel=1e-6)


def test_a_loop_that_fills_the_battery_is_refused_with_its_place():
    lattice = uniform_lattice(12, 12, lambda heading: -10.0)
    lattice = replace(lattice, robot=replace(lattice.robot, regeneration=0.5))
    with pytest.raises(NegativeCycleError, match="lower the robot's `regeneration`"):
        RoutePlanner(lattice).plan((2.5, 2.5), (9.5, 9.5))


def test_the_price_floor_is_below_every_price():
    rng = np.random.default_rng(2)
    for regeneration in (0.0, 0.5):
        lattice = random_lattice(rng, 12, 12, regeneration=regeneration)
        floor = price_floor_per_m(lattice)
        for _ in range(200):
            heading, centre = rng.uniform(0, 7), rng.uniform([103, 191], [109, 197])
            step = 0.01 * np.array([np.sin(heading), np.cos(heading)])
            price = price_world_path(lattice, [centre, centre + step]) / 0.01
            assert np.isnan(price) or price >= floor - 1e-6


def test_heights_beside_a_hole_are_the_nearest_known():
    """In the outer half cell heights are continued from two centres, of which one is in the hole."""
    lattice, at = ascii_lattice("""
        a....
        ...#.
        .....
    """)
    x, y = np.meshgrid(*lattice.frame.centres())
    elevation = (0.1 * x + 0.2 * y).astype(np.float32)
    hole = lattice.blocked > 0
    lattice = replace(lattice, elevation_m=np.where(hole, np.float32(np.nan), elevation))
    goal = (4.9, 1.5)  # 0.4 m beyond the last centre, and the one before it is unknown
    plan = RoutePlanner(lattice).plan(at["a"], goal)
    for route in (plan.route, plan.shortest, price_route(lattice, [goal, (4.5, 1.5), goal])):
        assert np.isfinite(route.points).all()
        assert np.isfinite([route.climb_m, route.descent_m]).all()
        assert np.isfinite(route.profile.z).all()
    assert plan.route.points[-1, 2] == pytest.approx(0.1 * 4.5 + 0.2 * 1.5, abs=1e-6)  # that of its own cell's centre
    far = price_route(lattice, [at["a"], (0.5, 0.1)])
    np.testing.assert_allclose(far.points[-1, 2], 0.1 * 0.5 + 0.2 * 0.1, atol=1e-6)  # elsewhere continued, as ever


def test_a_route_over_ground_of_unknown_height_has_no_heights():
    lattice, at = ascii_lattice("a...\n...b")
    route = price_route(replace(lattice, elevation_m=np.full_like(lattice.elevation_m, np.nan)), [at["a"], at["b"]])
    np.testing.assert_array_equal(route.points[:, :2], [at["a"], at["b"]])
    assert np.isnan(route.points[:, 2]).all()
    assert (route.climb_m, route.descent_m) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("energy_j", "feasible", "margin", "end"),
    [(100_000.0, True, 80_000.0, 0.8 - 100 / 360), (180_000.0, True, 0.0, 0.3), (252_000.0, False, -72_000.0, 0.1)],
)
def test_a_verdict_is_energy_against_charge_above_the_reserve(energy_j, feasible, margin, end):
    verdict = judge(energy_j, Battery(capacity_wh=100.0, charge=0.8, reserve=0.3))  # 180 kJ above the reserve
    assert verdict.feasible is feasible
    assert verdict.margin_j - verdict.shortfall_j == pytest.approx(margin)
    assert verdict.charge_at_end == pytest.approx(end)


def test_the_shortest_path_is_never_longer_than_the_route():
    lattice, _ = ascii_lattice(ROOM)
    distances = distance_lattice(lattice)
    around = np.array([(1.0, 1.0), (0.0, 2.0), (0.0, 6.0), (2.0, 8.0)])
    further = np.array([(1.0, 1.0), (3.0, 2.0), (0.0, 2.0), (0.0, 6.0), (4.0, 7.0), (2.0, 8.0)])
    assert shorter_of(lattice, distances, around, further) is around
    found = shorter_of(lattice, distances, further, around)
    assert path_length(found) <= path_length(around)
    np.testing.assert_array_equal(found[[0, -1]], around[[0, -1]])
    assert np.isfinite(path_price(lattice, found))
