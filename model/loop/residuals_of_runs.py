"""From measured runs to residuals against a model, and the runs that a model keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.predictor import MODEL_NAMES, Predictor
from joulemap.model.errors import RunsError
from joulemap.model.loop.calibrated import assumed_std
from joulemap.model.loop.drive import describe_segments
from joulemap.model.loop.prediction import predict_segments
from joulemap.model.loop.record import read_record, save_record
from joulemap.model.loop.residual import LEAST_SEGMENTS, Residuals, residuals_of
from joulemap.model.robot import Robot
from joulemap.model.runs.consistency import check_runs
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]
_MARK = "beside "  # of columns that are only carried along


def residuals_on(
    predictor: Predictor, heightmap: Heightmap, robot: Robot, segments: Segments, *, least: int = LEAST_SEGMENTS
) -> tuple[Residuals, dict[str, FloatArray], FloatArray]:
    """Return the residuals of segments against a model.

    Parameters
    ----------
    predictor : Predictor
        The model.
    heightmap : Heightmap
        On which they were driven.
    robot : Robot
        That drove.
    segments : Segments
        Measured.
    least : int
        Smallest number of usable segments.

    Returns
    -------
    tuple of (Residuals, dict, ndarray of float)
        The residuals; the readings of the battery of each row (means of voltage, current and power, energy, the
        current's ripple), (n,), which no effect may copy; and the standard deviation that the model assumes, (n,) [J].

    Raises
    ------
    RunsError
        As `check_runs`, and if fewer than `least` segments are usable.
    """
    check_runs(segments, heightmap, robot)
    said = predict_segments(predictor, heightmap, robot, segments)
    std = said.std_j
    if std is None:
        std = assumed_std(None, said.traction_per_m, robot) * segments.driven_m
    beside = {
        "voltage": segments.voltage_v,
        "current": segments.current_a,
        "power": segments.energy_j / segments.duration_s,
        "energy": segments.energy_j,
        "ripple": segments.ripple,
        "std_j": std,
        "told": said.energy_j,
    }
    residuals, kept = _residuals(heightmap, robot, segments, said.traction_per_m, beside, least=least)
    believed, told = kept.pop("std_j"), kept.pop("told")
    return replace(residuals, told=told), kept, believed


def _residuals(
    heightmap: Heightmap,
    robot: Robot,
    segments: Segments,
    traction: FloatArray,
    beside: Mapping[str, FloatArray],
    *,
    least: int = LEAST_SEGMENTS,
) -> tuple[Residuals, dict[str, FloatArray]]:
    """Residuals, and the rows of `beside` that belong to them, (n,) each (NaN of stationary intervals)."""
    drive, measured = describe_segments(segments, heightmap, robot, traction, with_stands=not segments.charge)
    rest = np.full(len(drive) - len(segments), np.nan)
    marked = {_MARK + key: np.concatenate([values, rest]) for key, values in beside.items()}
    found = residuals_of(
        replace(drive, columns=drive.columns | marked), measured, segments.runs, charge=segments.charge, least=least
    )
    columns = dict(found.drive.columns)
    kept = {key: columns.pop(_MARK + key) for key in beside}
    return replace(found, drive=replace(found.drive, columns=columns)), kept


def keep_base_runs(folder: Path, heightmap: Heightmap, robot: Robot, segments: Segments, traction: FloatArray) -> bool:
    """Keep the runs that a model was trained on beside it, as the baseline of later calibrations.

    Parameters
    ----------
    folder : Path
        Of the model.
    heightmap : Heightmap
        On which they were driven.
    robot : Robot
        That drove.
    segments : Segments
        Measured.
    traction : ndarray of float, (n,)
        Of every segment [J/m], from a network that was trained without its run.

    Returns
    -------
    bool
        False, and nothing is kept, where there are too few segments.
    """
    try:
        residuals, _ = _residuals(heightmap, robot, segments, traction, {})
    except RunsError:
        return False
    save_record(folder, residuals)
    return True


def base_residuals(
    model: str | Path, predictor: Predictor, heightmap: Heightmap, robot: Robot, runs: Segments | None
) -> Residuals | None:
    """Return the residuals of the baseline runs.

    Parameters
    ----------
    model : str or Path
        Name or folder of the base model.
    predictor : Predictor
        The base model.
    heightmap : Heightmap
        On which the given runs were driven.
    robot : Robot
        That drove.
    runs : Segments, optional
        Baseline runs; without them, those kept in the model's folder.

    Returns
    -------
    Residuals or None
        None where there are no baseline runs.
    """
    if runs is None:
        return None if model in MODEL_NAMES else read_record(model)
    return residuals_on(predictor, heightmap, robot, runs)[0]
