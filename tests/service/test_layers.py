"""Layers through the command line and HTTP: what they close and cost in the file that comes out."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin
from rasterio.warp import transform_bounds
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.frames import GridFrame
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice import Blocked
from joulemap.planner.lattice.loading import load_lattice
from joulemap.service.cli import app
from joulemap.service.commands.remote import unpack
from joulemap.service.storage.store import Store

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
        ("kinds=none.geojson", "no file"),
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


def sent_raster(client, values: np.ndarray, *, crs: str = CRS, **options: object) -> dict:
    """A raster of 2 m over the map, as a layer."""
    with rasterio.MemoryFile() as memory:
        place = from_origin(FRAME.west_m, FRAME.north_m, 2.0, 2.0)
        if crs != CRS:
            place = rasterio.transform.from_bounds(*transform_bounds(CRS, crs, *FRAME.bounds), *values.shape[::-1])
        shape = {"width": values.shape[1], "height": values.shape[0], "count": 1, "dtype": values.dtype.name}
        with memory.open(driver="GTiff", crs=crs, transform=place, **shape) as file:
            file.write(values, 1)
        sent = client.post(
            "/v1/heightmaps", params={"layer": True, **options}, files={"file": ("land.tif", memory.read())}
        )
    assert sent.status_code == 201, sent.text
    return sent.json()


def halves(least: int = 1, most: int = 3) -> np.ndarray:
    values = np.full((20, 20), least, dtype=np.uint8)
    values[:, 10:] = most
    return values


LAND = {"grass": {"value": 1, "rolling_resistance": 0.08}, "ice": {"value": 2, "rolling_resistance": 0.01},
        "mud": {"value": 3, "rolling_resistance": 0.2}}  # fmt: skip


@pytest.mark.parametrize("crs", [CRS, "EPSG:4326"])
def test_a_raster_is_sent_once_and_named_by_cost_maps(client, files, crs, tmp_path):
    """Between 1 and 3 lies 2, which no cell has: nothing is interpolated on the way."""
    ground = client.post("/v1/heightmaps", files={"file": ("level.tif", (files / "level.tif").read_bytes())}).json()
    kinds = sent_raster(client, halves(), crs=crs)
    assert [note for note in kinds["notes"] if "nearest" not in note and "reprojected" not in note] == []
    house = np.zeros((20, 20), dtype=np.uint8)
    house[:11, 9:11] = 1
    assert kinds["layer"]
    named = {"kinds": {"heightmap_id": kinds["id"]}, "obstacles": {"heightmap_id": sent_raster(client, house)["id"]}}
    asked = {"heightmap_id": ground["id"], "model": "physics", "layers": named, "legend": LAND}
    made = client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=300"})
    assert made.status_code == 201, made.text
    unpacked = tmp_path / "map.zarr"
    zipped = client.get(f"/v1/costmaps/{made.json()['id']}/data", params={"format": "zarr"})
    assert zipped.status_code == 200, zipped.text
    unpack(zipped.content, unpacked)
    check(unpacked)
    assert [layer["source"] for layer in load_lattice(unpacked).provenance["layers"]] == [
        f"land.tif ({layer['heightmap_id']})" for layer in named.values()
    ]
    if crs == CRS:
        kept = client.delete(f"/v1/heightmaps/{kinds['id']}")
        assert kept.status_code == 409
        assert f"is used by 1 cost map(s), {made.json()['id']}" in kept.json()["detail"]
        client.delete(f"/v1/costmaps/{made.json()['id']}")
        assert client.delete(f"/v1/heightmaps/{kinds['id']}").status_code == 204


def test_a_raster_that_is_deleted_while_a_map_asks_for_it(client, files, monkeypatch):
    ground = client.post("/v1/heightmaps", files={"file": ("level.tif", (files / "level.tif").read_bytes())}).json()
    factor = client.post("/v1/heightmaps", params={"layer": True}, content=(files / "level.tif").read_bytes()).json()
    whole = Store.add_costmap

    def _after_its_check(store, *arguments, **options):
        store.delete_heightmap(factor["id"])
        return whole(store, *arguments, **options)

    monkeypatch.setattr(Store, "add_costmap", _after_its_check)
    asked = {"heightmap_id": ground["id"], "model": "physics", "layers": {"factor": {"heightmap_id": factor["id"]}}}
    answer = client.post("/v1/costmaps", json=asked)
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found"), answer.text


def test_polygons_with_a_member_that_looks_like_an_id_are_polygons(client, files):
    ground = client.post("/v1/heightmaps", files={"file": ("level.tif", (files / "level.tif").read_bytes())}).json()
    layers = {"obstacles": WALL | {"heightmap_id": "../joulemap.db"}}
    asked = {"heightmap_id": ground["id"], "model": "physics", "layers": layers}
    made = client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=300"})
    assert made.status_code == 201, made.text
    assert [layer["source"] for layer in made.json()["provenance"]["layers"]] == ["areas of obstacles"]


def test_a_request_holds_thousands_of_polygons(client, files):
    ground = client.post("/v1/heightmaps", files={"file": ("level.tif", (files / "level.tif").read_bytes())}).json()
    trees = collection(
        *(polygon(0.5 * x, 0.5 * y, 0.5 * x + 0.2, 0.5 * y + 0.2, id=72 * x + y) for x in range(70) for y in range(72))
    )
    asked = {"heightmap_id": ground["id"], "model": "physics", "layers": {"obstacles": trees}}
    answer = client.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=300"})
    assert (answer.status_code, answer.json().get("status")) == (201, "done"), answer.text[:500]


def test_a_raster_that_names_no_crs_is_taken_for_the_map_s_and_that_is_said(files, tmp_path):
    values = halves().astype(np.float32)
    bare = Heightmap(values, GridFrame(FRAME.west_m, FRAME.north_m, 2.0, 20, 20))
    write_geotiff(tmp_path / "bare.tif", bare)
    asked = ("costmap", files / "level.tif", "--model", "physics", "--layer", f"factor={tmp_path / 'bare.tif'}")
    told = CliRunner().invoke(app, [str(word) for word in (*asked, "--out", tmp_path / "map.zarr")])
    assert told.exit_code == 0, told.output
    assert "bare.tif no coordinate reference system is known" in " ".join(told.output.split())


def test_rasters_that_are_no_layers_of_the_map_are_refused_at_once(client, files):
    ground = client.post("/v1/heightmaps", files={"file": ("level.tif", (files / "level.tif").read_bytes())}).json()
    kinds = sent_raster(client, halves())
    far = write_geotiff(None, Heightmap(np.zeros((9, 9), dtype=np.float32), GridFrame(0.0, 9.0, 1.0, 9, 9, CRS)))
    elsewhere = client.post("/v1/heightmaps", params={"layer": True}, content=far).json()
    for asked, status, said in (
        ({"heightmap_id": kinds["id"]}, 422, "sent as a layer"),
        ({"layers": {"kinds": {"heightmap_id": kinds["id"]}}}, 422, "the legend gives no `value`"),
        ({"layers": {"factor": {"heightmap_id": elsewhere["id"]}}}, 422, "outside the heightmap"),
        ({"layers": {"factor": {"heightmap_id": "hm-000000000000"}}}, 404, "is no heightmap"),
    ):
        answer = client.post("/v1/costmaps", json={"heightmap_id": ground["id"], "model": "physics"} | asked)
        assert answer.status_code == status, answer.text
        assert said in answer.text
