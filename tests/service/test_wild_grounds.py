"""Grounds in the shapes in which people have them, through each face: `shared/wild/grounds` and its answers."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.errors import HeightmapError
from joulemap.model.robot import Robot
from joulemap.planner.lattice import Blocked
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.lattice.loading import load_lattice
from joulemap.service.cli import app
from joulemap.service.http.app import create_app
from tests.service.conftest import settings_for

NAMED = os.environ.get("JOULEMAP_WILD_DATA")
AROUND = [
    folder / "shared" / "wild" for folder in Path(__file__).resolve().parents[2:4]
]  # in the checkout, or beside it
WILD = Path(NAMED) if NAMED else next((folder for folder in AROUND if folder.is_dir()), AROUND[0])
LAYERS = {"kinds.tif", "obstacles.yaml"}  # lie over a ground, and are none
ANSWERS = (
    {
        name.removeprefix("grounds/"): answer
        for name, answer in json.loads((WILD / "answers.json").read_text(encoding="utf-8")).items()
        if name.startswith("grounds/") and name.removeprefix("grounds/") not in LAYERS
    }
    if (WILD / "answers.json").is_file()
    else {}
)
SAID = {  # what the file does not say, as the notes of its answer name it
    "N36W005.hgt.zip": {"reproject": "auto"},
    "n36_w005.dt1.zip": {"reproject": "auto"},
    "degrees.asc": {"crs": "EPSG:4326", "reproject": "auto"},
    "terrain_rgb.png": {"resolution_m": 1.0},
    "terrarium.png": {"resolution_m": 1.0},
    "grey_in_colour.png": {"resolution_m": 1.0, "scale_m": 1 / 30, "offset_m": 100.0},
    "ascii.pcd": {"crs": "EPSG:32615"},
    "binary.pcd": {"crs": "EPSG:32615"},
    "ascii.ply": {"crs": "EPSG:32615"},
    "binary.ply": {"crs": "EPSG:32615"},
    "feet.las": {"reproject": "auto"},
}
WARNED = {"decimetres.tif": "of the Earth", "hillshade.tif": "picture", "zero_voids.tif": "exactly 0"}
SENT_ALONE = {  # a service gets one file, and reads no other
    "hill.vrt": "names other files",
    "saga.sdat": "header",
    "ehdr.bil": "header",
    "envi.dat": "header",
}


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """A service with the limits of a service, which the small one of other tests has not."""
    with TestClient(create_app(settings_for(tmp_path_factory.mktemp("data"))), raise_server_exceptions=False) as client:
        yield client


pytestmark = pytest.mark.skipif(not ANSWERS, reason=f"no grounds at {WILD}: set JOULEMAP_WILD_DATA to their folder")


def check(name: str, shape: list[int], resolution_m: float, low_m: float, top_m: float) -> None:
    answer = ANSWERS[name]
    if name == "grey_in_colour.png":
        answer = ANSWERS["hill.tif"] | {"tolerance_m": 1 / 60}
    if "cells" in answer:
        assert shape == answer["cells"]
        assert resolution_m == pytest.approx(answer["resolution_m"], rel=0.01)
    for found, key in ((low_m, "low_m"), (top_m, "top_m")):
        if key in answer:
            assert found == pytest.approx(answer[key], abs=answer.get("tolerance_m", 0.01 * max(answer[key], 1.0)))


@pytest.mark.parametrize("name", ANSWERS)
def test_in_python(name: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        heightmap = jm.read_heightmap(WILD / "grounds" / name, **SAID.get(name, {}))
    low, top = float(np.nanmin(heightmap.heights)), float(np.nanmax(heightmap.heights))
    check(name, list(heightmap.frame.shape), heightmap.resolution_m, low, top)
    if name in WARNED:
        assert WARNED[name] in " ".join(str(each.message) for each in caught)


@pytest.mark.parametrize("name", [name for name in ANSWERS if "cells" in ANSWERS[name] or name in WARNED])
def test_on_the_command_line(tmp_path: Path, name: str) -> None:
    options = {"resolution_m": "--resolution", "crs": "--crs", "reproject": "--reproject"}
    said = [word for key, value in SAID.get(name, {}).items() for word in (options[key], str(value))]
    out, made = tmp_path / "map.zarr", tmp_path / "made.json"
    asked = ["costmap", str(WILD / "grounds" / name), *said, "--model", "physics", "--headings", "4", "--out", str(out)]
    result = CliRunner().invoke(app, [*asked, "--json", str(made)])
    if name in WARNED:
        assert WARNED[name] in " ".join(result.stderr.split())
        return
    assert result.exit_code == 0, result.output
    found = json.loads(made.read_text(encoding="utf-8"))
    assert [found["rows"], found["cols"]] == ANSWERS[name]["cells"]


@pytest.mark.parametrize("name", ANSWERS)
def test_over_http(client: TestClient, name: str) -> None:
    data = (WILD / "grounds" / name).read_bytes()
    said = {key: str(value) for key, value in SAID.get(name, {}).items()}
    answer = client.post("/v1/heightmaps", files={"file": (name, data)}, data=said)
    if name in SENT_ALONE:
        assert answer.status_code == 422, answer.text
        assert SENT_ALONE[name] in answer.json()["detail"]
        return
    assert answer.status_code == 201, answer.text
    found = answer.json()
    shape = [found["rows"], found["cols"]]
    check(name, shape, found["resolution_m"], found["height_min_m"], found["height_max_m"])
    if name in WARNED:
        assert WARNED[name] in " ".join(found["notes"])


def test_a_file_that_names_others_is_read_only_where_they_lie() -> None:
    data = (WILD / "grounds" / "hill.vrt").read_bytes()
    with pytest.raises(HeightmapError, match="names other files"):
        jm.read_heightmap(data, filename="hill.vrt")


def test_kinds_and_obstacles_over_the_hill_through_the_command_line(tmp_path: Path):
    """Their answers: 1 grass, 2 sand, 3 water; a wall of 20 x 2 m from (500047.5, 4000030) to (500049.5, 4000050)."""
    folder, legend = WILD / "grounds", tmp_path / "legend.toml"
    legend.write_text("[grass]\nvalue = 1\n[sand]\nvalue = 2\n[water]\nvalue = 3\n")
    robot = tmp_path / "robot.toml"
    robot.write_text('name = "cart"\nwidth_m = 0.5\nlength_m = 0.5\ntracking_std_m = 0\n')
    words = f"costmap {folder}/hill.tif --model physics --spacing 0.5 --robot {robot}"
    layers = f"--layer kinds={folder}/kinds.tif --legend {legend} --layer obstacles={folder}/obstacles.yaml"
    for name, more in (("bare", ""), ("layered", layers)):
        done = CliRunner().invoke(app, [*words.split(), "--out", str(tmp_path / f"{name}.zarr"), *more.split()])
        assert done.exit_code == 0, done.output
    bare, layered = (load_lattice(tmp_path / f"{name}.zarr") for name in ("bare", "layered"))
    x, y = np.meshgrid(*layered.frame.centres())
    wall = (x > 500047.5) & (x < 500049.5) & (y > 4000030.0) & (y < 4000050.0)
    pond = (x > 500020.0) & (x < 500040.0) & (y > 4000040.0) & (y < 4000060.0)
    near = (x > 500047.0) & (x < 500050.0) & (y > 4000029.5) & (y < 4000050.5)
    near |= (x > 500019.5) & (x < 500040.5) & (y > 4000039.5) & (y < 4000060.5)
    assert np.all(layered.blocked[(wall | pond) & (bare.blocked == Blocked.FREE)] == Blocked.OBSTACLE)
    assert np.array_equal(layered.blocked[~near], bare.blocked[~near])  # unknown (205) is free, as the legend says
    more = (layered.traction_per_m - bare.traction_per_m)[..., 0] / bare.robot.weight_n
    own = bare.robot.rolling_resistance
    free = (layered.blocked == Blocked.FREE) & ~near
    assert more[free & (x < 500050.0)] == pytest.approx(0.06 - own, abs=1e-5)  # of the library
    assert more[free & (x > 500050.0)] == pytest.approx(0.2 - own, abs=1e-5)  # Carvill, sand
    assert [layer["resolution_m"] for layer in layered.provenance["layers"]] == [2.0, 0.5]


def test_a_climb_on_the_moon_costs_a_sixth():
    ground = jm.read_heightmap(WILD / "grounds" / "moon.tif")
    assert ground.height_range == pytest.approx((100.0, 107.0), abs=0.01)
    earth, moon = (build_lattice(ground, Robot(**more), PhysicsPredictor()) for more in ({}, {"gravity_mps2": 1.62}))
    known = np.isfinite(moon.traction_per_m)
    ratio = moon.traction_per_m[known] / earth.traction_per_m[known]
    assert ratio == pytest.approx(1.62 / 9.80665, rel=1e-3)
