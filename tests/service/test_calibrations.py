"""The closed loop through HTTP: runs in, what the model lacked out, and a cost map with the model that has it."""

from __future__ import annotations

import html
import io
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from fastapi.testclient import TestClient

from joulemap.model.frames import GridFrame, heading_of
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.http.app import create_app
from joulemap.service.models import load_model
from joulemap.service.storage.files import MODEL_SUMS, sums_of
from joulemap.service.storage.tables import CalibrationRow
from tests.reference.drives import wheel_logs
from tests.service.conftest import settings_for
from tests.service.test_bad_input import check_problem
from tests.service.test_restart import serving, wait_until

ROBOT = {"mass_kg": 40.0, "rolling_resistance": 0.05, "idle_power_w": 10.0}
TURN_J = 150.0  # J/rad, which equation 5 does not know
FRAME = GridFrame(500_000.0, 4_000_040.0, 0.5, 80, 100, "EPSG:32630")


def hills() -> Heightmap:
    y, x = np.mgrid[0:80, 0:100] * 0.5
    heights = 0.8 * np.sin(0.25 * x + 1.0) * np.sin(0.2 * y) + 0.3 * np.sin(0.5 * x)
    return Heightmap(heights.astype(np.float32), FRAME)


def run_csv(seed: int, *, turn_j: float = TURN_J, metres: float = 110.0) -> bytes:
    """A run at 0.5 m/s and 10 Hz on a winding track over `hills`, drawn by equation 5, turning, and 6 % of noise."""
    rng = np.random.default_rng(seed)
    robot, ground = Robot.from_mapping(ROBOT), hills()
    steps = np.arange(0.0, metres, 0.05)
    phase = rng.uniform(0.0, 6.28, 4)
    x = 25.0 + 20.0 * np.sin(0.037 * steps + phase[0]) + 1.0 * np.sin(0.31 * steps + phase[1])
    y = 20.0 + 15.0 * np.sin(0.049 * steps + phase[2]) + 1.0 * np.sin(0.27 * steps + phase[3])
    along = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
    places = np.arange(0.0, along[-1], 0.05)
    x, y = FRAME.bounds[0] + np.interp(places, along, x), FRAME.bounds[1] + np.interp(places, along, y)
    heading = np.unwrap(heading_of(np.gradient(x), np.gradient(y)))
    grade = np.gradient(ground.sample(x, y)) / 0.05
    traction = robot.weight_n * (robot.rolling_resistance + grade)
    marks = np.arange(0.0, along[-1] + 1.0)
    factor = 1.0 + 0.06 * np.interp(places, marks, rng.standard_normal(marks.size))
    power = robot.price_per_m(traction) * 0.5 * factor + turn_j * np.abs(np.gradient(heading)) / 0.1
    rows = np.column_stack([0.1 * np.arange(x.size), x, y, np.full(x.size, 28.8), power / 28.8])
    out = io.StringIO()
    np.savetxt(out, rows, fmt="%.4f", delimiter=",", header="t,x,y,voltage,current", comments="")
    return out.getvalue().encode()


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    limits: dict[str, Any] = {"max_run_mb": 0.5, "max_run_cells": 60_000, "max_runs": 6, "max_calibration_rows": 15_000}
    settings = settings_for(tmp_path_factory.mktemp("loop"), **limits)
    with TestClient(create_app(settings), raise_server_exceptions=False) as client:
        yield client


@pytest.fixture(scope="module")
def ground_id(service: TestClient) -> str:
    data = write_geotiff(None, hills())
    assert data is not None
    return service.post("/v1/heightmaps", content=data).json()["id"]


def send(client: TestClient | httpx.Client, *runs: bytes, **params: str) -> Any:
    files = [("file", (f"run_{k}.csv", run)) for k, run in enumerate(runs)]
    return client.post("/v1/runs", files=files, params=params)


