"""Latitude and longitude in, routes in every format out: over HTTP, by the commands, in Python and by the client."""

from __future__ import annotations

import json
import zipfile
from importlib import metadata
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gpxpy
import numpy as np
import pytest
from fastapi.testclient import TestClient
from pyproj import Transformer

import joulemap as jm
from joulemap.model.errors import InputError, PointError
from joulemap.model.frames import GridFrame
from joulemap.service.client import ServedCostMap
from joulemap.service.commands.console import parse_point
from joulemap.service.exports.maps import MAP_FORMATS
from joulemap.service.exports.routes import ROUTE_FORMATS
from joulemap.service.exports.track import track_of_drive
from joulemap.service.places.coordinates import world_point
from joulemap.service.places.places import Places
from tests.service.conftest import GOAL, NORTH, START, WEST, hill
from tests.service.test_cli import joulemap as command

_TO = Transformer.from_crs("EPSG:32630", "EPSG:4326", always_xy=True)
FRAME = GridFrame(WEST, NORTH, 1.0, 30, 40, "EPSG:32630")


def latlon(place: list[float]) -> list[float]:
    lon, lat = _TO.transform(place[0], place[1])
    return [lat, lon]


@pytest.fixture(scope="module")
def costmap() -> jm.CostMap:
    return jm.costmap(hill(), model="physics")


