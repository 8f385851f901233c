"""A robot with a turning radius, in commands, over HTTP and in Python: no curve is tighter than that."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from ompl import base as ompl
from starlette.testclient import TestClient

import joulemap as jm
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from tests.bench.maps import terrain
from tests.service.test_cli import joulemap

START, GOAL = (44.5, 44.5), (54.5, 44.5)


def two_lanes() -> Heightmap:
    """Two lanes of 8 m that are joined at their southern ends, in walls of 3 m: 18 m from side to side."""
    heights = np.full((60, 100), 3.0, dtype=np.float32)
    heights[10:50, 40:48] = heights[10:50, 50:58] = heights[42:50, 40:58] = 0.0
    return Heightmap(heights, GridFrame(0.0, 60.0, 1.0, 60, 100, "EPSG:32632"))


def tightest_m(xy: np.ndarray) -> float:
    """The least radius of the circle through three points that follow each other, of a path in equal short steps."""
    distance = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    step = np.linspace(0.0, distance[-1], int(distance[-1] / 2.0))
    x, y = (np.interp(step, distance, column) for column in xy.T)
    sides = [
        np.hypot(x[a : b or None] - x[c : d or None], y[a : b or None] - y[c : d or None])
        for a, b, c, d in ((0, -2, 1, -1), (1, -1, 2, 0), (0, -2, 2, 0))
    ]
    half = sum(sides) / 2.0
    area = np.sqrt(np.maximum(half * np.prod([half - side for side in sides], axis=0), 1e-12))
    return float((np.prod(sides, axis=0) / (4.0 * area)).min())


@pytest.mark.parametrize(("radius_m", "drives"), [(5.0, True), (9.0, False)])
def test_a_turn_at_the_end_of_a_lane(client: TestClient, tmp_path: Path, radius_m: float, drives: bool) -> None:
    write_geotiff(tmp_path / "lanes.tif", two_lanes())
    (tmp_path / "car.toml").write_text(f'name = "car"\nmin_turning_radius_m = {radius_m}\n')
    made = ["costmap", tmp_path / "lanes.tif", "--robot", tmp_path / "car.toml", "--model", "physics"]
    code, _, errors = joulemap(*made, "--out", tmp_path / "map.zarr")
    assert code == 0, errors
    ends = [f"{x},{y}" for x, y in (START, GOAL)]
    asked = ["path", tmp_path / "map.zarr", "--start", ends[0], "--goal", ends[1]]
    code, _, errors = joulemap(*asked, "--json", tmp_path / "route.json", "--out", tmp_path / "drive.plan")
    sent = client.post("/v1/heightmaps", files={"file": ("g.tif", (tmp_path / "lanes.tif").read_bytes())}).json()
    robot = {"name": "car", "min_turning_radius_m": radius_m}
    body = {"heightmap_id": sent["id"], "model": "physics", "robot": robot}
    costmap = client.post("/v1/costmaps", json=body, headers={"Prefer": "wait=60"}).json()
    found = client.post(f"/v1/costmaps/{costmap['id']}/paths", json={"start": START, "goal": GOAL})
    if not drives:
        said = "the turning radius of 9 m of car"
        assert (code, said in " ".join(errors.split())) == (4, True), errors
        assert found.status_code == 422
        assert said in found.json()["detail"]
        assert found.json()["context"]["limit"] == "min_turning_radius_m"
        return
    assert code == 0, errors
    route = json.loads((tmp_path / "route.json").read_text())
    assert route["tightest_radius_m"] == pytest.approx(found.json()["tightest_radius_m"])
    assert route["tightest_radius_m"] >= radius_m * (1.0 - 1e-6)
    assert tightest_m(np.array(route["path"])[:, :2]) > 0.9 * radius_m  # points between corners lie on their chords
    code, words, errors = joulemap("feasibility", tmp_path / "map.zarr", "--path", tmp_path / "drive.plan")
    assert (code, "cannot drive" in words + errors) == (0, False), words + errors
    corners = [START, (44.5, 20.5), (46.5, 20.5), (46.5, 44.5)]
    judged = client.post(f"/v1/costmaps/{costmap['id']}/feasibility", json={"path": corners}).json()
    assert "a curve of 1 m radius, which car cannot drive: its turning radius is 5 m" in " ".join(judged["warnings"])


def test_a_free_plane_is_driven_as_dubins_did() -> None:
    """The length is that of OMPL's state space of Dubins, within 3 %."""
    radius_m, rng = 4.0, np.random.default_rng(56)
    robot = jm.Robot(min_turning_radius_m=radius_m)
    plane = jm.costmap(jm.heightmap(np.zeros((80, 80)), resolution_m=1.0), robot=robot, model="physics")
    space = ompl.DubinsStateSpace(radius_m)
    for _ in range(12):
        poses = np.column_stack([rng.uniform(25.0, 55.0, (2, 2)), rng.uniform(0.0, 360.0, 2)])
        states = [space.allocState() for _ in poses]
        for state, (x, y, heading_deg) in zip(states, poses, strict=True):
            state.setXY(x, y)
            state.setYaw(math.radians(90.0 - heading_deg))
        route = plane.plan(
            tuple(poses[0, :2]), tuple(poses[1, :2]), start_heading_deg=poses[0, 2], goal_heading_deg=poses[1, 2]
        ).route
        assert route.length_m == pytest.approx(space.distance(*states), rel=0.03)
        assert route.tightest_radius_m >= radius_m * (1.0 - 1e-6)
        first, *_, last = np.rad2deg(route.profile.heading_rad)
        assert np.abs((np.array([first, last]) - poses[:, 2] + 180.0) % 360.0 - 180.0) == pytest.approx(
            [0, 0], abs=0.01
        )


