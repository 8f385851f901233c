"""The main job through HTTP: a heightmap in, a cost map, paths and verdicts out."""

from __future__ import annotations

import io
import json
import re
import zipfile

import numpy as np
import pytest
import rasterio
from fastapi.testclient import TestClient
from rasterio.io import MemoryFile

from joulemap.model.frames import GridFrame
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice.loading import load_lattice
from joulemap.service.schemas.planning import FeasibilityOut, PathOut
from tests.reference.lattices import price_world_path
from tests.service.conftest import GOAL, IN_HOLE, NORTH, START, WEST, hill
from tests.service.test_restart import wait_until


def test_heightmap_is_kept_as_it_was_sent(client: TestClient, heightmap_id: str) -> None:
    about = client.get(f"/v1/heightmaps/{heightmap_id}").json()
    assert (about["rows"], about["cols"], about["resolution_m"], about["crs"]) == (30, 40, 1.0, "EPSG:32630")
    assert about["bounds"] == [WEST, NORTH - 30, WEST + 40, NORTH]
    assert about["known_share"] == pytest.approx(1 - 12 / 1200)
    assert about["hash"] == hill().data_hash
    assert client.app.state.service.store.open_heightmap(heightmap_id).data_hash == hill().data_hash  # type: ignore[attr-defined]


def test_raw_body_with_parameters(client: TestClient) -> None:
    out = io.BytesIO()
    np.save(out, np.zeros((5, 6), dtype=np.float32))
    answer = client.post("/v1/heightmaps?resolution_m=0.5&west_m=10&crs=EPSG:32630&name=flat", content=out.getvalue())
    assert answer.status_code == 201, answer.text
    about = answer.json()
    assert answer.headers["location"] == f"/v1/heightmaps/{about['id']}"
    assert (about["name"], about["bounds"], about["crs"]) == ("flat", [10.0, 0.0, 13.0, 2.5], "EPSG:32630")
    assert client.get("/v1/heightmaps").json()["items"][0]["id"] == about["id"]
    assert client.delete(answer.headers["location"]).status_code == 204
    assert client.get(answer.headers["location"]).status_code == 404


def two_bands() -> bytes:
    """A GeoTIFF whose first band is zero and whose second holds the hill."""
    heights = np.stack([np.zeros((30, 40), dtype=np.float32), hill().heights])
    place = {"crs": "EPSG:32630", "transform": rasterio.Affine(1.0, 0.0, WEST, 0.0, -1.0, NORTH), "nodata": np.nan}
    with MemoryFile() as memory:
        with memory.open(driver="GTiff", height=30, width=40, count=2, dtype="float32", **place) as dataset:
            dataset.write(heights)
        return memory.read()


@pytest.mark.parametrize("how", ["query", "form", "costmap"])
def test_a_band_of_several_can_be_chosen(client: TestClient, how: str) -> None:
    """The error asks for `band`, and each way in takes it."""
    refused = client.post("/v1/heightmaps", content=two_bands())
    assert (refused.status_code, "band" in refused.json()["detail"]) == (422, True)
    file = {"file": ("two.tif", two_bands())}
    if how == "query":
        answer = client.post("/v1/heightmaps?band=2", content=two_bands())
    elif how == "form":
        answer = client.post("/v1/heightmaps", files=file, data={"band": "2"})
    else:
        options = {"options": '{"model": "physics", "headings": 4}', "band": "2"}
        made = client.post("/v1/costmaps", files=file, data=options, headers={"Prefer": "wait=60"})
        assert made.status_code == 201, made.text
        answer = client.get(made.json()["links"]["heightmap"])
    assert answer.status_code in (200, 201), answer.text
    about = answer.json()
    assert (about["band"], about["hash"]) == (2, hill().data_hash)
    assert client.get(f"/v1/heightmaps/{about['id']}").json()["band"] == 2


def test_a_band_that_is_not_there(client: TestClient) -> None:
    answer = client.post("/v1/heightmaps?band=3", content=two_bands())
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_heightmap")
    assert "bands 1 to 2" in answer.json()["detail"]


