"""How well a model predicts measured runs: what `evaluate` calls."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from model.energy.evaluation import coverage, errors
from model.energy.predictor import Predictor
from model.loop.prediction import predict_segments
from model.robot import Robot
from model.terrain.heightmap import Heightmap
from service.learning.runs import read_segments
from service.loop.plausible import check_runs


def evaluate_on_runs(
    predictor: Predictor, heightmap: Heightmap, robot: Robot, files: Sequence[Path], *, charge: bool = False
) -> dict[str, Any]:
    """Errors of a predictor on measured runs over a heightmap, JSON-able.

    The numbers of `model.energy.evaluation.errors`, with runs named; `coverage`: share of segments inside the
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
