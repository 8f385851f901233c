"""Drives that are followed: over HTTP, after kill -9, and by `joulemap follow`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from sqlalchemy import inspect
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.errors import DamagedError, StorageFullError
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice.checksums import Checksums
from joulemap.service.cli import app
from joulemap.service.library.drive import Drive
from tests.service.conftest import GOAL, START
from tests.service.test_restart import serving

POWER_W = 90.0


def samples(path: list[list[float]], until_m: float) -> list[dict[str, Any]]:
    """A robot at 0.5 m/s along a path, twice a second."""
    corners = np.array(path)[:, :2]
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(corners, axis=0).T)))
    places = np.arange(0.0, until_m, 0.25)
    x, y = (np.interp(places, along, axis) for axis in corners.T)
    return [
        {"time_s": 2.0 * at, "position": [px, py], "power_w": POWER_W}
        for at, px, py in zip(places.tolist(), x.tolist(), y.tolist(), strict=True)
    ]


@pytest.fixture
def path(client: TestClient, costmap_id: str) -> list[list[float]]:
    found = client.post(f"/v1/costmaps/{costmap_id}/paths", json={"start": START, "goal": GOAL})
    assert found.status_code == 200, found.text
    return found.json()["path"]


def test_a_drive_is_followed_and_its_forecast_corrects_itself(
    client: TestClient, costmap_id: str, path: list[list[float]]
) -> None:
    begun = client.post(f"/v1/costmaps/{costmap_id}/drives", json={"path": path, "battery": {"charge": 0.5}})
    assert begun.status_code == 201, begun.text
    drive, url = begun.json(), f"/v1/drives/{begun.json()['id']}"
    assert drive["forecast"]["energy_j"] == pytest.approx(drive["forecast"]["planned_j"])
    log = samples(path, 15.0)
    now = client.post(f"{url}/updates", json={"samples": log}).json()
    assert now["updates"] == 1
    assert now["forecast"]["at_m"] == pytest.approx(14.75, abs=0.3)
    assert now["forecast"]["used_j"] == pytest.approx(POWER_W * log[-1]["time_s"])
    assert now["forecast"]["charge"] < 0.5
    assert client.get(url).json() == now
    along = client.get(f"{url}/charge").json()
    assert along["position"] == log[-1]["position"]
    assert along["at_m"] == now["forecast"]["at_m"]
    assert along["places"][-1]["charge"] == pytest.approx(now["forecast"]["charge_at_end"], abs=1e-3)
    again = client.post(f"{url}/updates", json={"samples": log[-5:]}).json()
    assert again["forecast"] == now["forecast"]  # what was sent before changes nothing
    assert drive["id"] in [one["id"] for one in client.get("/v1/drives").json()["items"]]
    listed, _ = client.app.state.service.store.drives(limit=1, offset=0)  # type: ignore[attr-defined]
    assert {"request", "state"} <= inspect(listed[0]).unloaded  # a page does not read every route
    assert client.delete(url).status_code == 204
    assert client.get(url).status_code == 404


def test_a_sample_without_power_is_refused_and_nothing_of_its_request_is_kept(
    client: TestClient, costmap_id: str, path: list[list[float]]
) -> None:
    drive = client.post(f"/v1/costmaps/{costmap_id}/drives", json={"path": path}).json()
    wrong = [*samples(path, 3.0), {"time_s": 9.0, "position": path[0]}]
    refused = client.post(f"/v1/drives/{drive['id']}/updates", json={"samples": wrong})
    assert refused.status_code == 422
    assert "power_w" in refused.text
    assert client.get(f"/v1/drives/{drive['id']}").json() == drive


def test_another_way_is_proposed_over_http_once_climbing_is_known_to_cost_more(client: TestClient) -> None:
    y, x = np.mgrid[0:40, 0:120]
    ridge = 0.5 * np.exp(-(((x - 60.0) / 6.0) ** 2)) * np.clip((28.0 - y) / 10.0, 0.0, 1.0)  # none in the south
    tif = write_geotiff(None, jm.heightmap(ridge, resolution_m=1.0))
    ground = client.post("/v1/heightmaps", content=tif).json()
    wanted = {"heightmap_id": ground["id"], "model": "physics"}
    costs = client.post("/v1/costmaps", json=wanted, headers={"Prefer": "wait=100"}).json()
    begun = {"path": [[10.0, 20.0], [110.0, 20.0]]}
    drive = client.post(f"/v1/costmaps/{costs['id']}/drives", json=begun).json()
    assert client.get(f"/v1/drives/{drive['id']}/better-route").json() == {"route": None}
    store = client.app.state.service.store  # type: ignore[attr-defined]
    row = store.drive(drive["id"])
    state = {**row.state, "state": {**row.state["state"], "mean": [0.0, 0.0, 3.0, 0.0, 0.0]}}
    state["state"]["covariance"] = (1e-4 * np.eye(5)).tolist()  # climbing takes four times as much
    assert store.note_drive(row, state, row.forecast, 0)
    found = client.get(f"/v1/drives/{drive['id']}/better-route").json()["route"]
    assert found["saving_j"] > 1.6 * found["saving_std_j"] > 0.0
    assert min(y for _, y in found["path"]) < 16.0


def test_a_wild_fix_moves_nobody(client: TestClient, costmap_id: str, path: list[list[float]]) -> None:
    drive = client.post(f"/v1/costmaps/{costmap_id}/drives", json={"path": path}).json()
    log = samples(path, 8.0)
    wild = [*log[:16], {"time_s": 7.75, "position": [1e6, 1e6], "power_w": POWER_W}]
    now = client.post(f"/v1/drives/{drive['id']}/updates", json={"samples": wild}).json()["forecast"]
    assert now["off_route_m"] > 1e5
    assert now["at_m"] < 4.0
    now = client.post(f"/v1/drives/{drive['id']}/updates", json={"samples": log[16:]}).json()["forecast"]
    assert now["at_m"] == pytest.approx(7.75, abs=0.3)
    assert now["off_route_m"] < 0.1


def test_a_request_has_500_samples_however_they_are_written_and_no_more(
    client: TestClient, costmap_id: str, path: list[list[float]]
) -> None:
    drive = client.post(f"/v1/costmaps/{costmap_id}/drives", json={"path": path}).json()
    url, other = f"/v1/drives/{drive['id']}/updates", {"voltage_v": 24.0, "current_a": 3.0, "charge": 0.5}
    log = [{**samples(path, 0.2)[0], "time_s": 0.1 * k, **other} for k in range(501)]
    assert client.post(url, json={"samples": log}).status_code == 422
    now = client.post(url, json={"samples": log[:500]})
    assert now.status_code == 200, now.text
    assert now.json()["unused"] == 0
    assert client.post(url, json={"samples": log[:2]}).json()["unused"] == 2
    places = [{**one, "position": {"lat": 36.0, "lon": -4.0}} for one in log[:500]]
    assert client.post(url, json={"samples": places}).status_code != 413


def test_routes_that_are_too_short_or_long_are_refused(
    client: TestClient, costmap_id: str, path: list[list[float]]
) -> None:
    here, there = path[0][:2], path[-1][:2]
    near = [here[0] + 1e-9, here[1]]
    for wanted, words in (([here, near], "at least 0.01 "), ([here, there] * 2000, "at most 20000 m")):
        refused = client.post(f"/v1/costmaps/{costmap_id}/drives", json={"path": wanted})
        assert refused.status_code == 422
        assert words in refused.json()["detail"]


def test_the_route_of_a_drive_is_priced_once(
    client: TestClient, costmap_id: str, path: list[list[float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not again with its first samples: those of many robots come at the same moment."""
    priced = []
    along = Drive.along
    monkeypatch.setattr(Drive, "along", lambda *args: (priced.append(args), along(*args))[1])
    drive = client.post(f"/v1/costmaps/{costmap_id}/drives", json={"path": path}).json()
    answer = client.post(f"/v1/drives/{drive['id']}/updates", json={"samples": samples(path, 1.0)})
    assert answer.status_code == 200, answer.text
    assert len(priced) == 1


