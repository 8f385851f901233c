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
from joulemap.model.errors import HeightmapError
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
