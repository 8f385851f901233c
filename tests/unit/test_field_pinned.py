"""The field without effects is what the shipped network was made from: its numbers are pinned (ourselves, regression).

Ten digits are hashed and not the bits, because processors differ in the last one.
"""

import hashlib

import numpy as np
import pytest

from joulemap.model.field.drives import drive_along, random_waypoints
from joulemap.model.field.logger import simulate_run
from joulemap.model.field.robots import FieldRobot
from joulemap.model.field.simulation import simulate_segments, simulate_trace
from joulemap.model.field.sites import named_site
from joulemap.model.robot import Robot
from joulemap.model.training.simulated_set import make_pretraining_set


def digest(*arrays) -> str:
    text = ";".join(",".join(f"{value:.9e}" for value in array) for array in arrays)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


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
    columns = (cut.x, cut.y, cut.heading_rad, cut.energy_j, cut.explained_j, cut.duration_s)
    assert digest(*columns) == "90a416611c4385ce"
    trace = simulate_trace(site, robot, drive, rng=rng)
    assert digest(trace.t, trace.power_w, trace.explained_w, trace.wheels_w) == "6cb1fdfba427697e"
    log = simulate_run(site, robot, drive, rng=rng, start_s=10.0)
    assert digest(*log.columns.values()) == "b7721cf7527c5d35"
    assert rng.bit_generator.random_raw() == 13392144860719348900


def test_the_pretraining_set_is_pinned():
    examples = make_pretraining_set(sites=2, seed=5)
    assert digest(examples.energy_j.astype(np.float64)) == "cc55da95d4c248f7"
