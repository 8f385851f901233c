"""How well a model predicts measured segments and whole runs: the errors that `evaluate` and `train` print."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from joulemap.model.energy.predictor import Predictor
from joulemap.model.energy.uncertainty import LEVELS, Spread
from joulemap.model.errors import InputError
from joulemap.model.loop.prediction import predict_segments
from joulemap.model.robot import Robot
from joulemap.model.runs.consistency import check_runs
from joulemap.model.runs.files import read_segments
from joulemap.model.terrain.heightmap import Heightmap


def errors(predicted_j: ArrayLike, energy_j: ArrayLike, run: ArrayLike) -> dict[str, Any]:
    """Errors of predicted against measured energies [J] of n segments.

    segments; mean_relative_error and median_relative_error of |e_hat - e| / e (the paper's eq. 3); rmse_j; bias_j, the
    mean of measured - predicted; route_relative_error, |sum e_hat - sum e| / sum e of every whole run (mean over runs),
    and route_relative_errors of each. Raises InputError without a segment.
    """
    predicted, energy = np.asarray(predicted_j, dtype=np.float64), np.asarray(energy_j, dtype=np.float64)
    if energy.size == 0:
        raise InputError("there is no segment to judge by")
    relative = np.abs(predicted - energy) / np.maximum(np.abs(energy), 1e-9)
    residual = energy - predicted
    by_run = {}
    for one in np.unique(run):
        mine = np.asarray(run) == one
        by_run[str(one)] = float(abs(residual[mine].sum()) / max(abs(energy[mine].sum()), 1e-9))
    return {
        "segments": int(energy.size),
        "mean_relative_error": float(relative.mean()),
        "median_relative_error": float(np.median(relative)),
        "rmse_j": float(np.sqrt(np.mean(residual**2))),
        "bias_j": float(residual.mean()),
        "route_relative_error": float(np.mean(list(by_run.values()))),
        "route_relative_errors": by_run,
    }


def coverage(energy_j: ArrayLike, predicted_j: ArrayLike, std_j: ArrayLike, spread: Spread) -> dict[str, float]:
    """Share of measured segments inside the predicted intervals, by level in percent: {"50": ..., "80": ..., ...}."""
    energy = np.asarray(energy_j, dtype=np.float64)
    inside = {}
    for level in LEVELS:
        low, high = spread.interval(predicted_j, std_j, level)
        inside[f"{100 * level:.0f}"] = float(np.mean((low <= energy) & (energy <= high)))
    return inside


def evaluate_on_runs(
    predictor: Predictor, heightmap: Heightmap, robot: Robot, files: Sequence[Path], *, charge: bool = False
) -> dict[str, Any]:
    """Errors of a predictor on measured runs over a heightmap, JSON-able.

    The numbers of `errors`, with runs named; `coverage`: share of segments inside the
    predicted 50, 80 and 90 % intervals, where the model has some; `unknown`: segments on unknown ground; `repairs` and
    `left_out`: what was mended in the logs, and what was not made a segment, by rule. Raises RunsError, InputError.
    """
    runs, segments = read_segments(files, robot, crs=heightmap.frame.crs, charge=charge)
    check_runs(segments, heightmap, robot)
    said = predict_segments(predictor, heightmap, robot, segments)
    known = np.isfinite(said.energy_j)
    found = errors(said.energy_j[known], segments.energy_j[known], segments.run[known])
    by_run = {segments.runs[int(k)]: value for k, value in found.pop("route_relative_errors").items()}
    covered = None
    if said.std_j is not None:
        covered = coverage(segments.energy_j[known], said.energy_j[known], said.std_j[known], predictor.spread)
    return {
        "model": predictor.name,
        **found,
        "coverage": covered,
        "unknown": int((~known).sum()),
        "route_relative_errors": by_run,
        "repairs": {run.name: run.repairs for run in runs if run.repairs},
        "left_out": segments.left_out,
        "warnings": predictor.warnings(heightmap, robot),
    }