@pytest.fixture(scope="module")
def runs_id(service: TestClient, ground_id: str) -> str:
    answer = send(service, *(run_csv(seed) for seed in range(4)), heightmap_id=ground_id)
    assert answer.status_code == 201, answer.text
    return answer.json()["id"]


@pytest.fixture(scope="module")
def calibration(service: TestClient, ground_id: str, runs_id: str) -> dict[str, Any]:
    kept = send(service, run_csv(12), heightmap_id=ground_id).json()["id"]
    asked = {"heightmap_id": ground_id, "runs": [runs_id, kept], "model": "physics", "robot": ROBOT}
    answer = service.post(
        "/v1/calibrations", json=asked | {"test_runs": [kept], "quick": True}, headers={"Prefer": "wait=200"}
    )
    assert answer.status_code == 201, answer.text
    assert (answer.json()["runs"], answer.json()["test_runs"]) == ([runs_id], [kept])
    assert answer.json()["aside_runs"] == [kept]  # the former name, until version 0.3
    assert answer.headers["location"] == f"/v1/calibrations/{answer.json()['id']}"
    return answer.json()


def test_sent_runs_are_told_about(service: TestClient, ground_id: str, runs_id: str) -> None:
    told = service.get(f"/v1/runs/{runs_id}").json()
    assert [run["name"] for run in told["runs"]] == [f"run_{k}.csv" for k in range(4)]
    first = told["runs"][0]
    assert first["rows"] == run_csv(0).count(b"\n") - 1
    assert first["target"] == "energy_j"
    assert 60 < first["segments"] < 250
    assert service.get("/v1/runs").json()["items"][0]["id"] == runs_id
    broken = run_csv(7).splitlines(keepends=True)
    broken[100:103] = [broken[100], broken[100], b",".join([b"", *broken[102].split(b",")[1:]])]
    again = service.post("/v1/runs?name=seven.csv", content=b"".join(broken)).json()
    assert again["runs"][0]["repairs"].items() >= {"rows_without_time": 1, "duplicate_stamps": 1}.items()
    assert again["runs"][0]["name"] == "seven.csv"
    assert service.delete(f"/v1/runs/{again['id']}").status_code == 204
    check_problem(service.get(f"/v1/runs/{again['id']}"), 404, "not_found", again["id"])