def test_costmap_tells_how_it_was_made(client: TestClient, costmap_id: str) -> None:
    about = client.get(f"/v1/costmaps/{costmap_id}").json()
    assert (about["status"], about["progress"], about["model"], about["headings"]) == ("done", 1.0, "physics", 16)
    assert about["frame"]["bounds"] == [WEST, NORTH - 30, WEST + 40, NORTH]
    lattice = load_lattice(client.app.state.service.store.lattice_path(costmap_id))  # type: ignore[attr-defined]
    free = lattice.blocked_by_heading() == 0
    assert about["blocked"] == pytest.approx(lattice.blocked_shares())
    assert about["energy_per_m"]["mean"] == pytest.approx(float(lattice.energy_per_m[free].mean(dtype=np.float64)))
    assert about["energy_per_m"]["max"] == pytest.approx(float(lattice.energy_per_m[free].max()))
    assert about["provenance"]["model"] == {"name": "physics", "kind": "physics", "version": "1"}
    everything = client.get(about["links"]["provenance"]).json()
    assert everything == lattice.provenance
    assert "config" in everything["model"]


def test_the_answer_names_the_network_and_the_link_has_its_training(client: TestClient, heightmap_id: str) -> None:
    wanted = {"heightmap_id": heightmap_id, "model": "default", "headings": 4, "spacing_m": 2.0}
    answer = client.post("/v1/costmaps", json=wanted, headers={"Prefer": "wait=120"})
    assert answer.status_code == 201, answer.text
    about = answer.json()
    assert set(about["provenance"]["model"]) <= {"name", "kind", "version", "parent"}
    assert len(json.dumps(about["provenance"])) < 1000
    everything = client.get(f"/v1/costmaps/{about['id']}/provenance").json()
    assert everything["model"]["config"]["training"]["data_hash"]
    assert {**everything, "model": None} == {**about["provenance"], "model": None}
    lattice = load_lattice(client.app.state.service.store.lattice_path(about["id"]))  # type: ignore[attr-defined]
    assert lattice.provenance == everything
    assert client.delete(f"/v1/costmaps/{about['id']}").status_code == 204


def test_one_request_makes_a_costmap_of_a_sent_file(client: TestClient, hill_tif: bytes) -> None:
    options = {"model": "physics", "headings": 8, "spacing_m": 2.0, "robot": {"mass_kg": 50}}
    answer = client.post(
        "/v1/costmaps",
        files={"file": ("hill.tif", hill_tif)},
        data={"options": json.dumps(options)},
        headers={"Prefer": "respond-async, wait=60"},
    )
    assert answer.status_code == 201, answer.text
    about = answer.json()
    assert answer.headers["preference-applied"] == "wait=60"
    assert (about["frame"]["rows"], about["headings"], about["robot"]["mass_kg"]) == (15, 8, 50.0)
    refused = client.delete(f"/v1/heightmaps/{about['heightmap_id']}")
    assert refused.status_code == 409
    assert refused.json()["context"]["costmap_ids"] == [about["id"]]
    assert client.delete(f"/v1/costmaps/{about['id']}").status_code == 204
    assert client.delete(f"/v1/heightmaps/{about['heightmap_id']}").status_code == 204


def test_without_waiting_it_is_accepted_and_polled(client: TestClient, heightmap_id: str) -> None:
    answer = client.post("/v1/costmaps", json={"heightmap_id": heightmap_id, "model": "physics", "headings": 8})
    assert answer.status_code == 202, answer.text
    place = answer.headers["location"]
    for _ in range(1000):
        about = client.get(place).json()
        if about["status"] in ("done", "failed"):
            break
    assert about["status"] == "done"
    assert client.delete(place).status_code == 204


