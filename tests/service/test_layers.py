"""Layers through the command line and HTTP: what they close and cost in the file that comes out."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice import Blocked
from joulemap.planner.lattice.io import load_lattice
from joulemap.service.cli import app

CRS = "EPSG:32630"
FRAME = GridFrame(366900.0, 4064340.0, 0.5, 80, 80, CRS)


def polygon(west: float, south: float, east: float, north: float, **properties: object) -> dict:
    """A feature with a box, in metres from the map's south-west corner."""
    x, y = FRAME.bounds[0], FRAME.bounds[1]
    ring = [[x + a, y + b] for a, b in ((west, south), (east, south), (east, north), (west, north), (west, south))]
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": [ring]}}


def collection(*features: dict) -> dict:
    named = {"type": "name", "properties": {"name": CRS}}
    return {"type": "FeatureCollection", "crs": named, "features": list(features)}


KINDS = collection(polygon(0, 0, 20, 40, kind="Grass"), polygon(20, 0, 40, 40, kind="mud"))
WALL = collection(polygon(18, 18, 22, 40))
LEGEND = {"grass": {"rolling_resistance": 0.08}, "mud": {"value": 2, "rolling_resistance": 0.2, "std": 0.05}}


def check(folder: Path) -> None:
    lattice, robot = load_lattice(folder), Robot()
    level = lattice.traction_per_m[10, :, 0]
    assert level[8] == pytest.approx(robot.weight_n * 0.08, rel=1e-4)
    assert level[30] == pytest.approx(robot.weight_n * 0.2, rel=1e-4)
    assert lattice.blocked[8, 20] == Blocked.OBSTACLE
    assert lattice.blocked[32, 20] == Blocked.FREE
    assert [layer["role"] for layer in lattice.provenance["layers"]] == ["kinds", "obstacles"]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("layers")
    write_geotiff(folder / "level.tif", Heightmap(np.zeros(FRAME.shape, dtype=np.float32), FRAME))
    (folder / "kinds.geojson").write_text(json.dumps(KINDS))
    (folder / "wall.geojson").write_text(json.dumps(WALL))
    legend = "\n".join(f"[{name}]\n" + "\n".join(f"{k} = {v}" for k, v in one.items()) for name, one in LEGEND.items())
    (folder / "legend.toml").write_text(legend)
    return folder


def test_numbers_of_a_legend_and_words_for_numbers_on_the_command_line(files, tmp_path):
    (tmp_path / "dn.geojson").write_text(json.dumps(collection(polygon(0, 0, 40, 40, DN=2), polygon(0, 0, 9, 9, DN=5))))
    (tmp_path / "dn.toml").write_text("[mud]\nvalue = 2\nrolling_resistance = 0.2\n")
    (tmp_path / "abc.geojson").write_text(json.dumps(collection(polygon(0, 0, 40, 40, factor="abc"))))
    begin = f"costmap {files}/level.tif --model physics --out {tmp_path}/map.zarr --layer"
    done = CliRunner().invoke(app, f"{begin} kinds={tmp_path}/dn.geojson --legend {tmp_path}/dn.toml".split())
    assert done.exit_code == 0, done.output
    traction = load_lattice(tmp_path / "map.zarr").traction_per_m
    assert traction[10, 30, 0] == pytest.approx(Robot().weight_n * 0.2, rel=1e-4)
    assert "that the legend does not name (5)" in " ".join(done.output.split())
    done = CliRunner().invoke(app, f"{begin} factor={tmp_path}/abc.geojson --overwrite".split())
    assert isinstance(done.exception, SystemExit)  # and no traceback
    assert "abc.geojson has the factor 'abc', which is no number" in " ".join(done.output.split())


def test_on_the_command_line(files, tmp_path):
    words = (
        f"costmap {files}/level.tif --model physics --layer kinds={files}/kinds.geojson --legend {files}/legend.toml"
    )
    words += f" --layer obstacles={files}/wall.geojson --out {tmp_path}/map.zarr --picture {tmp_path}/map.png"
    done = CliRunner().invoke(app, words.split())
    assert done.exit_code == 0, done.output
    check(tmp_path / "map.zarr")


