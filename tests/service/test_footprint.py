"""The robot's outline from a robot file or a request to the answer: a door of 0.8 m, found or not."""

import json

import numpy as np
import pytest
from matplotlib import pyplot

from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice import Blocked
from joulemap.planner.lattice.build import build_lattice
from joulemap.service.ground_drawing import blocked_everywhere, draw_ground
from joulemap.service.map_layers import blocked_codes, blocked_image
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
        assert "outline 0.6 x 0.4 m and 0.25 m of clearance" in errors


def test_a_picture_paints_what_the_outline_would_meet_and_names_it():
    lattice = build_lattice(hall(), Robot(), PhysicsPredictor(), spacing_m=0.1)
    codes = blocked_everywhere(lattice)
    wall = codes == Blocked.OBSTACLE
    assert wall.any()
    assert (blocked_image(blocked_codes(lattice, None))[wall, 3] > 0.9).all()
    _, axes = pyplot.subplots()
    labels = [patch.get_label() for patch in draw_ground(axes, hall().heights, lattice.frame, blocked=codes)]
    assert "blocked: obstacle" in labels


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