def test_data_in_three_formats(client: TestClient, costmap_id: str, tmp_path) -> None:  # type: ignore[no-untyped-def]
    tif = client.get(f"/v1/costmaps/{costmap_id}/data?format=geotiff")
    with MemoryFile(tif.content) as memory, memory.open() as dataset:
        assert (dataset.count, dataset.crs) == (2 * 16, rasterio.CRS.from_epsg(32630))  # energies, and why blocked
        east = dataset.read(5)
    npz = np.load(io.BytesIO(client.get(f"/v1/costmaps/{costmap_id}/data?format=npz").content))
    zipped = client.get(f"/v1/costmaps/{costmap_id}/data?format=zarr")
    zipfile.ZipFile(io.BytesIO(zipped.content)).extractall(tmp_path)
    lattice = load_lattice(tmp_path / f"{costmap_id}.zarr")
    free = lattice.blocked_by_heading()[..., 4] == 0
    np.testing.assert_array_equal(npz["energy_per_m"], lattice.energy_per_m)
    np.testing.assert_array_equal(east[free], lattice.energy_per_m[..., 4][free])
    assert np.isnan(east[~free]).all()


@pytest.mark.parametrize("query", ["", "?heading_deg=90", "?view=mean", "?view=directionality", "?heading_deg=-12.5"])
def test_pictures(client: TestClient, costmap_id: str, query: str) -> None:
    answer = client.get(f"/v1/costmaps/{costmap_id}/image.png{query}")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")
    assert answer.content.startswith(b"\x89PNG")


def test_prices_at_one_place(client: TestClient, costmap_id: str) -> None:
    x, y = WEST + 15.5, NORTH - 15.5  # west flank of the hill, on a cell centre
    about = client.get(f"/v1/costmaps/{costmap_id}/at", params={"x": x, "y": y}).json()
    lattice = load_lattice(client.app.state.service.store.lattice_path(costmap_id))  # type: ignore[attr-defined]
    np.testing.assert_allclose(about["energy_per_m"], lattice.energy_per_m[15, 15], rtol=1e-3)
    assert about["headings_deg"][:3] == [0.0, 22.5, 45.0]
    assert about["energy_per_m"][4] > about["energy_per_m"][12]  # east climbs
    hole = client.get(f"/v1/costmaps/{costmap_id}/at", params={"x": IN_HOLE[0], "y": IN_HOLE[1]}).json()
    assert (hole["blocked"], hole["energy_per_m"]) == (["unknown"] * 16, [None] * 16)
    wall = client.get(f"/v1/costmaps/{costmap_id}/at", params={"x": WEST + 8.0, "y": NORTH - 3.5}).json()
    assert set(wall["blocked"]) == {"step"}  # 2 m up within a metre


def test_path_with_profile_and_shortest(client: TestClient, costmap_id: str) -> None:
    body = {"start": START, "goal": GOAL, "battery": {"reserve": 0.2}}
    about = client.post(f"/v1/costmaps/{costmap_id}/paths", json=body).json()
    assert PathOut.model_validate(about, strict=True).model_dump(mode="json") == about
    lattice = load_lattice(client.app.state.service.store.lattice_path(costmap_id))  # type: ignore[attr-defined]
    for route in (about, about["shortest"]):  # judged by re-pricing
        points = np.array(route["path"])[:, :2]
        assert route["energy_j"] == pytest.approx(price_world_path(lattice, points), rel=1e-6)
    assert about["path"][0][:2] == pytest.approx(START)
    assert about["path"][-1][:2] == pytest.approx(GOAL)
    assert about["energy_j"] <= about["shortest"]["energy_j"] + 1e-9
    assert about["length_m"] >= about["shortest"]["length_m"] - 1e-9
    assert about["saving_j"] == pytest.approx(about["shortest"]["energy_j"] - about["energy_j"])
    assert about["profile"][-1]["cumulative_j"] == pytest.approx(about["energy_j"], rel=1e-6)
    assert about["profile"][-1]["distance_m"] == pytest.approx(about["length_m"])
    assert about["duration_s"] == pytest.approx(about["length_m"] / 0.5)
    assert about["battery"]["feasible"] is True
    assert about["battery"]["charge_at_end"] == pytest.approx(1.0 - about["energy_wh"] / 280.0)


