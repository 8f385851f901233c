"""Prediction of measured segments from ground, path, payload and turns, which are known before a drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.learned import Learned
from joulemap.model.energy.predictor import Predictor
from joulemap.model.energy.uncertainty import USUAL_SPREAD, segment_std
from joulemap.model.robot import Robot
from joulemap.model.runs.features import FloatArray
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap


@dataclass(frozen=True)
class Prediction:
    """Predictions per segment; NaN on unknown ground."""

    energy_j: FloatArray  # (n,): Drawn from the battery [J]
    std_j: FloatArray | None  # (n,): Its standard deviation [J]; None from a model that does not know it
    traction_per_m: FloatArray  # (n,): Of the declared robot, before any calibration [J/m]


def joined(parts: Sequence[Prediction]) -> Prediction:
    """Join predictions of one kind of model.

    Result: one after the other; without a standard deviation where one part has none.
    """
    stds = [part.std_j for part in parts if part.std_j is not None]
    return Prediction(
        np.concatenate([part.energy_j for part in parts]),
        np.concatenate(stds) if len(stds) == len(parts) else None,
        np.concatenate([part.traction_per_m for part in parts]),
    )


def predict_segments(predictor: Predictor, heightmap: Heightmap, robot: Robot, segments: Segments) -> Prediction:
    """Predict measured segments.

    The ground costs what the model says. Turning, time and speeding up cost what was fitted to the runs of a network;
    of any other model turning costs what is declared, and idle power is drawn for as long as a segment took.
    """
    if isinstance(predictor, _ReadsLogs):
        return predictor.predict_segments(heightmap, robot, segments)
    traction, std = predictor.segment_traction_and_std(heightmap, robot, segments.x, segments.y, segments.heading_rad)
    factor = _payload_factor(predictor, robot, segments)
    if isinstance(predictor, Learned):
        beyond = predictor.drive_energy_j(robot, segments)
    else:
        longer_s = segments.duration_s - segments.driven_m / robot.speed_mps
        beyond = robot.turn_j_per_rad * segments.turned_abs_rad + robot.idle_power_w * longer_s
    energy = robot.price_per_m(traction * factor) * segments.driven_m + beyond
    return Prediction(energy, None if std is None else std * factor * segments.driven_m, traction)


def std_of_segments(said: Prediction, robot: Robot, segments: Segments) -> FloatArray:
    """Return the standard deviation of measured segments before a calibration.

    Result (n,): standard deviation [J]: the model's own, or a usual share of the price.
    """
    return assumed_std(None, said.traction_per_m, robot) * segments.driven_m if said.std_j is None else said.std_j


def assumed_std(std_j: NDArray[Any] | None, traction_per_m: NDArray[Any], robot: Robot) -> NDArray[Any]:
    """Return the standard deviation of 1 m segments before a calibration.

    `std_j`: as the model gives it [J], None from a model that does not know it. Result: standard deviation [J]: the
    model's own, or a usual share of the price.
    """
    if std_j is not None:
        return std_j
    level = robot.hotel_per_m + robot.weight_n * robot.rolling_resistance
    return segment_std(robot.price_per_m(traction_per_m), USUAL_SPREAD, level, factor=1.0).astype(traction_per_m.dtype)


@runtime_checkable
class _ReadsLogs(Protocol):
    """A calibrated model: its effects read more of a log than a plan could."""

    def predict_segments(self, heightmap: Heightmap, robot: Robot, segments: Segments) -> Prediction: ...


def _payload_factor(predictor: Predictor, robot: Robot, segments: Segments) -> FloatArray:
    """Weight with the logged payload over the declared weight, (n,), as far as the model was trained with payloads."""
    logged = segments.extras.get("payload")
    if logged is None or not isinstance(predictor, Learned):
        return np.ones(len(segments))
    known = np.clip(np.nan_to_num(logged), *predictor.domain.payload_kg)
    return np.asarray(1.0 + known / robot.mass_kg)
