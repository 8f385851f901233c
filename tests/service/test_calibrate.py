"""`joulemap calibrate` on the simulated field: files, report, a model that plans, and errors in words."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from model.loop.record import read_record
from model.robot import Robot
from model.terrain.readers import read_heightmap
from service.cli import app
from service.loop.residuals import keep_base_runs, read_calibration_runs

runner = CliRunner()


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    folder = tmp_path_factory.mktemp("field")
    done = runner.invoke(app, ["simulate", "--out", str(folder), "--runs", "4", "--drive", "waypoints", "--seed", "3"])
    assert done.exit_code == 0, done.output
    return folder


def calibrate(field, out, *more):
    options = ["--model", "physics", "--heightmap", field / "dem.tif", "--robot", field / "robot.toml"]
    return runner.invoke(app, ["calibrate", *map(str, [*options, "--runs", field, "--out", out, *more])])


def test_a_report_and_a_model_are_written_and_the_model_is_never_changed(field, tmp_path):
    done = calibrate(field, tmp_path, "--json", str(tmp_path / "answer.json"))
    assert done.exit_code == 0, done.output
    report = json.loads((tmp_path / "report.json").read_text())
    assert report == json.loads((tmp_path / "answer.json").read_text())
    assert report["verdict"] in ("effects_added", "nothing_found")
    assert report["target"] == "energy_j"
    assert {"fit", "held_out"} == set(report["segments"])
    assert {"mean_relative", "rmse", "bias"} <= set(report["error"]["before"])
    assert all({"name", "p_value", "held_out_gain"} <= set(c) for c in report["candidates"])
    page = (tmp_path / "report.html").read_text()
    assert page.startswith("<!doctype html>")
    assert "http://" not in page.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
        "http://creativecommons.org", ""
    )
    if report["model"]["after"] is None:
        return
    done = runner.invoke(
        app, ["evaluate", "--model", str(tmp_path / "model"), "--heightmap", str(field / "dem.tif"), "--robot",
              str(field / "robot.toml"), "--runs", str(field), "--json", str(tmp_path / "again.json")],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    again = json.loads((tmp_path / "again.json").read_text())
    assert again["mean_relative_error"] < report["error"]["before"]["mean_relative"]
    assert calibrate(field, tmp_path).exit_code == 6  # the version is there already


def test_runs_of_another_place_are_refused_in_words(field, tmp_path):
    other = tmp_path / "moved.csv"
    lines = (field / "run_01.csv").read_text().splitlines()
    x = lines[0].split(",").index("x")
    moved = [lines[0]]
    for line in lines[1:]:
        cells = line.split(",")
        cells[x] = str(float(cells[x]) + 5000.0) if cells[x] else ""
        moved.append(",".join(cells))
    other.write_text("\n".join(moved) + "\n")
    done = runner.invoke(
        app, ["calibrate", "--model", "physics", "--heightmap", str(field / "dem.tif"), "--runs", str(other), "--out",
              str(tmp_path / "out")],
    )  # fmt: skip
    assert done.exit_code == 3
    assert "belong together" in done.output


def test_a_missing_input_is_not_there(field, tmp_path):
    """5 for every file that is named and missing, before anything is computed."""
    here = {"--heightmap": field / "dem.tif", "--robot": field / "robot.toml", "--runs": field, "--model": "physics"}
    for missing in here:
        options = [str(v) for pair in (here | {missing: tmp_path / "nothing"}).items() for v in pair]
        for command in (["calibrate", "--out", str(tmp_path / "out")], ["suggest-drive"]):
            done = runner.invoke(app, [*command, *options])
            assert done.exit_code == 5, (missing, done.output)
            assert "nothing" in done.output
    assert not (tmp_path / "out").exists()


def test_too_few_runs_are_not_kept_beside_a_model(field, tmp_path):
    robot, ground = Robot.from_toml(field / "robot.toml"), read_heightmap(field / "dem.tif")
    segments, _ = read_calibration_runs([field / "run_01.csv"], robot, crs=ground.frame.crs)
    few = segments.take(np.arange(10))
    assert not keep_base_runs(tmp_path, ground, robot, few, np.full(10, 40.0))
    assert list(tmp_path.iterdir()) == []
    assert keep_base_runs(tmp_path, ground, robot, segments, np.full(len(segments), 40.0))
    assert read_record(tmp_path) is not None
