"""From a model and measured runs to a calibrated model: what `calibrate` and `POST /v1/calibrations` call."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.predictor import MODEL_NAMES, Predictor
from joulemap.model.energy.uncertainty import fit_spread
from joulemap.model.errors import ConflictError, InfeasibleError, InputError
from joulemap.model.loop.calibrate import Calibration, calibrate
from joulemap.model.loop.calibrated import (
    CalibratedPredictor,
    Correction,
    save_calibrated,
)
from joulemap.model.loop.report import report_document
from joulemap.model.loop.residuals import Residuals
from joulemap.model.loop.residuals_of_runs import base_residuals, residuals_on
from joulemap.model.loop.terms import turning_per_rad
from joulemap.model.robot import Robot
from joulemap.model.runs.files import CalibrationRuns
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.loop.deprecated_keys import with_former_keys
from joulemap.service.loop.next_drive import next_drive
from joulemap.service.loop.rerouting import Comparison, Task, compare_routes
from joulemap.service.models import CALIBRATED_FOLDER, load_model, model_name, planning_robot

FloatArray = NDArray[np.float64]

_LEAST_M = 1e-6  # of track: rounding
BASE_FOLDER = "base"
"""Where a calibrated model's folder keeps its base model."""


@dataclass(frozen=True, eq=False, repr=False)
class Calibrated:
    """What a calibration leaves.

    Attributes
    ----------
    document : dict
        The report, JSON-able.
    found : Calibration
        What was found, with the residuals.
    routes : Comparison, optional
        A task before and after. Without it the report's `route` says why there is none.
    """

    document: dict[str, Any]
    found: Calibration
    routes: Comparison | None


