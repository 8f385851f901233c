"""Energy fields as products: Python, command line and HTTP give the same numbers; the corridor holds good routes."""

import io
import json
import zipfile

import numpy as np
import pytest
import rasterio
from pyproj import Transformer
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.errors import InputError, NoRouteError
from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.cli import app
from tests.service.conftest import GOAL as HTTP_GOAL
from tests.service.conftest import START as HTTP_START

START, GOAL = (5.5, 5.5), (43.5, 33.5)


def hills():
    y, x = np.mgrid[0:40, 0:50].astype(float)
    heights = 1.5 * np.sin(x / 7.0) * np.cos(y / 9.0)
    heights[15:25, 20:30] = np.nan
    return Heightmap(heights.astype(np.float32), GridFrame(100.0, 40.0, 1.0, 40, 50, "EPSG:32630"))


@pytest.fixture(scope="module", params=[0.0, 40.0], ids=["no turning", "turning"])
def costmap(request):
    return jm.costmap(hills(), robot={"turn_j_per_rad": request.param}, model="physics")


def shifted(place):
    return place[0] + 100.0, place[1]


def test_fields_agree_with_routes_over_the_grid(costmap):
    start, goal = shifted(START), shifted(GOAL)
    best = costmap.plan(start, goal, refine=False).energy_j
    row, col = costmap.lattice.frame.cell_of(*goal)
    there = costmap.field(start=start).energy_j[row, col]
    row, col = costmap.lattice.frame.cell_of(*start)
    back = costmap.field(goal=goal).energy_j[row, col]
    through = costmap.field(start=start, goal=goal)
    assert there == pytest.approx(best, rel=1e-5)
    assert back == pytest.approx(best, rel=1e-5)
    assert through.least_j == pytest.approx(best, rel=1e-5)


def test_the_corridor_holds_the_best_route_and_grows(costmap):
    found = costmap.field(start=shifted(START), goal=shifted(GOAL))
    narrow, wide = found.corridor(0.0), found.corridor(0.2)
    assert (wide | ~narrow).all()
    assert narrow.sum() < wide.sum() < wide.size
    for x, y, _ in costmap.plan(shifted(START), shifted(GOAL), refine=False).points:
        assert narrow[costmap.lattice.frame.cell_of(x, y)]
    assert np.isnan(found.energy_j[20, 25])  # unknown ground


def test_a_field_as_dataset_and_geotiff(costmap):
    found = costmap.field(start=shifted(START), goal=shifted(GOAL))
    dataset = found.to_xarray(within=0.05)
    assert dataset.energy_j.attrs["units"] == "J"
    np.testing.assert_array_equal(dataset.corridor, found.corridor(0.05))
    x, _ = costmap.lattice.frame.centres()
    np.testing.assert_allclose(dataset.x, x)
    with rasterio.open(io.BytesIO(found.geotiff(within=0.05))) as file:
        np.testing.assert_array_equal(file.read(1), found.energy_j)
        np.testing.assert_array_equal(file.read(2), found.corridor(0.05))
        assert file.crs.to_epsg() == 32630


def test_wrong_questions_to_a_field(costmap):
    with pytest.raises(InputError, match="start"):
        costmap.field()
    with pytest.raises(InputError, match="start and a goal"):
        costmap.field(start=shifted(START)).corridor(0.1)
    with pytest.raises(InputError, match="within"):
        costmap.field(start=shifted(START), goal=shifted(GOAL)).corridor(-0.1)


def test_the_command_writes_the_field(costmap, tmp_path):
    folder, tif, out = costmap.save(tmp_path / "map.zarr"), tmp_path / "field.tif", tmp_path / "field.json"
    start, goal = (f"{x},{y}" for x, y in map(shifted, (START, GOAL)))
    command = ["field", str(folder), "--start", start, "--goal", goal, "--within", "5", "--out", str(tif)]
    result = CliRunner().invoke(app, [*command, "--json", str(out)])
    assert result.exit_code == 0, result.output
    found = costmap.field(start=shifted(START), goal=shifted(GOAL))
    told = json.loads(out.read_text())
    assert told["least_j"] == pytest.approx(found.least_j)
    assert told["corridor_cells"] == int(found.corridor(0.05).sum())
    with rasterio.open(tif) as file:
        np.testing.assert_array_equal(file.read(1), found.energy_j)


def test_a_field_keeps_off_areas_and_says_where_it_begins(costmap, tmp_path):
    area = [[110.0, 2.0], [120.0, 2.0], [120.0, 12.0], [110.0, 12.0]]
    found = costmap.field(start=shifted(START), avoid=[area])
    assert np.isnan(found.energy_j[costmap.lattice.frame.cell_of(115.0, 7.0)])
    folder, tif = costmap.save(tmp_path / "map.zarr"), tmp_path / "field.tif"
    hole = [*(f"--start={x},{y}" for x, y in [shifted((25.5, 19.5))]), "--snap"]
    result = CliRunner().invoke(app, ["field", str(folder), *hole, "--out", str(tif)])
    assert result.exit_code == 0, result.output
    assert "moved to the nearest free place" in result.output