def test_every_planner_answers(client: TestClient, costmap_id: str) -> None:
    energy = {}
    for planner in client.get("/v1").json()["planners"]:
        body = {"start": START, "goal": GOAL, "planner": planner, "time_limit_s": 0.5, "seed": 1}
        answer = client.post(f"/v1/costmaps/{costmap_id}/paths", json=body)
        assert answer.status_code == 200, answer.text
        energy[planner] = answer.json()["energy_j"]
    assert energy["astar"] == pytest.approx(energy["dijkstra"], rel=1e-6)
    assert min(energy.values()) >= 0.99 * energy["astar"]


@pytest.mark.parametrize("ask", [{"params": {"format": "geojson"}}, {"headers": {"Accept": "application/geo+json"}}])
def test_path_as_geojson(client: TestClient, costmap_id: str, ask: dict) -> None:
    answer = client.post(f"/v1/costmaps/{costmap_id}/paths", json={"start": START, "goal": GOAL}, **ask)
    assert answer.headers["content-type"] == "application/geo+json"
    about = answer.json()
    best, shortest = about["features"]
    assert (best["properties"]["kind"], shortest["properties"]["kind"]) == ("energy_optimal", "shortest")
    assert len(best["geometry"]["coordinates"][0]) == 3
    assert "crs" not in about  # RFC 7946: longitude, latitude
    assert -9.0 < best["geometry"]["coordinates"][0][0] < 0.0
    assert 36.0 < best["geometry"]["coordinates"][0][1] < 37.0