@pytest.fixture(scope="module")
def folder(costmap: jm.CostMap, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return costmap.save(tmp_path_factory.mktemp("missions") / "hill.zarr")


@pytest.fixture(scope="module")
def served(service: jm.Client, costmap_id: str) -> ServedCostMap:
    return service.open_costmap(costmap_id)


def test_two_numbers_are_metres_on_the_map_and_degrees_beside_it() -> None:
    assert world_point(FRAME, START) == world_point(FRAME, [*START, 12.0])
    assert world_point(FRAME, START).note is None
    lat, lon = latlon(START)
    found = world_point(FRAME, [lat, lon], name="start")
    assert (found.x, found.y) == pytest.approx(START, abs=1e-3)
    assert found.note is not None
    assert found.note.startswith(f"start {lat:g},{lon:g} was read as latitude,longitude")
    for place in ({"lat": lat, "lon": lon}, {"Latitude": lat, "longitude": lon}):
        assert world_point(FRAME, place).note is None
        assert (world_point(FRAME, place).x, world_point(FRAME, place).y) == pytest.approx(START, abs=1e-3)
    with pytest.raises(PointError, match="write latitude first"):
        world_point(FRAME, [lon, lat])
    near_origin = GridFrame(0.0, 100.0, 1.0, 100, 100, "EPSG:32630")
    assert world_point(near_origin, (36.72, 4.49)).note is None  # metres: they lie on the map
    assert world_point(GridFrame(0.0, 30.0, 1.0, 30, 30), (36.72, -4.49)).note is None  # no CRS: nothing else is meant


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ({"lat": 95.0, "lon": 0.0}, "within -90..90"),
        ({"lat": 36.0}, "`lat` and `lon` in degrees"),
        ({"lat": 36.0, "lon": "west"}, "`lat` and `lon` in degrees"),
        ({"lat": 36.0, "lon": 1.0, "alt": 3.0}, "`lat` and `lon` in degrees"),
        ({"lat": 10.0, "lon": 10.0}, "spans latitude"),
        ({"lat": float("nan"), "lon": 1.0}, "within -90..90"),
        ("there", "give x and y in metres"),
        ([1.0], "give x and y in metres"),
        (None, "give x and y in metres"),
    ],
)
def test_what_is_no_place_is_named(place: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        world_point(FRAME, place, name="goal")


def test_paths_and_areas_are_read_in_one_form() -> None:
    places = Places(FRAME)
    degrees = [latlon(START), latlon(GOAL)]
    for path in (degrees, [{"lat": lat, "lon": lon} for lat, lon in degrees]):
        assert places.path(path) == pytest.approx(Places(FRAME).path([START, GOAL]), abs=1e-3)
    assert len(places.notes) == 1
    corners = [[WEST - 5.0, NORTH + 5.0], [WEST + 10.0, NORTH + 5.0], [WEST + 10.0, NORTH - 9.0]]  # beyond the map
    for area in ([latlon(p) for p in corners], [{"lat": latlon(p)[0], "lon": latlon(p)[1]} for p in corners]):
        (found,) = Places(FRAME).areas([area])
        assert [v for p in found for v in p] == pytest.approx([v for p in corners for v in p], abs=1e-3)
    assert Places(FRAME).areas([corners]) == [corners]
    with pytest.raises(InputError, match="point 1 of the path"):
        places.path([START, "there"])


def test_http_takes_degrees_and_says_so(client: TestClient, costmap_id: str) -> None:
    base = f"/v1/costmaps/{costmap_id}"
    (lat, lon), goal = latlon(START), latlon(GOAL)
    plain = client.post(f"{base}/paths", json={"start": START, "goal": GOAL}).json()
    answer = client.post(f"{base}/paths", json={"start": {"lat": lat, "lon": lon}, "goal": goal})
    assert answer.status_code == 200, answer.text
    assert answer.json()["energy_j"] == pytest.approx(plain["energy_j"], rel=1e-3)
    assert any("goal" in w and "was read as latitude,longitude" in w for w in answer.json()["warnings"])
    asked = {"path": [{"lat": lat, "lon": lon}, {"lat": goal[0], "lon": goal[1]}]}
    judged = client.post(f"{base}/feasibility", json=asked)
    straight = client.post(f"{base}/feasibility", json={"path": [START, GOAL]})
    assert judged.json()["energy_j"] == pytest.approx(straight.json()["energy_j"], rel=1e-3)
    here = client.get(f"{base}/at", params={"lat": lat, "lon": lon}).json()
    assert (here["x"], here["y"]) == pytest.approx(START, abs=1e-3)
    for wrong, words in (
        ({"lat": lat}, "go together"),
        ({}, "name one place"),
        ({"x": 1, "y": 2, "lat": 3, "lon": 4}, "one"),
    ):
        problem = client.get(f"{base}/at", params=wrong)
        assert (problem.status_code, words in problem.json()["detail"]) == (422, True), problem.text
    swapped = client.post(f"{base}/paths", json={"start": [lon, lat], "goal": GOAL})
    assert (swapped.status_code, "write latitude first" in swapped.json()["detail"]) == (422, True)


def test_every_format_over_http_and_by_the_client(client: TestClient, costmap_id: str, served: ServedCostMap) -> None:
    url, asked = f"/v1/costmaps/{costmap_id}/paths", {"start": START, "goal": GOAL}
    for name, known in ROUTE_FORMATS.items():
        answer = client.post(url, params={"format": name}, json=asked)
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-type"].startswith(known.media_type)
        assert f'{known.suffix}"' in answer.headers["content-disposition"]
        assert served.plan_file(START, GOAL, format=name) == answer.content
    gpx = client.post(url, json=asked, headers={"Accept": "application/gpx+xml"})
    assert gpxpy.parse(gpx.text).tracks[0].type == "energy_optimal"
    assert client.post(url, json=asked, headers={"Accept": "text/plain, */*"}).json()["planner"] == "astar"
    wrong = client.post(url, params={"coordinates": "map"}, json=asked)
    assert (wrong.status_code, "format=geojson" in wrong.json()["detail"]) == (422, True)
    assert client.post(url, params={"format": "doc"}, json=asked).status_code == 422
    assert "map_crs" in served.plan_geojson(START, GOAL)
    assert served.plan_geojson(START, GOAL, coordinates="map")["crs"]["properties"]["name"] == "EPSG:32630"


def test_a_tour_as_a_mission(served: ServedCostMap) -> None:
    pytest.importorskip("ortools")
    stops = [START, GOAL, [START[0] + 10.0, START[1] - 8.0]]
    plan = json.loads(served.file("tour", stops=[stops[0], latlon(stops[1]), stops[2]], format="qgc-plan"))
    assert plan["mission"]["items"][1]["params"][4:6] == pytest.approx(plan["mission"]["items"][-1]["params"][4:6])


def test_cost_maps_in_every_format_over_http(client: TestClient, costmap_id: str) -> None:
    for name, known in MAP_FORMATS.items():
        answer = client.get(f"/v1/costmaps/{costmap_id}/data", params={"format": name})
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-type"] == known.media_type
        if name == "nav2-map":
            names = zipfile.ZipFile(BytesIO(answer.content)).namelist()
            assert names == [f"{costmap_id}.yaml", f"{costmap_id}.pgm"]


def test_commands_write_and_read_every_format(folder: Path, tmp_path: Path) -> None:
    lat, lon = latlon(START)
    files = [tmp_path / f"way{known.suffix}" for known in ROUTE_FORMATS.values()]
    out = [word for file in files for word in ("--out", file)]
    start = f"{lat:.7f}N,{-lon:.7f}W" if lon < 0 else f"{lat:.7f}N,{lon:.7f}E"
    goal = ",".join(f"{v:.8f}" for v in latlon(GOAL))
    code, words, errors = command("path", folder, "--start", start, "--goal", goal, *out, "--json", tmp_path / "a.json")
    assert code == 0, errors
    assert "was read as latitude,longitude" in errors
    assert "start" not in errors
    energy = json.loads((tmp_path / "a.json").read_text())["energy_j"]
    for file in files:
        assert file.stat().st_size > 0
        if file.suffix != ".mcap":
            code, words, errors = command("feasibility", folder, "--path", file, "--json", "-")
            assert code == 0, (file, errors)
            assert json.loads(words)["energy_j"] == pytest.approx(energy, rel=0.01)
    code, _, errors = command("feasibility", folder, "--path", tmp_path / "way.mcap")
    assert (code, "holds no path" in errors) == (3, True)
    code, _, errors = command("path", folder, "--start", start, "--goal", goal, "--out", tmp_path / "way.doc")
    assert (code, "end with one of" in errors) == (3, True)
    code, _, _ = command("path", folder, "--start", start, "--goal", goal, "--format", "gpx")
    assert code == 2
    code, _, errors = command("path", folder, "--start", f"{lon},{lat}", "--goal", goal)
    assert (code, "write latitude first" in errors) == (3, True)


def test_the_command_that_exports_a_map(folder: Path, tmp_path: Path) -> None:
    for known in MAP_FORMATS.values():
        code, words, errors = command("export", folder, "--out", tmp_path / f"map{known.suffix}", "--json", "-")
        assert code == 0, errors
        assert all(Path(file).stat().st_size > 0 for file in json.loads(words)["written"])
    assert (tmp_path / "map.pgm").exists()
    code, _, errors = command("export", folder, "--out", tmp_path / "map.docx")
    assert (code, "Nav2" in errors) == (3, True)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("36.72N,4.49W", {"lat": 36.72, "lon": -4.49}),
        ("33.9 S, 151.2 E", {"lat": -33.9, "lon": 151.2}),
        ("-36.72n,-4.49e", {"lat": -36.72, "lon": -4.49}),
        ("12.5,40", (12.5, 40.0)),
        ("-3,1e3", (-3.0, 1000.0)),
    ],
)
def test_places_as_they_are_typed(text: str, place: Any) -> None:
    assert parse_point(text) == place


