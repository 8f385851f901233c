"""The robot's outline from a robot file or a request to the answer: a door of 0.8 m, found or not."""

import json

import numpy as np
import pytest

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from tests.service.test_cli import joulemap

START, GOAL = (4.0, 1.5), (4.0, 6.5)


def hall() -> Heightmap:
    """A wall with a door of 0.8 m, in cells of 5 cm."""
    heights = np.zeros((160, 160), dtype=np.float32)
    heights[78:82] = 1.0
    heights[78:82, 72:88] = 0.0
    return Heightmap(heights, GridFrame(0.0, 8.0, 0.05, 160, 160))


@pytest.mark.parametrize(("clearance_m", "passes"), [(0.0, True), (0.25, False)])
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