def test_a_layer_that_is_typed_wrongly_is_refused_with_what_to_type(files, tmp_path):
    for typed, said in (
        ("kinds", "WHAT=FILE"),
        ("mud=kinds.geojson", "no file"),
        (f"mud={files}/wall.geojson", "kinds, "),
    ):
        words = f"costmap {files}/level.tif --model physics --out {tmp_path}/no.zarr --layer {typed}"
        done = CliRunner().invoke(app, words.split())
        assert done.exit_code != 0
        assert said in " ".join(done.output.split())


def test_over_http(client, files):
    sent = client.post("/v1/heightmaps", files={"file": ("level.tif", (files / "level.tif").read_bytes())}).json()
    by_value = collection(KINDS["features"][0], polygon(20, 0, 40, 40, DN=2))
    asked = {
        "heightmap_id": sent["id"],
        "model": "physics",
        "layers": {"kinds": by_value, "obstacles": WALL},
        "legend": LEGEND,
    }
    made = client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=300"})
    assert made.status_code == 201, made.text
    about = made.json()
    assert [layer["role"] for layer in about["provenance"]["layers"]] == ["kinds", "obstacles"]
    assert about["blocked"]["obstacle"] > 0.0
    while client.get("/readyz").status_code != 200:  # kernels are loading
        time.sleep(0.5)
    start, goal = ([FRAME.bounds[0] + x, FRAME.bounds[1] + 30.0] for x in (10.0, 30.0))
    path = client.post(f"/v1/costmaps/{about['id']}/paths", json={"start": start, "goal": goal}).json()
    assert path["length_m"] > 25.0  # round the wall and not through it


@pytest.mark.parametrize(
    ("layers", "said"),
    [
        ({"mud": WALL}, "kinds"),
        ({"obstacles": {"type": "Point", "coordinates": [1.0, 2.0]}}, "Point"),
        ({"kinds": WALL}, "does not say its kinds"),
        ({"obstacles": {"type": "FeatureCollection"}}, "no GeoJSON"),
        ({"factor": collection(polygon(0, 0, 9, 9, factor=-1))}, "the limits are 0 and 100"),
        ({"cost": collection(polygon(0, 0, 9, 9, cost=1e308))}, "the layer of cost"),
        ({"kinds": collection(polygon(0, 0, 9, 9, kind={"a": 1}))}, "the layer of kinds"),
        ({"obstacles": {"type": "Feature", "properties": {}, "geometry": None}}, "has no geometry"),
        ({"obstacles": collection(polygon(50, 50, 60, 60))}, "lies on the heightmap"),
    ],
)
def test_what_is_no_layer_is_refused_at_once(client, files, layers, said):
    sent = client.post("/v1/heightmaps", files={"file": ("level.tif", (files / "level.tif").read_bytes())}).json()
    answer = client.post("/v1/costmaps", json={"heightmap_id": sent["id"], "model": "physics", "layers": layers})
    assert answer.status_code == 422
    assert said in answer.text


def test_speeds_are_judged_on_the_layers_of_the_cost_map(client):
    level = Heightmap(np.zeros(FRAME.shape, dtype=np.float32), FRAME)
    sent = client.post("/v1/heightmaps", content=write_geotiff(None, level)).json()
    over = {
        "factor": collection(polygon(0, 0, 60, 60, factor=2.0)),
        "cost": collection(polygon(0, 0, 60, 60, cost=5.0)),
    }
    asked = {"heightmap_id": sent["id"], "model": "default", "layers": over}
    about = client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=300"}).json()
    ends = {name: [FRAME.bounds[0] + x, FRAME.bounds[1] + 30.0] for name, x in (("start", 10.0), ("goal", 30.0))}
    path = client.post(f"/v1/costmaps/{about['id']}/paths", json=ends).json()
    speeds = client.post(f"/v1/costmaps/{about['id']}/speeds", json=ends).json()
    assert speeds["declared"]["energy_j"] == pytest.approx(path["energy_j"], rel=1e-3)
    costs = jm.costmap(jm.with_layers(level, **over))
    route = costs.plan(ends["start"], ends["goal"])
    with pytest.raises(jm.JoulemapError, match="made with cost, factor over its heightmap, this one has no layers"):
        costs.speeds(route, level)