def test_fields_over_http(client, costmap_id):
    place = f"/v1/costmaps/{costmap_id}/field"
    ends = {"start_x": HTTP_START[0], "start_y": HTTP_START[1], "goal_x": HTTP_GOAL[0], "goal_y": HTTP_GOAL[1]}
    told = client.get(place, params={**ends, "within": 5}).json()
    assert told["kind"] == "through"
    answer = client.get(place, params={**ends, "within": 5, "format": "geotiff"})
    with rasterio.open(io.BytesIO(answer.content)) as file:
        energy, corridor = file.read(1), file.read(2)
    assert told["least_j"] == pytest.approx(float(np.nanmin(energy)))
    assert told["corridor_cells"] == int(corridor.sum())
    assert told["reached"] == int(np.isfinite(energy).sum())
    path = {"start": HTTP_START, "goal": HTTP_GOAL, "refine": False}
    best = client.post(f"/v1/costmaps/{costmap_id}/paths", json=path).json()
    assert told["least_j"] == pytest.approx(best["energy_j"], rel=1e-5)
    assert client.get(place, params={**ends, "format": "png"}).content[:4] == b"\x89PNG"
    assert client.get(place).status_code == 422
    assert client.get(place, params={"start_x": 1.0}).status_code == 422
    assert told["warnings"] == []
    (lon,), (lat,) = Transformer.from_crs("EPSG:32630", "EPSG:4326", always_xy=True).transform(
        [HTTP_START[0]], [HTTP_START[1]]
    )
    here = client.get(place, params={"start_x": lat, "start_y": lon}).json()
    assert here["reached"] > 0
    assert "was read as latitude,longitude" in here["warnings"][0]


def test_areas_to_avoid_hold_for_paths_tours_and_verdicts_over_http(client, costmap_id):
    west, north = HTTP_START[0] - 3.5, HTTP_START[1] + 15.5
    area = [
        [west + 18.0, north - 20.0],
        [west + 22.0, north - 20.0],
        [west + 22.0, north - 2.0],
        [west + 18.0, north - 2.0],
    ]
    place = f"/v1/costmaps/{costmap_id}"
    asked = {"start": HTTP_START, "goal": HTTP_GOAL, "avoid": [area]}
    free = client.post(f"{place}/paths", json=asked | {"avoid": []}).json()
    path = client.post(f"{place}/paths", json=asked).json()
    assert path["energy_j"] > free["energy_j"]
    assert not any(west + 18.0 < x < west + 22.0 and north - 20.0 < y < north - 2.0 for x, y, _ in path["path"])
    verdict = client.post(f"{place}/feasibility", json=asked).json()
    assert verdict["energy_j"] == pytest.approx(path["energy_j"], rel=1e-6)
    tour = client.post(f"{place}/tours", json={"stops": [HTTP_START, HTTP_GOAL], "avoid": [area]}).json()
    assert tour["legs"][0]["energy_j"] == pytest.approx(path["energy_j"], rel=1e-6)
    refused = client.post(f"{place}/paths", json=asked | {"start": [west + 20.0, north - 10.0]})
    assert refused.status_code == 422
    assert refused.json()["context"]["reason"] == "avoid"
    short = client.post(f"{place}/paths", json=asked | {"avoid": [area[:2]]})
    assert short.status_code == 422


def test_reach_over_http_and_in_python_is_one_answer_in_every_format(client, costmap_id, costmap, tmp_path):
    place = f"/v1/costmaps/{costmap_id}/reach"
    asked = {"start": HTTP_START, "charges": [0.001, 0.002, 1.0], "round_trip": True, "battery": {"reserve": 0.0}}
    found = client.post(place, json=asked).json()
    areas = [level["area_m2"] for level in found["levels"]]
    assert 0.0 < areas[0] < areas[1] < areas[2]
    features = client.post(place, json=asked, params={"format": "geojson"}).json()["features"]
    assert [one["properties"]["area_m2"] for one in features] == areas
    longitude, latitude = features[0]["geometry"]["coordinates"][0][0][0]
    assert (longitude, latitude) == pytest.approx((-3.0, 36.14), abs=0.01)
    assert features[0]["properties"] | {"charge": 0.001, "round_trip": True} == features[0]["properties"]
    mine = client.post(place, json=asked, params={"format": "geojson", "coordinates": "map"}).json()
    assert mine["features"][0]["geometry"]["coordinates"] == found["levels"][0]["polygons"]
    tif = client.post(place, json=asked, params={"format": "geotiff"}).content
    with rasterio.open(io.BytesIO(tif)) as dataset:
        assert (np.nan_to_num(dataset.read(2), nan=-1.0) >= 0.0).sum() == areas[1]
    assert client.post(place, json=asked, params={"format": "png"}).content[:4] == b"\x89PNG"
    here = jm.open_costmap(_saved(client, costmap_id, tmp_path)).reach(HTTP_START, charge=[0.002], round_trip=True)
    assert here.area_m2() == areas[1]


