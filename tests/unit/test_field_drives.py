"""Drives and the logger: what is written is what was driven, and its faults are the stated ones."""

import math

import numpy as np
import pytest

from joulemap.model.errors import PointError
from joulemap.model.field.drives import STEP_M, drive_along, lawnmower, random_waypoints
from joulemap.model.field.logger import COLUMNS, Logger, log_trace, simulate_run
from joulemap.model.field.robots import FieldRobot
from joulemap.model.field.simulation import simulate_trace
from joulemap.model.field.sites import named_site
from joulemap.model.robot import Robot

BOUNDS = (0.0, 0.0, 20.0, 10.0)


def test_a_perfect_driver_keeps_to_the_line():
    drive = drive_along([(1, 1), (4, 5)], speed_mps=0.5)
    assert drive.length_m == pytest.approx(5.0)
    np.testing.assert_allclose(drive.heading_rad, math.atan2(3, 4), atol=1e-9)
    np.testing.assert_allclose(np.hypot(np.diff(drive.x), np.diff(drive.y)), STEP_M, rtol=0.02)
    np.testing.assert_allclose(drive.speed_mps, 0.5, rtol=1e-9)


def test_a_single_point_is_no_drive():
    with pytest.raises(PointError, match="two distinct"):
        drive_along([(1, 1), (1, 1)], speed_mps=0.5)


def test_a_lawnmower_covers_the_bounds():
    points = np.array(lawnmower(BOUNDS, spacing_m=2.0))
    legs = points.reshape(-1, 2, 2)
    assert len(legs) == 10  # 20 m wide, a line every 2 m
    np.testing.assert_allclose(np.abs(legs[:, 1, 1] - legs[:, 0, 1]), 10.0)  # each runs north-south over all 10 m
    np.testing.assert_allclose(np.diff(np.sort(legs[:, 0, 0])), 2.0)
    slanted = np.array(lawnmower(BOUNDS, spacing_m=2.0, heading_rad=0.7))
    assert (slanted >= -1e-9).all()
    assert (slanted <= np.array([20, 10]) + 1e-9).all()


@pytest.fixture(scope="module")
def driven():
    site = named_site("grass_a", width_m=25.0, height_m=20.0)
    rng = np.random.default_rng(2)
    points = random_waypoints(site.drivable, 40, rng)
    drive = drive_along(points, speed_mps=0.5, rng=rng)
    robot = FieldRobot.nominal(Robot())
    return site, robot, drive, simulate_trace(site, robot, drive, rng=rng)


def test_a_perfect_log_carries_the_energy(driven):
    _, robot, _, trace = driven
    log = log_trace(trace, robot, rng=np.random.default_rng(0), logger=Logger.perfect())
    c = log.columns
    assert set(c) | {"terrain"} == set(COLUMNS)
    measured = np.trapezoid(c["voltage"] * c["current"], c["t"])
    assert measured == pytest.approx(np.interp(c["t"][-1], trace.t, trace.energy_j()), rel=2e-3)
    np.testing.assert_allclose(c["x"], np.interp(c["t"], trace.t, trace.x))
    np.testing.assert_allclose(np.diff(c["t"]), 0.1, atol=1e-9)


def test_a_real_log_has_the_stated_faults(driven):
    _, robot, _, trace = driven
    log = log_trace(trace, robot, rng=np.random.default_rng(0), logger=Logger(jumps=0.0, floats=0.0))
    t, x = log.columns["t"] - 3.0, log.columns["x"]
    assert (np.diff(t) == 0).any()
    assert (np.diff(t) > 0.25).any()
    assert (np.diff(t) >= 0).all()
    error = x - np.interp(t, trace.t, trace.x)
    assert 0.008 < error.std() < 0.012


def test_a_log_is_written_in_the_run_format(driven, tmp_path):
    site, robot, drive, _ = driven
    log = simulate_run(site, robot, drive, rng=np.random.default_rng(0))
    again = simulate_run(site, robot, drive, rng=np.random.default_rng(0))
    first, second = log.write_csv(tmp_path / "a.csv").read_text(), again.write_csv(tmp_path / "b.csv").read_text()
    assert first == second
    lines = first.splitlines()
    assert lines[0] == ",".join(COLUMNS)
    cells = dict(zip(COLUMNS, lines[50].split(","), strict=True))
    assert cells["terrain"] == "grass"
    assert cells["wind_speed"] == ""
    assert float(cells["voltage"]) == pytest.approx(31.5, abs=2.5)
