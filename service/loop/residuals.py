"""From measured runs to residuals against a model, and what a model keeps of its own runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from model.energy.predictor import MODEL_NAMES, Predictor
from model.errors import RunsError
from model.loop.calibrated import assumed_std
from model.loop.drive import describe_segments
from model.loop.prediction import predict_segments
from model.loop.record import read_record, save_record
from model.loop.residual import Residuals, residuals_of
from model.loop.runs import read_run
from model.loop.segments import CARRIED, Segments, concatenate, cut_segments, driven_only
from model.robot import Robot
from model.terrain.heightmap import Heightmap

FloatArray = NDArray[np.float64]
_MARK = "beside "  # of columns that only go along


def read_calibration_runs(
    files: Sequence[Path], robot: Robot, *, crs: str | None
) -> tuple[Segments, dict[str, dict[str, int]]]:
    """The segments of all runs, in joules, or in ampere seconds where a run has no voltage; and the repairs by run.

    Raises RunsError for no run, or for runs of which only some have a voltage.
    """
    if not files:
        raise RunsError("there is no run to read: no file has such a name")
    names = Counter(file.name for file in files)
    runs = [read_run(file, crs=crs) for file in files]
    runs = [
        replace(run, name=f"{file.parent.name}/{run.name}") if names[file.name] > 1 else run
        for run, file in zip(runs, files, strict=True)
    ]
    without = [run.name for run in runs if run.voltage_v is None]
    if without and len(without) < len(runs):
        raise RunsError(
            f"{len(without)} of {len(runs)} runs have no voltage (the first is {without[0]}): calibrate them apart",
            run=without[0],
        )
    segments = driven_only(
        concatenate([cut_segments(run, charge=bool(without), max_speed_mps=CARRIED * robot.speed_mps) for run in runs])
    )
    return segments, {run.name: run.repairs for run in runs if run.repairs}


def residuals_on(
    predictor: Predictor, heightmap: Heightmap, robot: Robot, segments: Segments
) -> tuple[Residuals, dict[str, FloatArray], FloatArray]:
    """Residuals of segments against a model; of each row what the battery's meters said (means of voltage, current and
    power, energy, the current's ripple), which no effect may copy; and (n,) the standard deviation [J] that the model
    believes in. Raises RunsError."""
    if len(segments) == 0:
        raise RunsError("the runs hold no segment of 1 m: did the robot move, and is its position recorded?")
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
    residuals, kept = _residuals(heightmap, robot, segments, said.traction_per_m, beside)
    believed, told = kept.pop("std_j"), kept.pop("told")
    return replace(residuals, told=told), kept, believed


def _residuals(
    heightmap: Heightmap,
    robot: Robot,
    segments: Segments,
    traction: FloatArray,
    beside: Mapping[str, FloatArray],
) -> tuple[Residuals, dict[str, FloatArray]]:
    """Residuals, and the rows of `beside`, (n,) of the segments each, that go with them (NaN of stands)."""
    drive, measured = describe_segments(segments, heightmap, robot, traction)
    rest = np.full(len(drive) - len(segments), np.nan)
    marked = {_MARK + key: np.concatenate([values, rest]) for key, values in beside.items()}
    found = residuals_of(
        replace(drive, columns=drive.columns | marked), measured, segments.runs, charge=segments.charge
    )
    columns = dict(found.drive.columns)
    kept = {key: columns.pop(_MARK + key) for key in beside}
    return replace(found, drive=replace(found.drive, columns=columns)), kept


def keep_base_runs(folder: Path, heightmap: Heightmap, robot: Robot, segments: Segments, traction: FloatArray) -> bool:
    """Leave the runs that a model was trained on beside it, so that a calibration can hold later runs against them.

    traction : (n,) [J/m] of every segment, from a network that had not seen its run. False, and nothing is kept, where
    they are too few to hold anything against.
    """
    try:
        residuals, _ = _residuals(heightmap, robot, segments, traction, {})
    except RunsError:
        return False
    save_record(folder, residuals)
    return True


def base_residuals(
    model: str | Path, predictor: Predictor, heightmap: Heightmap, robot: Robot, files: Sequence[Path]
) -> Residuals | None:
    """The base model's own runs: those given, or those kept in its folder."""
    if not files:
        return None if model in MODEL_NAMES else read_record(model)
    segments, _ = read_calibration_runs(files, robot, crs=heightmap.frame.crs)
    return residuals_on(predictor, heightmap, robot, segments)[0]