def test_the_hidden_effect_is_found_and_planned_with(
    service: TestClient, ground_id: str, runs_id: str, calibration: dict[str, Any]
) -> None:
    report = calibration["report"]
    assert report["effects"][0]["name"] == "turning"
    listed = {one["id"]: one["found"] for one in service.get("/v1/calibrations").json()["items"]}
    assert listed[calibration["id"]] == [one["label"] for one in report["effects"]]
    assert report["validation"] == {"folds": 0, "left_out": "runs", "whole_procedure": False}  # as asked for
    found = report["effects"][0]["coefficients"][0]
    assert found["value"] == pytest.approx(TURN_J, rel=0.15)
    assert found["ci95"][0] < TURN_J < found["ci95"][1]
    assert report["error"]["after"]["rmse"] < 0.6 * report["error"]["before"]["rmse"]
    assert report["route"]["saving_j"] >= 0.0
    test = report["test_set"]["error"]
    assert test["after"]["rmse"] < 0.6 * test["before"]["rmse"]
    assert report["kept_aside"] == report["test_set"]  # the former key, until version 0.3
    check_problem(service.delete(f"/v1/runs/{calibration['test_runs'][0]}"), 409, "conflict", calibration["id"])
    page = service.get(calibration["links"]["page"])
    assert page.headers["content-type"].startswith("text/html")
    assert "data:image/png;base64," in page.text
    sent = html.unescape(page.text).split("POST /v1/costmaps ")[1].split("</code>")[0]
    asked = {"heightmap_id": ground_id, "model": calibration["calibrated_model"], "robot": ROBOT}
    assert json.loads(sent) == asked  # the page says what to send
    made = service.post("/v1/costmaps", json=asked, headers={"Prefer": "wait=60"})
    assert made.status_code == 201, made.text
    costmap = made.json()
    assert costmap["provenance"]["model"]["version"] == report["model"]["after"]
    whole = service.get(costmap["links"]["provenance"]).json()
    assert whole["model"]["heightmaps"] == [whole["heightmap"]["hash"]]
    found = report["turning_in_plans"]["j_per_rad"]  # one radian, the same in report, map and plans
    assert report["map"]["turn_j_per_rad"] == {"before": 0.0, "after": pytest.approx(found, rel=1e-3)}
    assert costmap["robot"]["turn_j_per_rad"] == report["map"]["turn_j_per_rad"]["after"]
    assert f"{costmap['robot']['turn_j_per_rad'] * np.pi / 2:.0f} J after" in page.text
    task = {"start": [500_005.0, 4_000_005.0], "goal": [500_044.0, 4_000_035.0], "battery": {"capacity_wh": 2.0}}
    question = f"/v1/costmaps/{costmap['id']}/feasibility"
    for robot in (ROBOT, costmap["robot"]):  # the one asked for, and the one that is told of
        assert service.post(question, json=task | {"robot": robot}).status_code == 200
    check_problem(service.post(question, json=task | {"robot": {"turn_j_per_rad": 1.0}}), 409, "conflict", "turn_j")
    verdict = service.post(question, json=task).json()
    assert 0.0 < verdict["energy_std_j"] < 0.2 * verdict["energy_j"]
    assert 0.0 <= verdict["probability"] <= 1.0
    plain = service.post("/v1/costmaps", json=asked | {"model": "physics"}, headers={"Prefer": "wait=60"}).json()
    told = service.post(f"/v1/costmaps/{plain['id']}/feasibility", json=task).json()
    assert (told["energy_std_j"], told["probability"]) == (None, None)
    # faster than the runs were driven, map, route and verdict say so, and moving does not become free
    robot = ROBOT | {"speed_mps": 1.0}
    fast = service.post("/v1/costmaps", json=asked | {"robot": robot}, headers={"Prefer": "wait=60"}).json()
    place = f"/v1/costmaps/{fast['id']}"
    route = service.post(f"{place}/paths", json={"start": task["start"], "goal": task["goal"]}).json()
    hurried = service.post(f"{place}/feasibility", json=task).json()
    for answer in (fast, route, hurried):
        warned = [words for words in answer["warnings"] if words.startswith("the robot's speed of 1 m/s is outside")]
        assert len(warned) == 1
    moving = verdict["energy_j"] - ROBOT["idle_power_w"] * verdict["out"]["length_m"] / 0.5
    assert hurried["energy_j"] - ROBOT["idle_power_w"] * hurried["out"]["length_m"] > 0.5 * moving > 0.0
    assert not [words for words in costmap["warnings"] if "robot's speed" in words]
    # what is used is not deleted, what is not is gone with all its files
    assert service.delete(place).status_code == 204
    check_problem(service.delete(f"/v1/runs/{runs_id}"), 409, "conflict", calibration["id"])
    check_problem(service.delete(f"/v1/calibrations/{calibration['id']}"), 409, "conflict", costmap["id"])
    users = check_problem(service.delete(f"/v1/heightmaps/{ground_id}"), 409, "conflict", "2 cost map(s) and 1")
    assert users["context"]["calibration_ids"] == [calibration["id"]]
    again = asked | {"runs": [runs_id]}
    del again["model"]
    check_problem(
        service.post("/v1/calibrations", json=again | {"model": calibration["id"]}),
        422,
        "invalid_input",
        "the model that it was made from",
    )


def test_the_report_keeps_the_checksums_of_its_model(service: TestClient, calibration: dict[str, Any]) -> None:
    inner = service.app.state.service  # type: ignore[attr-defined]
    kept = json.loads((inner.store.path(CalibrationRow, calibration["id"]) / MODEL_SUMS).read_text())
    assert kept == sums_of(inner.settings.resolved_models_dir / calibration["id"]) != {}