def calibrate_on_runs(
    model: str | Path,
    heightmap: Heightmap,
    robot: Robot,
    runs: CalibrationRuns,
    *,
    out: Path,
    task: Task | None = None,
    groups: Sequence[str] | None = None,
    cross_validate: bool = True,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Calibrated:
    """Find what a model lacks on measured runs, and write the calibrated model to `out/model`.

    Parameters
    ----------
    model : str or Path
        Name or folder of the base model.
    heightmap : Heightmap
        On which the runs were driven.
    robot : Robot
        That drove, as its owner declares it.
    runs : CalibrationRuns
        As `runs.files` reads them. Without baseline runs, those in the model's folder are used.
    out : Path
        Folder to write to.
    task : tuple of tuple of float, optional
        Start and goal [m] whose routes before and after are compared, see `compare_routes`.
    groups : sequence of str, optional
        Of each run, such as its campaign: groups are left out together.
    cross_validate : bool
        Repeat the whole procedure without each group of runs for the errors.
    seed : int
        Of the places that are tried for a task.
    progress : callable, optional
        Called with the share of the work that is done, 0..1.

    Returns
    -------
    Calibrated
        With the report.

    Raises
    ------
    ConflictError
        If `out/model` exists already: a model version is never changed.
    InputError
        If the model is calibrated already.
    RunsError
        If the runs do not fit the heightmap, or are too short.
    ModelError
        If the model cannot be read.
    """
    target = out / CALIBRATED_FOLDER
    if target.exists():
        raise ConflictError(
            f"{target} is there already: a model version is never changed. Choose another folder or remove this one",
            path=str(target),
        )
    begun = out / "model.partial"  # a calibration that is cut off leaves no model
    shutil.rmtree(begun, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)  # what cannot be written there is known before it is computed
    predictor = load_model(model)
    refuse_calibrated(model, predictor)
    segments = runs.segments
    measured, electric, std = residuals_on(predictor, heightmap, robot, segments)
    base = base_residuals(model, predictor, heightmap, robot, runs.baseline)
    test = None if runs.test is None else residuals_on(predictor, heightmap, robot, runs.test, least=1)[0]
    _report(progress, _READ)
    found = calibrate(
        measured,
        electric=electric,
        base=base,
        groups=groups,
        cross_validate=cross_validate,
        progress=_part(progress, _READ, _CALIBRATED),
    )
    base_turn = planning_robot(predictor, robot).turn_j_per_rad
    correction = correction_of(found, std)
    version = _write(begun, model, predictor, correction)
    after = CalibratedPredictor(predictor, correction, name=model_name(target), version=version)
    routes, why_not = None, "the runs have no positions"
    if runs.placed:
        driven = measured.features.take(measured.moving)  # on ground that the map knows
        places = np.column_stack([driven.x, driven.y])
        try:
            routes = compare_routes(
                heightmap,
                robot,
                predictor,
                after,
                places,
                task=task,
                seed=seed,
                progress=_part(progress, _CALIBRATED, 1.0),
            )
        except InfeasibleError as error:  # a report all the same
            why_not = error.message
    report = report_document(found, before=predictor.provenance(), after=version)
    if groups is not None and measured.whole_runs:
        report["validation"]["left_out"] = "campaigns"
    if any(e.term.form.name == "turning" and e.term.form.known_before for e in found.effects):
        total = base_turn + correction.turn_j_per_rad
        report["turning_in_plans"] = {"j_per_rad": max(total, 0.0), "new_j_per_rad": correction.turn_j_per_rad}
    report["route"] = routes.as_dict() if routes is not None else {"why_not": why_not}
    if routes is not None:
        report["map"] = routes.map_as_dict()
    if routes is not None and segments.charge:
        report["route"]["nominal_voltage_v"] = robot.nominal_voltage_v
    if test is not None:
        report["test_set"] = {"segments": int(test.moving.sum()), "error": found.errors_on(test)}
    report["runs"] = {
        "names": list(segments.runs),
        "rows": runs.rows,
        "repairs": runs.repairs,
        "left_out": segments.left_out,
        "coverage": _coverage(segments, measured),
    }
    report["next_drive"] = _next_drive(found, predictor, heightmap, robot, runs, seed)
    report["warnings"] = after.warnings(heightmap, robot)
    begun.rename(target)
    _report(progress, 1.0)
    return Calibrated(with_former_keys(report), found, routes)


def _coverage(segments: Segments, measured: Residuals) -> dict[str, Any]:
    """Coverage of the track: what was compared with the model are the segments on ground that the map knows."""
    found = segments.coverage()
    used_m = float(measured.features.length_m.sum())
    if (unknown_m := found["used_m"] - used_m) > _LEAST_M:
        found["left_out_m"]["unknown_ground"] = unknown_m
    return found | {"used_m": used_m}


def _next_drive(
    found: Calibration, predictor: Predictor, heightmap: Heightmap, robot: Robot, runs: CalibrationRuns, seed: int
) -> dict[str, Any]:
    try:
        return next_drive(found, predictor, heightmap, robot, placed=runs.placed, seed=seed).as_dict()
    except (InputError, InfeasibleError) as error:  # no effect was found, or no route fits
        return {"why_not": error.message}


_READ, _CALIBRATED = 0.3, 0.8  # of the work
_DATE = re.compile(r"(?<!\d)(19|20)\d\d([-_]?)(0[1-9]|1[0-2])\2(0[1-9]|[12]\d|3[01])(?!\d)")


def _report(progress: Callable[[float], None] | None, share: float) -> None:
    if progress is not None:
        progress(share)


def _part(progress: Callable[[float], None] | None, start: float, end: float) -> Callable[[float], None] | None:
    return None if progress is None else lambda share: progress(start + (end - start) * share)


def campaigns_of(runs: Sequence[str]) -> list[str]:
    """Return the campaign that each run belongs to, by its name.

    Parameters
    ----------
    runs : sequence of str
        Names of runs.

    Returns
    -------
    list of str
        The date in the name, or else the part of the name before the last underscore.

    Raises
    ------
    InputError
        If all runs belong to one campaign.
    """
    names = []
    for run in runs:
        date = _DATE.search(run)
        names.append(date[0] if date else Path(run).stem.rpartition("_")[0] or Path(run).stem)
    if len(set(names)) < 2:
        raise InputError(
            f"all {len(runs)} runs belong to the campaign {names[0]!r}, so that none can be left out. A campaign of "
            "runs is the date in their names, or the name before the last underscore",
            campaign=names[0],
        )
    return names


def refuse_calibrated(model: str | Path, predictor: Predictor) -> None:
    """Refuse a model that is calibrated already.

    Parameters
    ----------
    model : str or Path
        What it is called.
    predictor : Predictor
        The model.

    Raises
    ------
    InputError
        If it is calibrated.
    """
    if isinstance(predictor, CalibratedPredictor):
        raise InputError(
            f"{model} is calibrated already: calibrate the model that it was made from again, with all runs together"
        )


def correction_of(found: Calibration, std_j: FloatArray) -> Correction:
    """Return what a calibration adds to its base model.

    Parameters
    ----------
    found : Calibration
        What was found.
    std_j : ndarray, (n,)
        Standard deviation of the base model for each of the calibration's rows [J].

    Returns
    -------
    Correction
        With the spread of the calibrated model on left-out runs.
    """
    fitted, rows, moving = found.fitted, found.residuals.features, found.residuals.moving
    conditions = {k: float(np.nanmean(v)) for k, v in rows.columns.items() if np.isfinite(v).any()}
    spread = None
    if not found.residuals.charge:
        spread = fit_spread(
            found.residuals.measured[moving], found.held_out["after_planner"][moving], std_j[moving], rows.run[moving]
        )
    return Correction(
        fitted.terms,
        fitted.planner_terms,
        ranges=fitted.ranges,
        drives=fitted.drives,
        first_base=fitted.first_base,
        charge=found.residuals.charge,
        turn_j_per_rad=rows.unit_j * turning_per_rad(fitted.planner_terms, rows),
        conditions=conditions,
        evidence=[{"name": e.term.form.name, "p_value": e.p_value, "share": e.share} for e in found.effects],
        spread=spread,
    )


def _write(target: Path, model: str | Path, predictor: Predictor, correction: Correction) -> str:
    """Write the folder of a calibrated model, with a copy of its base model where that is a folder."""
    version = predictor.provenance()["version"]
    if model in MODEL_NAMES:
        return save_calibrated(target, correction, {"name": str(model), "version": version})
    target.mkdir(parents=True)
    shutil.copytree(model, target / BASE_FOLDER)
    return save_calibrated(target, correction, {"folder": BASE_FOLDER, "version": version})
