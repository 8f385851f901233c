"""The field without effects is what the shipped network was made from: its numbers are pinned (ourselves, regression).

Figures are compared to a millionth of the mean, because processors differ in the last digits.
"""

import numpy as np
import pytest

from joulemap.model.field.drives import drive_along, random_waypoints
from joulemap.model.field.logger import simulate_run
from joulemap.model.field.robots import FieldRobot
from joulemap.model.field.simulation import simulate_segments, simulate_trace
from joulemap.model.field.sites import named_site
from joulemap.model.robot import Robot
from joulemap.model.training.simulated_set import make_pretraining_set

SEGMENTS = {
    "x": [19, 500007.747, -1700.20688],
    "y": [19, 4979994.28, -16932.1508],
    "heading_rad": [19, 2.59777924, 0.198353695],
    "energy_j": [19, 70.3578547, -9.33212373],
    "explained_j": [19, 72.6708163, -9.13969389],
    "duration_s": [19, 1.96881783, 0.000576767553],
}
TRACE = {
    "t": [904, 23.35364, -0.0156904827],
    "power_w": [904, 37.1575104, 0.132038258],
    "explained_w": [904, 38.1009044, 0.148700425],
    "wheels_w": [904, 24.3815079, 0.123347892],
}
LOG = {
    "t": [500, 34.8813911, 0.142936354],
    "x": [500, 500007.64, 1958.09581],
    "z": [500, -0.090149236, -0.000374553794],
    "voltage": [500, 32.0843648, 0.126213136],
    "current": [500, 1.20009375, -0.000815266059],
    "heading": [500, 151.480975, 0.0681515364],
    "roll": [500, 0.265234578, 0.0603829964],
    "wind_speed": [0, 0.0, 0.0],
    "motor_temperature": [500, 23.2527054, 0.0909114616],
    "gps_error": [500, 0.0121273018, -3.475202e-05],
}


def figures(array) -> list[float]:
    """Number, mean and a weighted mean of the values that are there, which any of them changes."""
    values = np.asarray(array, dtype=np.float64)
    values = values[~np.isnan(values)]
    if not values.size:
        return [0, 0.0, 0.0]
    return [values.size, float(values.mean()), float((values * np.sin(np.arange(values.size))).mean())]


def pinned_at(known):
    """To a millionth; of the weighted mean, in which values cancel, to a millionth of the mean."""
    return pytest.approx(known, rel=1e-6, abs=max(1e-8, 1e-6 * abs(known[1])))


def same(known, found) -> None:
    for name, of in known.items():
        assert figures(found[name]) == pinned_at(of), name


@pytest.fixture(scope="module")
def pinned():
    site = named_site("dirt", seed=3, width_m=16.0, height_m=12.0)
    rng = np.random.default_rng(11)
    robot = FieldRobot.drawn(Robot(), rng)
    drive = drive_along(random_waypoints(site.drivable, 5, rng), speed_mps=0.5, rng=rng)
    return site, robot, drive, rng


def test_segments_trace_log_and_the_state_of_the_generator_are_pinned(pinned):
    site, robot, drive, rng = pinned
    cut = simulate_segments(site, robot, drive, rng=rng)
    same(SEGMENTS, vars(cut))
    trace = simulate_trace(site, robot, drive, rng=rng)
    same(TRACE, vars(trace))
    log = simulate_run(site, robot, drive, rng=rng, start_s=10.0)
    same(LOG, log.columns)
    assert rng.bit_generator.random_raw() == 13392144860719348900


def test_the_pretraining_set_is_pinned():
    examples = make_pretraining_set(sites=2, seed=5)
    assert figures(examples.energy_j) == pinned_at([812, 137.734738, 1.46708047])