def test_wheel_speeds_stand_in_for_positions(service: TestClient, ground_id: str, runs_id: str) -> None:
    files = [("file", (name, log.encode())) for name, log in wheel_logs(2).items()]
    how = {"odometry_track_m": "1.0", "terrain_from_name": "true"}
    answer = service.post("/v1/runs", files=files, params=how)
    assert answer.status_code == 201, answer.text
    sent = answer.json()
    assert sent["runs"][0]["odometry"] == {"track_m": 1.0, "terrain_from_name": True}
    assert (sent["runs"][0]["target"], "terrain" in sent["runs"][0]["columns"]) == ("charge_as", True)
    asked: dict[str, Any] = {"runs": [sent["id"]], "model": "physics", "quick": True}
    for changed, words in (
        ({"heightmap_id": ground_id}, "leave heightmap_id out"),
        ({"runs": [runs_id]}, "name the heightmap"),
        ({"runs": [runs_id, sent["id"]], "heightmap_id": ground_id}, "separately"),
    ):
        check_problem(service.post("/v1/calibrations", json=asked | changed), 422, "invalid_input", words)
    for wrong, words in (
        ({"heightmap_id": ground_id}, "belong to no heightmap"),
        ({"odometry_track_m": "0"}, "greater"),
    ):
        refused = service.post("/v1/runs", files=files, params=how | wrong)
        check_problem(refused, 422, refused.json()["code"], words)
    alone = service.post("/v1/runs", files=files, params={"terrain_from_name": "true"})
    check_problem(alone, 422, "invalid_input", "goes with odometry_track_m")
    check_problem(service.post("/v1/runs", files=files), 422, "invalid_runs", "`odometry` with the track")


def test_the_list_has_no_reports(service: TestClient, calibration: dict[str, Any]) -> None:
    listed = service.get("/v1/calibrations").json()
    assert {item["report"] for item in listed["items"]} == {None}
    assert calibration["id"] in [item["id"] for item in listed["items"]]
    assert service.get(f"/v1/calibrations/{calibration['id']}").json() == calibration


def test_the_next_drive_is_a_mission(service: TestClient, calibration: dict[str, Any]) -> None:
    place, drive = f"/v1/calibrations/{calibration['id']}/next-drive", calibration["report"]["next_drive"]
    assert service.get(place).json() == drive
    table = service.get(place, params={"format": "csv"})
    assert table.headers["content-type"].startswith("text/csv")
    corners = [[float(v) for v in line.split(",")[:2]] for line in table.text.splitlines()[1:]]
    assert corners == drive["points"]
    assert drive["crs"] == "EPSG:32630"
    plan = service.get(place, params={"format": "qgc-plan"}).json()
    assert plan["mission"]["cruiseSpeed"] == drive["speeds_mps"][0]
    assert len(plan["mission"]["items"]) == 1 + len(drive["points"])


def test_a_running_calibration_is_stopped_by_deleting_it(service: TestClient, ground_id: str, runs_id: str) -> None:
    asked = {"heightmap_id": ground_id, "runs": [runs_id], "model": "physics", "robot": ROBOT}
    place = service.post("/v1/calibrations", json=asked).headers["location"]
    wait_until(lambda: service.get(place).json()["progress"] > 0.0, timeout_s=200.0)
    check_problem(service.get(f"{place}/report.html"), 409, "conflict", "running")
    assert service.delete(place).status_code == 204
    check_problem(service.get(place), 404, "not_found")
    job = place.rsplit("/", 1)[-1]
    folder = service.app.state.service.settings.data_dir  # type: ignore[attr-defined]
    wait_until(lambda: not [*folder.glob(f"calibrations/{job}*"), *folder.glob(f"models/{job}")])


