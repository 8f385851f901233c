"""Tours and other ways, over HTTP and on the command line: the same answers, priced as claimed."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

import joulemap as jm
from joulemap.planner.lattice.loading import load_lattice
from joulemap.service.analysis.objectives import Objective, best_routes
from tests.reference.lattices import price_world_path
from tests.service.conftest import GOAL, IN_HOLE, NORTH, START, WEST, hill
from tests.service.test_bad_input import check_problem
from tests.service.test_cli import folder, joulemap  # noqa: F401

NORTH_WEST, SOUTH = [WEST + 4.5, NORTH - 8.5], [WEST + 20.5, NORTH - 27.5]


def test_a_tour_visits_all_stops_and_comes_home(client: TestClient, costmap_id: str) -> None:
    stops = [START, SOUTH, NORTH_WEST, GOAL]
    asked = {"stops": stops, "battery": {"charge": 0.5, "reserve": 0.1}}
    answer = client.post(f"/v1/costmaps/{costmap_id}/tours", json=asked)
    assert answer.status_code == 200, answer.text
    tour = answer.json()
    assert tour["proven"]
    assert tour["order"][0] == 0
    assert sorted(tour["order"]) == [0, 1, 2, 3]
    visited = [stops[k] for k in (*tour["order"], 0)]
    for leg, (here, there) in zip(tour["legs"], pairwise(visited), strict=True):
        assert (leg["path"][0][:2], leg["path"][-1][:2]) == (pytest.approx(here), pytest.approx(there))
    lattice = load_lattice(client.app.state.service.store.lattice_path(costmap_id))  # type: ignore[attr-defined]
    assert tour["energy_j"] == pytest.approx(sum(leg["energy_j"] for leg in tour["legs"]))
    radii = [leg["tightest_radius_m"] for leg in tour["legs"]]
    assert tour["tightest_radius_m"] == min(radius for radius in radii if radius is not None)
    assert tour["energy_j"] == pytest.approx(price_world_path(lattice, np.array(tour["path"], dtype=float)))
    assert tour["energy_j"] <= tour["grid_energy_j"] * (1 + 1e-9)
    assert tour["bound_j"] <= tour["grid_energy_j"] * (1 + 1e-6)
    assert tour["battery"]["energy_j"] == pytest.approx(tour["energy_j"])
    assert client.get(f"/v1/costmaps/{costmap_id}").json()["links"]["tours"] == f"/v1/costmaps/{costmap_id}/tours"


def test_a_blocked_stop_can_be_moved_to_the_nearest_free_place(client: TestClient, costmap_id: str) -> None:
    url = f"/v1/costmaps/{costmap_id}/tours"
    refused = check_problem(client.post(url, json={"stops": [START, IN_HOLE]}), 422, "blocked", "nearest free place")
    tour = client.post(url, json={"stops": [START, IN_HOLE], "snap": True}).json()
    assert tour["legs"][0]["path"][-1][:2] == pytest.approx(refused["context"]["nearest"])
    assert "stop 1" in tour["warnings"][0]


@pytest.mark.parametrize("one_way", [True, False])
def test_a_tour_in_the_given_order_and_one_that_does_not_return(
    client: TestClient,
    costmap_id: str,
    folder: Path,  # noqa: F811
    one_way: bool,
) -> None:
    stops = [START, GOAL, SOUTH, NORTH_WEST]
    url, more = f"/v1/costmaps/{costmap_id}/tours", {"stops": stops, "one_way": one_way}
    best, given = (client.post(url, json=more | {"in_order": kept}).json() for kept in (False, True))
    assert given["order"] == [0, 1, 2, 3]
    visited = stops if one_way else [*stops, START]
    for leg, (here, there) in zip(given["legs"], pairwise(visited), strict=True):
        assert (leg["path"][0][:2], leg["path"][-1][:2]) == (pytest.approx(here), pytest.approx(there))
    assert (best["order"][-1] == 3 and len(best["legs"]) == 3) if one_way else len(best["legs"]) == 4
    assert best["energy_j"] <= given["energy_j"]
    costs = jm.costmap(hill())
    judged = costs.feasibility(costs.tour(stops, in_order=True, one_way=one_way), charge=0.5, reserve=0.1)
    assert f"to {'arrive' if one_way else 'return'} with the reserve" in judged.text
    here = [[x - WEST, y - NORTH + 30.0] for x, y in stops]
    seen = jm.open_costmap(folder / "dem.zarr").tour(here, in_order=True, one_way=one_way)
    assert (seen.order, len(seen.legs)) == ((0, 1, 2, 3), 3 if one_way else 4)
    options = ["--in-order", *(["--one-way"] if one_way else [])]
    code, said, errors = joulemap("tour", folder / "dem.zarr", "--stop", *(f"{x},{y}" for x, y in here), *options)
    assert code == 0, errors
    assert f"0 -> 1 -> 2 -> 3{'' if one_way else ' -> 0'}" in said


def test_legs_that_follow_one_another_are_priced_as_one_path() -> None:
    flat = jm.heightmap(np.zeros((40, 40)), resolution_m=1.0)
    costs = jm.costmap(flat, robot=jm.Robot(turn_j_per_rad=100.0))
    there = (5.0, 5.0), (30.0, 5.0)
    back = costs.feasibility(costs.plan(*there), round_trip=True), costs.feasibility(there, round_trip=True)
    whole = costs.feasibility([*there, there[0]])
    assert [one.energy_j for one in back] == pytest.approx([whole.energy_j] * 2)
    assert back[0].probability == pytest.approx(whole.probability)
    stops = [*there, (30.0, 30.0)]
    tour = costs.tour(stops, in_order=True)
    path = np.vstack([leg.points for leg in tour.legs])
    judged = [costs.feasibility(tour).energy_j, costs.feasibility(path).energy_j]
    assert judged == pytest.approx([tour.energy_j] * 2)
    means = tuple(costs.plan(a, b).route for a, b in (there, there[::-1]))
    ways, weighed = best_routes(costs.planner, means, Objective("quantile"))
    assert sum(way.energy_j for way in ways) == pytest.approx(whole.energy_j, rel=1e-3)
    assert weighed.mean_quantile_j == pytest.approx(whole.verdict.energy_p95_j, rel=1e-3)


def test_tours_that_cannot_be_asked(client: TestClient, costmap_id: str) -> None:
    url = f"/v1/costmaps/{costmap_id}/tours"
    check_problem(client.post(url, json={"stops": [START, IN_HOLE]}), 422, "blocked", "stop 1", "unknown")
    check_problem(client.post(url, json={"stops": [START]}), 422, "invalid_request", "stops")
    check_problem(client.post(url, json={"stops": [START, GOAL], "robot": {"mass_kg": 99}}), 409, "conflict", "mass_kg")
    check_problem(client.post("/v1/costmaps/cm-none/tours", json={"stops": [START, GOAL]}), 404, "not_found")


def test_a_sharper_bound_where_it_is_asked_for(client: TestClient, costmap_id: str) -> None:
    asked, url = {"start": START, "goal": GOAL}, f"/v1/costmaps/{costmap_id}/paths"
    plain, sharper = (client.post(url, json={**asked, "bound": wanted}).json() for wanted in (False, True))
    assert plain["energy_j"] == sharper["energy_j"]
    assert 0.0 < plain["bound_j"] < sharper["bound_j"] <= sharper["energy_j"]
    for found in (plain, sharper):
        assert found["gap"] == pytest.approx(found["energy_j"] / found["bound_j"] - 1.0)


def test_other_ways_round_the_hill(client: TestClient, costmap_id: str) -> None:
    asked = {"start": START, "goal": GOAL, "alternatives": 2}
    url = f"/v1/costmaps/{costmap_id}/paths"
    found = client.post(url, json=asked).json()
    assert 1 <= len(found["alternatives"]) <= 2
    lattice = load_lattice(client.app.state.service.store.lattice_path(costmap_id))  # type: ignore[attr-defined]
    energies = [found["energy_j"]]
    for other in found["alternatives"]:
        assert other["path"][0][:2] == pytest.approx(START)
        assert other["path"][-1][:2] == pytest.approx(GOAL)
        assert other["energy_j"] == pytest.approx(price_world_path(lattice, np.array(other["path"], dtype=float)))
        energies.append(other["energy_j"])
    assert energies == sorted(energies)
    assert client.post(url, json={**asked, "alternatives": 0}).json()["alternatives"] == []
    kinds = [f["properties"]["kind"] for f in client.post(f"{url}?format=geojson", json=asked).json()["features"]]
    assert kinds == ["energy_optimal", "shortest", *["alternative"] * len(found["alternatives"])]


def test_tour_and_other_ways_on_the_command_line(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    ends = ("--start", "2.5,15.5", "--goal", "37.5,15.5")
    code, out, errors = joulemap(
        "path", folder / "dem.zarr", *ends, "--alternatives", 1, "--json", tmp_path / "path.json"
    )
    assert code == 0, errors
    assert "alternative 1" in out
    assert len(json.loads((tmp_path / "path.json").read_text())["alternatives"]) == 1
    stops = ("--stop", "2.5,15.5", "--stop", "37.5,15.5", "--stop", "20.5,3.5")
    files = ("--geojson", tmp_path / "tour.geojson", "--json", tmp_path / "tour.json")
    code, out, errors = joulemap("tour", folder / "dem.zarr", *stops, *files)
    assert code == 0, errors
    found = json.loads((tmp_path / "tour.json").read_text())
    assert " -> ".join(str(k) for k in (*found["order"], 0)) in out
    assert "feasible" in out
    legs = json.loads((tmp_path / "tour.geojson").read_text())["features"]
    assert [leg["properties"]["from_stop"] for leg in legs] == found["order"]
    assert sum(leg["properties"]["energy_j"] for leg in legs) == pytest.approx(found["energy_j"])
    code, _, errors = joulemap("tour", folder / "dem.zarr", "--stop", "2.5,15.5", "--stop", "34.5,4.5")
    assert code == 4
    assert "stop 1" in errors
