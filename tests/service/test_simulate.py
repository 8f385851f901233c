"""`joulemap simulate`: days at one site with one robot, with and without effects that no file declares."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from joulemap.model.field.days import simulate_day
from joulemap.model.field.drives import drive_along
from joulemap.model.field.hidden_draws import EFFECT_NAMES
from joulemap.model.field.robots import FieldRobot
from joulemap.model.field.sites import random_site
from joulemap.model.robot import Robot
from joulemap.service.cli import app

MADE = ("--site", "random", "--drive", "waypoints", "--runs", "1", "--seed", "5")


def simulate(out: Path, *more: str) -> dict[str, object]:
    """The answer of the command, in this process."""
    result = CliRunner().invoke(app, ["simulate", "--out", str(out), *MADE, *more, "--json", "-"])
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


def test_the_command_knows_the_effects_of_the_field() -> None:
    words = CliRunner().invoke(app, ["simulate", "--help"]).stdout
    assert all(name in "".join(words.replace("│", " ").split()) for name in EFFECT_NAMES)


def test_another_day_is_at_the_same_site_with_the_same_robot(tmp_path: Path) -> None:
    first = simulate(tmp_path / "base")
    again, hidden = simulate(tmp_path / "day", "--day", "2"), simulate(tmp_path / "new", "--hidden", "turning")
    assert (first["day"], again["day"], hidden["day"]) == (1, 2, 2)
    for name in ("dem.tif", "robot.toml"):  # nothing in them says what is hidden
        assert len({(tmp_path / folder / name).read_bytes() for folder in ("base", "day", "new")}) == 1
    logs = {folder: (tmp_path / folder / "run_01.csv").read_bytes() for folder in ("base", "day", "new")}
    assert len(set(logs.values())) == 3
    simulate(tmp_path / "again", "--hidden", "turning")
    assert (tmp_path / "again" / "run_01.csv").read_bytes() == logs["new"]


def test_several_effects_are_at_work_together(tmp_path: Path) -> None:
    made = simulate(tmp_path / "new", "--hidden", "terrain_class", "payload")
    assert made["hidden"] == ["terrain_class", "payload"]
    words = np.genfromtxt(tmp_path / "new" / "run_01.csv", delimiter=",", skip_header=1, usecols=14, dtype=str)
    assert set(words) == {"grass", "gravel"}


def test_an_unknown_effect_is_wrong_usage(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["simulate", "--out", str(tmp_path / "new"), "--hidden", "gravity"])
    assert result.exit_code == 2
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", ["turning", "hotel_load", "sensor_gain"])
def test_an_effect_is_felt_in_the_log(name: str) -> None:
    """Winding round and round, with the effect and without: other noise, but the same drive."""
    site = random_site(np.random.default_rng(1))
    robot = FieldRobot.nominal(Robot())
    angle = np.linspace(0.0, 12.0 * np.pi, 200)
    drive = drive_along(np.column_stack([15 + 2 * np.cos(angle), 15 + 2 * np.sin(angle)]), speed_mps=0.5)

    def drawn_j(hidden: tuple[str, ...]) -> float:
        (log,) = simulate_day(site, robot, [drive], day=2, hidden=hidden, rng=np.random.default_rng(4))
        power = np.clip(log.columns["voltage"], 10.0, 40.0) * np.clip(log.columns["current"], 0.0, 40.0)
        return float(np.sum(power[1:] * np.diff(log.columns["t"])))

    assert abs(drawn_j((name,)) / drawn_j(()) - 1.0) > 0.05