def test_a_deleted_drive_is_not_kept_in_memory(client: TestClient, costmap_id: str, path: list[list[float]]) -> None:
    drive = client.post(f"/v1/costmaps/{costmap_id}/drives", json={"path": path}).json()
    client.post(f"/v1/drives/{drive['id']}/updates", json={"samples": samples(path, 1.0)})
    open_drives = client.app.state.service.drives._open  # type: ignore[attr-defined]
    assert drive["id"] in open_drives
    client.delete(f"/v1/drives/{drive['id']}")
    assert drive["id"] not in open_drives


@pytest.mark.parametrize("power_w", [-5e6, 5e6])
def test_no_charge_is_outside_its_bounds_and_no_battery_gives_all_at_once(
    client: TestClient, costmap_id: str, path: list[list[float]], power_w: float
) -> None:
    begun = client.post(f"/v1/costmaps/{costmap_id}/drives", json={"path": path, "battery": {"capacity_wh": 1.0}})
    url, log = f"/v1/drives/{begun.json()['id']}", samples(path, 15.0)
    wild = client.post(f"{url}/updates", json={"samples": [*log[:-1], log[-1] | {"power_w": power_w}]})
    assert (wild.status_code, "is it in watts" in wild.json()["detail"]) == (422, True), wild.text
    full_w = 0.1 * power_w / 1e4  # which is possible, and more than it has
    sent = [one | {"power_w": full_w} for one in log]
    assert client.post(f"{url}/updates", json={"samples": sent}).status_code == 200
    places = client.get(f"{url}/charge").json()["places"]
    assert all(0.0 <= place[name] <= 1.0 for place in places for name in ("charge", "low", "high"))


