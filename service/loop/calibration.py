"""From a model and measured runs to a calibrated model: what `calibrate` and `POST /v1/calibrations` call."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.predictor import MODEL_NAMES, Predictor
from joulemap.model.energy.reliability import checked_spread
from joulemap.model.energy.uncertainty import FEWEST, fit_spread
from joulemap.model.errors import ConflictError, InfeasibleError, InputError
from joulemap.model.loop.calibrate import CALIBRATED, Calibration, calibrate
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.loop.calibration_file import save_calibrated
from joulemap.model.loop.correction import Correction
from joulemap.model.loop.drive_prior import columns_of_rows, fit_drive_prior, prior_of_spread
from joulemap.model.loop.report import report_document
from joulemap.model.loop.terms import turning_per_rad
from joulemap.model.robot import Robot
from joulemap.model.runs.calibration_runs import CalibrationRuns
from joulemap.model.runs.residuals import Residuals
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.loop.measured import Measured, measure, sites_document
from joulemap.service.loop.next_drive import next_drive
from joulemap.service.loop.rerouting import AskedTask, Comparison, compare_routes
from joulemap.service.loop.summary import with_former_keys
from joulemap.service.models import CALIBRATED_FOLDER, load_model, model_name, planning_robot

FloatArray = NDArray[np.float64]

_LEAST_M = 1e-6  # of track: rounding
_WORTH_DRIVING = 0.95  # most of an interval's width that a drive may leave
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
    heightmap : Heightmap
        Where it was compared: of several, the one with the most metres driven.
    """

    document: dict[str, Any]
    found: Calibration
    routes: Comparison | None
    heightmap: Heightmap