def test_a_goal_beside_a_hole_at_the_maps_edge_is_valid_json(client: TestClient) -> None:
    """In the outer half of an edge cell heights are continued from the inner neighbour, which is unknown here."""
    heights = np.zeros((24, 24), dtype=np.float32)
    heights[12:16, 18:22] = np.nan
    file = write_geotiff(None, Heightmap(heights, GridFrame(0.0, 24.0, 1.0, 24, 24)))
    assert file is not None
    made = client.post(
        "/v1/costmaps",
        files={"file": ("hole.tif", file)},
        data={"options": '{"model": "physics", "spacing_m": 2.0, "headings": 8}'},
        headers={"Prefer": "wait=60"},
    ).json()
    asked = {"start": [2.2, 2.2], "goal": [23.4, 10.9]}
    for form in ("json", "geojson&coordinates=map"):
        answer = client.post(f"/v1/costmaps/{made['id']}/paths?format={form}", json=asked)
        assert answer.status_code == 200, answer.text
        json.loads(answer.text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


def blocked(client: TestClient, costmap_id: str, question: str, asked: dict) -> dict:
    answer = client.post(f"/v1/costmaps/{costmap_id}/{question}", json=asked)
    assert (answer.status_code, answer.json()["code"]) == (422, "blocked"), answer.text
    return answer.json()


def test_a_blocked_goal_names_the_nearest_free_place_and_snap_goes_there(client: TestClient, costmap_id: str) -> None:
    asked = {"start": START, "goal": IN_HOLE}
    for question in ("paths", "feasibility"):
        problem = blocked(client, costmap_id, question, asked)
        place = problem["context"]["nearest"]
        assert f"nearest free place is ({place[0]:.2f}, {place[1]:.2f})" in problem["detail"]
    path = client.post(f"/v1/costmaps/{costmap_id}/paths", json={**asked, "snap": True}).json()
    assert path["path"][-1][:2] == pytest.approx(place)
    assert "moved to the nearest free place" in path["warnings"][0]
    there = client.post(f"/v1/costmaps/{costmap_id}/paths", json={**asked, "goal": place}).json()
    assert path["energy_j"] == pytest.approx(there["energy_j"])
    both = {**asked, "snap": True, "round_trip": True}
    refused = client.post(f"/v1/costmaps/{costmap_id}/feasibility", json=both)
    assert refused.status_code == 422  # a verdict is about the place that was asked for
    assert "`snap` may move it by 1.41 m at most" in refused.json()["detail"]
    beside = (np.array(place) + 0.8 * np.sign(np.subtract(IN_HOLE, place))).tolist()
    trip = client.post(f"/v1/costmaps/{costmap_id}/feasibility", json={**both, "goal": beside}).json()
    assert trip["out"]["energy_j"] == pytest.approx(path["energy_j"])
    assert trip["back"]["path"][0][:2] == pytest.approx(place)
    assert trip["back"]["path"][-1][:2] == pytest.approx(START)
    assert len([words for words in trip["warnings"] if "moved" in words]) == 1


def test_start_that_is_the_goal(client: TestClient, costmap_id: str) -> None:
    answer = client.post(f"/v1/costmaps/{costmap_id}/paths", json={"start": START, "goal": START})
    assert answer.status_code == 200, answer.text
    assert (answer.json()["energy_j"], answer.json()["length_m"]) == (0.0, 0.0)


def test_round_trip_is_priced_with_reversed_headings(client: TestClient, costmap_id: str) -> None:
    top = [WEST + 20.5, NORTH - 15.5]
    about = client.post(
        f"/v1/costmaps/{costmap_id}/feasibility", json={"path": [START, top], "round_trip": True}
    ).json()
    assert about["out"]["energy_j"] > about["back"]["energy_j"]  # up, and down again
    assert about["energy_j"] == pytest.approx(about["out"]["energy_j"] + about["back"]["energy_j"])
    assert about["out"]["climb_m"] == pytest.approx(about["back"]["descent_m"])
    assert about["feasible"] is True
    assert FeasibilityOut.model_validate(about, strict=True).model_dump(mode="json") == about
    best = client.post(
        f"/v1/costmaps/{costmap_id}/feasibility", json={"start": START, "goal": top, "round_trip": True}
    ).json()
    assert best["energy_j"] <= about["energy_j"] + 1e-6


def test_shortfall_is_an_answer_not_an_error(client: TestClient, costmap_id: str) -> None:
    battery = {"capacity_wh": 1.0, "charge": 0.5, "reserve": 0.4}
    answer = client.post(
        f"/v1/costmaps/{costmap_id}/feasibility", json={"start": START, "goal": GOAL, "battery": battery}
    )
    about = answer.json()
    assert (answer.status_code, about["feasible"], about["margin_j"]) == (200, False, 0.0)
    assert about["available_j"] == pytest.approx(360.0)  # (0.5 - 0.4) x 1 Wh
    assert about["shortfall_j"] == pytest.approx(about["energy_j"] - 360.0)
    assert about["message"].startswith("not feasible")


def test_the_documentation_needs_no_other_server(client: TestClient) -> None:
    page = client.get("/docs")
    assert page.headers["content-type"].startswith("text/html")
    assert "http" not in page.text
    wanted = re.findall(r"(?:href|src)=\"([^\"]+)\"", page.text) + re.findall(r"\burl: '([^']+)'", page.text)
    assert len(wanted) == 4  # style, icon, script, and the document itself
    for place in wanted:
        assert client.get(f"/{place}").status_code == 200, place
    script = next(client.get(f"/{place}").text for place in wanted if place.endswith(".js"))
    assert "openapi: 3.1" in script  # what this Swagger UI can read
    assert '"validatorUrl": null' in page.text
    assert client.get("/docs/static/..%2f__init__.py").status_code == 404
    assert 'href="docs"' in client.get("/").text


def test_where_to_start(client: TestClient) -> None:
    links = client.get("/v1").json()["links"]
    assert {client.get(link).status_code for link in links.values()} == {200}
    page = client.get("/")
    assert page.status_code == 200
    assert "http://" not in page.text
    assert "https://" not in page.text
    assert client.get("/healthz").json() == {"status": "live"}
    wait_until(lambda: client.get("/readyz").status_code == 200)
    assert client.get("/readyz").json()["warm_up_s"] > 0.0
