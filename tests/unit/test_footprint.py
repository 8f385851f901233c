"""The robot's outline: doors and lanes in closed form, and routes against a slow check at one centimetre."""

import math

import numpy as np
import pytest

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.errors import BlockedError, NoRouteError
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.planner.lattice import Blocked
from joulemap.planner.lattice.build import build_lattice, write_lattice
from joulemap.planner.lattice.loading import load_lattice
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.planner.lattice.tiles import Tiling
from joulemap.planner.pricing.integrator import leg_prices
from joulemap.planner.route_planner import RouteOptions, RoutePlanner
from joulemap.planner.stored_planner import StoredPlanner
from tests.reference.outline import ROBOTS, first_collision, wall_with_door, world_with_walls

ANGLES_DEG = (0.0, 17.0, 31.0, 45.0, 68.0, 90.0)
CELLS_M = 0.05
SPACING_M = 0.1


def passes(heightmap: Heightmap, robot: Robot, angle_deg: float) -> bool:
    planner = RoutePlanner(build_lattice(heightmap, robot, PhysicsPredictor(), spacing_m=SPACING_M))
    angle = math.radians(angle_deg)
    away = 2.5 * np.array([math.cos(angle), -math.sin(angle)])
    try:
        route = planner.plan(tuple(4.0 - away), tuple(4.0 + away)).route
    except NoRouteError:
        return False
    # on level ground through the middle of the door: the paper's eq. 5 without a climb
    level_per_m = robot.weight_n * robot.rolling_resistance + robot.hotel_per_m
    assert route.energy_j == pytest.approx(level_per_m * 5.0, rel=0.02)
    return True


@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
@pytest.mark.parametrize(("width_m", "length_m", "clearance_m"), [(0.3, 0.3, 0.0), (0.55, 0.6, 0.0), (0.5, 1.0, 0.1)])
def test_a_door_wider_than_the_robot_its_clearance_and_a_cell_is_found_and_a_narrower_one_is_not(
    angle_deg, width_m, length_m, clearance_m
):
    robot = Robot(width_m=width_m, length_m=length_m, clearance_m=clearance_m, tracking_std_m=0.0)
    needed_m = width_m + 2.0 * clearance_m
    pixel_m = CELLS_M * (abs(math.cos(math.radians(angle_deg))) + abs(math.sin(math.radians(angle_deg))))  # of its rim
    assert passes(wall_with_door(needed_m + SPACING_M + pixel_m, angle_deg, cells_m=CELLS_M), robot, angle_deg)
    assert not passes(wall_with_door(needed_m - pixel_m, angle_deg, cells_m=CELLS_M), robot, angle_deg)


def test_a_leg_is_open_exactly_where_the_rectangle_fits():
    # walls along x = 2.9 and x = 5.1 m: a lane of 2.2 m to the north, from wall pixel to wall pixel
    frame = GridFrame(0.0, 8.0, 0.1, 80, 80)
    x, _ = np.meshgrid(*frame.centres())
    wall = (np.abs(x - 2.85) < 0.05) | (np.abs(x - 5.15) < 0.05)
    heightmap = Heightmap(np.where(wall, 1.0, 0.0).astype(np.float32), frame)
    robot = Robot(width_m=1.0, length_m=2.0, centre_ahead_m=0.4)
    lattice = build_lattice(heightmap, robot, PhysicsPredictor(), spacing_m=0.2)

    def is_open(x0, y0, x1, y1):
        row, col = lattice.frame.rowcol([x0, x1], [y0, y1])
        return bool(np.isfinite(leg_prices(lattice, np.column_stack([row, col])))[0])

    for half, side in ((0.5, 1.0), (0.5, -1.0)):
        middle = 4.0 + side * (1.1 - half)
        assert is_open(middle - side * 1e-3, 2.0, middle - side * 1e-3, 6.0)
        assert not is_open(middle + side * 1e-3, 2.0, middle + side * 1e-3, 6.0)
    # to the east the nose is 1.4 m ahead of the reference point and the tail 0.6 m behind it: 2.0 of the 2.2 m
    assert is_open(3.51, 4.0, 3.69, 4.0)
    assert not is_open(3.51, 4.0, 3.71, 4.0)
    assert not is_open(3.49, 4.0, 3.69, 4.0)
    # turned by a: half of w cos a + l sin a on the side of the nose
    for degrees in (10.0, 30.0):
        a = math.radians(degrees)
        right = 0.5 * math.cos(a) + 1.4 * math.sin(a)  # of the front right corner
        for short, free in ((1e-3, True), (-1e-3, False)):
            x0 = 5.1 - right - short
            assert is_open(x0 - 0.05 * math.sin(a), 4.0 - 0.05 * math.cos(a), x0, 4.0) == free