def calibrate_on_runs(
    model: str | Path,
    runs: CalibrationRuns,
    *,
    out: Path,
    task: AskedTask | None = None,
    groups: Sequence[str] | None = None,
    cross_validate: bool = True,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Calibrated:
    """Find what a model lacks on measured runs, and write the calibrated model to `out/model`.

    `task`: start and goal [m] whose routes before and after are compared, see `compare_routes`, on the map with the
    most metres driven. Raises ConflictError if `out/model` exists already: a model version is never changed.
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
    measured = measure(model, predictor, runs)
    _report(progress, _READ)
    found = calibrate(
        measured.residuals,
        electric=measured.electric,
        base=measured.baseline,
        test=measured.test,
        groups=groups,
        cross_validate=cross_validate,
        progress=lambda share: _report(progress, _READ + (_CALIBRATED - _READ) * share),
    )
    correction = correction_of(
        found, measured.std, groups, declared_turn=planning_robot(predictor, runs.robot).turn_j_per_rad
    )
    maps = (site.heightmap.data_hash for site in runs.sites if runs.placed)
    correction = replace(correction, heightmaps=tuple(maps))
    version = _write(begun, model, predictor, correction)
    after = CalibratedPredictor(predictor, correction, name=model_name(target), version=version)
    ground = measured.main.heightmap
    routes, why_not = None, "the runs have no positions"
    if found.confirmed("proposed") is False:
        why_not = "the calibrated model is not confirmed for plans"
    elif runs.placed:
        try:
            routes = compare_routes(
                ground,
                runs.robot,
                predictor,
                after,
                measured.places,
                task=task,
                seed=seed,
            )
        except InfeasibleError as error:  # a report all the same
            why_not = error.message
    report = report_document(found, before=predictor.provenance(), after=version)
    if groups is not None and measured.residuals.whole_runs:
        report["validation"]["left_out"] = "campaigns"
    report["reliability"] = correction.reliability
    report |= _turning(found, predictor, runs.robot, correction) | _runs(runs, measured)
    report |= _route(routes, why_not, runs)
    if measured.test is not None:
        report["test_set"] = {"segments": int(measured.test.moving.sum()), "error": found.test_errors}
    report["next_drive"] = _next_drive(found, predictor, ground, runs, seed)
    report["warnings"] = after.warnings(ground, runs.robot)
    begun.rename(target)
    _report(progress, 1.0)
    return Calibrated(with_former_keys(report), found, routes, ground)


def _turning(found: Calibration, predictor: Predictor, robot: Robot, correction: Correction) -> dict[str, Any]:
    """What turning costs in plans, where it is known before a drive."""
    if not any(e.term.form.name == "turning" and e.term.form.known_before for e in found.effects):
        return {}
    total = planning_robot(predictor, robot).turn_j_per_rad + correction.turn_j_per_rad
    return {"turning_in_plans": {"j_per_rad": max(total, 0.0), "new_j_per_rad": correction.turn_j_per_rad}}


def _route(routes: Comparison | None, why_not: str, runs: CalibrationRuns) -> dict[str, Any]:
    if routes is None:
        return {"route": {"why_not": why_not}}
    route = routes.as_dict()
    if runs.segments.charge:
        route["nominal_voltage_v"] = runs.robot.nominal_voltage_v
    return {"route": route, "map": routes.map_as_dict()}


def _runs(runs: CalibrationRuns, measured: Measured) -> dict[str, Any]:
    segments = runs.segments
    read = {
        "names": list(segments.runs),
        "rows": runs.rows,
        "repairs": runs.repairs,
        "left_out": segments.left_out,
        "coverage": _coverage(segments, measured.residuals),
    }
    return {"runs": read, "sites": sites_document(runs, measured)}


def _coverage(segments: Segments, measured: Residuals) -> dict[str, Any]:
    """Coverage of the track: what was compared with the model are the segments on ground that the map knows."""
    found = segments.coverage()
    used_m = float(measured.features.length_m.sum())
    if (unknown_m := found["used_m"] - used_m) > _LEAST_M:
        found["left_out_m"]["unknown_ground"] = unknown_m
    return found | {"used_m": used_m}


def _next_drive(
    found: Calibration, predictor: Predictor, heightmap: Heightmap, runs: CalibrationRuns, seed: int
) -> dict[str, Any]:
    try:
        drive = next_drive(found, predictor, heightmap, runs.robot, placed=runs.placed, seed=seed)
    except (InputError, InfeasibleError) as error:  # no effect was found, or no route fits
        return {"why_not": error.message}
    share, title = drive.suggestion.shrinkage, drive.effect.title
    if share > _WORTH_DRIVING:
        return {"why_not": f"after the best drive found, the interval of {title} would be {share:.0%} as wide as now"}
    return drive.as_dict()


_READ, _CALIBRATED = 0.3, 0.8  # of the work
_DATE = re.compile(r"(?<!\d)(19|20)\d\d([-_]?)(0[1-9]|1[0-2])\2(0[1-9]|[12]\d|3[01])(?!\d)")


def _report(progress: Callable[[float], None] | None, share: float) -> None:
    if progress is not None:
        progress(share)


def campaigns_of(runs: Sequence[str]) -> list[str]:
    """Return the campaign that each run belongs to, by its name.

    Result: the date in the name, or else the part of the name before the last underscore.
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
    """Refuse a model that is calibrated already."""
    if isinstance(predictor, CalibratedPredictor):
        raise InputError(
            f"{model} is calibrated already: calibrate the model that it was made from again, with all runs together"
        )


def correction_of(
    found: Calibration, std_j: FloatArray, groups: Sequence[str] | None = None, *, declared_turn: float = 0.0
) -> Correction:
    """Return what a calibration adds to its base model.

    `std_j` (n,); `declared_turn`: cost of turning in plans with the base model [J/rad]. Result: with the spread of the
    calibrated model on left-out runs, where there are enough segments.
    """
    rows, moving = found.residuals.features, found.residuals.moving
    conditions = {k: float(np.nanmean(v)) for k, v in rows.columns.items() if np.isfinite(v).any()}
    unit_j = rows.unit_j
    measured_j, said_j = (unit_j * energy for energy in (found.residuals.measured, found.held_out["proposed"]))
    judged = moving & np.isfinite(measured_j) & np.isfinite(said_j) & (std_j > 0.0)
    run, spread, check = rows.run[judged], None, None
    if judged.sum() >= FEWEST:
        group = None if groups is None or not found.residuals.whole_runs else np.asarray(groups)[run]
        _, number = np.unique(run if group is None else group, return_inverse=True)
        given = measured_j[judged], said_j[judged], std_j[judged], run
        spread, check = checked_spread(*given, number) if found.folds else (fit_spread(*given, group=number), None)
    reliability = None if check is None else check.as_dict()
    prior = None
    if spread is not None and found.folds:
        columns, std = columns_of_rows(rows.take(judged), said_j[judged]), spread.factor * std_j[judged]
        start = prior_of_spread(spread, columns, std)
        prior = fit_drive_prior(measured_j[judged], columns, std, run, start).as_dict()
    correction = found.fitted.correction
    terms = correction.planner_terms
    turned = unit_j * turning_per_rad(terms, rows)
    by_kind = {kind: unit_j * turning_per_rad(terms, rows, kind) - turned for kind in correction.kinds}
    turn, factor = turned + declared_turn, found.levels["proposed"].factor
    if found.proposal != CALIBRATED:
        simple = found.fitted.simple.get(found.proposal)  # the model before is none
        terms = tuple(term for term in (simple or found.fitted.scale,) if term is not None)
        correction = replace(correction, planner_terms=terms, alone=True)
        turn, by_kind = declared_turn if simple is None else unit_j * simple.by_name.get("turned", 0.0), {}
    return replace(
        correction,
        turn_j_per_rad=factor * turn - declared_turn,
        turn_by_kind={kind: factor * more for kind, more in by_kind.items() if more},
        conditions=conditions,
        evidence=[{"name": e.term.form.name, "p_value": e.p_value, "share": e.share} for e in found.effects],
        spread=spread,
        scale=found.levels["after"].factor,
        planner_scale=factor,
        reliability=reliability,
        drive_prior=prior,
        drivetrain_efficiency=rows.robot.drivetrain_efficiency,
    )


def _write(target: Path, model: str | Path, predictor: Predictor, correction: Correction) -> str:
    """Write the folder of a calibrated model, with a copy of its base model where that is a folder."""
    version = predictor.provenance()["version"]
    if model in MODEL_NAMES:
        return save_calibrated(target, correction, {"name": str(model), "version": version})
    target.mkdir(parents=True)
    shutil.copytree(model, target / BASE_FOLDER)
    return save_calibrated(target, correction, {"folder": BASE_FOLDER, "version": version})
