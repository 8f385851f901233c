"""Prediction of measured segments from ground, path, payload and turns, which are known before a drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.domain import Learned
from joulemap.model.energy.predictor import Predictor
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.robot import Robot
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """Predictions per segment; NaN on unknown ground.

    Attributes
    ----------
    energy_j : ndarray of float, (n,)
        Drawn from the battery [J].
    std_j : ndarray of float, (n,), optional
        Its standard deviation [J]; None from a model that does not know it.
    traction_per_m : ndarray of float, (n,)
        Of the declared robot, before any calibration [J/m].
    turning_j : ndarray of float, (n,)
        The part of the energy beyond straight driving at the declared speed: turning and, of a network that was trained
        on runs, time and speeding up. Without the effects of a calibration [J].
    """

    energy_j: FloatArray
    std_j: FloatArray | None
    traction_per_m: FloatArray
    turning_j: FloatArray

    def take(self, index: NDArray[np.int64]) -> Prediction:
        """Return some of the segments.

        Parameters
        ----------
        index : ndarray of int
            Their indices.

        Returns
        -------
        Prediction
            In the order of `index`.
        """
        std = None if self.std_j is None else self.std_j[index]
        return Prediction(self.energy_j[index], std, self.traction_per_m[index], self.turning_j[index])


def joined(parts: Sequence[Prediction]) -> Prediction:
    """Join predictions of one kind of model.

    Parameters
    ----------
    parts : sequence of Prediction
        At least one.

    Returns
    -------
    Prediction
        One after the other; without a standard deviation where one part has none.
    """
    stds = [part.std_j for part in parts if part.std_j is not None]
    return Prediction(
        np.concatenate([part.energy_j for part in parts]),
        np.concatenate(stds) if len(stds) == len(parts) else None,
        np.concatenate([part.traction_per_m for part in parts]),
        np.concatenate([part.turning_j for part in parts]),
    )


def predict_segments(predictor: Predictor, heightmap: Heightmap, robot: Robot, segments: Segments) -> Prediction:
    """Predict segments that are driven at the robot's declared speed along the length of their track.

    Turning, time and speeding up cost what was fitted to the runs of a network, beside what it says of the ground.

    Parameters
    ----------
    predictor : Predictor
        Any model.
    heightmap : Heightmap
        On which they were driven.
    robot : Robot
        That drove.
    segments : Segments
        Measured.

    Returns
    -------
    Prediction
        In the order of the segments.
    """
    base = predictor.base if isinstance(predictor, CalibratedPredictor) else predictor
    traction, std = base.segment_traction_and_std(heightmap, robot, segments.x, segments.y, segments.heading_rad)
    factor = payload_factor(base, robot, segments)
    std = predictor.std_of(std, traction, robot) if isinstance(predictor, CalibratedPredictor) else std
    std = None if std is None else std * factor * segments.driven_m
    if isinstance(predictor, CalibratedPredictor):  # its effects use more of a log than a plan could
        energy = predictor.segment_energy(segments, heightmap, robot)
        return Prediction(energy, std, traction, np.zeros(len(segments)))
    if isinstance(base, Learned):
        turning = base.drive_energy_j(robot, segments)
    else:
        turning = robot.turn_j_per_rad * segments.turned_abs_rad
    return Prediction(robot.price_per_m(traction * factor) * segments.driven_m + turning, std, traction, turning)


def payload_factor(predictor: Predictor, robot: Robot, segments: Segments) -> NDArray[np.float64]:
    """Return the weight with the logged payload over the declared weight, as far as the model was trained with
    payloads.

    Parameters
    ----------
    predictor : Predictor
        Any model.
    robot : Robot
        As declared.
    segments : Segments
        Measured.

    Returns
    -------
    ndarray of float, (n,)
        1 where no payload was logged.
    """
    logged = segments.extras.get("payload")
    if logged is None or not isinstance(predictor, Learned):
        return np.ones(len(segments))
    known = np.clip(np.nan_to_num(logged), *predictor.domain.payload_kg)
    return np.asarray(1.0 + known / robot.mass_kg)
