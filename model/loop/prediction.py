"""What a model says of measured segments: from ground, path, payload and turns, which a planner knows beforehand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.energy.domain import Learned
from model.energy.predictor import Predictor
from model.loop.calibrated import CalibratedPredictor
from model.loop.segments import Segments
from model.robot import Robot
from model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """Per segment, (n,) each; NaN on unknown ground. energy_j [J] : drawn from the battery. std_j : its standard
    deviation, None from a model that does not know it. traction_per_m [J/m] : with the payload's weight. turning_j :
    the part of the energy that goes into turning."""

    energy_j: FloatArray
    std_j: FloatArray | None
    traction_per_m: FloatArray
    turning_j: FloatArray


def payload_factor(predictor: Predictor, robot: Robot, segments: Segments) -> FloatArray:
    """Weight with the logged payload over the declared weight, as far as the model learned of payloads; 1 where none
    was logged. (n,)"""
    logged = segments.extras.get("payload")
    if logged is None or not isinstance(predictor, Learned):
        return np.ones(len(segments))
    known = np.clip(np.nan_to_num(logged), *predictor.domain.payload_kg)
    return np.asarray(1.0 + known / robot.mass_kg)


def predict_segments(predictor: Predictor, heightmap: Heightmap, robot: Robot, segments: Segments) -> Prediction:
    """What the model says of every segment, driven at the robot's declared speed along the track's length."""
    traction, std = predictor.segment_traction_and_std(heightmap, robot, segments.x, segments.y, segments.heading_rad)
    if isinstance(predictor, CalibratedPredictor):  # its effects know more of a log than a plan could
        energy = predictor.segment_energy(segments, heightmap, robot)
        return Prediction(energy, std, traction, np.zeros(len(segments)))
    factor = payload_factor(predictor, robot, segments)
    turn_j_per_rad = robot.turn_j_per_rad + (predictor.turn_j_per_rad if isinstance(predictor, Learned) else 0.0)
    turning = turn_j_per_rad * np.abs(segments.heading_change_rad)
    energy = robot.price_per_m(traction * factor) * segments.driven_m + turning
    return Prediction(energy, None if std is None else std * factor * segments.driven_m, traction * factor, turning)
