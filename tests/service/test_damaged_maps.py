"""A damaged cost map through the service and the commands: an error that names the file, and never another number."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

from joulemap.service.cli import app
from joulemap.service.http.app import create_app
from joulemap.service.storage.files import sums_of
from tests.fuzz.damages import make_older
from tests.service.conftest import GOAL, START, settings_for
from tests.service.test_data_directory import flip

ASKED = {"start": list(START), "goal": list(GOAL)}


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory, hill_tif: bytes) -> dict[str, Any]:
    """A data directory with a cost map, after its service has stopped; and what it answered."""
    folder = tmp_path_factory.mktemp("kept")
    with TestClient(create_app(settings_for(folder))) as client:
        heightmap = client.post("/v1/heightmaps", content=hill_tif).json()["id"]
        asked = {"heightmap_id": heightmap, "model": "physics"}
        made = client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=120"})
        assert made.status_code == 201, made.text
        costmap = made.json()["id"]
        answer = client.post(f"/v1/costmaps/{costmap}/paths", json=ASKED)
        assert answer.status_code == 200, answer.text
    return {"folder": folder, "costmap": costmap, "energy_j": answer.json()["energy_j"]}


@pytest.fixture
def copied(kept: dict[str, Any], tmp_path: Path) -> dict[str, Any]:
    shutil.copytree(kept["folder"], tmp_path / "data")
    return {**kept, "folder": tmp_path / "data", "map": tmp_path / "data" / "costmaps" / f"{kept['costmap']}.zarr"}


DAMAGES: dict[str, tuple[str, Callable[[Path], object]]] = {
    "bit of a chunk": ("traction_per_m/c/0/0/0", flip),
    "lost chunk": ("blocked/c/0/0", Path.unlink),
    "bit of the attributes": ("zarr.json", flip),
    "lost metadata": ("gradient/zarr.json", Path.unlink),
    "bit of the checksums": ("checksums", flip),
}


@pytest.mark.parametrize("from_disk", [False, True], ids=["in memory", "from disk"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_the_service_says_what_is_damaged(copied: dict[str, Any], damage: str, from_disk: bool) -> None:
    file, do = DAMAGES[damage]
    do(copied["map"] / file)
    how = {"max_cells_in_memory": 100} if from_disk else {}
    with TestClient(create_app(settings_for(copied["folder"], **how)), raise_server_exceptions=False) as client:
        answer = client.post(f"/v1/costmaps/{copied['costmap']}/paths", json=ASKED)
    assert (answer.status_code, answer.json()["code"]) == (503, "damaged"), answer.text
    assert f"{copied['map'].name}/{file}" in answer.json()["detail"]
    assert "joulemap check --repair" in answer.json()["detail"]


def test_pictures_and_files_of_a_damaged_map_are_refused_too(copied: dict[str, Any]) -> None:
    flip(copied["map"] / "traction_per_m/c/0/0/0")
    base = f"/v1/costmaps/{copied['costmap']}"
    with TestClient(create_app(settings_for(copied["folder"])), raise_server_exceptions=False) as client:
        for what in (f"{base}/layer.png?layer=energy", f"{base}/data?format=npz", f"{base}/data?format=geotiff"):
            answer = client.get(what)
            assert (answer.status_code, answer.json()["code"]) == (503, "damaged"), (what, answer.text)


@pytest.mark.parametrize("damaged", [False, True])
def test_a_map_of_the_version_before_is_compared_with_what_was_kept(copied: dict[str, Any], damaged: bool) -> None:
    make_older(copied["map"])
    with sqlite3.connect(copied["folder"] / "joulemap.db") as database:
        database.execute("update costmaps set sums = ?", [json.dumps(sums_of(copied["map"]))])
    if damaged:
        flip(copied["map"] / "traction_per_m/c/0/0/0")
    with TestClient(create_app(settings_for(copied["folder"])), raise_server_exceptions=False) as client:
        answer = client.post(f"/v1/costmaps/{copied['costmap']}/paths", json=ASKED)
    if damaged:
        assert (answer.status_code, answer.json()["code"]) == (503, "damaged"), answer.text
        assert "traction_per_m: its content is not what was kept" in answer.json()["detail"]
    else:
        assert answer.json()["energy_j"] == copied["energy_j"]
    assert (copied["map"] / "checksums").exists() is not damaged


@pytest.mark.parametrize("file", ["traction_per_m/c/0/0/0", "zarr.json"])
def test_commands_name_the_file_and_end_with_a_code_of_their_own(copied: dict[str, Any], tmp_path, file) -> None:
    flip(copied["map"] / file)
    ends = [f"{name}={x},{y}" for name, (x, y) in (("--start", START), ("--goal", GOAL))]
    for words in (["path", *ends], ["path", "--memory", "0.5", *ends], ["export", "--out", str(tmp_path / "a.tif")]):
        done = CliRunner().invoke(app, [words[0], str(copied["map"]), *words[1:]])
        assert done.exit_code == 13, (words, done.output)
        assert f"{copied['map'].name}/{file}" in " ".join(done.output.split())
