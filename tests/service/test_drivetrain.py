"""What the losses of gears and motors do to climbs: in both models, on the command line, in Python and over HTTP."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

import joulemap as jm
from joulemap.model.errors import RobotError
from joulemap.model.terrain.writers import write_geotiff
from tests.service.test_cli import joulemap

SLOPE = 0.15
UP, DOWN = ([20.0, 10.0], [20.0, 30.0]), ([20.0, 30.0], [20.0, 10.0])
WEIGHT_N, ROLLING = jm.Robot().weight_n, jm.Robot().rolling_resistance
METRES, IDLE_J = 20.0, 20.0 / 0.5 * 12.0


def plane():
    return jm.heightmap(np.tile(SLOPE * np.arange(40.0)[::-1, None], (1, 40)), resolution_m=1.0)


def ways_j(model, **robot):
    costmap = jm.costmap(plane(), robot=jm.Robot(regeneration=0.5, **robot), model=model)
    return [costmap.plan(*ends).route.energy_j for ends in (UP, DOWN)]


@pytest.mark.parametrize("efficiency", [0.5, 0.8, 1.0])
def test_equation_5_lifts_with_the_losses_of_the_drivetrain(efficiency):
    up, down = ways_j("physics", drivetrain_efficiency=efficiency)
    assert up == pytest.approx(IDLE_J + METRES * WEIGHT_N * (ROLLING + SLOPE / efficiency), rel=1e-4)
    pulled = METRES * WEIGHT_N * (ROLLING - SLOPE / efficiency)  # the ground spares what it would take to lift
    released = METRES * WEIGHT_N * (ROLLING * efficiency - SLOPE)  # at the wheels, of which half comes back
    assert down == pytest.approx(IDLE_J + (pulled if pulled > 0.0 else 0.5 * released), rel=1e-3)


def test_along_a_contour_between_two_headings_of_the_lattice_a_lossy_drivetrain_costs_nothing():
    y, x = np.mgrid[60.0:0.0:-1.0, 0.0:60.0]
    hill = jm.heightmap(0.25 * (0.5 * x + math.sqrt(0.75) * y), resolution_m=1.0)
    ends = [(30.0 + side * math.sqrt(0.75), 30.0 - 0.5 * side) for side in (-9.0, 9.0)]  # 120 degrees
    prices = [
        jm.costmap(hill, robot={"drivetrain_efficiency": e}, model="physics").feasibility(ends).energy_j
        for e in (0.6, 0)
    ]
    assert prices[0] == pytest.approx(prices[1], rel=1e-4)


def test_a_formula_of_the_user_says_what_moving_takes_whatever_the_drivetrain():
    of_own = [
        jm.costmap(plane(), robot={"drivetrain_efficiency": e}, model=lambda along, *_: 300.0 + 200.0 * along).lattice
        for e in (0.5, 0.0)
    ]
    np.testing.assert_array_equal(*(lattice.traction_per_m for lattice in of_own))


def test_the_shipped_network_knows_gears_of_80_per_cent():
    undeclared, same, half = (
        ways_j("default", **more) for more in ({}, {"drivetrain_efficiency": 0.8}, {"drivetrain_efficiency": 0.4})
    )
    assert same == undeclared
    rolling_j = IDLE_J + METRES * WEIGHT_N * ROLLING
    assert half[0] - rolling_j == pytest.approx(2.0 * (same[0] - rolling_j), rel=0.01)


def test_the_standard_deviation_goes_with_what_a_climb_asks_of_the_battery():
    same, half = (jm.costmap(plane(), robot={"drivetrain_efficiency": e}).lattice for e in (0.8, 0.4))
    north = np.s_[15:25, 15:25, 0]
    assert (half.energy_per_m[north] > 1.3 * same.energy_per_m[north]).all()
    np.testing.assert_allclose(
        half.std_j[north] / same.std_j[north], half.energy_per_m[north] / same.energy_per_m[north], rtol=1e-4
    )


def test_a_robot_file_and_a_request_say_it(client: TestClient, tmp_path: Path):
    write_geotiff(tmp_path / "plane.tif", plane())
    (tmp_path / "robot.toml").write_text('name = "r"\ndrivetrain_efficiency = 0.5\n')
    made = ("costmap", tmp_path / "plane.tif", "--robot", tmp_path / "robot.toml", "--model", "physics")
    assert joulemap(*made, "--out", tmp_path / "map.zarr")[0] == 0
    asked = ("path", tmp_path / "map.zarr", "--start", "20,10", "--goal", "20,30", "--json", tmp_path / "route.json")
    assert joulemap(*asked)[0] == 0
    sent = client.post("/v1/heightmaps", files={"file": ("g.tif", (tmp_path / "plane.tif").read_bytes())}).json()
    body = {"heightmap_id": sent["id"], "model": "physics", "robot": {"drivetrain_efficiency": 0.5}}
    costmap = client.post("/v1/costmaps", json=body, headers={"Prefer": "wait=60"}).json()
    found = client.post(f"/v1/costmaps/{costmap['id']}/paths", json={"start": UP[0], "goal": UP[1]}).json()
    expected = pytest.approx(IDLE_J + METRES * WEIGHT_N * (ROLLING + 2.0 * SLOPE), rel=1e-4)
    assert json.loads((tmp_path / "route.json").read_text())["energy_j"] == expected
    assert found["energy_j"] == expected


@pytest.mark.parametrize("value", [-0.1, 0.05, 1.01, float("nan")])
def test_no_drivetrain_gives_more_than_it_gets_or_next_to_nothing(value: float):
    with pytest.raises(RobotError, match=r"robot\.drivetrain_efficiency is .*; it must be .* 1"):
        jm.Robot(drivetrain_efficiency=value)
