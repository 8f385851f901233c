"""The generators: energies from closed forms, variation as asked for, and answers that are judged as declared."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from joulemap.model.robot import Robot
from joulemap.service.library.heightmaps import read_heightmap
from tests.loop import generators
from tests.loop.generators.case import make_case
from tests.loop.generators.config import FLAT, CaseConfig, DriveConfig, LogConfig, NoiseConfig, RobotConfig, SiteConfig
from tests.loop.generators.hidden import KINDS, drawn_effects
from tests.loop.generators.noise import factor_along
from tests.loop.generators.robots import G_MPS2
from tests.loop.generators.site import Site

QUIET = NoiseConfig(run_sd=0.0, white_sd=0.0)
EXACT = LogConfig(gps_sd_m=(0.0, 0.0), current_sd=0.0, innocent=False)
STEADY = DriveConfig(length_m=120.0, stops_per_100m=0.0, speed_factor=(1.0, 1.0))
LEVEL = CaseConfig(
    site=replace(FLAT, grade_rms=1e-9), drive=STEADY, log=EXACT, noise=QUIET, new_runs=1, base_runs=1, other_runs=1
)


def test_the_generators_know_neither_the_calibration_nor_the_models_nor_the_simulated_field():
    folder = Path(generators.__file__).parent
    trees = [ast.parse(file.read_text(encoding="utf-8")) for file in folder.glob("*.py")]
    every = [node.module or "" for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    named = {module for module in every if module.startswith("joulemap")}
    allowed = {"frames", "robot", "terrain.heightmap", "terrain.writers"}
    assert named == {f"joulemap.model.{name}" for name in allowed}


def energy_j(log):
    power = log.numbers["voltage"] * log.numbers["current"]
    return float(np.sum(power) * (log.numbers["t"][1] - log.numbers["t"][0]))


def test_level_driving_takes_rolling_resistance_and_idle_power():
    case = make_case(LEVEL, 3)
    log, robot = case.new.logs[0], case.robot
    seconds = log.numbers["t"].size / 10.0
    rolling = robot.rolling_resistance * robot.mass_kg * G_MPS2 * 120.0 / robot.efficiency  # closed form
    assert energy_j(log) == pytest.approx(robot.idle_power_w * seconds + rolling, rel=2e-3)


def test_a_climb_takes_the_potential_energy_and_kinetic_energy_comes_back_where_nothing_brakes():
    config = replace(
        LEVEL,
        site=SiteConfig(grade_rms=0.01),
        drive=replace(STEADY, speed_factor=(0.6, 1.2), acceleration_mps2=0.05),
        robot=replace(RobotConfig(), rolling_resistance=(0.09, 0.10), wheelbase_m=(0.4, 0.41)),
    )
    case = make_case(config, 5)
    log, robot = case.new.logs[0], case.robot
    height = case.new.site.height_m(log.numbers["x"][[0, -1]], log.numbers["y"][[0, -1]])
    speed = np.abs(np.interp([0, 1e9], log.numbers["t"] - log.numbers["t"][0], log.numbers["speed"]))
    weight = robot.mass_kg * G_MPS2
    work = weight * robot.rolling_resistance * 120.0 + weight * np.diff(height)[0]
    work += 0.5 * robot.mass_kg * (speed[1] ** 2 - speed[0] ** 2)
    idle = robot.idle_power_w * log.numbers["t"].size / 10.0
    assert energy_j(log) == pytest.approx(idle + work / robot.efficiency, rel=4e-3)


def test_the_survey_is_the_surface_and_the_slope_is_as_asked(tmp_path):
    site = Site.drawn(SiteConfig(), np.random.default_rng(0))
    x, y = np.array([501_010.1, 501_030.3]), np.array([4_981_510.1, 4_981_520.5])  # centres of cells
    np.testing.assert_allclose(site.heightmap.sample(x, y), site.height_m(x, y), atol=1e-4)
    dy, dx = np.gradient(site.heightmap.heights.astype(float), 0.2)
    assert np.sqrt(np.mean(dx**2 + dy**2)) == pytest.approx(0.07, rel=0.35)  # the waves are few and long
    site.write(tmp_path / "dem.tif")
    assert read_heightmap(tmp_path / "dem.tif").frame == site.heightmap.frame


@pytest.mark.parametrize(
    ("config", "sd", "correlation"),
    [
        (NoiseConfig(run_sd=0.0), 0.05, 0.0),
        (NoiseConfig(run_sd=0.0, freedom=3.0), 0.05, 0.0),
        (NoiseConfig(run_sd=0.0, white_sd=0.0, serial_sd=0.05), 0.05, 0.95),
    ],
)
def test_variation_has_the_spread_and_the_correlation_that_are_asked_for(config, sd, correlation):
    driven = np.arange(0.0, 40_000.0, 0.5)
    nowhere = np.zeros_like(driven)
    factor = factor_along(driven, nowhere, nowhere, config, np.array([0.0, 1.0, 1.0]), np.random.default_rng(1))
    metres = factor[::2]
    assert np.all(factor[::2] == factor[1::2])  # constant over a metre
    assert metres.std() == pytest.approx(sd, rel=0.15)
    assert np.corrcoef(metres[:-1], metres[1:])[0, 1] == pytest.approx(correlation, abs=0.03)


def test_runs_differ_by_their_level():
    config = replace(LEVEL, noise=replace(QUIET, run_sd=0.10), new_runs=40, drive=replace(STEADY, length_m=20.0))
    case = make_case(config, 1)
    power = [np.mean(log.numbers["voltage"] * log.numbers["current"]) for log in case.new.logs]
    assert np.std(power) / np.mean(power) == pytest.approx(0.10, rel=0.35)


@pytest.mark.parametrize("kind", [k for k in KINDS if k not in ("late_meter", "wrong_datum")])
def test_every_effect_changes_the_energy_of_its_runs_and_of_no_others(kind):
    config = CaseConfig(
        log=EXACT, noise=QUIET, new_runs=2, base_runs=1, other_runs=1, drive=replace(DriveConfig(), length_m=150.0)
    )
    effects = drawn_effects(kind, 4)
    plain, case = make_case(replace(config, new_runs=2), 4), make_case(config, 4, effects)
    with_it, without = (sum(energy_j(log) for log in logs) for logs in (case.new.logs, case.new.twins))
    change = with_it / without - 1.0
    assert 0.005 < abs(change) < 0.6, change
    none = make_case(config, 4, drawn_effects(kind, 4, size=1e-9))
    if kind != "power_ceiling":  # a ceiling of no size is infinitely high, but not for a size of 1e-9 in 1 / size
        assert sum(map(energy_j, none.new.logs)) == pytest.approx(without, rel=1e-6)
    if effects[0].arranged(config) == config:
        assert energy_j(case.base[0]) == energy_j(plain.base[0])
    other = abs(energy_j(case.other.logs[0]) / energy_j(case.other.twins[0]) - 1.0)
    assert (other > 1e-4) or not effects[0].transfers or effects[0].between


def test_faults_of_the_log_move_the_readings_and_not_the_energy():
    config = CaseConfig(log=EXACT, noise=QUIET, new_runs=1, base_runs=0)
    (late,) = drawn_effects("late_meter", 2)
    case = make_case(config, 2, [late])
    (lag,) = late.coefficients(case.robot)
    power, true = (p.numbers["voltage"] * p.numbers["current"] for p in (case.new.logs[0], case.new.twins[0]))
    t = case.new.logs[0].numbers["t"]
    assert 0.5 <= lag <= 1.5
    np.testing.assert_allclose(power[30:], np.interp(t[30:] - lag, t, true), rtol=1e-6)
    (wrong,) = drawn_effects("wrong_datum", 2)
    case = make_case(config, 2, [wrong])
    shift = [case.new.logs[0].numbers[k] - case.new.twins[0].numbers[k] for k in "xy"]
    np.testing.assert_allclose(np.mean(shift, axis=1), wrong.coefficients(case.robot), atol=1e-6)
    assert 1.0 <= np.hypot(*wrong.coefficients(case.robot)) <= 2.0


def test_a_case_is_made_again_from_its_seed_and_written_as_files(tmp_path):
    config = CaseConfig(new_runs=2, base_runs=1, other_runs=1, drive=replace(DriveConfig(), length_m=30.0))
    one, two = make_case(config, 9, drawn_effects("heater", 9)), make_case(config, 9, drawn_effects("heater", 9))
    for a, b in zip(one.new.logs, two.new.logs, strict=True):
        assert all(np.array_equal(a.numbers[key], b.numbers[key]) for key in a.numbers)
    one.write(tmp_path)
    assert Robot.from_toml(tmp_path / "robot.toml") == replace(one.declared)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["base", "dem.tif", "new", "other_site", "robot.toml", "twins"]


@pytest.mark.parametrize(
    ("kind", "right", "wrong"),
    [
        ("sliding_scrub", "turning | turning", "learned:heading | heading (fitted curve)"),
        ("furrows", "structure:heading | structure in heading", "turning | heading change per segment"),
        ("stiff_grease", "temperature | temperature", "learned:motor_temperature | motor_temperature"),
        ("late_meter", "meter_lag | the meter is late", "cross_slope | lateral slope"),
        ("wet_patch", "learned:place | position on the map", "learned:hollow | topographic position index"),
        ("fast_drag", "learned:speed | speed", "wind_speed | wind_speed"),
        ("crabbing", "learned:roll | roll", "rolling_resistance | rolling resistance"),
    ],
)
def test_answers_are_judged_by_the_quantity(kind, right, wrong):
    (effect,) = drawn_effects(kind, 0)
    assert effect.is_named_by(right)
    assert not effect.is_named_by(wrong)