def test_a_slalom_is_driven_without_a_tighter_curve() -> None:
    heights = np.zeros((40, 100), dtype=np.float32)
    for k, col in enumerate((20, 40, 60, 80)):
        heights[slice(0, 26) if k % 2 else slice(14, 40), col : col + 2] = 2.0
    hill, lengths = jm.heightmap(heights, resolution_m=1.0), []
    for radius_m in (0.0, 3.0, 7.0):
        robot = jm.Robot(min_turning_radius_m=radius_m)
        route = jm.costmap(hill, robot=robot, model="physics").plan((5.0, 20.0), (95.0, 20.0)).route
        lengths.append(route.length_m)
        assert route.tightest_radius_m >= radius_m * (1.0 - 1e-6)
    assert lengths[0] <= lengths[1] <= lengths[2] < 1.5 * lengths[0]


def test_the_way_back_begins_by_turning_round() -> None:
    ground = jm.costmap(jm.heightmap(np.zeros((60, 80)), resolution_m=1.0), robot=jm.Robot(min_turning_radius_m=3.0))
    there = ground.plan((20.0, 30.0), (35.0, 30.0))
    back = ground.feasibility(there, round_trip=True).route_back
    assert back is not None
    assert back.length_m > there.length_m + 2.0 * math.pi * 3.0 / 2.0
    assert back.tightest_radius_m == pytest.approx(3.0)


def test_a_goal_heading_against_the_way_takes_no_longer_search() -> None:
    ground = jm.costmap(jm.heightmap(np.zeros((60, 90)), resolution_m=1.0), robot=jm.Robot(min_turning_radius_m=5.0))
    along, against = (ground.plan((10.0, 30.0), (70.0, 30.0), goal_heading_deg=to) for to in (90.0, 270.0))
    assert against.length_m > along.length_m + math.pi * 5.0 / 2.0
    assert against.found.details["expanded"] < 3 * along.found.details["expanded"]


def test_a_small_radius_costs_little_on_open_hills() -> None:
    """A path that is nearly straight needs no room to turn: the best one of any angles is rounded."""
    hill, rng, above = terrain(60, 0.5), np.random.default_rng(3), []
    free, curved = (
        jm.costmap(hill, robot=jm.Robot(min_turning_radius_m=radius_m), model="physics") for radius_m in (0.0, 1.0)
    )
    for _ in range(8):
        ends = [tuple(xy) for xy in rng.uniform(5.0, 55.0, (2, 2)).tolist()]
        above.append(curved.plan(*ends).energy_j / free.plan(*ends).energy_j - 1.0)
    assert np.mean(above) < 0.004


def test_a_tour_arrives_as_it_can_leave() -> None:
    """The cheapest arrival has its nose to a wall; along it both legs can be driven."""
    heights = np.zeros((40, 40))
    heights[14:16, 5:35] = 3.0
    car = jm.Robot(name="car", min_turning_radius_m=2.0)
    costmap = jm.costmap(jm.heightmap(heights, resolution_m=1.0), robot=car, model="physics")
    there, back = costmap.tour([(20.0, 5.0), (20.0, 22.0)]).legs
    arrival, departure = np.diff(there.points[-2:, :2], axis=0)[0], np.diff(back.points[:2, :2], axis=0)[0]
    assert arrival[0] * departure[1] == pytest.approx(arrival[1] * departure[0], abs=1e-6)
    assert arrival @ departure > 0.0
    assert min(leg.tightest_radius_m for leg in (there, back)) >= 2.0 * (1.0 - 1e-6)
