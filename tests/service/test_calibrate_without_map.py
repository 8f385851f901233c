"""Calibration of logs with a speed and no positions, through the command line, Python and HTTP."""

import json

import numpy as np
import pytest
from fastapi.testclient import TestClient

import joulemap as jm
from joulemap.model.errors import InputError, RunsError
from joulemap.model.robot import Robot
from joulemap.service.http.app import create_app
from tests.service.conftest import settings_for
from tests.service.test_bad_input import check_problem
from tests.service.test_cli import joulemap

CAR = Robot(mass_kg=400.0, speed_mps=8.0, idle_power_w=60.0, rolling_resistance=0.02, regeneration=0.5)
VOLTS, HEATING, RUNS = 48.0, 1.1, 8


def log(number, *, heater="heater power [kW]", height=True, speed="speed [km/h]"):
    """A drive over hills at 2 Hz. A heater, which is on in cold runs, takes 1.1 times its logged power."""
    rng, dt = np.random.default_rng(number), 0.5
    t = dt * np.arange(1200)
    v = CAR.speed_mps * (1.0 + 0.15 * np.sin(0.02 * t + number))
    along = np.cumsum(v * dt)
    climb = 0.03 * np.sin(along / 150.0 + number)
    z = np.cumsum(climb * v * dt)
    heat = (number % 4) * 400.0 * (1.0 + 0.5 * np.sin(0.013 * t + 2.0 * number))
    force = CAR.weight_n * (CAR.rolling_resistance + climb)
    drive = np.where(force > 0.0, force, CAR.regeneration * force) * v
    power = CAR.idle_power_w + drive + HEATING * heat + rng.normal(0.0, 60.0, t.size)
    columns = {"t [s]": t, "voltage [V]": np.full(t.size, VOLTS), "current [A]": power / VOLTS}
    columns |= {speed: 3.6 * v} if speed else {}
    columns |= {"elevation [m]": z} if height else {}
    columns |= {heater: heat / 1e3} if heater else {}
    rows = [",".join(f"{value:.4f}" for value in row) for row in zip(*columns.values(), strict=True)]
    return "\n".join([",".join(columns), *rows]) + "\n"


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives")
    (folder / "runs").mkdir()
    for number in range(RUNS):
        (folder / "runs" / f"day{number // 2}_{number}.csv").write_text(log(number))
    (folder / "car.toml").write_text("".join(f"{k} = {json.dumps(v)}\n" for k, v in CAR.as_dict().items()))
    return folder


def calibrate(drives, out, *words, runs="runs"):
    given = ["--model", "physics", "--robot", drives / "car.toml", "--runs", drives / runs]
    return joulemap("calibrate", *given, "--out", out, *words)


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    with TestClient(create_app(settings_for(tmp_path_factory.mktemp("kept"))), raise_server_exceptions=False) as client:
        yield client


@pytest.fixture(scope="module")
def found(drives, tmp_path_factory):
    out = tmp_path_factory.mktemp("found")
    code, said, wrong = calibrate(drives, out, "--campaigns")
    assert code == 0, wrong
    return json.loads((out / "report.json").read_text()), " ".join(said.split()), out


def test_a_heater_is_found_without_a_map(found):
    report, said, out = found
    first = report["effects"][0]
    assert (first["name"], first["in_plans"]) == ("auxiliary_power:heater power [kW]", False)
    assert first["coefficients"][0]["value"] == pytest.approx(HEATING, rel=0.1)
    assert "Found: auxiliary power (heater power [kW])" in said
    assert report["sites"][0]["heightmap"] == "none: the runs have no positions"
    assert len(report["sites"][0]["runs"]) == RUNS
    assert report["route"] == {"why_not": "the runs have no positions"}
    assert (out / "report.html").exists()


def test_the_report_says_what_plans_cannot_know(found):
    report, said, out = found
    error = report["error"]
    assert error["after"]["run_energy_rms"] < 0.03 < error["after_planner"]["run_energy_rms"]
    for text in (said, (out / "report.html").read_text()):
        assert "with what only a log knows: auxiliary power (heater power [kW])" in text
    assert "of the variance of plans is theirs" in said


def test_without_heights_the_ground_is_level_and_that_is_said(drives, tmp_path):
    (drives / "level").mkdir(exist_ok=True)
    for number in range(5):
        (drives / "level" / f"level_{number}.csv").write_text(log(number, height=False))
    code, said, wrong = calibrate(drives, tmp_path / "out", "--quick", runs="level")
    assert code == 0, wrong
    assert "All runs are on level ground, which says nothing of slopes" in " ".join(said.split())


def test_what_is_missing_is_named(drives, tmp_path):
    assert joulemap("calibrate", "--model", "physics", "--out", tmp_path)[0] == 2
    (drives / "nothing").mkdir(exist_ok=True)
    (drives / "nothing" / "nothing.csv").write_text(log(1, speed=None))
    code, said, wrong = calibrate(drives, tmp_path, runs="nothing")
    assert code != 0
    assert "neither 'x' and 'y' nor 'lat' and 'lon', nor a speed or a distance" in said + wrong
    (drives / "placed").mkdir(exist_ok=True)
    rows = "".join(f"{k},{k},0,1,24\n" for k in range(9))
    (drives / "placed" / "placed.csv").write_text(f"t,x,y,current,voltage\n{rows}")
    code, said, wrong = calibrate(drives, tmp_path, runs="placed")
    assert code != 0
    assert "has positions: give the heightmap" in said + wrong


def test_python_and_http_find_the_same(drives, found, service, tmp_path):
    report, _, _ = found
    files = sorted((drives / "runs").glob("*.csv"))
    made = jm.calibrate(runs=files[:-2], test_runs=files[-2:], robot=CAR, model="physics", quick=True, out=tmp_path)
    assert made.effects[0]["name"] == report["effects"][0]["name"]
    assert made.report["test_set"]["error"]["after"]["run_energy_rms"] < 0.03
    with pytest.raises(InputError, match="belong to no heightmap"):
        jm.calibrate(sites=[], odometry_track_m=1.0, robot=CAR, out=tmp_path / "no")
    with pytest.raises(RunsError, match="speed_left"):
        jm.calibrate(runs=files, odometry_track_m=1.0, robot=CAR, out=tmp_path / "no")
    sent = service.post("/v1/runs", files=[("file", (file.name, file.read_bytes())) for file in files])
    assert sent.status_code == 201, sent.text
    asked = {"runs": [sent.json()["id"]], "model": "physics", "robot": CAR.as_dict(), "quick": True}
    done = service.post("/v1/calibrations", json=asked, headers={"Prefer": "wait=200"})
    assert done.status_code == 201, done.text
    answer = done.json()["report"]
    assert (done.json()["heightmap_id"], "heightmap" in done.json()["links"]) == (None, False)
    assert [effect["name"] for effect in answer["effects"]] == [effect["name"] for effect in report["effects"]]
    wrong = service.post("/v1/calibrations", json=asked | {"heightmap_id": "hm-none"})
    check_problem(wrong, 404, "not_found", "hm-none")


def test_a_refusal_of_a_log_says_which_columns_were_recognised(service):
    rows = "".join(f"{0.5 * k},{k},{24 + k % 3},{3 + k % 4}\n" for k in range(40))
    wrong = service.post("/v1/runs", files=[("file", ("a.csv", "zeit,q2,U_batt,I_batt\n" + rows))])
    assert wrong.status_code == 422
    assert wrong.json()["context"]["reading"] == {
        "t": "zeit [s]",
        "voltage": "U_batt [V]",
        "current": "I_batt [A]",
    }
