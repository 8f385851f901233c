"""`python -m tests.paper`: `reproduce` from the first drive to the table, and `baselines` on its runs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from joulemap.model.robot import Robot
from tests.paper.__main__ import app
from tests.paper.fieldwork import read_measured
from tests.paper.profiles import FIRST_SEED, PROFILES
from tests.paper.setting import Setting

pytestmark = pytest.mark.slow  # minutes
QUICK = ["--profile", "quick", "--seeds", "1", "--workers", "1"]


@pytest.fixture(scope="module")
def reproduced(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("reproduction")
    answer = CliRunner().invoke(app, ["reproduce", "--out", str(folder), *QUICK])
    assert answer.exit_code == 0, answer.output
    return folder


def test_every_method_is_judged_on_every_row(reproduced: Path) -> None:
    document = json.loads((reproduced / "results.json").read_text())
    methods = document["methods"]
    for method in ("physics", "gp", "ridge", "compact", "compact_scratch", "resnet_finetuned"):
        assert set(methods[method]) >= {"V-A", "V-B", "V-C", "V-E", "V-E shifted", "V-E rest", "V-E other"}, method
    assert set(methods["map_floor"]) == {"V-A", "V-B", "V-C", "V-E rest", "V-E other"}
    assert {"resnet_frozen", "resnet_scratch", "compact_driven", "curve_shipped", "curve_scratch"} <= set(methods)
    for rows in methods.values():
        for found in rows.values():
            assert 0.0 < found["mean_relative_error"]["mean"] < 3.0
    for row in ("V-A", "V-B", "V-C"):  # nobody knows better than perfect knowledge
        assert methods["noise_floor"][row]["mean_relative_error"]["mean"] < 0.12
    assert document["setting"]["profile"]["name"] == "quick"


def test_the_tables_have_every_method_beside_the_paper(reproduced: Path) -> None:
    text = (reproduced / "TABLES.md").read_text()
    columns = "paper | physics | gp | ridge | resnet_finetuned | compact | noise_floor | map_floor"
    assert f"| section | tested on | {columns} |" in text
    assert "| V-A | rest of site A, same pattern | 9.1 (23.6) | " in text
    assert text.count("\n## ") == 6


def test_the_mean_shift_takes_the_bias_out(reproduced: Path) -> None:
    shifted = json.loads((reproduced / "results.json").read_text())["methods"]["compact"]["V-E shifted"]
    assert shifted["seeds"][str(FIRST_SEED)]["bias_j"] == pytest.approx(0.0, abs=1e-6)


def test_a_cut_off_run_goes_on(reproduced: Path) -> None:
    result = reproduced / "results" / f"baselines_{FIRST_SEED}.json"
    before = json.loads(result.read_text())["methods"]
    result.unlink()
    answer = CliRunner().invoke(app, ["reproduce", "--out", str(reproduced), *QUICK])
    assert answer.exit_code == 0, answer.output
    ended = [line for line in answer.output.splitlines() if ", seed " in line]
    assert len(ended) == 1
    assert ended[0].startswith("baselines")
    assert json.loads(result.read_text())["methods"] == before


def test_another_setting_is_refused(reproduced: Path) -> None:
    answer = CliRunner().invoke(app, ["reproduce", "--out", str(reproduced), *QUICK, "--heightmap-from", "driven"])
    assert answer.exit_code == 3
    assert "choose another folder" in answer.output


def test_baselines_on_any_runs(reproduced: Path) -> None:
    field = Setting(reproduced, PROFILES["quick"]).field(FIRST_SEED)
    answer = CliRunner().invoke(
        app,
        [
            "baselines",
            "--heightmap",
            str(field / "grass_a.tif"),
            "--robot",
            str(field / "robot.toml"),
            "--runs",
            str(field / "a_lawnmower_*.csv"),
            "--test-runs",
            str(field / "a_lawnmower_06.csv"),
            "--model",
            "physics",
            "--json",
            "-",
        ],
    )
    assert answer.exit_code == 0, answer.output
    document = json.loads(answer.stdout)
    assert (len(document["learned"]), len(document["tested"])) == (5, 1)
    robot = Robot.from_toml(field / "robot.toml")
    tested = read_measured(field, "a_lawnmower", robot).of_runs(5)
    assert {found["segments"] for found in document["methods"].values()} == {int(tested.straight.sum())}
    assert {"fitted friction", "ridge on shape", "physics"} <= set(document["methods"])
