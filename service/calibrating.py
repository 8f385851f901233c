"""From a model and measured runs to a calibrated model: what `calibrate` and `POST /v1/calibrations` call."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.energy.predictor import MODEL_NAMES, Predictor, load_predictor
from model.errors import ConflictError, InputError, ModelError, RunsError
from model.loop.calibrated import (
    CALIBRATION_FILE,
    CalibratedPredictor,
    Correction,
    read_calibrated,
    save_calibrated,
)
from model.loop.calibration import Calibration, calibrate
from model.loop.drive import describe_segments
from model.loop.prediction import predict_segments
from model.loop.record import read_record, save_record
from model.loop.report import report_document
from model.loop.residual import Residuals, residuals_of
from model.loop.runs import read_run
from model.loop.segments import Segments, concatenate, cut_segments
from model.robot import Robot
from model.terrain.heightmap import Heightmap

BASE_FOLDER = "base"
"""Where a calibrated model's folder keeps its base model."""


def read_calibration_runs(files: Sequence[Path], *, crs: str | None) -> tuple[Segments, dict[str, dict[str, int]]]:
    """The segments of all runs, in joules, or in ampere seconds where a run has no voltage; and the repairs by run.

    Raises RunsError for no run, or for runs of which only some have a voltage.
    """
    if not files:
        raise RunsError("there is no run to read: no file has such a name")
    runs = [read_run(file, crs=crs) for file in files]
    without = [run.name for run in runs if run.voltage_v is None]
    if without and len(without) < len(runs):
        raise RunsError(
            f"{len(without)} of {len(runs)} runs have no voltage (the first is {without[0]}): calibrate them apart",
            run=without[0],
        )
    segments = concatenate([cut_segments(run, charge=bool(without)) for run in runs])
    return segments, {run.name: run.repairs for run in runs if run.repairs}


def residuals_on(
    heightmap: Heightmap, robot: Robot, segments: Segments, traction: NDArray[np.float64]
) -> tuple[Residuals, dict[str, np.ndarray]]:
    """Residuals of segments against a model's traction (n,) [J/m], and each row's mean voltage, current and power.

    Raises RunsError.
    """
    if len(segments) == 0:
        raise RunsError("the runs hold no segment of 1 m: did the robot move, and is its position recorded?")
    drive, measured = describe_segments(segments, heightmap, robot, traction)
    marked = replace(drive, columns=drive.columns | _electric(segments, len(drive) - len(segments)))
    found = residuals_of(marked, measured, segments.runs, charge=segments.charge)
    columns = dict(found.drive.columns)
    electric = {key.removeprefix(_MARK): columns.pop(key) for key in list(columns) if key.startswith(_MARK)}
    return replace(found, drive=replace(found.drive, columns=columns)), electric


_MARK = "measured "


def _electric(segments: Segments, stands: int) -> dict[str, np.ndarray]:
    rest = np.full(stands, np.nan)
    power = segments.energy_j / segments.duration_s
    means = {"voltage": segments.voltage_v, "current": segments.current_a, "power": power}
    return {_MARK + key: np.concatenate([values, rest]) for key, values in means.items()}


def keep_base_runs(
    folder: Path, heightmap: Heightmap, robot: Robot, segments: Segments, traction: NDArray[np.float64]
) -> None:
    """Leave the runs that a model was trained on beside it, so that a calibration can hold later runs against them.

    traction : (n,) [J/m] of every segment, from a network that had not seen its run. Runs too short to be held against
    anything are not kept.
    """
    with suppress(RunsError):
        save_record(folder, residuals_on(heightmap, robot, segments, traction)[0])


def calibrate_on_runs(
    model: str | Path,
    heightmap: Heightmap,
    robot: Robot,
    files: Sequence[Path],
    *,
    out: Path,
    base_files: Sequence[Path] = (),
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> tuple[dict[str, Any], Calibration]:
    """Trace what a model lacks on measured runs and write `out/model`: the base and its effects. Returns the report.

    base_files : runs without the effect, where the model's folder does not keep its own. Raises InputError, RunsError,
    ModelError, and ConflictError where `out/model` is there already: a model version is never changed.
    """
    target = out / "model"
    if target.exists():
        raise ConflictError(f"{target} is there already: a model version is never changed", path=str(target))
    predictor = load_model(model)
    if isinstance(predictor, CalibratedPredictor):
        raise InputError(f"{model} is calibrated already: calibrate its base again, with all runs together")
    segments, repairs = read_calibration_runs(files, crs=heightmap.frame.crs)
    said = partial(predict_segments, predictor, heightmap, robot)
    measured, electric = residuals_on(heightmap, robot, segments, said(segments).traction_per_m)
    base = None if model in MODEL_NAMES else read_record(model)
    if base_files:
        base_segments, _ = read_calibration_runs(base_files, crs=heightmap.frame.crs)
        base = residuals_on(heightmap, robot, base_segments, said(base_segments).traction_per_m)[0]
    found = calibrate(measured, electric=electric, base=base, seed=seed, progress=progress)
    correction = correction_of(found)
    version = _write(target, model, predictor, correction) if found.terms else None
    report = report_document(found, before=predictor.provenance(), after=version)
    report["runs"] = {"names": list(segments.runs), "repairs": repairs, "left_out": segments.left_out}
    report["warnings"] = predictor.warnings(heightmap, robot)
    return report, found


def correction_of(found: Calibration) -> Correction:
    """What a calibration adds to its base model."""
    drive, moving = found.residuals.drive, found.residuals.moving
    planner = [True] * (len(found.shared.terms) + len(found.silent)) + [e.planner for e in found.effects]
    turned = float(drive.turned_abs_rad[moving].sum())
    turning = sum(float(t.energy(drive)[moving].sum()) for t in found.terms if t.formula.startswith("turning"))
    conditions = {k: float(np.nanmean(v)) for k, v in drive.columns.items() if np.isfinite(v).any()}
    return Correction(
        found.terms,
        tuple(planner),
        charge=found.residuals.charge,
        turn_j_per_rad=turning / turned if turned > 0 and not found.residuals.charge else 0.0,
        conditions=conditions,
        evidence=[{"name": e.term.name, "p_value": e.p_value, "share": e.share} for e in found.effects],
    )


def _write(target: Path, model: str | Path, predictor: Predictor, correction: Correction) -> str:
    """The folder of a calibrated model, with a copy of its base where that is a folder."""
    version = predictor.provenance()["version"]
    if model in MODEL_NAMES:
        return save_calibrated(target, correction, {"name": str(model), "version": version})
    target.mkdir(parents=True)
    shutil.copytree(model, target / BASE_FOLDER)
    return save_calibrated(target, correction, {"folder": BASE_FOLDER, "version": version})


def load_model(spec: str | Path) -> Predictor:
    """`load_predictor`, or the calibrated model of a folder. Raises ModelError."""
    if spec in MODEL_NAMES or not (Path(spec) / CALIBRATION_FILE).is_file():
        return load_predictor(spec)
    folder = Path(spec)
    correction, base, version = read_calibrated(folder)
    predictor = load_predictor(base["name"] if "name" in base else folder / str(base["folder"]))
    if predictor.provenance()["version"] != base["version"]:
        raise ModelError(
            f"{folder} was calibrated on {base}, but that model is now {predictor.provenance()['version']}",
            expected=base["version"],
        )
    return CalibratedPredictor(predictor, correction, name=folder.resolve().name, version=version)
