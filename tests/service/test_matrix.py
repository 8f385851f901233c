"""Energies between many places: those of single searches, with reasons where there is no way, in every face."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import joulemap as jm
from joulemap.model.errors import InputError
from tests.service.conftest import GOAL, IN_HOLE, START, hill
from tests.service.test_cli import joulemap
from tests.service.test_client import client, costmap, running

__all__ = ["client", "costmap", "running"]
MIDDLE = [START[0] + 10.0, START[1] - 8.0]


def _costs(turn_j_per_rad: float = 0.0) -> jm.CostMap:
    return jm.costmap(hill(), robot={"mass_kg": 50.0, "turn_j_per_rad": turn_j_per_rad}, model="physics")


@pytest.fixture(scope="module")
def costs() -> jm.CostMap:
    return _costs()


@pytest.mark.parametrize("turn_j_per_rad", [0.0, 30.0])
@pytest.mark.parametrize(("starts", "goals"), [([START, MIDDLE], [GOAL]), ([START], [GOAL, MIDDLE])])
def test_the_values_are_those_of_single_searches(
    turn_j_per_rad: float, starts: list[list[float]], goals: list[list[float]]
) -> None:
    ground = _costs(turn_j_per_rad)
    found = ground.matrix(starts, goals, neighbours=16)
    for i, start in enumerate(starts):
        for j, goal in enumerate(goals):
            one = ground.plan(start, goal, refine=False)
            assert found.energies_j[i, j] == pytest.approx(one.energy_j, rel=1e-6)
            assert found.lengths_m[i, j] == pytest.approx(one.length_m, rel=1e-6)
    assert found.reasons == [[None] * len(goals)] * len(starts)


def test_there_and_back_differ_and_staying_is_free(costs: jm.CostMap) -> None:
    found = costs.matrix([START, GOAL, MIDDLE], [START, GOAL, MIDDLE])
    assert found.energies_j.shape == (3, 3)
    assert np.diagonal(found.energies_j) == pytest.approx(0.0)
    assert abs(found.energies_j[0, 2] - found.energies_j[2, 0]) > 1.0


def test_what_is_not_reached_has_a_reason_and_harms_nothing_else(costs: jm.CostMap) -> None:
    found = costs.matrix([START, IN_HOLE], [GOAL, IN_HOLE, MIDDLE])
    assert np.isfinite(found.energies_j).tolist() == [[True, False, True], [False] * 3]
    assert "goal 1" in str(found.reasons[0][1])
    assert "blocked ground" in str(found.reasons[0][1])
    assert "start 1" in str(found.reasons[1][0])
    assert found.cheapest == [2, None]
    y = START[1]
    wall = [[START[0] + 15.0, y - 500.0], [START[0] + 17.0, y - 500.0], [START[0] + 17.0, y + 500.0]]
    parted = costs.matrix([START], [GOAL], avoid=[[*wall, [START[0] + 15.0, y + 500.0]]])
    assert not np.isfinite(parted.energies_j[0, 0])
    assert "no way leads from start 0 to goal 0" in str(parted.reasons[0][0])
    moved = costs.matrix([IN_HOLE], [GOAL], snap=True)
    assert np.isfinite(moved.energies_j).all()
    assert "start 0" in moved.notes[0]


def test_the_cheapest_goal_alone(costs: jm.CostMap) -> None:
    goals = [GOAL, IN_HOLE, MIDDLE]
    whole = costs.matrix([START, GOAL], goals)
    found = costs.matrix([START, GOAL], goals, only_cheapest=True)
    assert found.cheapest == whole.cheapest == [2, 0]
    assert np.isfinite(found.energies_j).sum(axis=1).tolist() == [1, 1]
    assert found.energies_j.min(axis=1) == pytest.approx(whole.energies_j.min(axis=1), rel=1e-9)
    assert "another goal takes less" in str(found.reasons[0][0])
    assert "blocked ground" in str(found.reasons[0][1])


def test_odds_where_the_model_knows_them(costs: jm.CostMap) -> None:
    pack = jm.Battery(280.0, charge=0.5)
    assert costs.matrix([START], [GOAL], battery=pack).probabilities is None
    learned = jm.costmap(hill())
    found = learned.matrix([START, MIDDLE], [GOAL], battery={"capacity_wh": 0.8})
    assert (found.energies_p05_j < found.energies_j).all()
    assert (found.energies_j < found.energies_p95_j).all()
    assert ((found.probabilities > 0.0) & (found.probabilities < 1.0)).any()
    assert (learned.matrix([START], [GOAL], battery=pack).probabilities > 0.99).all()


def test_every_face_answers_alike(costs: jm.CostMap, costmap: Any, tmp_path: Path) -> None:
    here = costs.matrix([START, IN_HOLE], [GOAL, MIDDLE])
    there = costmap.matrix([START, IN_HOLE], [GOAL, MIDDLE])
    assert there.energies_j[0] == pytest.approx(here.energies_j[0], rel=1e-9)
    assert there.energies_j[1] == [None, None]
    assert there.reasons == here.reasons
    sent = costmap._connection.send(
        "POST", f"/v1/costmaps/{costmap.id}/matrix", json={"starts": [START, GOAL], "goals": [START, GOAL]}
    ).json()
    assert sent["cheapest"] == [0, 1]
    assert sent["lengths_m"][0][1] == pytest.approx(sent["lengths_m"][1][0], rel=0.2)
    folder, starts, goals = costs.save(tmp_path / "map.zarr"), tmp_path / "starts.csv", tmp_path / "goals.csv"
    for file, places in ((starts, [START, IN_HOLE]), (goals, [GOAL, MIDDLE])):
        file.write_text("x_m,y_m\n" + "".join(f"{x},{y}\n" for x, y in places))
    table, document = tmp_path / "out.csv", tmp_path / "out.json"
    code, words, errors = joulemap("matrix", folder, starts, "--goals", goals, "--out", table, "--json", document)
    assert code == 0, errors
    assert "2 ways between 2 starts and 2 goals" in words
    assert json.loads(document.read_text())["energies_j"][0] == pytest.approx(here.energies_j[0].tolist(), rel=1e-9)
    lines = list(csv.DictReader(table.open()))
    assert [(line["start"], line["goal"]) for line in lines] == [("0", "0"), ("0", "1"), ("1", "0"), ("1", "1")]
    assert float(lines[1]["energy_j"]) == pytest.approx(here.energies_j[0, 1], rel=1e-9)
    assert lines[2]["energy_j"] == ""
    assert "blocked ground" in lines[2]["reason"]
    starts.write_text("x_m,y_m\n" + "".join(f"{x},{y}\n" for x, y in (START, GOAL)))
    assert joulemap("matrix", folder, starts, "--json", document)[0] == 0
    assert json.loads(document.read_text())["cheapest"] == [1, 0]  # a place is no goal of itself
    code, _, errors = joulemap("matrix", folder, starts, "--only-cheapest")
    assert (code, "needs --goals" in errors) == (2, True)


def test_a_map_on_disk_says_that_it_cannot(costs: jm.CostMap, tmp_path: Path) -> None:
    stored = jm.open_costmap(costs.save(tmp_path / "map.zarr"), memory_gb=0.5)
    with pytest.raises(InputError, match="whole cost map in memory"):
        stored.matrix([START], [GOAL])
