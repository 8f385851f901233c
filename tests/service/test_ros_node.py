"""The node of ROS 2 over stand-ins of its seam: actions of Nav2, the grid of costs, battery and odometry, forecasts."""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import joulemap as jm
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.ros.node import JoulemapNode, start
from tests.service.ros_standin import OverDds, StandIn, battery, moved, place

ORIGIN = (500_000.0, 4_000_000.0)
"""As of UTM: where float32 has steps of 0.25 m north."""


@pytest.fixture(scope="module")
def costmap() -> jm.CostMap:
    y, x = np.mgrid[0:40, 0:120]
    heights = np.where((x - 60) ** 2 + (y - 20) ** 2 < 25, 5.0, 0.0)  # a rock in the middle
    return jm.costmap(
        Heightmap(heights.astype(np.float32), GridFrame(ORIGIN[0], ORIGIN[1] + 40.0, 1.0, 40, 120)), model="physics"
    )


def node(costmap: jm.CostMap, ros: Any = None) -> tuple[Any, JoulemapNode]:
    ros = ros or StandIn()
    return ros, JoulemapNode(ros, costmap, origin=ORIGIN, reserve=0.1)


def places_of(path: Any) -> list[tuple[float, float]]:
    return [(pose.pose.position.x, pose.pose.position.y) for pose in path.poses]


def test_a_path_to_a_pose_is_the_route_in_the_frame_of_the_map(costmap: jm.CostMap) -> None:
    ros, _ = node(costmap)
    done, result = ros.ask(
        "compute_path_to_pose", start=place(ros, 10, 20), goal=place(ros, 110, 20, yaw=1.0), use_start=True
    )
    assert done, ros.errors
    places = places_of(result.path)
    assert places[0] == pytest.approx((10.0, 20.0))
    assert places[-1] == pytest.approx((110.0, 20.0))
    assert min(math.dist(one, (60.0, 20.0)) for one in places) > 5.0  # round the rock
    turned = result.path.poses[-1].pose.orientation
    assert 2.0 * math.atan2(turned.z, turned.w) == pytest.approx(1.0)
    for here, there, pose in zip(places, places[1:], result.path.poses[:-1], strict=False):
        yaw = 2.0 * math.atan2(pose.pose.orientation.z, pose.pose.orientation.w)
        assert math.cos(yaw - math.atan2(there[1] - here[1], there[0] - here[0])) > 0.99
    assert result.path.header.frame_id == "map"
    assert result.planning_time.nanosec + result.planning_time.sec > 0
    route = costmap.plan((ORIGIN[0] + 10, ORIGIN[1] + 20), (ORIGIN[0] + 110, ORIGIN[1] + 20))
    length = sum(math.dist(a, b) for a, b in zip(places, places[1:], strict=False))
    assert length == pytest.approx(route.length_m, rel=0.01)


def test_a_path_through_poses_visits_all_of_them(costmap: jm.CostMap) -> None:
    ros, _ = node(costmap)
    goals = [place(ros, 30, 35), place(ros, 30, 35), place(ros, 90, 5)]
    done, result = ros.ask("compute_path_through_poses", start=place(ros, 10, 20), goals=goals, use_start=True)
    assert done, ros.errors
    places = places_of(result.path)
    assert all(min(math.dist(one, goal) for one in places) < 0.6 for goal in ((10, 20), (30, 35), (90, 5)))


@pytest.mark.parametrize(
    ("asked", "code", "words"),
    [
        ({"start": (10, 20), "goal": (500, 20)}, 205, "outside the map"),
        ({"start": (-50, 20), "goal": (20, 20)}, 204, "outside the map"),
        ({"start": (10, 20), "goal": (20, 20, "odom")}, 203, "'odom'"),
        ({"goal": (20, 20)}, 201, "no odometry came yet"),
        ({"start": (10, 20), "goal": (10, 20)}, 201, "at its goal"),
    ],
)
def test_what_cannot_be_planned_has_the_code_of_nav2(costmap: jm.CostMap, asked: Any, code: int, words: str) -> None:
    ros, _ = node(costmap)
    sent = {name: place(ros, *where) for name, where in asked.items()}
    done, result = ros.ask("compute_path_to_pose", use_start="start" in asked, **sent)
    assert not done
    assert result.error_code == code
    assert words in result.error_msg
    assert words in ros.errors[0]


