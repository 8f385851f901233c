"""What is said beside an answer or in its place, by commands and over HTTP, and which exit code goes with it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

import joulemap as jm
from joulemap.model.energy.predictor import SHIPPED_WEIGHTS
from joulemap.model.terrain.writers import write_geotiff
from tests.service.conftest import GOAL, START, hill
from tests.service.test_cli import joulemap
from tests.service.test_turning_radius import GOAL as LANE_END
from tests.service.test_turning_radius import START as LANE_START
from tests.service.test_turning_radius import two_lanes

RADIUS_M = 5.0


def typed(place: object) -> str:
    return ",".join(map(str, np.array(place)))


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a cost map of a hill, and one of two lanes for a robot with a turning radius."""
    folder = tmp_path_factory.mktemp("said")
    write_geotiff(folder / "hill.tif", hill())
    write_geotiff(folder / "lanes.tif", two_lanes())
    (folder / "car.toml").write_text(f'name = "car"\nmin_turning_radius_m = {RADIUS_M}\n')
    for name, robot in (("hill", ()), ("lanes", ("--robot", folder / "car.toml"))):
        made = ("costmap", folder / f"{name}.tif", *robot, "--model", "physics", "--out", folder / f"{name}.zarr")
        assert joulemap(*made)[0] == 0
    return folder


WAY = "path hill.zarr --start {start} --goal {goal}"
WRONG = {
    f"{WAY} --alternatives 99": (2, "--alternatives: Input should be less than or equal to 10, got 99"),
    "path hill.zarr --start nan,nan --goal {goal}": (2, "--start: Input should be a finite number, got nan\n"),
    "reach hill.zarr --start {start} --confidence 2": (2, "--confidence: Input should be"),
    "costmap hill.tif --headings 3 --out new.zarr": (2, "--headings: Input should be"),
    "costmap hill.tif --resolution=-1 --out new.zarr": (2, "--resolution: Input should be"),
    f"{WAY} --goal-heading-deg 90": (3, "headings are given for a robot with"),
    "path hill.zarr --start 1,1 --goal {goal}": (3, "lies outside the map"),
    "feasibility hill.zarr --path nan.csv": (3, "--path: Input should be a finite number, got nan"),
    "feasibility hill.zarr --start {start} --goal {goal} --battery bad.toml": (
        3,
        "health is 3; it lies between 0 and 1",
    ),
}


@pytest.mark.parametrize("command", WRONG)
def test_a_wrong_option_is_wrong_usage_and_a_wrong_file_is_wrong_input(
    ground: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.chdir(ground)
    Path("nan.csv").write_text("x,y\n500003.5,4000014.5\nnan,4000014.5\n")
    Path("bad.toml").write_text("capacity_wh = 280\nhealth = 3.0\n")
    expected, said = WRONG[command]
    code, _, errors = joulemap(*command.format(start=typed(START), goal=typed(GOAL)).split())
    assert (code, said in errors) == (expected, True), errors
    assert not Path("new.zarr").exists()


def test_a_map_says_that_it_does_not_keep_a_turning_radius(ground: Path, tmp_path: Path) -> None:
    folder, ends = ground / "lanes.zarr", (typed(LANE_START), typed(LANE_END))
    points = tmp_path / "points.csv"
    points.write_text("\n".join(["x,y", *ends]))
    for question in (
        ("reach", folder, "--start", ends[0]),
        ("field", folder, "--goal", ends[1], "--out", tmp_path / "field.tif"),
        ("matrix", folder, points),
        ("return", folder, "--position", ends[0], "--home", ends[1]),
    ):
        code, _, errors = joulemap(*question)
        assert code == 0, errors
        assert "the turning radius of car, 5 m, is not kept" in errors, question
    code, _, errors = joulemap("matrix", ground / "hill.zarr", typed(START), typed(GOAL))
    assert "turning radius" not in errors


def test_no_tour_leads_through_a_stop_at_the_end_of_a_lane(ground: Path) -> None:
    code, _, errors = joulemap("tour", ground / "lanes.zarr", "--stop", typed(LANE_START), typed(LANE_END))
    assert (code, "no tour leads through the stop (54.50, 44.50)" in errors) == (4, True), errors


def test_the_shortest_path_that_is_cheaper_on_its_line_alone_is_said(client: TestClient, tmp_path: Path) -> None:
    heights = np.zeros((60, 200), dtype=np.float32)
    heights[:, 160:] = 0.25 * np.arange(40)  # where metres are dear, so that a margin is worth more than by length
    heights[29:31, :100] = 2.0
    heights[29:31, 20:27] = 0.0  # a door
    write_geotiff(tmp_path / "wall.tif", jm.heightmap(heights, resolution_m=0.5))
    (tmp_path / "r.toml").write_text('name = "r"\ntracking_std_m = 0.1\nwidth_m = 0.3\nlength_m = 0.4\n')
    made = ("costmap", tmp_path / "wall.tif", "--robot", tmp_path / "r.toml", "--model", "physics")
    assert joulemap(*made, "--out", tmp_path / "map.zarr")[0] == 0
    asked = ("path", tmp_path / "map.zarr", "--start", "11,8", "--goal", "11,22", "--json", "-")
    code, words, errors = joulemap(*asked)
    found = json.loads(words)
    assert (code, "J less if it is driven exactly" in errors) == (0, True), errors
    assert found["shortest"]["energy_j"] < found["energy_j"]
    assert found["saving_j"] == 0.0


def test_a_trained_model_says_that_it_does_not_use_a_declared_efficiency(ground: Path, tmp_path: Path) -> None:
    shutil.copytree(str(SHIPPED_WEIGHTS), tmp_path / "net")
    written = tmp_path / "net" / "config.json"
    config = json.loads(written.read_text())
    del config["checksum"]
    config["training"]["robot"] = jm.Robot().as_dict()
    written.write_text(json.dumps(config))
    (tmp_path / "r.toml").write_text('name = "r"\ndrivetrain_efficiency = 0.5\n')
    made = ("costmap", ground / "hill.tif", "--model", tmp_path / "net", "--robot", tmp_path / "r.toml")
    code, _, errors = joulemap(*made, "--out", tmp_path / "map.zarr")
    assert code == 0, errors
    assert "the drivetrain efficiency of 0.5 is not used: net learned what climbs cost" in errors
