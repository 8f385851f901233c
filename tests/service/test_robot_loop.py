"""The examples of the page on a robot in the loop, against a service: a robot that comes home."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

import joulemap as jm
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.client import ServedCostMap
from tests.docs.code_blocks import blocks_of
from tests.service.conftest import GOAL, START
from tests.service.test_closed_way import ground

PAGE = "docs/how-to/my-robot-in-the-loop.md"


def example(name: str) -> dict[str, Any]:
    (block,) = [block for block in blocks_of(PAGE) if block.title == name]
    names: dict[str, Any] = {"__name__": name}
    exec(compile(block.text, name, "exec"), names)
    return names


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


def test_a_robot_does_not_drive_to_a_goal_or_a_home_that_no_way_leads_to(service: jm.Client, tmp_path: Path) -> None:
    write_geotiff(tmp_path / "wall.tif", ground("wall"))
    costmap = service.costmap(tmp_path / "wall.tif", model="physics")
    home, beyond = (10.5, 5.5), (10.5, 34.5)
    loop = example("robot_loop.py")["RobotLoop"](costmap, home)
    heading_for, route, _ = loop.decide(home, 1.0, beyond)
    assert (heading_for, route.length_m) == ("home", 0.0)
    with pytest.raises(RuntimeError, match=r"no way leads home: the nearest place is 1\d\.\d m away"):
        loop.decide(beyond, 1.0, beyond)
