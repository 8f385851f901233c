"""What networks know of a robot and of the survey: nine numbers."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from joulemap.model.robot import Robot
from joulemap.model.terrain.denoising import LEAST_NOISE_M

FEATURES = (
    "log_mass_kg",
    "width_m",
    "length_m",
    "wheel_radius_m",
    "log_speed_mps",
    "rolling_resistance",
    "hotel_over_weight",
    "log2_resolution_m",
    "log2_noise_m",
)
"""hotel_over_weight is the idle energy per metre over m g; log2_resolution_m is of metres per pixel; log2_noise_m is of
the standard deviation of the noise that was taken out of the map, at least `LEAST_NOISE_M`."""


def robot_features(robot: Robot, resolution_m: float, noise_m: float = 0.0) -> NDArray[np.float32]:
    """Return the features of a robot on a map, in the order of `FEATURES`. The result is (9,)."""
    return np.array(
        [
            math.log(robot.mass_kg),
            robot.width_m,
            robot.length_m,
            robot.wheel_radius_m,
            math.log(robot.speed_mps),
            robot.rolling_resistance,
            robot.hotel_per_m / robot.weight_n,
            math.log2(resolution_m),
            math.log2(max(noise_m, LEAST_NOISE_M)),
        ],
        dtype=np.float32,
    )