def test_what_cannot_be_calibrated_is_a_failed_job(service: TestClient, ground_id: str) -> None:
    """A run of 30 m is too short, and so says the calibration."""
    short = send(service, run_csv(3, metres=25.0)).json()
    assert short["runs"][0]["segments"] > 0
    asked = {"heightmap_id": ground_id, "runs": [short["id"]], "model": "physics", "robot": ROBOT}
    answer = service.post("/v1/calibrations", json=asked, headers={"Prefer": "wait=100"})
    problem = check_problem_of_job(answer, 422, "invalid_runs")
    place = f"/v1/calibrations/{problem['context']['job_id']}"
    assert service.get(place).json()["status"] == "failed"
    check_problem(service.get(f"{place}/report.html"), 409, "conflict", "could not be made")
    assert service.delete(place).status_code == 204
    assert service.delete(f"/v1/runs/{short['id']}").status_code == 204


def check_problem_of_job(answer: Any, status: int, code: str) -> dict[str, Any]:
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    assert answer.json()["code"] == code
    return answer.json()


GOOD = run_csv(0, metres=40.0)
BAD_RUNS = [
    (b"", 422, "invalid_runs", "empty"),
    (b"t,x,y\n" + b"1,2,3\n" * 10, 422, "invalid_runs", "current"),
    (b"no table at all", 422, "invalid_runs", "rows are too few"),
    (b"\xff\xfe\x00\x01" * 50, 422, "invalid_runs", "run_0.csv"),
    (b"PAR1" + b"\0" * 100, 422, "invalid_runs", "Parquet"),
    (GOOD.replace(b"t,x,y", b"t,lat,lon"), 422, "invalid_runs", "CRS"),
    (b't,x,y,current\n1,2,"' + b"x" * 200_000 + b'",4\n' * 3, 422, "invalid_runs", "run_0.csv"),
    (b"t,x,y,current\n" + b"".join(b"%d,1,1,2\n" % k for k in range(200)), 422, "invalid_runs", "does not move"),
    (b"t,x,y,current\n" + b"".join(b"%d,%d,1,2\n" % (k, 1000 * k) for k in range(300)), 413, "too_large", "in metres"),
    (b"x" * 600_000, 413, "too_large", "limit is 0.5 MB"),
    (b"," * 70_000, 413, "too_large", "limit is 2,000"),
    (b"t,x,y,current\n" + b"1,1,1,2\n" * 20_000, 413, "too_large", "limit is 60,000"),
]


@pytest.mark.parametrize(("data", "status", "code", "words"), BAD_RUNS)
@pytest.mark.parametrize("how", ["raw", "form"])
def test_bad_runs(service: TestClient, data: bytes, status: int, code: str, words: str, how: str) -> None:
    before = service.get("/v1/runs").json()["total"]
    answer = service.post("/v1/runs?name=run_0.csv", content=data) if how == "raw" else send(service, data, GOOD)
    check_problem(answer, status, code, words)
    assert service.get("/v1/runs").json()["total"] == before  # all are kept or none


def test_bad_forms_of_runs(service: TestClient, ground_id: str) -> None:
    check_problem(service.post("/v1/runs", files={"other": b"x"}), 422, "invalid_input", "'other'")
    twice = [("file", ("a.csv", GOOD)), ("file", ("b/a.csv", run_csv(1, metres=40.0)))]
    check_problem(service.post("/v1/runs", files=twice), 422, "invalid_input", "two runs are called a.csv")
    check_problem(send(service, *[GOOD] * 7), 400, "bad_request", "6")
    check_problem(send(service, GOOD, heightmap_id="hm-none"), 404, "not_found", "hm-none")
    moved = GOOD.replace(b"500", b"100")
    check_problem(send(service, moved, heightmap_id=ground_id), 422, "invalid_runs", "do not belong together")


