"""`joulemap calibrate` on the simulated field: files, report, a model that plans, and errors in words."""

import json
import re
import shlex

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import joulemap
from joulemap.model.errors import InputError
from joulemap.model.robot import Robot
from joulemap.model.runs.words import number_words
from joulemap.model.terrain.writers import write_geotiff
from joulemap.service.cli import app
from joulemap.service.library.costmaps import open_costmap
from joulemap.service.library.heightmaps import read_heightmap
from joulemap.service.models import load_model, planning_robot
from tests.reference.drives import unlike_logs, wheel_logs
from tests.reference.words import PRIVATE, shown

runner = CliRunner()
AROUND = np.arange(8) * np.pi / 4  # headings


def ground_of(field):
    return read_heightmap(field / "dem.tif")


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    folder = tmp_path_factory.mktemp("field")
    done = runner.invoke(app, ["simulate", "--out", str(folder), "--runs", "4", "--drive", "waypoints", "--seed", "3"])
    assert done.exit_code == 0, done.output
    for run in folder.glob("run_*.csv"):  # that much of each is enough
        lines = run.read_text().splitlines(keepends=True)
        run.write_text("".join(lines[: 2 * len(lines) // 5]))
    return folder


def calibrate(field, out, *more, quick=True):
    more = (*more, "--quick") if quick else more
    options = ["--model", "physics", "--heightmap", field / "dem.tif", "--robot", field / "robot.toml"]
    return runner.invoke(app, ["calibrate", *map(str, [*options, "--runs", field, "--out", out, *more])])


def evaluate(field, out, runs, answer):
    options = ["--model", out / "model", "--heightmap", field / "dem.tif", "--robot", field / "robot.toml"]
    return runner.invoke(app, ["evaluate", *map(str, [*options, "--runs", runs, "--json", answer])])


def test_a_report_and_a_model_are_written_and_the_model_is_never_changed(field, tmp_path):
    done = calibrate(field, tmp_path, "--json", str(tmp_path / "answer.json"), quick=False)
    assert done.exit_code == 0, done.output
    report = json.loads((tmp_path / "report.json").read_text())
    assert report == json.loads((tmp_path / "answer.json").read_text())
    assert report["verdict"] in ("effects_added", "nothing_found")
    assert report["target"] == "energy_j"
    assert {"fit", "held_out"} == set(report["segments"])
    assert report["validation"] == {"folds": 4, "left_out": "runs", "whole_procedure": True}
    simple = {"constant", "least_squares", "proposed"}
    assert set(report["error"]) == {"before", "corrected", "after", "after_planner"} | simple
    assert {"mean_relative", "absolute_share", "rmse", "bias"} <= set(report["error"]["before"])
    assert report["base_parameters"][0]["name"] == "rolling_resistance"
    assert {"collinear", "shadows", "baseline_corrections", "base_corrections"}.isdisjoint(report)
    assert all({"name", "p_value", "held_out_gain"} <= set(c) for c in report["candidates"])
    page = (tmp_path / "report.html").read_text()
    assert page.startswith("<!doctype html>")
    assert "http://" not in page.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
        "http://creativecommons.org", ""
    )
    assert '<meta name="viewport"' in page
    assert [match[0] for match in PRIVATE.finditer(shown(page))] == []
    assert [match[0] for match in PRIVATE.finditer(done.output)] == []
    headings = "Base parameters|Ranges of these runs|Track used|Change of the cost map|What to drive next"
    for heading in f"{headings}|All candidate effects|read from the logs".split("|"):
        assert f"{heading}</h2>" in page
    assert {"points", "why_not"} & set(report["next_drive"])
    said = done.output
    assert said.startswith("Found: " if report["effects"] else "No missing effect was found")
    told = (
        "Base parameters:",
        "These runs show",
        "Errors on runs that had no part",
        "Driven: speed",
        "joulemap costmap",
    )
    assert [said.index(words) for words in told] == sorted(said.index(words) for words in told)
    assert "drive next" in said
    assert "WARNING" not in said
    for line in said.splitlines():
        if line.strip().startswith(("joulemap costmap", "joulemap suggest-drive")):
            assert f"--robot {field / 'robot.toml'}" in line
    step = next(line.strip() for line in said.splitlines() if line.strip().startswith("joulemap costmap"))
    made = runner.invoke(app, [*shlex.split(step)[1:], "--spacing", "4", "--headings", "8"])  # as it says
    assert made.exit_code == 0, made.output
    done = evaluate(field, tmp_path, field, tmp_path / "again.json")
    assert done.exit_code == 0, done.output
    again = json.loads((tmp_path / "again.json").read_text())
    assert again["model"] == f"{tmp_path.name}/model"
    assert again["mean_relative_error"] < report["error"]["before"]["mean_relative"]
    assert calibrate(field, tmp_path).exit_code == 6  # the version is there already


@pytest.mark.slow
def test_a_calibration_cut_off_leaves_no_model_and_can_be_done_again(field, tmp_path, monkeypatch):
    def cut_off(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("joulemap.service.loop.calibration.compare_routes", cut_off)
        assert calibrate(field, tmp_path).exit_code != 0
    assert not (tmp_path / "model").exists()
    done = calibrate(field, tmp_path)
    assert done.exit_code == 0, done.output
    assert {p.name for p in tmp_path.iterdir()} <= {"model", "report.json", "report.html"}


def test_an_out_that_cannot_be_written_is_known_at_once(field, tmp_path):
    file = tmp_path / "taken"
    file.write_text("")
    done = calibrate(field, file)
    assert done.exit_code == 1
    assert f"{file}: File exists" in done.output


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
        app,
        [
            "calibrate",
            "--model",
            "physics",
            "--heightmap",
            str(field / "dem.tif"),
            "--runs",
            str(other),
            "--out",
            str(tmp_path / "out"),
        ],
    )
    assert done.exit_code == 3
    assert "the runs lie off the heightmap" in done.output


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


def written(path, lines):
    path.write_text("\n".join(",".join(map(str, row)) for row in lines) + "\n")


def test_test_runs_are_judged_by_and_nothing_else(field, tmp_path):
    done = calibrate(field, tmp_path, "--test-runs", str(field / "run_02.csv"))
    assert done.exit_code == 0, done.output
    assert "Errors on one test run that had no part in the calibration" in done.output
    assert "WARNING: these are errors of the fit" in done.output
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["runs"]["names"] == ["run_01.csv", "run_03.csv", "run_04.csv"]
    error = report["test_set"]["error"]
    assert all(set(error[key]["by_run"]) == {"run_02.csv"} for key in ("before", "corrected", "after", "after_planner"))
    assert "run_02.csv" not in report["error"]["before"]["by_run"]
    assert report["test_set"]["segments"] > 20
    assert report["kept_aside"] == report["test_set"]  # its former key, until version 0.3
    assert "Errors on one test run that had no part in the calibration" in (tmp_path / "report.html").read_text()
    # another way of stating the model's answer gives the same number
    told = tmp_path / "again.json"
    done = evaluate(field, tmp_path, field / "run_02.csv", told)
    assert done.exit_code == 0, done.output
    assert json.loads(told.read_text())["mean_relative_error"] == pytest.approx(error["after"]["mean_relative"], 0.15)


def test_former_names_of_options_are_accepted_with_a_note(field, tmp_path):
    former = calibrate(field, tmp_path, "--keep-aside", str(field), "--base-runs", str(field / "run_01.csv"))
    assert "--keep-aside is now called --test-runs" in former.output
    assert "--base-runs is now called --baseline-runs" in former.output
    assert "there is no run to read" in former.output  # all of them are test runs
    help_text = runner.invoke(app, ["calibrate", "--help"]).output
    assert "--test-runs" in help_text
    assert not {"--keep-aside", "--base-runs"} & set(help_text.split())


def hostile(source, target, number):
    """A clock that goes back, one that leaps over a day, a run that leaves the map; copies of the meters, and a column
    given twice."""
    head, *rows = (line.split(",") for line in source.read_text().splitlines())
    at = {name: k for k, name in enumerate(head)}
    rng = np.random.default_rng(number)
    odd = rng.standard_normal(len(rows))
    out = [[*head, "left_motor", "bus", "odd", "odd_again"]]
    for k, row in enumerate(rows):
        t = float(row[at["t"]])
        if number == 1 and k > len(rows) // 2:
            t -= 30.0
        if number == 2 and k > len(rows) // 2:
            t += 86_400.0
        if number == 3 and k > len(rows) // 2 and row[at["x"]]:
            row[at["x"]] = repr(float(row[at["x"]]) + 500.0)  # beside the map
        row[at["t"]] = repr(t)
        amps = next(row[c] for name, c in at.items() if name.startswith("current"))
        out.append([*row, amps and 3.0 * float(amps), row[at["voltage"]], odd[k], odd[k]])
    written(target / source.name, out)


def test_hostile_runs_get_a_clear_answer(field, tmp_path):
    bad = tmp_path / "bad"
    bad.mkdir()
    for number, source in enumerate(sorted(field.glob("run_*.csv"))):
        hostile(source, bad, number)
    options = ["--model", "physics", "--heightmap", field / "dem.tif", "--robot", field / "robot.toml", "--runs", bad]
    done = runner.invoke(app, ["calibrate", *map(str, options), "--out", str(tmp_path / "out"), "--quick"])
    assert done.exit_code == 0, done.output
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert "copy of the current" in report["refused"]["left_motor"]
    assert "copy of the voltage" in report["refused"]["bus"]
    assert report["refused"]["odd_again"] == "identical to odd"
    assert report["runs"]["repairs"]["run_02.csv"]["backward_stamps"] > 0
    # the clock and the columns bring nothing of their own
    assert {"drift", "learned:odd"}.isdisjoint(e["name"] for e in report["effects"])


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """(options, output of a quick calibration, its folder): two grounds by the files' names, turning dearer on one."""
    folder = tmp_path_factory.mktemp("wheels")
    for name, log in wheel_logs(12).items():
        (folder / name).write_text(log)
    options = ["--odometry", "1.0", "--terrain-from-name", "--model", "physics", "--runs", str(folder)]
    done = runner.invoke(app, ["calibrate", *options, "--out", str(folder / "out"), "--quick"])
    assert done.exit_code == 0, done.output
    return options, done.output, folder / "out"


@pytest.mark.slow
def test_turning_that_costs_on_one_side_only_is_in_plans(field, tmp_path):
    """Each radian to the right takes 300 J. A plan, which knows no side, pays for a turn to either side."""
    for file in field.glob("run_*.csv"):
        log = pd.read_csv(file)
        heading = np.unwrap(np.radians(log["heading"].ffill()))
        rate = np.zeros(len(log))
        rate[10:-10] = (heading[20:] - heading[:-20]) / (log["t"].to_numpy()[20:] - log["t"].to_numpy()[:-20])
        power = 300.0 * np.clip(rate, 0.0, 2.0)
        log["current"] += (power / log["voltage"].where(log["voltage"] > 1.0)).fillna(0.0)
        log.to_csv(tmp_path / file.name, index=False)
    options = ["--model", "physics", "--heightmap", str(field / "dem.tif"), "--robot", str(field / "robot.toml")]
    options += ["--runs", str(tmp_path), "--out", str(tmp_path / "out"), "--quick"]
    done = runner.invoke(app, ["calibrate", *options])
    assert done.exit_code == 0, done.output
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    in_plans = {effect["name"]: effect["in_plans"] for effect in report["effects"]}
    assert in_plans.items() >= {"turning": True, "turning_to_one_side": False}.items()
    ground = joulemap.heightmap(np.zeros((24, 24)), resolution_m=1.0)
    costs = joulemap.costmap(ground, field / "robot.toml", model=tmp_path / "out" / "model")
    straight = costs.feasibility([(2.5, 12.5), (8.5, 12.5), (14.5, 12.5)]).energy_j
    bent = costs.feasibility([(2.5, 12.5), (8.5, 12.5), (8.5, 6.5)]).energy_j
    assert 150.0 < (bent - straight) / (np.pi / 2.0) < 300.0  # the runs turn more to the right


def test_a_calibration_remembers_the_drivetrain_of_its_robot(field, tmp_path):
    """The runs say what climbs cost: of another efficiency the cost map is the same, and says so."""
    declared, other = (tmp_path / f"{name}.toml" for name in ("declared", "other"))
    lines = (field / "robot.toml").read_text().splitlines()
    text = "\n".join(line for line in lines if not line.startswith("drivetrain_efficiency"))
    declared.write_text(f"{text}\ndrivetrain_efficiency = 0.8\n")
    other.write_text(f"{text}\ndrivetrain_efficiency = 0.4\n")
    (tmp_path / "silent.toml").write_text(text)
    out, dem = tmp_path / "out", field / "dem.tif"
    options = ["--model", "physics", "--heightmap", dem, "--robot", declared, "--runs", field, "--out", out, "--quick"]
    done = runner.invoke(app, ["calibrate", *map(str, options)])
    assert done.exit_code == 0, done.output
    said, prices = {}, {}
    for robot in (declared, other, tmp_path / "silent.toml"):
        at = tmp_path / f"{robot.stem}.zarr"
        command = ["costmap", dem, "--model", out / "model", "--robot", robot, "--out", at]
        done = runner.invoke(app, list(map(str, command)))
        assert done.exit_code == 0, done.output
        said[robot.stem] = " ".join(done.output.split())
        prices[robot.stem] = joulemap.open_costmap(at).lattice.energy_per_m
    np.testing.assert_array_equal(prices["other"], prices["declared"])
    np.testing.assert_array_equal(prices["silent"], prices["declared"])
    words = "the drivetrain efficiency of 0.4 is not used: the robot of the calibration runs declared 0.8"
    assert [words in said[name] for name in ("declared", "other", "silent")] == [False, True, False]


def test_a_model_that_is_not_confirmed_is_not_proposed(tmp_path):
    """Of four runs that have nothing in common, three say nothing of the one that is left out."""
    for name, log in unlike_logs().items():
        (tmp_path / name).write_text(log)
    out = tmp_path / "out"
    options = ["--odometry", "1.0", "--model", "physics", "--runs", str(tmp_path), "--out", str(out)]
    done = runner.invoke(app, ["calibrate", *options])
    assert done.exit_code == 0, done.output
    report = json.loads((out / "report.json").read_text())
    assert report["error"]["after"]["rmse"] > 0.99 * report["error"]["before"]["rmse"]
    assert report["confirmed_in_plans"] is False
    assert report["route"] == {"why_not": "the calibrated model is not confirmed for plans"}
    for said in (done.output, (out / "report.html").read_text()):
        assert "Not confirmed: keep the model that you have" in shown(said)
        assert "joulemap costmap" not in said
        assert "joulemap path" not in said


def test_a_right_rolling_resistance_is_confirmed_though_a_part_of_the_ground_drags(tmp_path):
    """30 W, 0.1, and 70 N more on clay; the same law prices level lawn in plans."""

    def height(x, y):
        return 1.5 * np.sin(x / 9.0) * np.cos(y / 11.0)

    rows, cols = (np.mgrid[0:160, 0:160] + 0.5) / 2.0
    write_geotiff(tmp_path / "dem.tif", joulemap.heightmap(height(cols, 80.0 - rows), resolution_m=0.5))
    given = 'name = "r"\nmass_kg = 60.0\nrolling_resistance = 0.1\nidle_power_w = 30.0\nspeed_mps = 0.8\n'
    (tmp_path / "r.toml").write_text(given)
    weight_n = Robot.from_toml(tmp_path / "r.toml").weight_n
    (tmp_path / "runs").mkdir()
    t = np.arange(0.0, 160.0, 0.5)
    for k, speed in enumerate([0.5, 0.9, 0.7, 0.6]):
        heading = 0.4 + 1.6 * k + 1.3 * np.sin(t / (9.0 + 2.0 * k)) + 0.7 * np.sin(t / 23.0)
        x, y = (40.0 + np.cumsum(speed * 0.5 * f(heading)) - 25.0 * f(heading[0]) for f in (np.sin, np.cos))
        slope = np.gradient(height(x, y), speed * 0.5)
        clay = np.sin(x / 5.0) > 0.3
        power = 30.0 + speed * np.maximum(weight_n * (0.1 + slope) + 70.0 * clay, 0.0)
        kinds = np.where(clay, "clay", "lawn")
        lines = [f"{a},{b:.3f},{c:.3f},{d:.2f},{e}" for a, b, c, d, e in zip(t, x, y, power, kinds, strict=True)]
        (tmp_path / "runs" / f"{k}.csv").write_text("\n".join(["t,x,y,power_w,terrain", *lines]))
    options = ["--model", "physics", "--heightmap", tmp_path / "dem.tif", "--robot", tmp_path / "r.toml", "--quick"]
    done = runner.invoke(
        app, ["calibrate", *map(str, [*options, "--runs", tmp_path / "runs", "--out", tmp_path / "out"])]
    )
    assert done.exit_code == 0, done.output
    rolling = json.loads((tmp_path / "out" / "report.json").read_text())["base_parameters"][0]
    assert (rolling["name"], rolling["declared"]) == ("rolling_resistance", 0.1)
    low, high = rolling["ci95"]
    assert low < 0.1 < high, rolling


def test_the_cost_of_the_ground_is_that_of_the_logs(wheels):
    report = json.loads((wheels[2] / "report.json").read_text())
    ground = next(e for e in report["effects"] if e["name"] == "terrain_class")["coefficients"][0]
    if ground["unit"] == "A s/m":
        assert ground["value"] == pytest.approx(-6.0, rel=0.05)
    else:  # on level ground the same, as a share of what the base parameters alone make of both grounds
        assert ground["unit"] == "of the motion's energy"
        assert -0.75 < ground["value"] < -0.3  # 6 of 8 (ice) to 20 A s/m (loam with its curves)


@pytest.mark.parametrize("regeneration", [0.0, 0.4])
def test_runs_on_level_ground_leave_what_slopes_cost(wheels, regeneration):
    """Cost maps of planes up to 27 % steep: what is new is the same on every slope."""
    robot = {"regeneration": regeneration, "max_grade_deg": 20.0}
    more = []
    for slope in (0.0, 0.04, 0.27):
        ground = joulemap.heightmap(slope * np.arange(24.0)[::-1, None] * np.ones(24), resolution_m=1.0)
        base, new = (joulemap.costmap(ground, robot, model=m).lattice for m in ("physics", wheels[2] / "model"))
        up, down = (new.energy_per_m - base.energy_per_m)[12, 12, [0, 8]]
        more += [up, down]
    assert (
        more[0] > 100.0
    )  # `wheel_logs`: 4 to 7 A at 0.5 m/s and 24 V are 190 to 340 J/m, and a rover of 35 kg takes 55
    np.testing.assert_allclose(more, more[0], rtol=1e-3)


def test_wheel_speeds_stand_in_for_positions(wheels, tmp_path):
    options, said, out = wheels
    report = json.loads((out / "report.json").read_text())
    assert report["target"] == "charge_as"
    found = {e["name"]: e["coefficients"][0] for e in report["effects"]}
    # see `wheel_logs`
    assert found["terrain_class"]["name"] == "ice"
    assert found["turning"]["value"] == pytest.approx(30.0, rel=0.1)
    assert found["turning x terrain_class"]["value"] == pytest.approx(-28.0, rel=0.1)
    planned = planning_robot(load_model(out / "model"), Robot()).turn_j_per_rad
    assert report["turning_in_plans"]["j_per_rad"] == pytest.approx(planned)
    assert f"In plans one radian of turning costs {number_words(planned)} J (charge times the nominal voltage)" in said
    assert report["error"]["after"]["rmse"] < 0.4 * report["error"]["before"]["rmse"]
    assert "12 runs, 10,800 rows" in said
    assert not report["next_drive"]["placed"]
    assert "of level ground" in (out / "report.html").read_text()
    for command in (["calibrate", "--out", str(out / "no")], ["suggest-drive"]):
        both = [*command, *options, "--heightmap", str(out / "report.json")]
        assert runner.invoke(app, both).exit_code == 2
        without = runner.invoke(app, [*command, *options[3:]])
        assert without.exit_code == 3
        assert "--odometry with the track in metres" in " ".join(without.stderr.split())
    done = runner.invoke(app, ["suggest-drive", *options, "--length", "60", "--json", str(tmp_path / "drive.json")])
    assert done.exit_code == 0, done.output
    assert "wherever there is room" in done.output
    drive = json.loads((tmp_path / "drive.json").read_text())
    assert len(drive["speeds_mps"]) * int(drive["length_m"]) <= 1.25 * 60.0  # a round at each speed, in whole metres


def test_whole_campaigns_are_left_out_when_asked(field, tmp_path, monkeypatch):
    asked = {}

    def told(*_, **options):
        asked.update(options)
        raise InputError("enough")

    monkeypatch.setattr("joulemap.service.loop.calibration.calibrate_on_runs", told)
    runs = tmp_path / "runs"
    runs.mkdir()
    for number, name in enumerate(("june_1", "june_2", "may_1", "may_2"), 1):
        (runs / f"{name}.csv").write_text((field / f"run_0{number}.csv").read_text())
    options = f"--model physics --heightmap {field}/dem.tif --out {tmp_path}/out --campaigns --runs".split()
    done = runner.invoke(app, ["calibrate", *options, str(runs)])
    assert "enough" in done.output
    assert (asked["groups"], asked["cross_validate"]) == (["june", "june", "may", "may"], True)
    calibrate(field, tmp_path / "out")
    assert (asked["groups"], asked["cross_validate"]) == (None, False)
    done = runner.invoke(app, ["calibrate", *options, str(field)])
    assert done.exit_code == 3
    assert "all 4 runs belong to the campaign 'run'" in done.output


def test_beyond_the_speeds_of_the_runs_map_route_and_verdict_warn_and_nothing_is_free(field, tmp_path):
    """Calibrated at the robot's own speed, asked at three times that."""
    assert calibrate(field, tmp_path / "out").exit_code == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    own, fast = Robot.from_toml(field / "robot.toml"), tmp_path / "fast.toml"
    assert not [words for words in report["warnings"] if "robot's speed" in words]
    speed = 3.0 * own.speed_mps
    assert report["ranges"]["speed"][1] < speed
    text = (field / "robot.toml").read_text()
    fast.write_text(re.sub(r"speed_mps = [\d.]+", f"speed_mps = {speed}", text))
    made = tmp_path / "map.zarr"
    model = ["--model", str(tmp_path / "out" / "model"), "--spacing", "2", "--headings", "8"]

    def ask(*words):
        done = runner.invoke(app, [*map(str, words), "--json", str(tmp_path / "answer.json")])
        assert done.exit_code in (0, 1), done.output
        return done.output, json.loads((tmp_path / "answer.json").read_text())

    ends = report["route"]["task"]
    task = ["--start", "{:.1f},{:.1f}".format(*ends["start"]), "--goal", "{:.1f},{:.1f}".format(*ends["goal"])]
    words = f"the robot's speed of {speed:g} m/s is outside"
    for output, answer in (
        ask("costmap", field / "dem.tif", "--robot", fast, *model, "--out", made),
        ask("path", made, *task),
        ask("feasibility", made, *task),
    ):
        assert words in " ".join(output.split())
        assert len([warning for warning in answer["warnings"] if warning.startswith(words)]) == 1
    ground = open_costmap(made)
    assert ground.robot.speed_mps == speed
    route = ground.plan(ends["start"], ends["goal"])
    verdict = ground.feasibility(route)
    for told in (ground.warnings, route.warnings, verdict.warnings):
        assert len([warning for warning in told if warning.startswith(words)]) == 1
    assert f"Warning: {words}" in str(verdict)
    assert words in str(route)
    usual = load_model(tmp_path / "out" / "model")
    x, y = (np.array([p]) for p in route.points[len(route.points) // 2, :2])
    price = np.mean(
        [ground.robot.price_per_m(usual.segment_traction(ground_of(field), ground.robot, x, y, h)) for h in AROUND]
    )
    slow = np.mean([own.price_per_m(usual.segment_traction(ground_of(field), own, x, y, h)) for h in AROUND])
    # the power of driving is drawn for a third of the time
    assert price - ground.robot.hotel_per_m > 0.3 * (slow - own.hotel_per_m) > 0.0
