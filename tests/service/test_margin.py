"""The margin to closed ground from a robot file or a request to the answer: lengths of routes, and what they say."""

import json

import numpy as np
import pytest

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from tests.service.test_cli import joulemap

START, GOAL = (10.0, 8.0), (10.0, 22.0)
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
    ends = ["--start", ",".join(map(str, START)), "--goal", ",".join(map(str, GOAL))]
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
    found = client.post(f"/v1/costmaps/{made['id']}/paths", json={"start": START, "goal": GOAL}).json()
    assert (found["length_m"] > 20.0) is wide, found["warnings"]
