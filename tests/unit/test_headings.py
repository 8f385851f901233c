"""Turned angles of simulated drives, of which the truth is known."""

from collections.abc import Callable

import numpy as np
import pytest

from joulemap.model.runs.cutting import cut_segments
from joulemap.model.runs.reader import Run
from joulemap.model.runs.segments import Segments

TURN_RAD = 1.5
"""To the right in 4 s while driving, and back in 1 s on the spot."""
Column = Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]


def drive(columns: dict[str, Column], *, rate_hz: float = 10.0, noise_m: float = 0.01, seed: int = 0) -> Segments:
    """A minute at 1 m/s with noisy positions and these columns of the time, the heading and a generator."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 60.0, 1.0 / rate_hz)
    heading = np.interp(t, [20.0, 24.0, 40.0, 41.0], [0.0, TURN_RAD, TURN_RAD, 0.0])
    speed = np.where((t > 40.0) & (t < 41.0), 0.0, 1.0)
    x, y = (
        np.cumsum(speed * way) / rate_hz + noise_m * rng.standard_normal(t.size)
        for way in (np.sin(heading), np.cos(heading))
    )
    extras = {name: of(t, heading, rng) for name, of in columns.items()}
    return cut_segments(Run("drive", t, x, y, np.ones(t.size), np.full(t.size, 24.0), extras))


def _rate(t: np.ndarray, heading: np.ndarray) -> np.ndarray:
    return np.gradient(heading, t)


SENSORS: dict[str, dict[str, Column]] = {
    "positions": {},
    "a yaw to the other side, from another zero, that drifts": {
        "yaw": lambda t, h, rng: (77.0 - np.degrees(h + 0.001 * t)) % 360.0
    },
    "a gyro to the other side with a bias": {
        "gyro_z": lambda t, h, rng: 0.03 - _rate(t, h) + 0.02 * rng.standard_normal(t.size)
    },
    "a gyro in degrees": {"yaw_rate": lambda t, h, rng: np.degrees(_rate(t, h) + 0.02 * rng.standard_normal(t.size))},
    "wheels": {
        "speed_left": lambda t, h, rng: 1.0 + 0.3 * _rate(t, h),
        "speed_right": lambda t, h, rng: 1.0 - 0.3 * _rate(t, h),
    },
    "a compass with spikes": {
        "heading": lambda t, h, rng: np.degrees(
            h + 0.002 * rng.standard_normal(t.size) + 3.0 * (rng.random(t.size) < 0.01)
        )
    },
    "a compass whose first guess is replaced": {
        "heading": lambda t, h, rng: np.degrees(h + np.where(t < 5.0, 2.06, 0.0) + 0.002 * rng.standard_normal(t.size))
    },
    "a compass that says nothing": {"heading": lambda t, h, rng: rng.uniform(0.0, 360.0, t.size)},
}


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 20.0])
@pytest.mark.parametrize("sensor", SENSORS)
def test_turns_are_those_that_happened(sensor, rate_hz):
    segments = drive(SENSORS[sensor], rate_hz=rate_hz)
    assert segments.turned_abs_rad.sum() == pytest.approx(2.0 * TURN_RAD, rel=0.2)
    assert segments.turned_abs_rad[segments.t0 < 17.0].sum() < 0.25
    assert segments.heading_change_rad.sum() == pytest.approx(0.0, abs=0.2)


def test_positions_that_scatter_make_turns_and_a_yaw_takes_them_out():
    """As of a receiver of satellites: 10 cm, ten times a second."""
    yaw = SENSORS["a yaw to the other side, from another zero, that drifts"]
    scattered, told = drive({}, noise_m=0.1), drive(yaw, noise_m=0.1)
    assert told.turned_abs_rad[told.t0 < 17.0].sum() < 0.1 < scattered.turned_abs_rad[scattered.t0 < 17.0].sum()
    assert told.turned_abs_rad.sum() == pytest.approx(2.0 * TURN_RAD, rel=0.1)


def test_the_standard_deviation_of_a_turned_angle_is_no_smaller_than_its_error():
    """Of a straight drive, where every turned angle is an error."""
    off = []
    for seed in range(5):
        segments = drive({}, noise_m=0.03, seed=seed)
        straight = segments.t0 < 17.0
        off.append((segments.heading_change_rad / segments.turn_sd_rad)[straight])
    assert 0.05 < np.sqrt(np.mean(np.concatenate(off) ** 2)) < 1.0
    sure = drive(SENSORS["wheels"], noise_m=0.03)
    assert np.median(sure.turn_sd_rad) < np.median(segments.turn_sd_rad)


def test_a_standing_robot_does_not_turn():
    rng = np.random.default_rng(1)
    t = 0.1 * np.arange(600)
    y = np.interp(t, [0.0, 20.0, 40.0, 60.0], [0.0, 20.0, 20.0, 40.0])
    x, y = (values + 0.02 * rng.standard_normal(t.size) for values in (0.0 * y, y))
    segments = cut_segments(Run("stands", t, x, y, np.ones(t.size), np.full(t.size, 24.0)))
    assert segments.turned_abs_rad.max() < 0.3
