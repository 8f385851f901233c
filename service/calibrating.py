"""From a model and measured runs to a calibrated model: what `calibrate` and `POST /v1/calibrations` call."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
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
from model.loop.segments import CARRIED, Segments, concatenate, cut_segments, driven_only
from model.loop.suggest import Suggestion, suggest_drive
from model.robot import Robot
from model.terrain.heightmap import Heightmap

BASE_FOLDER = "base"
"""Where a calibrated model's folder keeps its base model."""


def read_calibration_runs(
    files: Sequence[Path], robot: Robot, *, crs: str | None
) -> tuple[Segments, dict[str, dict[str, int]]]:
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
    segments = driven_only(
        concatenate([cut_segments(run, charge=bool(without), max_speed_mps=CARRIED * robot.speed_mps) for run in runs])
    )
    return segments, {run.name: run.repairs for run in runs if run.repairs}


def residuals_on(
    predictor: Predictor, heightmap: Heightmap, robot: Robot, segments: Segments
) -> tuple[Residuals, dict[str, np.ndarray]]:
    """Residuals of segments against a model, and what the battery's meters said of each row: means of voltage, current
    and power, energy, and the current's ripple. Raises RunsError."""
    if len(segments) == 0:
        raise RunsError("the runs hold no segment of 1 m: did the robot move, and is its position recorded?")
    said = predict_segments(predictor, heightmap, robot, segments)
    return _residuals(heightmap, robot, segments, said.traction_per_m)


def _residuals(
    heightmap: Heightmap, robot: Robot, segments: Segments, traction: NDArray[np.float64]
) -> tuple[Residuals, dict[str, np.ndarray]]:
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
    means = {"voltage": segments.voltage_v, "current": segments.current_a, "power": power, "energy": segments.energy_j,
             "ripple": segments.ripple}  # fmt: skip
    return {_MARK + key: np.concatenate([values, rest]) for key, values in means.items()}


def keep_base_runs(
    folder: Path, heightmap: Heightmap, robot: Robot, segments: Segments, traction: NDArray[np.float64]
) -> None:
    """Leave the runs that a model was trained on beside it, so that a calibration can hold later runs against them.

    traction : (n,) [J/m] of every segment, from a network that had not seen its run. Runs too short to be held against
    anything are not kept.
    """
    with suppress(RunsError):
        save_record(folder, _residuals(heightmap, robot, segments, traction)[0])


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
    segments, repairs = read_calibration_runs(files, robot, crs=heightmap.frame.crs)
    measured, electric = residuals_on(predictor, heightmap, robot, segments)
    base = _base_residuals(model, predictor, heightmap, robot, base_files)
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


def suggest_next_drive(
    model: str | Path,
    heightmap: Heightmap,
    robot: Robot,
    files: Sequence[Path],
    *,
    effect: str | None = None,
    base_files: Sequence[Path] = (),
    length_m: float = 200.0,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> tuple[Suggestion, list[str]]:
    """The drive that tells an effect from what these runs confuse it with, or pins its coefficient; and those rivals.

    effect : a candidate's name; the first confounded one, or the least certain one found, unless given. Raises
    InputError where nothing was found and no effect is named, InfeasibleError where no route fits.
    """
    predictor = load_model(model)
    segments, _ = read_calibration_runs(files, robot, crs=heightmap.frame.crs)
    measured, electric = residuals_on(predictor, heightmap, robot, segments)
    base = _base_residuals(model, predictor, heightmap, robot, base_files)
    found = calibrate(measured, electric=electric, base=base, seed=seed, progress=progress)
    best = {c.name: found.trace.evidence.terms[v.term] for c, v in found.trace.ranking}
    best |= {e.term.name: e.term for e in found.effects}
    name = effect or next(iter(found.trace.confounded), None)
    if name is None and found.effects:
        name = max(found.effects, key=lambda e: float(np.max((e.high - e.low) / np.abs(e.term.coefficients)))).term.name
    if name is None:
        raise InputError("these runs show nothing that the model lacks: name the effect that you are in doubt about")
    if name not in best:
        raise InputError(
            f"there is no candidate {name!r} on these runs; there are {', '.join(sorted(best))}", name=name
        )
    rivals = found.trace.confounded.get(name, [])
    others = [e.term for e in found.effects if e.term.name != name]

    def traction(x: np.ndarray, y: np.ndarray, heading_rad: np.ndarray) -> np.ndarray:
        return predictor.segment_traction(heightmap, robot, x, y, heading_rad)

    suggestion = suggest_drive(
        found.residuals, best[name], [*(best[r] for r in rivals), *others], heightmap, robot, traction,
        length_m=length_m, seed=seed,
    )  # fmt: skip
    return suggestion, rivals


def _base_residuals(
    model: str | Path, predictor: Predictor, heightmap: Heightmap, robot: Robot, files: Sequence[Path]
) -> Residuals | None:
    """The base model's own runs: those given, or those kept in its folder."""
    if not files:
        return None if model in MODEL_NAMES else read_record(model)
    segments, _ = read_calibration_runs(files, robot, crs=heightmap.frame.crs)
    return residuals_on(predictor, heightmap, robot, segments)[0]
