"""The cheapest way with charging stops: on the command line, in Python and over HTTP."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from starlette.testclient import TestClient

import joulemap as jm
from tests.service.conftest import GOAL, START, hill
from tests.service.test_cli import joulemap

MIDDLE = [0.5 * (a + b) for a, b in zip(START, GOAL, strict=True)]
ASIDE = [START[0] + 3.0, START[1]]


def test_it_charges_where_it_must_and_says_so_by_every_face(
    client: TestClient, costmap_id: str, tmp_path: Path
) -> None:
    ground = jm.costmap(hill(), model="physics")
    route = ground.plan(START, GOAL)
    usual = ground.robot.battery_wh * 3600.0
    charge = 0.7 * route.energy_j / usual
    asked = {"start": START, "goal": GOAL, "at": [ASIDE, MIDDLE], "power_w": 100.0, "snap": True}
    found = ground.charging(**asked, battery=jm.Battery(ground.robot.battery_wh, charge=charge))
    over = [sum(ground.plan(*leg, snap=True).energy_j for leg in ((START, at), (at, GOAL))) for at in (ASIDE, MIDDLE)]
    best = over.index(min(over))
    assert [leg.hop.start for leg in found.legs] == [0, best + 1]
    assert found.energy_j == pytest.approx(min(over))
    first, second = found.legs
    assert first.hop.charged_j == 0.0
    assert second.hop.charged_j == pytest.approx(second.route.energy_j - (charge * usual - first.route.energy_j))
    assert second.hop.waits_s == pytest.approx(60.0 + second.hop.charged_j / 100.0)
    assert second.verdict.feasible
    assert all(leg.verdict.charge_at_end >= -1e-9 for leg in found.legs)
    assert found.energy_j >= route.energy_j - 1e-6
    body = {**asked, "battery": {"charge": charge}}
    sent = client.post(f"/v1/costmaps/{costmap_id}/charging", json=body)
    assert sent.status_code == 200, sent.text
    there = sent.json()
    assert [leg["charger"] for leg in there["legs"]] == [None, best]
    assert (there["feasible"], there["energy_j"]) == (True, pytest.approx(found.energy_j))
    folder = ground.save(tmp_path / "map.zarr")
    options = [
        f"--{name}={x},{y}" for name, (x, y) in (("start", START), ("goal", GOAL), ("at", ASIDE), ("at", MIDDLE))
    ]
    command = ["charging", folder, *options, "--snap", f"--charge={charge}"]
    code, words, errors = joulemap(*command, "--power", "100", "--json", "-")
    assert code == 0, errors
    assert json.loads(words)["duration_s"] == pytest.approx(there["duration_s"])
    assert json.loads(words)["text"].startswith(f"It arrives charging at place {best + 1}")
    code, words, errors = joulemap(*command, "--swap", "30", "--json", "-")
    assert code == 0, errors
    assert json.loads(words)["legs"][1]["charge_at_start"] == pytest.approx(1.0)
    code, _, errors = joulemap(*command)
    assert code == 2
    assert "give either --power or --swap" in errors


@pytest.mark.parametrize(("power_w", "status"), [(1e-308, 422), (0.5, 422), (1.0, 200)])
def test_a_power_that_never_charges_is_refused(
    client: TestClient, costmap_id: str, power_w: float, status: int
) -> None:
    body = {"start": START, "goal": GOAL, "at": [MIDDLE], "power_w": power_w, "snap": True}
    sent = client.post(f"/v1/costmaps/{costmap_id}/charging", json=body)
    assert sent.status_code == status, sent.text


def test_where_no_chain_reaches_it_says_what_is_missing(client: TestClient, costmap_id: str) -> None:
    body = {"start": START, "goal": GOAL, "at": [MIDDLE], "power_w": 100.0, "snap": True, "battery": {"charge": 1e-4}}
    sent = client.post(f"/v1/costmaps/{costmap_id}/charging", json=body)
    assert sent.status_code == 200, sent.text
    found = sent.json()
    assert (found["feasible"], found["legs"], found["energy_j"]) == (False, [], None)
    assert "No chain of charging places reaches the goal" in found["text"]
    full = client.post(f"/v1/costmaps/{costmap_id}/charging", json={**body, "battery": {}}).json()
    assert [leg["charger"] for leg in full["legs"]] == [None]
    assert full["text"].startswith("It arrives without charging")