def test_doctor_finds_what_is_there_and_what_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, words, errors = command("doctor", "--data-dir", tmp_path, "--json", "-")
    assert code == 0, errors
    found = {one["name"]: one for one in json.loads(words)["findings"]}
    assert found["data directory"]["words"].startswith(str(tmp_path))
    assert found["requirements"]["state"] == "good"
    assert {"joulemap", "python", "extra tours", "extra logs", "geodata", "model", "gpu"} <= found.keys()
    real = metadata.version
    monkeypatch.setattr(metadata, "version", lambda name: "0.0.1" if name == "zarr" else real(name))
    monkeypatch.setenv("JOULEMAP_DATA_DRI", "/tmp")
    code, words, errors = command("doctor", "--data-dir", tmp_path, "--json", "-")
    assert code == 1
    found = {one["name"]: one for one in json.loads(words)["findings"]}
    assert "zarr 0.0.1 is installed, >=3.0 is needed" in found["requirements"]["words"]
    assert "JOULEMAP_DATA_DRI" in found["environment"]["words"]
    assert json.loads(words)["wrong"] == 2


def test_doctor_names_an_extra_that_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = metadata.version

    def _without(name: str) -> str:
        if name == "ortools":
            raise metadata.PackageNotFoundError(name)
        return real(name)

    monkeypatch.setattr(metadata, "version", _without)
    code, words, _ = command("doctor", "--data-dir", tmp_path)
    assert code == 0  # optional
    assert "pip install 'joulemap[tours]'" in words


