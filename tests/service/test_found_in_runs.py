"""What calibrations find beside the usual effects: curves against baseline runs, and faults that belong to no plan."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

from joulemap.model.loop.forms import form_from_dict
from joulemap.service.cli import app
from tests.loop.generators.case import Case, make_case
from tests.loop.generators.config import CaseConfig, DriveConfig
from tests.loop.generators.logs import Log
from tests.loop.reports import case_of


def sent(client: TestClient, folder: Path, ground: str) -> str:
    files = [("file", (path.name, path.read_bytes())) for path in sorted(folder.glob("*.csv"))]
    answer = client.post("/v1/runs", files=files, params={"heightmap_id": ground})
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


@pytest.mark.parametrize(
    "name", ["low_mud:1:990298:3:60", pytest.param("heater:0:990641:3:60", marks=pytest.mark.slow)]
)
def test_a_curve_against_baseline_runs_is_found_and_drawn(client: TestClient, tmp_path: Path, name: str) -> None:
    case = case_of(name)
    case.write(tmp_path)
    ground = client.post("/v1/heightmaps", content=(tmp_path / "dem.tif").read_bytes()).json()["id"]
    robot = {key: value for key, value in case.declared.as_dict().items() if value is not None}
    asked: dict[str, Any] = {"heightmap_id": ground, "model": "physics", "robot": robot, "quick": True}
    asked |= {
        "runs": [sent(client, tmp_path / "new", ground)],
        "baseline_runs": [sent(client, tmp_path / "base", ground)],
    }
    answer = client.post("/v1/calibrations", json=asked, headers={"Prefer": "wait=200"})
    assert answer.status_code == 201, answer.text
    made = answer.json()
    curves = [effect for effect in made["report"]["effects"] if effect["form"] == "curve"]
    assert made["report"]["baseline_runs"]
    assert curves
    for curve in curves:
        assert not curve["settings"]["centred"]
        assert len(curve["coefficients"]) == len(curve["settings"]["knots"])
    page = client.get(made["links"]["page"])
    assert page.status_code == 200
    assert "Zero is what the baseline runs show" in page.text
    segments = client.get(f"/v1/calibrations/{made['id']}/segments").json()
    assert len(segments["runs"]) == 3


STARTS_S = 1.75e9


def costing(log: Log, factor: float, begins_s: float = 0.0) -> Log:
    numbers = log.numbers
    return replace(log, numbers=numbers | {"t": begins_s + numbers["t"], "current": factor * numbers["current"]})


def calibrated(case: Case, folder: Path, *more: str) -> tuple[str, dict[str, Any]]:
    """What the command line says of a case, and the report."""
    case.write(folder)
    options = [f"--{name}={folder / path}" for name, path in PATHS.items()]
    done = CliRunner().invoke(app, ["calibrate", "--model", "physics", "--quick", *options, *more])
    assert done.exit_code == 0, done.output
    return " ".join(done.output.split()), json.loads((folder / "found" / "report.json").read_text(encoding="utf-8"))


PATHS = {"heightmap": "dem.tif", "robot": "robot.toml", "runs": "new", "out": "found"}
CONFIG = CaseConfig(drive=DriveConfig(length_m=60.0), new_runs=8, base_runs=0, test_runs=0, other_runs=0)


@pytest.fixture(scope="module")
def plain() -> Case:
    return make_case(CONFIG, 881)


def within_limits(report: dict[str, Any]) -> bool:
    for effect in report["effects"]:
        form = form_from_dict({"form": effect["form"], **effect["settings"]})
        if any(not form.low <= c["value"] <= form.high for c in effect["coefficients"]):
            return False
    return True


def test_a_bearing_that_fails_is_named_with_the_run_and_the_date_and_is_in_no_plan(plain, tmp_path):
    logs = [costing(log, 1.27 if k >= 4 else 1.0, STARTS_S) for k, log in enumerate(plain.new.logs)]
    said, report = calibrated(replace(plain, new=replace(plain.new, logs=logs)), tmp_path)
    (effect,) = (e for e in report["effects"] if e["name"] == "change")
    assert effect["where"].startswith("from run 5 on (2025-")
    assert not effect["in_plans"]
    assert "% more, look at the robot" in said
    assert 0.20 < effect["coefficients"][0]["value"] < 0.34
    assert within_limits(report)


def test_what_is_undetermined_is_not_printed(plain, tmp_path):
    said, report = calibrated(plain, tmp_path)
    assert within_limits(report)
    for parameter in report["base_parameters"]:
        low, high = parameter["ci95"]
        if high - low > 2.0 * max(1.0, abs(parameter["value"])):
            assert f"{high:.3g})" not in said


def test_what_changed_on_the_whole_is_no_curve(tmp_path):
    """Everything costs a fifth more than in the baseline runs: no curve over anything is named beside that."""
    case = make_case(replace(CONFIG, base_runs=6), 883)
    logs = [costing(log, 1.2) for log in case.new.logs]
    _, report = calibrated(
        replace(case, new=replace(case.new, logs=logs)), tmp_path, f"--baseline-runs={tmp_path / 'base'}"
    )
    assert report["effects"]
    assert [e["name"] for e in report["effects"] if e["form"] == "curve"] == []
    shares = [c["value"] for e in report["effects"] for c in e["coefficients"] if e["name"] in ("sensor_gain", "mass")]
    assert np.abs(np.array(shares) - 0.2).min() < 0.08