def _saved(client, costmap_id, folder):
    content = client.get(f"/v1/costmaps/{costmap_id}/data", params={"format": "zarr"}).content
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(folder / "map.zarr")
    found = next((folder / "map.zarr").rglob("zarr.json"))
    return found.parent


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"confidence": 0.9}, "does not know its uncertainty"),
        ({"confidence": 1.0}, "less than or equal to 0.99"),
        ({"charges": []}, "at least 1"),
        ({"charges": [0.5] * 11}, "at most 10"),
        ({"battery": {"reserve": 2.0}}, "reserve"),
    ],
)
def test_questions_for_reach_that_have_no_answer_are_refused_in_words(client, costmap_id, more, words):
    answer = client.post(f"/v1/costmaps/{costmap_id}/reach", json={"start": HTTP_START, **more})
    assert answer.status_code == 422
    assert words in answer.text


def test_reach_from_the_command_line(costmap, tmp_path):
    place = costmap.save(tmp_path / "hills.zarr")
    out = tmp_path / "reach.geojson"
    words = ["reach", str(place), "--start", "105.5,5.5", "--charge", "0.0008,0.003", "--return", "--out", str(out)]
    found = CliRunner().invoke(app, [*words, "--json", str(tmp_path / "reach.json")])
    assert found.exit_code == 0, found.output
    assert "from 0.08 % charge" in found.output
    assert len(json.loads(out.read_text())["features"]) == 2
    levels = json.loads((tmp_path / "reach.json").read_text())["levels"]
    assert [level["charge"] for level in levels] == [0.0008, 0.003]
    refused = CliRunner().invoke(app, [*words[:-1], "reach.gpx"])
    assert refused.exit_code == 2


def test_a_field_between_places_that_no_way_joins_is_an_error(tmp_path):
    heights = np.zeros((30, 40))
    heights[:, 20:22] = 5.0
    ground = jm.costmap(jm.heightmap(heights, resolution_m=1.0), model="physics")
    with pytest.raises(NoRouteError, match="no way leads"):
        ground.field(start=(5.5, 15.5), goal=(35.5, 15.5), snap=True)
    ground.save(tmp_path / "walled.zarr")
    place = tmp_path / "field.tif"
    words = ["--start", "5.5,15.5", "--goal", "35.5,15.5", "--snap", "--out", str(place)]
    found = CliRunner().invoke(app, ["field", str(tmp_path / "walled.zarr"), *words])
    assert found.exit_code == 4, found.output
    assert not place.exists()
    with pytest.raises(NoRouteError):
        ground.plan((5.5, 15.5), (35.5, 15.5))
    found = ground.plan((5.5, 15.5), (35.5, 15.5), snap=True)
    assert found.points[-1][0] < 20.0
    assert any("cannot be reached and was moved" in note for note in found.route.notes)


def test_help_shows_choices_and_null_is_an_answer(costmap, tmp_path):
    """`--confidence null` judges by the expected energy, as over HTTP; a number outside the bounds is wrong usage."""
    costmap.save(tmp_path / "map.zarr")
    runner = CliRunner(env={"COLUMNS": "200"})
    shown = runner.invoke(app, ["path", "--help"]).output
    assert "astar|dijkstra|" in shown
    assert "8|16|32" in shown
    asked = ["return", str(tmp_path / "map.zarr"), "--position", "110,10", "--home", "140,30", "--charge", "0.5"]
    found = runner.invoke(app, [*asked, "--confidence", "null", "--json", str(tmp_path / "found.json")])
    assert found.exit_code == 0, found.output
    without = json.loads((tmp_path / "found.json").read_text())
    assert (without["home"]["probability"], without["warnings"]) == (None, [])
    assert "does not know its uncertainty: the expected energy decides" in runner.invoke(app, asked).output
    refused = runner.invoke(app, [*asked, "--confidence", "0.9"])
    assert (refused.exit_code, "no confidence can be given" in " ".join(refused.output.split())) == (3, True)
    wrong = runner.invoke(app, [*asked, "--confidence", "0.2"])
    assert wrong.exit_code == 2
    assert "--confidence: Input should be greater than or equal to 0.5, got 0.2" in wrong.output