@pytest.mark.parametrize(("robot", "cells_m", "spacing_m"), ROBOTS)
def test_no_pose_of_a_route_meets_a_wall(robot, cells_m, spacing_m):
    rng = np.random.default_rng(11)
    wall, heightmap = world_with_walls(rng, robot, cells_m=cells_m, spacing_m=spacing_m)
    planner = RoutePlanner(build_lattice(heightmap, robot, PhysicsPredictor(), spacing_m=spacing_m))
    east = heightmap.frame.bounds[2]
    found = 0
    for _ in range(4):
        start, goal = rng.uniform(0.05 * east, 0.95 * east, (2, 2))
        try:
            plan = planner.plan(tuple(start), tuple(goal), RouteOptions(snap=True))
        except (NoRouteError, BlockedError):
            continue
        found += 1
        for route in (plan.route, plan.shortest):
            assert first_collision(route.points[:, :2], robot, wall, heightmap.frame) is None
    assert found >= 2


def test_stored_and_read_again_it_is_the_same(tmp_path):
    heightmap = wall_with_door(0.9, 17.0, cells_m=CELLS_M)
    robot = Robot()
    tiling = Tiling.of(heightmap.frame, spacing_m=SPACING_M, headings=8, side=16)
    write_lattice(tmp_path / "a.zarr", heightmap, robot, PhysicsPredictor(), tiling)
    whole = build_lattice(heightmap, robot, PhysicsPredictor(), spacing_m=SPACING_M, headings=8)
    back, stored = load_lattice(tmp_path / "a.zarr"), StoredLattice(tmp_path / "a.zarr")
    part = stored.window(20, 50, 25, 60)
    expected = whole.blocked_by_heading()
    assert (expected == Blocked.OBSTACLE).any()
    np.testing.assert_array_equal(back.blocked_by_heading(), expected)
    np.testing.assert_array_equal(part.blocked_by_heading(), expected[20:50, 25:60])
    ends = (2.0, 2.0), (6.0, 6.0)
    from_disk = StoredPlanner(stored.path).plan(*ends).route
    assert from_disk.energy_j == pytest.approx(RoutePlanner(whole).plan(*ends).route.energy_j, rel=1e-3)
    write_lattice(tmp_path / "b.zarr", heightmap, Robot(width_m=1.1), PhysicsPredictor(), tiling)
    with pytest.raises(NoRouteError):
        StoredPlanner(tmp_path / "b.zarr").plan(*ends)


def test_a_map_without_steps_has_no_obstacles():
    level = Heightmap(np.zeros((80, 80), dtype=np.float32), GridFrame(0.0, 8.0, 0.1, 80, 80))
    assert build_lattice(level, Robot(), PhysicsPredictor()).obstacles is None


def test_a_map_too_coarse_for_the_robot_says_so():
    level = Heightmap(np.zeros((20, 20), dtype=np.float32), GridFrame(0.0, 40.0, 2.0, 20, 20))
    warnings = build_lattice(level, Robot(width_m=1.5, length_m=2.0), PhysicsPredictor(), spacing_m=2.0).provenance[
        "warnings"
    ]
    assert any("cells of 2 m are not smaller than" in line for line in warnings)