def test_the_next_drive_by_command_and_in_python(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drive: dict[str, Any] = {
        "effect": "turning",
        "label": "turning",
        "confounded_with": [],
        "confounded_labels": [],
        "kind": "slalom",
        "placed": True,
        "crs": "EPSG:32630",
        "points": [START, GOAL],
        "speeds_mps": [0.4],
        "length_m": 33.0,
        "total_length_m": 100.0,
        "expected_interval_share": 0.5,
    }
    monkeypatch.setattr("joulemap.service.commands.drives.ComparedDrives.read", lambda _asked: None)
    monkeypatch.setattr(
        "joulemap.service.loop.next_drive.suggest_next_drive",
        lambda *_given, **_options: SimpleNamespace(as_dict=lambda: dict(drive)),
    )
    (tmp_path / "run.csv").write_text("t\n")
    (tmp_path / "dem.tif").write_bytes(b"")
    asked = ("suggest-drive", "--heightmap", tmp_path / "dem.tif", "--runs", tmp_path / "run.csv")
    out = ("--out", tmp_path / "next.gpx", "--out", tmp_path / "next.plan")
    code, _, errors = command(*asked, *out)
    assert code == 0, errors
    (line,) = gpxpy.parse((tmp_path / "next.gpx").read_text()).tracks
    assert [(p.latitude, p.longitude) for p in line.segments[0].points][1] == pytest.approx(latlon(GOAL), abs=1e-9)
    result = jm.CalibrationResult(tmp_path, {"next_drive": drive})
    assert result.save_next_drive(tmp_path / "again.gpx").read_bytes() == (tmp_path / "next.gpx").read_bytes()
    with pytest.raises(InputError, match="no effect"):
        track_of_drive({"why_not": "no effect was found"})
    drive["placed"] = False
    code, _, errors = command(*asked, *out)
    assert (code, "are no places" in errors) == (3, True)


def test_ros_and_nav2_files_may_count_from_a_local_origin(
    folder: Path, served: ServedCostMap, costmap: jm.CostMap, tmp_path: Path
) -> None:
    """In UTM a float32 has steps of 0.25 m: the same places from a near origin, by every face."""

    def _places(content: bytes) -> list[tuple[float, float]]:
        found = [pose["pose"]["position"] for pose in json.loads(content)["poses"]]
        return [(one["x"], one["y"]) for one in found]

    ends = ["--start", ",".join(map(str, START)), "--goal", ",".join(map(str, GOAL))]
    far, near = tmp_path / "far.path.json", tmp_path / "near.path.json"
    assert command("path", folder, *ends, "--out", far)[0] == 0
    assert command("path", folder, *ends, "--out", near, "--origin", "start")[0] == 0
    moved = np.array(_places(far.read_bytes())) - START
    assert np.array(_places(near.read_bytes())) == pytest.approx(moved, abs=1e-6)
    over_http = served.plan_file(start=START, goal=GOAL, format="ros-path", origin=f"{START[0]},{START[1]}")
    assert np.array(_places(over_http)) == pytest.approx(moved, abs=1e-6)
    assert command("export", folder, "--out", tmp_path / "near.yaml", "--origin", f"{WEST},{NORTH - 30.0}")[0] == 0
    assert "origin: [0.0, 0.0, 0.0]" in (tmp_path / "near.yaml").read_text()
    code, _, errors = command("path", folder, *ends, "--out", tmp_path / "a.gpx", "--origin", "start")
    assert (code, "--origin is for mcap, ros-path" in " ".join(errors.split())) == (2, True), errors
    with pytest.raises(InputError, match="give x,y in metres"):
        costmap.export(tmp_path / "b.yaml", origin="there")  # type: ignore[arg-type]
