"""A way that is closed: which limit closes it, where, by how much, and what opens it; in commands and over HTTP."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from starlette.testclient import TestClient

import joulemap as jm
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.places import free_places
from joulemap.planner.route_planner import RoutePlanner
from tests.service.test_cli import joulemap

START, GOAL = (10.5, 5.5), (10.5, 34.5)


def ground(kind: str) -> Heightmap:
    """Two flat halves: 7 m apart in height with a ramp of 35 deg between, or with a wall, or a hole in the map."""
    y = np.arange(40)[::-1] + 0.5
    heights = np.zeros((40, 20), dtype=np.float32)
    if kind == "ramp":
        heights += (np.tan(np.deg2rad(35.0)) * np.clip(y - 15.0, 0.0, 10.0))[:, None].astype(np.float32)
    else:
        heights[18:20] = 2.0 if kind == "wall" else np.nan
    return Heightmap(heights, GridFrame(0.0, 40.0, 1.0, 40, 20))


@pytest.mark.parametrize(
    ("kind", "limit", "words"),
    [
        ("ramp", "max_grade_deg", "instead of 25 a route exists"),
        (
            "wall",
            "step",
            "a step or a wall that is higher than the wheel radius of 0.127 m closes it at (10.50, 21.00)",
        ),
        ("hole", "unknown", "ground of unknown height closes it"),
    ],
)
def test_what_closes_the_way_is_named(client: TestClient, tmp_path: Path, kind: str, limit: str, words: str) -> None:
    write_geotiff(tmp_path / "ground.tif", ground(kind))
    code, _, errors = joulemap("costmap", tmp_path / "ground.tif", "--model", "physics", "--out", tmp_path / "map.zarr")
    assert code == 0, errors
    ends = [f"{x},{y}" for x, y in (START, GOAL)]
    for command in ("path", "field"):
        asked = [command, tmp_path / "map.zarr", "--start", ends[0], "--goal", ends[1]]
        code, _, errors = joulemap(*asked, *(["--out", tmp_path / "field.tif"] if command == "field" else []))
        said = " ".join(errors.split())
        assert (code, words in said) == (4, True), errors
    sent = client.post("/v1/heightmaps", files={"file": ("g.tif", (tmp_path / "ground.tif").read_bytes())}).json()
    made = client.post(
        "/v1/costmaps", json={"heightmap_id": sent["id"], "model": "physics"}, headers={"Prefer": "wait=60"}
    ).json()
    found: dict[str, Any] = client.post(f"/v1/costmaps/{made['id']}/paths", json={"start": START, "goal": GOAL}).json()
    why = found["context"]
    assert (found["code"], why["limit"]) == ("no_route", limit), found
    assert words in found["detail"]
    assert 14.0 < why["place"][1] < 26.0
    if kind == "ramp":  # and that is true
        for degrees, status in ((why["opens"], 200), (why["opens"] - 1.0, 422)):
            steeper = {"heightmap_id": sent["id"], "model": "physics", "robot": {limit: degrees}}
            again = client.post("/v1/costmaps", json=steeper, headers={"Prefer": "wait=60"}).json()
            way = client.post(f"/v1/costmaps/{again['id']}/paths", json={"start": START, "goal": GOAL})
            assert way.status_code == status, way.text
    snapped = client.post(f"/v1/costmaps/{made['id']}/paths", json={"start": START, "goal": GOAL, "snap": True}).json()
    assert snapped["path"][-1][1] < 26.0
    assert "nearest place that can" in " ".join(snapped["warnings"])
    moved_m = snapped["goal_moved_m"]
    assert moved_m == pytest.approx(np.hypot(*np.subtract(snapped["path"][-1][:2], GOAL)))
    _, words, _ = joulemap("path", tmp_path / "map.zarr", "--start", ends[0], "--goal", ends[1], "--snap")
    assert f"the goal was moved by {moved_m:.2f} m" in " ".join(words.split())
    judged = client.post(f"/v1/costmaps/{made['id']}/feasibility", json={"start": START, "goal": GOAL, "snap": True})
    assert judged.json()["code"] == "no_route"  # a verdict is about the place that was asked for
    deep = {"start": START, "goal": (10.5, 21.0), "snap": True}
    for question in ("feasibility", "paths"):
        asked = deep | ({"furthest_m": 1.0} if question == "paths" else {})
        beyond = client.post(f"/v1/costmaps/{made['id']}/{question}", json=asked).json()
        assert kind == "ramp" or (beyond["code"], "m at most" in beyond["detail"]) == ("blocked", True), beyond
    x, y = snapped["path"][-1][:2]
    assert (
        client.post(f"/v1/costmaps/{made['id']}/feasibility", json={"start": START, "goal": [x, y]}).status_code == 200
    )


@pytest.mark.parametrize(("seed", "limit"), [(3, "max_grade_deg"), (4, "max_cross_slope_deg"), (5, "max_grade_deg")])
def test_the_least_change_that_opens_a_way_is_found(seed: int, limit: str) -> None:
    """With that value the planner finds a way, and none with a whole degree less."""
    rng = np.random.default_rng(seed)
    heights = (16.0 * gaussian_filter(rng.standard_normal((40, 40)), 4.0)).astype(np.float32)
    heights[18:20] += 2.0 * (np.abs(np.arange(40) - rng.uniform(5, 35)) > 1.5)  # a wall with a door
    robot = jm.Robot(width_m=1.2, length_m=1.4, clearance_m=0.8, max_grade_deg=9.0, max_cross_slope_deg=10.0)
    lattice = jm.costmap(jm.heightmap(heights, resolution_m=1.0), robot=robot, model="physics").lattice
    free = rng.permutation(np.argwhere(free_places(lattice)))
    start, goal = (lattice.frame.xy(*free[side][0]) for side in (free[:, 0] > 27, free[:, 0] < 12))
    with pytest.raises(jm.JoulemapError) as refused:
        RoutePlanner(lattice).plan(start, goal)
    why = refused.value.context
    assert why["limit"] == limit
    for value, found in ((why["opens"], True), (why["opens"] - 1.0, False)):
        planner = RoutePlanner(replace(lattice, robot=replace(robot, **{limit: value})))
        with nullcontext() if found else pytest.raises(jm.JoulemapError):
            planner.plan(start, goal)


def test_a_door_is_opened_by_the_clearance_that_fits_through_it() -> None:
    heights = np.zeros((40, 40), dtype=np.float32)
    heights[18:20] = 2.0
    heights[18:20, 19:22] = 0.0  # 3 m: beside 1.2 m of robot 0.9 m are left on each side
    robot = jm.Robot(width_m=1.2, length_m=1.4, clearance_m=2.0)
    hall = jm.costmap(jm.heightmap(heights, resolution_m=1.0), robot=robot, model="physics")
    with pytest.raises(jm.JoulemapError, match=r"with clearance_m 0\.9 instead of 2 a route exists"):
        hall.plan((20.5, 35.5), (20.5, 5.5))
