"""What a model says of measured segments: from ground, path, payload and turns, which a planner knows beforehand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.energy.domain import Learned
from model.energy.predictor import Predictor
from model.loop.calibrated import CalibratedPredictor
from model.loop.payload import payload_factor
from model.loop.segments import Segments
from model.robot import Robot
from model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """Per segment, (n,) each; NaN on unknown ground. energy_j [J] : drawn from the battery. std_j : its standard
    deviation, None from a model that does not know it. traction_per_m [J/m] : with the payload's weight, before any
    calibration. turning_j : the part of the energy that goes into turning, apart from a calibration's effects."""

    energy_j: FloatArray
    std_j: FloatArray | None
    traction_per_m: FloatArray
    turning_j: FloatArray


def predict_segments(predictor: Predictor, heightmap: Heightmap, robot: Robot, segments: Segments) -> Prediction:
    """What the model says of every segment, driven at the robot's declared speed along the track's length."""
    base = predictor.base if isinstance(predictor, CalibratedPredictor) else predictor
    traction, std = base.segment_traction_and_std(heightmap, robot, segments.x, segments.y, segments.heading_rad)
    factor = payload_factor(base, robot, segments)
    std = predictor.std_of(std, traction, robot) if isinstance(predictor, CalibratedPredictor) else std
    traction = traction * factor
    std = None if std is None else std * factor * segments.driven_m
    if isinstance(predictor, CalibratedPredictor):  # its effects know more of a log than a plan could
        energy = predictor.segment_energy(segments, heightmap, robot)
        return Prediction(energy, std, traction, np.zeros(len(segments)))
    turning_robot = base.robot_with_turning(robot) if isinstance(base, Learned) else robot
    turning = turning_robot.turn_j_per_rad * np.abs(segments.heading_change_rad)
    return Prediction(robot.price_per_m(traction) * segments.driven_m + turning, std, traction, turning)
