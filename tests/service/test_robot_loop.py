"""The examples of the page on a robot in the loop, against a service: a robot that comes home, a planner for Nav2."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from fastapi.testclient import TestClient

import joulemap as jm
from joulemap.service.client import ServedCostMap
from tests.docs.code_blocks import blocks_of
from tests.service.conftest import GOAL, START

PAGE = "docs/how-to/my-robot-in-the-loop.md"


def example(name: str) -> dict[str, Any]:
    (block,) = [block for block in blocks_of(PAGE) if block.title == name]
    names: dict[str, Any] = {"__name__": name}
    exec(compile(block.text, name, "exec"), names)
    return names


@pytest.fixture(scope="module")
def service(client: TestClient) -> jm.Client:
    def _answer(request: httpx.Request) -> httpx.Response:
        answer = client.request(
            request.method, str(request.url), content=request.content, headers=dict(request.headers)
        )
        return httpx.Response(answer.status_code, headers=answer.headers, content=answer.content)

    return jm.Client("http://testserver", transport=httpx.MockTransport(_answer))


@pytest.fixture(scope="module")
def costmap(service: jm.Client, costmap_id: str) -> ServedCostMap:
    return service.open_costmap(costmap_id)


def test_a_robot_drives_there_and_home(costmap: ServedCostMap) -> None:
    names = example("robot_loop.py")
    robot = names["SimulatedRobot"](costmap, START)
    decided = list(names["RobotLoop"](costmap, START).drive(robot, GOAL))
    assert [heading_for for heading_for, _, _ in decided] == ["goal", "home"]
    assert all(verdict.feasible for _, _, verdict in decided)
    assert robot.position == pytest.approx(START, abs=1e-6)
    planned = sum(route.energy_j for _, route, _ in decided)
    used = (1.0 - robot.charge) * 3600.0 * costmap.about.robot.battery_wh
    assert used == pytest.approx(planned, rel=1e-6)


def test_a_robot_that_needs_more_than_planned_turns_home_in_time(costmap: ServedCostMap) -> None:
    names = example("robot_loop.py")
    loop = names["RobotLoop"](costmap, START, reserve=0.2)
    trip = costmap.feasibility(start=START, goal=GOAL, round_trip=True).energy_j
    charge = 0.2 + 1.05 * trip / (3600.0 * costmap.about.robot.battery_wh)
    robot = names["SimulatedRobot"](costmap, START, charge=charge, factor=1.3)
    decided = list(loop.drive(robot, GOAL, ask_every_m=2.0))
    assert [heading_for for heading_for, _, _ in decided] == ["goal", "home"]
    assert math.dist(decided[1][1].path[0][:2], GOAL) > 5.0  # it turned on the way
    assert robot.position == pytest.approx(START, abs=1e-6)
    assert robot.charge > 0.19  # near the reserve: the way home needed more than planned as well


def test_a_robot_with_too_little_charge_stays_at_home(costmap: ServedCostMap) -> None:
    names = example("robot_loop.py")
    heading_for, route, verdict = names["RobotLoop"](costmap, START).decide(START, 0.2, GOAL)
    assert (heading_for, route.length_m) == ("home", 0.0)
    assert verdict.feasible


def _message(**fields: Any) -> Any:
    return SimpleNamespace(**fields)


def _pose() -> Any:
    place = _message(x=0.0, y=0.0, z=0.0)
    turned = _message(x=0.0, y=0.0, z=0.0, w=1.0)
    return _message(header=_message(frame_id="", stamp=None), pose=_message(position=place, orientation=turned))


def _path() -> Any:
    return _message(header=_message(frame_id="", stamp=None), poses=[])


def test_a_planner_as_nav2_calls_it(service: jm.Client, costmap: ServedCostMap) -> None:
    origin = (START[0] - 3.0, START[1] - 4.0)
    planner = example("nav2_planner.py")["JoulemapPlanner"](
        "http://testserver", costmap.id, path_type=_path, pose_type=_pose, origin=origin
    )
    planner.configure(service)
    planner.activate()
    start, goal = _pose(), _pose()
    for pose, place in ((start, START), (goal, GOAL)):
        pose.header.frame_id = "map"
        pose.pose.position.x, pose.pose.position.y = place[0] - origin[0], place[1] - origin[1]
    goal.pose.orientation = _message(x=0.0, y=0.0, z=1.0, w=0.0)
    path = planner.create_plan(start, goal)
    places = [(p.pose.position.x, p.pose.position.y) for p in path.poses]
    assert places[0] == pytest.approx((3.0, 4.0))
    assert places[-1] == pytest.approx((GOAL[0] - origin[0], GOAL[1] - origin[1]))
    assert max(math.dist(a, b) for a, b in zip(places, places[1:], strict=False)) < 1.001
    assert path.poses[-1].pose.orientation.z == 1.0
    for here, there, pose in zip(places, places[1:], path.poses, strict=False):
        yaw = 2.0 * math.atan2(pose.pose.orientation.z, pose.pose.orientation.w)
        along = math.atan2(there[1] - here[1], there[0] - here[0])
        assert math.cos(yaw - along) > 0.999
    assert planner.last.energy_j == pytest.approx(costmap.plan(START, GOAL).energy_j, rel=1e-6)
    start.header.frame_id = "odom"
    with pytest.raises(ValueError, match="odom"):
        planner.create_plan(start, goal)
    planner.deactivate()
    planner.cleanup()
