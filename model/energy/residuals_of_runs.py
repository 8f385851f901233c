"""From measured runs to residuals against a model, and the runs that a model keeps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.prediction import predict_segments, std_of_segments
from joulemap.model.energy.predictor import MODEL_NAMES, Predictor
from joulemap.model.errors import RunsError
from joulemap.model.robot import Robot
from joulemap.model.runs.consistency import check_place
from joulemap.model.runs.describe import describe_segments
from joulemap.model.runs.record import read_record, save_record
from joulemap.model.runs.residuals import LEAST_SEGMENTS, Residuals, residuals_of
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]


def residuals_on(
    predictor: Predictor, heightmap: Heightmap, robot: Robot, segments: Segments, *, least: int = LEAST_SEGMENTS
) -> tuple[Residuals, dict[str, FloatArray], FloatArray]:
    """Return the residuals of segments against a model.

    Result: the residuals; the readings of the battery of each row (means of voltage, current and power, and energy),
    (n,), which no effect may copy; and the standard deviation that the model assumes, (n,) [J].
    """
    check_place(segments, heightmap)
    said = predict_segments(predictor, heightmap.bare, robot, segments)  # what kinds of ground cost, the runs say
    residuals, index = _residuals(heightmap, robot, segments, said.traction_per_m, said.energy_j, least=least)
    electric = {
        "voltage": segments.voltage_v,
        "current": segments.current_a,
        "power": segments.energy_j / segments.duration_s,
        "energy": segments.energy_j,
    }
    read = {key: _rows(values, index) for key, values in electric.items()}
    return residuals, read, _rows(std_of_segments(said, robot, segments), index)


def _rows(values: FloatArray, index: NDArray[np.int64]) -> FloatArray:
    """Values of segments by row; NaN of stationary intervals."""
    return np.where(index < values.size, values[np.minimum(index, values.size - 1)], np.nan)


def _residuals(
    heightmap: Heightmap,
    robot: Robot,
    segments: Segments,
    traction: FloatArray,
    energy: FloatArray,
    *,
    least: int = LEAST_SEGMENTS,
) -> tuple[Residuals, NDArray[np.int64]]:
    """Residuals, and the number of the segment of every row; more than there are of stationary intervals."""
    features, measured = describe_segments(segments, heightmap, robot, traction)
    informed = np.concatenate([energy, np.full(len(features) - len(segments), np.nan)])
    return residuals_of(features, measured, segments.runs, charge=segments.charge, informed=informed, least=least)


def keep_base_runs(
    folder: Path, heightmap: Heightmap, robot: Robot, segments: Segments, traction: FloatArray, energy: FloatArray
) -> str | None:
    """Keep the runs that a model was trained on beside it, as the baseline of later calibrations.

    `traction` (n,): of every segment [J/m], from a network that was trained without its run; `energy` (n,): predicted
    by the same network [J]. Result: SHA-256 of the record; None, and nothing is kept, where there are too few segments.
    """
    try:
        residuals, _ = _residuals(heightmap, robot, segments, traction, energy)
    except RunsError:
        return None
    return save_record(folder, residuals)


def base_residuals(
    model: str | Path, predictor: Predictor, heightmap: Heightmap, robot: Robot, runs: Segments | None
) -> Residuals | None:
    """Return the residuals of the baseline runs. Result: None where there are no baseline runs."""
    if runs is None:
        training = predictor.provenance().get("config", {}).get("training", {})
        return None if model in MODEL_NAMES else read_record(model, kept=training.get("base_runs"))
    return residuals_on(predictor, heightmap, robot, runs)[0]