def test_a_map_that_is_deleted_while_it_is_read_is_not_there(
    client: TestClient, heightmap_id: str, path: list[list[float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = {"heightmap_id": heightmap_id, "model": "physics", "headings": 8, "spacing_m": 2.0}
    made = client.post("/v1/costmaps", json=wanted, headers={"Prefer": "wait=100"}).json()
    url = f"/v1/costmaps/{made['id']}"
    client.app.state.service.maps.forget(made["id"])  # type: ignore[attr-defined]

    def _deleted(folder: Path) -> None:
        monkeypatch.undo()
        client.app.state.service.store.delete_costmap(made["id"])  # type: ignore[attr-defined]
        raise DamagedError(f"{folder} is half deleted")

    monkeypatch.setattr(Checksums, "read", _deleted)
    answer = client.post(f"{url}/paths", json={"start": START, "goal": GOAL})
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found"), answer.text


def test_a_drive_whose_cost_map_was_deleted_is_a_conflict(
    client: TestClient, heightmap_id: str, path: list[list[float]]
) -> None:
    wanted = {"heightmap_id": heightmap_id, "model": "physics", "headings": 8}
    costs = client.post("/v1/costmaps", json=wanted, headers={"Prefer": "wait=100"}).json()
    drive = client.post(f"/v1/costmaps/{costs['id']}/drives", json={"path": path}).json()
    assert client.delete(f"/v1/costmaps/{costs['id']}").status_code == 204
    answer = client.post(f"/v1/drives/{drive['id']}/updates", json={"samples": samples(path, 1.0)})
    assert answer.status_code == 409
    assert "was deleted" in answer.json()["detail"]
    answer = client.get(f"/v1/drives/{drive['id']}/charge")
    assert (answer.status_code, f"its last forecast is at /v1/drives/{drive['id']}" in answer.text) == (409, True)
    assert client.get(f"/v1/drives/{drive['id']}").json() == drive


def test_no_drive_begins_without_room(
    client: TestClient, costmap_id: str, path: list[list[float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("joulemap.service.storage.data_folder.Room.check", _no_room)
    assert client.post(f"/v1/costmaps/{costmap_id}/drives", json={"path": path}).status_code == 507


def _no_room(*_: object) -> None:
    raise StorageFullError("no room")


def test_nothing_acknowledged_is_lost_by_kill_9(tmp_path: Path, hill_tif: bytes) -> None:
    with serving(tmp_path, place="/readyz") as (_, web):
        ground = web.post("/v1/heightmaps", content=hill_tif).json()
        wanted = {"heightmap_id": ground["id"], "model": "physics", "headings": 8}
        costs = web.post("/v1/costmaps", json=wanted, headers={"Prefer": "wait=100"}).json()
        way = web.post(f"/v1/costmaps/{costs['id']}/paths", json={"start": START, "goal": GOAL}).json()["path"]
        drive = web.post(f"/v1/costmaps/{costs['id']}/drives", json={"path": way}).json()
        log = samples(way, 16.0)
        for k in range(8):
            said = web.post(f"/v1/drives/{drive['id']}/updates", json={"samples": log[4 * k : 4 * k + 4]}).json()
    with serving(tmp_path, place="/readyz") as (_, web):
        assert web.get(f"/v1/drives/{drive['id']}").json() == said
        end = web.post(f"/v1/drives/{drive['id']}/updates", json={"samples": log[32:]}).json()
        whole = web.post(f"/v1/costmaps/{costs['id']}/drives", json={"path": way}).json()
        at_once = web.post(f"/v1/drives/{whole['id']}/updates", json={"samples": log}).json()
        assert end["forecast"] == at_once["forecast"]
        with web.stream("GET", f"/v1/drives/{drive['id']}/events") as stream:
            lines = stream.iter_lines()
            assert next(line for line in lines if line.startswith("event")) == "event: forecast"
            data = json.loads(next(line for line in lines if line.startswith("data")).partition(":")[2])
            assert data["forecast"] == end["forecast"]


def test_a_log_is_replayed_as_if_live(tmp_path: Path) -> None:
    costs = jm.costmap(jm.heightmap(np.zeros((40, 120)), resolution_m=1.0), model="physics")
    costs.save(tmp_path / "flat.zarr")
    route = [[10.0, 20.0], [110.0, 20.0]]
    (tmp_path / "route.csv").write_text("x_m,y_m\n" + "\n".join(f"{x},{y}" for x, y in route) + "\n")
    lines = [f"{s['time_s']},{s['position'][0]},{s['position'][1]},{s['power_w']}" for s in samples(route, 60.0)]
    (tmp_path / "log.csv").write_text("t,x,y,power\n" + "\n".join(lines) + "\n")
    arguments = [tmp_path / "log.csv", "--map", tmp_path / "flat.zarr", "--route", tmp_path / "route.csv"]
    arguments += ["--charge", "0.4", "--json", tmp_path / "out.json"]
    result = CliRunner().invoke(app, ["follow", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    said = json.loads((tmp_path / "out.json").read_text())
    assert len(said["forecasts"]) == 6
    end = said["end"]
    assert end["energy_j"] == pytest.approx(POWER_W / 0.5 * end["left_m"], rel=0.05)
    assert "more than planned" in result.output


def test_a_replay_ends_at_a_gap_of_more_than_an_hour(tmp_path: Path) -> None:
    jm.costmap(jm.heightmap(np.zeros((40, 120)), resolution_m=1.0), model="physics").save(tmp_path / "flat.zarr")
    (tmp_path / "route.csv").write_text("x_m,y_m\n10,20\n110,20\n")
    lines = ["t,x,y,power"]
    for one in samples([[10.0, 20.0], [110.0, 20.0]], 60.0):
        late = 9000.0 if one["position"][0] > 40.0 else 0.0
        lines.append(f"{one['time_s'] + late},{one['position'][0]},{one['position'][1]},{one['power_w']}")
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    files = [tmp_path / "log.csv", "--map", tmp_path / "flat.zarr", "--route", tmp_path / "route.csv", "--better"]
    result = CliRunner().invoke(app, ["follow", *map(str, files)])
    assert result.exit_code == 0, result.output
    said = " ".join(result.output.split())
    assert "a gap of 2.5 h in the log" in said
    assert "for 30 of 100 m" in said
    assert "119 later samples" in said


@pytest.mark.parametrize(
    ("away", "words"),
    [((0.0, 0.0), "arrival at the end of the route"), ((0.0, 80.0), "left the route"), ((0.0, 1e6), "nowhere on the")],
)
def test_a_replay_ends_with_the_route(tmp_path: Path, away: tuple[float, float], words: str) -> None:
    jm.costmap(jm.heightmap(np.zeros((40, 120)), resolution_m=1.0), model="physics").save(tmp_path / "flat.zarr")
    (tmp_path / "route.csv").write_text("x_m,y_m\n10,20\n30,20\n")
    there = samples([[10.0, 20.0], [110.0, 20.0]], 60.0)
    back = [{**one, "time_s": 239.0 - one["time_s"]} for one in reversed(there)]
    lines = ["t,x,y,power"]
    for k, one in enumerate([*there, *back]):
        x, y = one["position"]
        moved = (0.0, 0.0) if away[1] < 1e6 and k < 20 else away
        lines.append(f"{one['time_s']},{x + moved[0]},{y + moved[1]},{one['power_w']}")
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    files = [tmp_path / "log.csv", "--map", tmp_path / "flat.zarr", "--route", tmp_path / "route.csv"]
    result = CliRunner().invoke(app, ["follow", *map(str, files)])
    assert words in " ".join(result.output.split())
    assert (result.exit_code == 0) == (words != "nowhere on the")
    assert ("for 20 of 20 m" in result.output) == words.startswith("arrival")
