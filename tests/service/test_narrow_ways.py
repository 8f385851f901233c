"""Narrow ways from a robot file or a request to the answer: the margin to closed ground, and the robot's outline."""

import json

import numpy as np
import pytest

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from tests.service.test_cli import joulemap

SOUTH, NORTH = (10.0, 8.0), (10.0, 22.0)
NARROW, WIDE = slice(18, 23), slice(45, 63)
"""Columns of half a metre at which the wall is open."""


def ground(*gaps: slice) -> Heightmap:
    """Level ground with a wall from west to east."""
    heights = np.zeros((60, 80), dtype=np.float32)
    heights[29:31] = 2.0
    for gap in gaps:
        heights[29:31, gap] = 0.0
    return Heightmap(heights, GridFrame(0.0, 30.0, 0.5, 60, 80))


def asked(folder, gaps, tracking_std_m):
    """The route that the command line finds."""
    write_geotiff(folder / "dem.tif", ground(*gaps))
    (folder / "robot.toml").write_text(f"tracking_std_m = {tracking_std_m}\n")
    made = ["costmap", folder / "dem.tif", "--model", "physics", "--robot", folder / "robot.toml"]
    code, _, errors = joulemap(*made, "--out", folder / "dem.zarr", "--overwrite")
    assert code == 0, errors
    ends = ["--start", ",".join(map(str, SOUTH)), "--goal", ",".join(map(str, NORTH))]
    code, _, errors = joulemap("path", folder / "dem.zarr", *ends, "--json", folder / "path.json")
    assert code == 0, errors
    return json.loads((folder / "path.json").read_text())


def test_on_the_command_line_the_wide_gap_is_taken_or_the_narrow_one_is_said(tmp_path):
    exact, kept = (asked(tmp_path, (NARROW, WIDE), std) for std in (0.0, 0.1))
    assert exact["length_m"] < 16.0
    assert kept["length_m"] > exact["length_m"] + 5.0
    assert (exact["warnings"], kept["warnings"]) == ([], [])
    only = asked(tmp_path, (NARROW,), 0.1)
    assert only["length_m"] < 16.0
    assert "nearer than 0.5 m to ground that may not be driven" in only["warnings"][0]


@pytest.mark.parametrize(("std", "wide"), [(0.0, False), (0.1, True)])
def test_over_http_the_robot_of_the_cost_map_decides(client, tmp_path, std, wide):
    write_geotiff(tmp_path / "dem.tif", ground(NARROW, WIDE))
    content = (tmp_path / "dem.tif").read_bytes()
    kept = client.post("/v1/heightmaps", content=content, headers={"Content-Type": "image/tiff"}).json()["id"]
    wish = {"heightmap_id": kept, "model": "physics", "robot": {"tracking_std_m": std}}
    made = client.post("/v1/costmaps", json=wish, headers={"Prefer": "wait=300"}).json()
    assert made["status"] == "done", made
    found = client.post(f"/v1/costmaps/{made['id']}/paths", json={"start": SOUTH, "goal": NORTH}).json()
    assert (found["length_m"] > 20.0) is wide, found["warnings"]


START, GOAL = (4.0, 1.5), (4.0, 6.5)


def hall() -> Heightmap:
    """A wall with a door of 0.8 m, in cells of 5 cm."""
    heights = np.zeros((160, 160), dtype=np.float32)
    heights[78:82] = 1.0
    heights[78:82, 72:88] = 0.0
    return Heightmap(heights, GridFrame(0.0, 8.0, 0.05, 160, 160))


@pytest.mark.parametrize(("clearance_m", "passes"), [(0.15, True), (0.25, False)])
def test_from_a_robot_file_to_a_route_on_the_command_line(tmp_path, clearance_m, passes):
    write_geotiff(tmp_path / "hall.tif", hall())
    (tmp_path / "robot.toml").write_text(f"width_m = 0.4\nclearance_m = {clearance_m}\n")
    made = ["costmap", tmp_path / "hall.tif", "--model", "physics", "--robot", tmp_path / "robot.toml"]
    code, _, errors = joulemap(*made, "--spacing", 0.1, "--out", tmp_path / "hall.zarr")
    assert code == 0, errors
    ends = ["--start", ",".join(map(str, START)), "--goal", ",".join(map(str, GOAL))]
    code, _, errors = joulemap("path", tmp_path / "hall.zarr", *ends, "--json", tmp_path / "path.json")
    if passes:
        assert code == 0, errors
        assert json.loads((tmp_path / "path.json").read_text())["length_m"] == pytest.approx(5.0, rel=0.05)
    else:
        assert code != 0
        assert "no way leads from start to goal" in errors
        said = " ".join(errors.split())
        assert "with clearance_m 0.15 instead of 0.25 a route exists" in said  # 0.2 is as wide as the door


def test_each_area_of_several_files_is_kept_off(tmp_path):
    """One wall from either side, with a way round each; both together close the map."""
    write_geotiff(tmp_path / "flat.tif", Heightmap(np.zeros((40, 40), dtype=np.float32), GridFrame(0, 40, 1.0, 40, 40)))
    code, _, errors = joulemap("costmap", tmp_path / "flat.tif", "--model", "physics", "--out", tmp_path / "flat.zarr")
    assert code == 0, errors
    ask = ["path", tmp_path / "flat.zarr", "--start", "20,5", "--goal", "20,35"]
    files = []
    for name, west, east in (("left", 0.0, 22.0), ("right", 18.0, 40.0)):
        ring = [[west, 18.0], [east, 18.0], [east, 22.0], [west, 22.0], [west, 18.0]]
        files.append(tmp_path / f"{name}.geojson")
        files[-1].write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
        assert joulemap(*ask, "--avoid", files[-1])[0] == 0
    code, _, errors = joulemap(*ask, "--avoid", files[0], "--avoid", files[1])
    assert code == 4
    assert "no way leads" in errors


@pytest.mark.parametrize(("width_m", "passes"), [(0.55, True), (0.85, False)])
def test_over_http_a_robot_passes_a_door_or_not(client, tmp_path, width_m, passes):
    write_geotiff(tmp_path / "hall.tif", hall())
    content = (tmp_path / "hall.tif").read_bytes()
    kept = client.post("/v1/heightmaps", content=content, headers={"Content-Type": "image/tiff"}).json()["id"]
    wish = {"heightmap_id": kept, "model": "physics", "spacing_m": 0.1, "robot": {"width_m": width_m}}
    made = client.post("/v1/costmaps", json=wish, headers={"Prefer": "wait=300"}).json()
    assert made["status"] == "done", made
    answer = client.post(f"/v1/costmaps/{made['id']}/paths", json={"start": START, "goal": GOAL})
    assert answer.status_code == (200 if passes else 422), answer.text
    if not passes:
        assert answer.json()["code"] == "no_route"