def test_bad_questions(service: TestClient, ground_id: str, runs_id: str) -> None:
    asked: dict[str, Any] = {"heightmap_id": ground_id, "runs": [runs_id], "model": "physics", "robot": ROBOT}
    for changed, status, code, words in (
        ({"heightmap_id": "hm-none"}, 404, "not_found", "hm-none"),
        ({"runs": ["runs-none"]}, 404, "not_found", "runs-none"),
        ({"baseline_runs": ["runs-none"]}, 404, "not_found", "runs-none"),
        ({"test_runs": ["runs-none"]}, 404, "not_found", "runs-none"),
        ({"test_runs": [runs_id]}, 422, "invalid_input", "none to learn from"),
        ({"base_runs": ["runs-none"]}, 404, "not_found", "runs-none"),  # former names
        ({"aside_runs": [runs_id]}, 422, "invalid_input", "none to learn from"),
        ({"aside_runs": [], "test_runs": []}, 422, "invalid_request", "former name of `test_runs`"),
        ({"base_runs": [], "baseline_runs": []}, 422, "invalid_request", "former name of `baseline_runs`"),
        ({"runs": []}, 422, "invalid_request", "runs"),
        ({"model": "../physics"}, 422, "invalid_model", "known are physics"),
        ({"robot": {"mass_kg": -1.0}}, 422, "invalid_request", "mass_kg"),
        ({"start": [1.0, 2.0]}, 422, "invalid_request", "goal"),
        (
            {"start": [1.0, 2.0], "goal": [3.0, 4.0]},
            422,
            "invalid_point",
            "start (1, 2) lies outside the map, also as lat",
        ),
        ({"start": {"lat": 1.0, "lon": 2.0}, "goal": [3.0, 4.0]}, 422, "invalid_point", "start"),
        ({"speed": 1.0}, 422, "invalid_request", "speed"),
        ({"campaigns": True}, 422, "invalid_input", "all 4 runs belong to the campaign 'run'"),
    ):
        check_problem(service.post("/v1/calibrations", json=asked | changed), status, code, words)
    more = [send(service, *(run_csv(seed) for seed in (20, 21, 22, 23))).json()["id"] for _ in range(2)]
    answer = service.post("/v1/calibrations", json=asked | {"runs": [runs_id, *more]})
    check_problem(answer, 413, "too_large", "limit of a calibration is 15,000")
    for runs in more:
        assert service.delete(f"/v1/runs/{runs}").status_code == 204


def test_a_full_queue_is_told(tmp_path: Path) -> None:
    settings = settings_for(tmp_path, queue_size=1, workers=0)
    with TestClient(create_app(settings)) as client:
        ground = client.post("/v1/heightmaps", content=write_geotiff(None, hills())).json()["id"]
        asked = {"heightmap_id": ground, "runs": [send(client, GOOD).json()["id"]], "model": "physics"}
        assert client.post("/v1/calibrations", json=asked).status_code == 202
        refused = client.post("/v1/calibrations", json=asked)
        check_problem(refused, 503, "busy", "calibrations that wait or run: 1, limit: 1")
        assert refused.headers["retry-after"] == "10"


@pytest.mark.slow
def test_a_killed_calibration_is_done_again(tmp_path: Path) -> None:
    """A real process, killed without warning while it calibrates."""
    with serving(tmp_path, place="/readyz") as (_, http):
        ground = http.post("/v1/heightmaps", content=write_geotiff(None, hills())).json()["id"]
        runs = send(http, *(run_csv(seed, metres=60.0) for seed in range(3))).json()["id"]
        asked = {"heightmap_id": ground, "runs": [runs], "model": "physics", "robot": ROBOT, "quick": True}
        place = http.post("/v1/calibrations", json=asked).headers["location"]
        wait_until(lambda: http.get(place).json()["progress"] > 0.0, timeout_s=200.0)
    with TestClient(create_app(settings_for(tmp_path))) as client:
        wait_until(lambda: client.get(place).json()["status"] == "done", timeout_s=200.0)
        done = client.get(place).json()
        assert done["report"]["effects"][0]["name"] == "turning"
        time.sleep(0.1)
        assert [p.name for p in (tmp_path / "calibrations").iterdir()] == [done["id"]]
        assert json.loads((tmp_path / "calibrations" / done["id"] / "report.json").read_text()) == done["report"]
        assert load_model(tmp_path / "models" / done["calibrated_model"]).name == done["id"]