def test_the_grid_of_costs_has_its_rows_from_the_south_and_blocked_cells(costmap: jm.CostMap) -> None:
    ros, _ = node(costmap)
    (grid,) = ros.published["joulemap/costs"]
    cells = np.frombuffer(grid.data, np.int8).reshape(grid.info.height, grid.info.width)
    assert (grid.info.resolution, cells.shape) == (1.0, costmap.lattice.frame.shape)
    assert (grid.info.origin.position.x, grid.info.origin.position.y) == pytest.approx((0.0, 0.0), abs=1.0)
    mean = np.flipud(costmap.lattice.mean_energy_per_m())
    assert ((cells == 100) == ~np.isfinite(mean)).all()
    assert cells[20, 60 - 5] == 100  # the rim of the rock
    assert cells.min() == 0
    assert cells.max() == 100


def test_battery_and_odometry_give_forecasts_that_stay_when_nav2_plans_again(costmap: jm.CostMap) -> None:
    ros, _ = node(costmap)
    ros.taken["odom"](moved(ros, 5.0, 5.0, frame="odom"))
    assert "'odom'" in ros.errors.pop()
    ros.taken["odom"](moved(ros, 10.0, 8.0))
    ros.taken["battery_state"](battery(ros, 0.0, 60.0, 0.8))
    assert "joulemap/forecast" not in ros.published  # no path yet
    assert ros.ask("compute_path_to_pose", goal=place(ros, 110, 8), use_start=False)[0], ros.errors
    route = costmap.plan((ORIGIN[0] + 10, ORIGIN[1] + 8), (ORIGIN[0] + 110, ORIGIN[1] + 8))
    power = 1.5 * route.energy_j / (route.length_m / costmap.robot.speed_mps)
    for k in range(60):
        if k == 40:  # Nav2 plans again
            assert ros.ask("compute_path_to_pose", goal=place(ros, 110, 8), use_start=False)[0], ros.errors
        ros.taken["odom"](moved(ros, 10.0 + 0.5 * k, 8.0))
        ros.taken["battery_state"](battery(ros, 0.5 * k / costmap.robot.speed_mps, power, 0.8 - 0.001 * k))
    assert not ros.errors
    said = ros.published["joulemap/forecast"]
    values = [{pair.key: pair.value for pair in one.status[0].values} for one in (said[0], said[39], said[45])]
    more = [float(one["energy_j"]) / float(one["planned_j"]) for one in values]
    assert more[0] == pytest.approx(1.0, abs=0.05)
    assert more[1] > 1.3
    assert more[2] == pytest.approx(more[1], abs=0.1)
    assert float(values[2]["charge"]) == pytest.approx(0.755, abs=0.002)
    assert said[-1].status[0].level == b"\x00"
    assert "more than planned" in said[-1].status[0].message


def test_topics_reach_another_participant_of_dds_and_come_from_it(costmap: jm.CostMap) -> None:
    pytest.importorskip("cyclonedds", reason="pip install cyclonedds")
    ros, there = OverDds(7), OverDds(7)
    got: dict[str, list[Any]] = {"costs": [], "forecast": []}
    there.subscribe("joulemap/forecast", "diagnostic_msgs/msg/DiagnosticArray", got["forecast"].append)
    odometry = there.publisher("odom", "nav_msgs/msg/Odometry")
    states = there.publisher("battery_state", "sensor_msgs/msg/BatteryState")
    _, made = node(costmap, ros)
    assert ros.ask("compute_path_to_pose", start=place(ros, 10, 8), goal=place(ros, 110, 8), use_start=True)[0]
    for k in range(40):
        odometry(moved(there, 10.0 + 0.5 * k, 8.0))
        states(battery(there, float(k), 60.0, 0.8))
        until = time.monotonic() + 5.0
        while ros.spin_once() < 1 and time.monotonic() < until:
            time.sleep(0.01)
        time.sleep(0.02)
        ros.spin_once()
        there.spin_once()
    assert made.drive is not None
    assert made.drive.forecast().learnt_m > 5.0
    assert len(got["forecast"]) > 5
    assert got["forecast"][-1].status[0].name == "joulemap: drive"


def test_what_keeps_the_node_from_starting_is_one_sentence(
    costmap: jm.CostMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    costmap.save(tmp_path / "map.zarr")
    monkeypatch.setitem(sys.modules, "rclpy", None)
    for name, words in (("map.zarr", "source /opt/ros/jazzy/setup.bash first"), ("no.zarr", "there is no cost map")):
        monkeypatch.setattr(sys, "argv", ["joulemap-ros", str(tmp_path / name)])
        with pytest.raises(SystemExit) as stop:
            start()
        said = capsys.readouterr().err
        assert stop.value.code in (3, 5)
        assert words in said
        assert len(said.splitlines()) == 1
