"""Odds over HTTP, in Python and on the command line: energies, classes, the battery along the way, the way home."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

import joulemap as jm
from joulemap.model.energy.physics import PhysicsPredictor
from joulemap.model.energy.uncertainty import Spread
from joulemap.model.errors import InputError
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.loop.correction import Correction
from joulemap.model.terrain.writers import write_geotiff
from joulemap.planner.lattice.build import build_lattice
from joulemap.planner.route_planner import RoutePlanner
from joulemap.service.analysis.route_uncertainty import quantiles_of_route
from joulemap.service.cli import app
from joulemap.service.library.costmaps import CostMap
from joulemap.service.schemas.planning import profile_pieces
from tests.service.conftest import GOAL, START, hill

FEW = Spread(run_share=0.08, freedom=12.0, run_freedom=4.0)


@pytest.fixture(scope="module")
def known() -> CostMap:
    """A map of calibrated `physics`, which knows its errors."""
    model = CalibratedPredictor(PhysicsPredictor(), Correction((), (), spread=FEW), name="calibrated", version="1")
    return CostMap(build_lattice(hill(), jm.Robot(), model))


def ask(client: TestClient, costmap_id: str, question: str, **body: Any) -> dict[str, Any]:
    answer = client.post(f"/v1/costmaps/{costmap_id}/{question}", json=body)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_a_model_without_runs_gives_a_class_and_no_odds(client: TestClient, costmap_id: str) -> None:
    path = ask(client, costmap_id, "paths", start=START, goal=GOAL)
    assert [path[f"energy_p{share}_j"] for share in ("05", "50", "95")] == [None] * 3
    full = ask(client, costmap_id, "feasibility", start=START, goal=GOAL)
    assert (full["verdict"], full["probability"]) == ("yes", None)
    assert "without odds because the model has seen no runs" in full["verdict_text"]
    share = path["energy_j"] / 3600.0 / 280.0
    for factor, verdict in ((2.0, "yes"), (1.4, "likely"), (1.05, "marginal"), (0.5, "no")):
        asked = ask(client, costmap_id, "feasibility", start=START, goal=GOAL, battery={"charge": factor * share})
        assert asked["verdict"] == verdict


def test_calibrated_physics_gives_a_distribution(known: CostMap) -> None:
    route = known.plan(START, GOAL)
    verdict = known.feasibility(route, charge=1.0).verdict
    low, middle, high = verdict.energy_p05_j, verdict.energy_p50_j, verdict.energy_p95_j
    assert low is not None
    assert middle is not None
    assert high is not None
    assert low < middle < high
    assert middle == pytest.approx(route.energy_j)
    for energy, probability in ((high, 0.95), (middle, 0.5), (low, 0.05)):
        asked = known.feasibility(route, charge=energy / 3600.0 / 280.0).verdict
        assert asked.probability == pytest.approx(probability, abs=0.002)
        assert asked.charge_for_yes == pytest.approx(high / 3600.0 / 280.0, rel=1e-6)
    yes, no = (known.feasibility(route, charge=factor * middle / 3600.0 / 280.0) for factor in (1.4, 0.6))
    assert (yes.class_, no.class_) == ("yes", "no")
    assert "makes it a yes" in no.text
    assert no.verdict.yes_until_m is not None
    assert 0.0 < no.verdict.yes_until_m < route.length_m


def test_the_charge_that_is_named_makes_it_a_yes(client: TestClient, costmap_id: str) -> None:
    battery = {"capacity_wh": 2.0, "reserve": 0.1}
    marginal = ask(client, costmap_id, "feasibility", start=START, goal=GOAL, battery={**battery, "charge": 0.3})
    assert marginal["verdict"] != "yes"
    named = marginal["charge_for_yes"]
    for charge, is_yes in ((named + 1e-6, True), (named - 1e-3, False)):
        asked = ask(client, costmap_id, "feasibility", start=START, goal=GOAL, battery={**battery, "charge": charge})
        assert (asked["verdict"] == "yes") is is_yes


def test_the_battery_along_the_way(client: TestClient, costmap_id: str) -> None:
    body = {"start": START, "goal": GOAL, "round_trip": True, "profile": True}
    found = ask(client, costmap_id, "feasibility", **body, battery={"resistance_ohm": 0.05, "reserve": 0.1})
    charges = [piece["charge"] for piece in found["profile"]]
    assert charges == sorted(charges, reverse=True)
    assert charges[-1] == pytest.approx(found["charge_at_end"])
    assert found["profile"][-1]["distance_m"] == pytest.approx(found["length_m"])
    assert min(piece["voltage_v"] for piece in found["profile"]) == pytest.approx(found["least_voltage_v"])
    assert ask(client, costmap_id, "feasibility", start=START, goal=GOAL)["profile"] is None


@pytest.mark.parametrize(
    ("battery", "words"),
    [
        ({"temperature_c": -10.0}, "capacity_curve"),
        ({"cutoff_v": 60.0}, "highest voltage"),
        ({"open_circuit_v": [[0.0, 12.0], [1.0, 11.0]]}, "falls to 11 V"),
        ({"health": 0.0}, "health"),
        ({"resistance": 0.1}, "did you mean resistance_ohm"),
        ({"capacity_wh": 0}, "capacity_wh"),
    ],
)
def test_odd_batteries_are_refused(client: TestClient, costmap_id: str, battery: dict, words: str) -> None:
    body = {"start": START, "goal": GOAL, "battery": battery}
    answer = client.post(f"/v1/costmaps/{costmap_id}/feasibility", json=body)
    assert answer.status_code == 422
    assert words in answer.text


def test_the_band_of_the_profile_ends_in_the_quantiles_of_the_route(known: CostMap) -> None:
    plan = RoutePlanner(known.lattice).plan(START, GOAL)
    pieces, whole = profile_pieces([plan.route]), quantiles_of_route(plan.route)
    assert pieces[-1]["cumulative_p05_j"] == pytest.approx(whole["energy_p05_j"])
    assert pieces[-1]["cumulative_p95_j"] == pytest.approx(whole["energy_p95_j"])
    wide = np.array([one["cumulative_p95_j"] - one["cumulative_p05_j"] for one in pieces])
    assert wide[0] < 0.2 * wide[-1]
    assert (np.diff(wide) > -1e-6).all()  # it never grows narrower, also where energy comes back
    both = profile_pieces([plan.route, plan.route])
    assert both[-1]["distance_m"] == pytest.approx(2.0 * plan.route.length_m)
    assert both[-1]["cumulative_p95_j"] == pytest.approx(quantiles_of_route(plan.route, plan.route)["energy_p95_j"])


def test_a_profile_without_odds(client: TestClient, costmap_id: str) -> None:
    path = ask(client, costmap_id, "paths", start=START, goal=GOAL)
    assert {one["cumulative_p95_j"] for one in path["profile"]} == {None}
    tour = ask(client, costmap_id, "tours", stops=[START, GOAL])
    assert tour["profile"][-1]["cumulative_j"] == pytest.approx(tour["energy_j"])
    assert tour["profile"][-1]["distance_m"] == pytest.approx(tour["length_m"])


def test_the_point_of_no_return_is_where_the_way_home_takes_what_is_left(client: TestClient, costmap_id: str) -> None:
    """At the place that is named, the path so far and the way home take what there is; a metre on they take more."""
    path = ask(client, costmap_id, "paths", start=START, goal=GOAL)
    way = [point[:2] for point in path["path"]]
    available = 1.1 * path["energy_j"]
    battery = {"charge": available / 3600.0 / 280.0}
    body = {"position": START, "home": START, "path": way, "battery": battery, "confidence": None}
    found = ask(client, costmap_id, "return", **body)
    assert found["still_home"]
    place = found["point_of_no_return"]
    assert 0.0 < place["distance_m"] < path["length_m"]
    driven = np.interp(
        [place["distance_m"], place["distance_m"] + 2.0],
        [piece["distance_m"] for piece in path["profile"]],
        [piece["cumulative_j"] for piece in path["profile"]],
    )
    ends = [[place["x"], place["y"]], None]
    k = next(k for k, piece in enumerate(path["profile"]) if piece["distance_m"] >= place["distance_m"] + 2.0)
    ends[1] = [path["profile"][k]["x"], path["profile"][k]["y"]]
    homes = [ask(client, costmap_id, "paths", start=end, goal=START)["energy_j"] for end in ends]
    assert driven[0] + homes[0] <= available
    assert 1.03 * (driven[1] + homes[1]) > available  # ways over grid moves take up to some percent more


def test_on_the_way_the_point_of_no_return_stays_where_it_is(client: TestClient, costmap_id: str) -> None:
    path = ask(client, costmap_id, "paths", start=START, goal=GOAL)
    pieces, available = path["profile"], 1.2 * path["energy_j"]
    places = []
    for k in (0, 4, 8):
        rest = [[piece["x"], piece["y"]] for piece in pieces[k:]]
        charge = (available - pieces[k]["cumulative_j"]) / 3600.0 / 280.0
        body = {"position": rest[0], "home": START, "path": rest, "battery": {"charge": charge}, "confidence": None}
        found = ask(client, costmap_id, "return", **body)
        places.append(found["point_of_no_return"]["distance_m"] + pieces[k]["distance_m"])
    assert places == pytest.approx([places[0]] * 3, abs=1.1)


def test_a_charging_place_on_the_path_is_the_best(client: TestClient, costmap_id: str) -> None:
    path = ask(client, costmap_id, "paths", start=START, goal=GOAL)
    middle = path["profile"][len(path["profile"]) // 2]
    way = [point[:2] for point in path["path"]]
    aside = [START[0] + 5.0, START[1] + 6.0]
    body = {"position": START, "home": START, "path": way, "charging": [aside, [middle["x"], middle["y"]]]}
    found = ask(client, costmap_id, "return", **body)
    assert found["best_charging"] == 1
    assert found["charging"][1]["cheapest_j"] < 0.05 * path["energy_j"]
    empty = ask(client, costmap_id, "return", **body, battery={"charge": 0.0, "reserve": 0.2})
    assert (empty["still_home"], empty["verdict"], empty["best_charging"]) == (False, "no", None)
    assert empty["point_of_no_return"] is None


def test_python_and_the_command_line_say_the_same(known: CostMap, tmp_path: Path) -> None:
    folder = known.save(tmp_path / "known.zarr")
    route = known.plan(START, GOAL)
    track = tmp_path / "path.csv"
    track.write_text("x,y\n" + "".join(f"{x},{y}\n" for x, y in route.points[:, :2]))
    charge = 1.3 * route.energy_j / 3600.0 / 280.0
    here = known.homeward(START, START, battery=jm.Battery(280.0, charge=charge), path=route.points[:, :2].tolist())
    home = ",".join(map(str, START))
    command = ["return", str(folder), "--path", str(track), "--home", home, "--charge", str(charge), "--json", "-"]
    said = CliRunner().invoke(app, command)
    assert said.exit_code == 0, said.output
    document = json.loads(said.stdout)
    assert here.home.last is not None
    assert document["point_of_no_return"]["distance_m"] == pytest.approx(here.home.last.distance_m)
    pack = tmp_path / "pack.toml"
    pack.write_text("resistance_ohm = 2.0\ncutoff_v = 27.0\n")
    asked = ["feasibility", str(folder), "--path", str(track), "--battery", str(pack), "--json", "-"]
    judged = CliRunner().invoke(app, asked)
    assert judged.exit_code == 0, judged.output
    strong = known.feasibility(route, battery=jm.Battery(280.0, resistance_ohm=2.0, cutoff_v=27.0)).verdict
    assert json.loads(judged.stdout)["least_voltage_v"] == pytest.approx(strong.least_voltage_v)
    stops = [home, ",".join(map(str, GOAL))]
    tour = CliRunner().invoke(app, ["tour", str(folder), "--stop", *stops, "--battery", str(pack), "--json", "-"])
    assert tour.exit_code == 0, tour.output
    assert 27.0 < json.loads(tour.stdout)["battery"]["least_voltage_v"] < 33.5
    pack.write_text("charge = 0.5\n")
    refused = CliRunner().invoke(app, asked)
    assert refused.exit_code == 3


def test_a_model_that_knows_no_speed_is_refused_over_http(client: TestClient, costmap_id: str) -> None:
    place = f"/v1/costmaps/{costmap_id}/speeds"
    refused = client.post(place, json={"start": START, "goal": GOAL})
    assert refused.status_code == 422
    assert "physics does not know what speed costs" in refused.json()["detail"]
    assert client.post(place, json={"start": START}).status_code == 422


@pytest.fixture(scope="module")
def learned(client: TestClient, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """A cost map of the shipped network, which knows its errors and what speed costs, and its heightmap."""
    ground = tmp_path_factory.mktemp("learned") / "hill.tif"
    write_geotiff(ground, hill())
    sent = client.post("/v1/heightmaps", files={"file": ("hill.tif", ground.read_bytes())})
    body = {"heightmap_id": sent.json()["id"], "model": "default"}
    made = client.post("/v1/costmaps", json=body, headers={"Prefer": "wait=120"})
    assert made.status_code == 201, made.text
    return made.json()["id"], ground


def test_speeds_over_http_and_on_the_command_line(client: TestClient, learned: tuple[str, Path]) -> None:
    costmap_id, ground = learned
    over_http = ask(client, costmap_id, "speeds", start=START, goal=GOAL)
    path = ask(client, costmap_id, "paths", start=START, goal=GOAL)
    assert over_http["declared"]["energy_j"] == pytest.approx(path["energy_j"], rel=0.03)
    folder = jm.costmap(ground).save(ground.with_suffix(".zarr"))
    ends = [f"{x},{y}" for x, y in (START, GOAL)]
    command = ["speeds", str(folder), str(ground), "--start", ends[0], "--goal", ends[1], "--json", "-"]
    said = CliRunner().invoke(app, command)
    assert said.exit_code == 0, said.output
    assert json.loads(said.stdout)["cheapest"] == pytest.approx(over_http["cheapest"], rel=1e-3)
    for more, several in ([], False), (["--by-stretch"], True):
        plan = ground.with_suffix(".plan")
        written = CliRunner().invoke(app, [*command, *more, "--out", str(plan)])
        assert written.exit_code == 0, written.output
        found = json.loads(written.stdout)
        items = json.loads(plan.read_text())["mission"]["items"]
        changes = [item["params"][1] for item in items if item["command"] == 178]
        wanted = found["profile"]["speed_mps"] if several else [found["cheapest"]["speed_mps"]]
        assert changes == pytest.approx(wanted, abs=1e-3)
        assert items[0]["command"] == 178  # how fast to the first place, and so on
        assert [item["doJumpId"] for item in items] == list(range(1, len(items) + 1))
    sent = client.post(
        f"/v1/costmaps/{costmap_id}/speeds?format=waypoints", json={"start": START, "goal": GOAL, "by_stretch": True}
    )
    assert sent.status_code == 200, sent.text
    assert sent.text.count("\t178\t") == len(changes)
    missing = CliRunner().invoke(app, ["speeds", str(folder), "--start", ends[0], "--goal", ends[1]])
    assert missing.exit_code == 2
    assert "name the heightmap" in missing.output


def test_routes_are_chosen_by_more_than_their_mean(
    known: CostMap, client: TestClient, learned: tuple[str, Path]
) -> None:
    costmap_id = learned[0]
    careful = known.plan(START, GOAL, objective="quantile", quantile=0.9)
    assert careful.objective is not None
    assert careful.objective.quantile_j <= careful.objective.mean_quantile_j
    assert known.plan(START, GOAL).objective is None
    place = f"/v1/costmaps/{costmap_id}"
    ends = {"start": START, "goal": GOAL}
    usual = ask(client, costmap_id, "paths", **ends)
    assert usual["objective"] is None
    found = ask(client, costmap_id, "paths", **ends, objective="quantile")
    assert found["objective"]["quantile_j"] == pytest.approx(found["energy_p95_j"])
    assert "objective" not in found["details"]
    battery = {"charge": 1.3 * 2.0 * usual["energy_j"] / 3600.0 / 280.0}
    both = ask(client, costmap_id, "feasibility", **ends, round_trip=True, battery=battery, objective="arrival")
    assert both["objective"]["probability"] == pytest.approx(both["probability"])
    power = max(piece["energy_j"] / step for piece, step in zip(usual["profile"], steps(usual), strict=True)) * 0.5
    limited = ask(client, costmap_id, "paths", **ends, max_power_w=0.97 * power)
    most = max(piece["energy_j"] / step for piece, step in zip(limited["profile"], steps(limited), strict=True)) * 0.5
    assert most <= 0.97 * power + 1e-6
    for wrong, words in (
        ({"objective": "arrival"}, "needs a battery"),
        ({"objective": "fast"}, "mean"),
        ({"quantile": 0.999}, "quantile"),
        ({"max_power_w": 5.0}, "without moving"),
    ):
        refused = client.post(f"{place}/paths", json=ends | wrong)
        assert refused.status_code == 422
        assert words in refused.text


def test_a_question_of_no_length_takes_no_energy(known: CostMap, client: TestClient, learned: tuple[str, Path]) -> None:
    costmap_id, nowhere = learned[0], {"start": START, "goal": START}
    path = ask(client, costmap_id, "paths", **nowhere)
    assert [path[key] for key in ("energy_j", "length_m", "energy_std_j", "energy_p95_j")] == [0.0] * 4
    for task in (nowhere | {"round_trip": True}, {"path": [START, START]}):
        verdict = ask(client, costmap_id, "feasibility", **task, battery={"charge": 0.5})
        assert (verdict["energy_j"], verdict["energy_p95_j"], verdict["feasible"]) == (0.0, 0.0, True)
    assert ask(client, costmap_id, "tours", stops=[START, GOAL, GOAL])["energy_j"] > 0.0
    refused = client.post(f"/v1/costmaps/{costmap_id}/speeds", json=nowhere)
    assert refused.status_code == 422
    assert "the route has no length" in refused.text
    again = known.plan(START, START)
    assert quantiles_of_route(again.route)["energy_p50_j"] == 0.0


def test_speeds_are_those_of_the_model_of_the_cost_map() -> None:
    ground = hill()
    costs = CostMap(build_lattice(ground, jm.Robot(), PhysicsPredictor()))
    with pytest.raises(InputError, match=r"made with the model physics \(version 1\), this is default"):
        costs.speeds([START, GOAL], ground)


def test_return_and_feasibility_say_the_same_odds(learned: tuple[str, Path], tmp_path: Path) -> None:
    """A way home is judged as a given path: the same energy, spread and probability from both commands."""
    folder, path = jm.costmap(learned[1]).save(tmp_path / "learned.zarr"), tmp_path / "way.csv"
    ends = {name: ",".join(map(str, place)) for name, place in (("position", GOAL), ("home", START))}

    charge = "1"

    def _asked(command: str, **options: str) -> dict[str, Any]:
        given = [part for name, value in options.items() for part in (f"--{name}", value)]
        said = CliRunner().invoke(app, [command, str(folder), *given, "--charge", charge, "--json", "-"])
        assert said.exit_code == 0, said.output
        return json.loads(said.stdout)

    charge = str(1.05 * _asked("return", **ends)["home"]["energy_j"] / 3600.0 / jm.Robot().battery_wh)
    home = _asked("return", **ends)["home"]
    path.write_text("x,y\n" + "".join(f"{x!r},{y!r}\n" for x, y in home["way"]))
    judged = _asked("feasibility", path=str(path))
    assert 0.02 < home["probability"] < 0.98
    assert home["probability"] == pytest.approx(judged["probability"], abs=1e-9)
    assert (home["energy_j"], home["needed_j"]) == pytest.approx((judged["energy_j"], judged["energy_p95_j"]))
    assert home["verdict"] == judged["verdict"]
    planned = _asked("feasibility", start=ends["position"], goal=ends["home"])
    assert planned["energy_j"] <= home["energy_j"]
    assert planned["probability"] == pytest.approx(home["probability"], abs=0.03)  # a refined route takes less


def test_the_way_home_without_a_path_is_told(tmp_path: Path) -> None:
    CostMap(build_lattice(hill(), jm.Robot(), PhysicsPredictor())).save(tmp_path / "hill.zarr")
    ends = ["--position", "{},{}".format(*START), "--home", "{},{}".format(*GOAL)]
    told = CliRunner().invoke(app, ["return", str(tmp_path / "hill.zarr"), *ends, "--charge", "0.5"])
    assert told.exit_code == 0, told.output
    assert "It still comes home from here" in told.output


def steps(path: dict[str, Any]) -> list[float]:
    """Length of each piece [m]."""
    return np.diff([piece["distance_m"] for piece in path["profile"]], prepend=0.0).tolist()
