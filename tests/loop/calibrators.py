"""Calibrators: joulemap itself, and two to test the harness with: one finds nothing, one is given the truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.predictor import load_predictor
from joulemap.model.field.validation_case import CaseTruth
from joulemap.model.loop.calibrated import CalibratedPredictor
from joulemap.model.robot import Robot
from joulemap.model.runs.files import read_calibration_runs, read_segments
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.readers import read_heightmap
from joulemap.service.loop.calibration import calibrate_on_runs
from joulemap.service.models import load_model
from tests.loop.cases import extra_energy

FloatArray = NDArray[np.float64]


class Joulemap:
    """What `joulemap calibrate` does, given no more than its options."""

    def calibrate(
        self, model: Path, heightmap: Path, runs: Sequence[Path], robot: Path, out: Path, *, truth: CaseTruth
    ) -> dict[str, Any]:
        ground, declared = read_heightmap(heightmap), Robot.from_toml(robot)
        read = read_calibration_runs(runs, declared, crs=ground.frame.crs)
        return calibrate_on_runs(str(model), ground, declared, read, out=out).document

    def predict(self, model: Path, heightmap: Path, segments: Segments, robot: Path, out: Path) -> FloatArray:
        found = out / "model"
        if not found.is_dir():
            return base_energy(model, heightmap, segments, robot)
        predictor = load_model(found)
        assert isinstance(predictor, CalibratedPredictor)
        return predictor.segment_energy(segments, read_heightmap(heightmap), Robot.from_toml(robot))


class Nothing:
    """Finds nothing, whatever there is."""

    def calibrate(
        self, model: Path, heightmap: Path, runs: Sequence[Path], robot: Path, out: Path, *, truth: CaseTruth
    ) -> dict[str, Any]:
        _, segments = read_segments(runs, Robot.from_toml(robot), crs=read_heightmap(heightmap).frame.crs)
        before = _mean_error(self.predict(model, heightmap, segments, robot, out), segments)
        return {
            "verdict": "nothing_found",
            "error": {"before": {"mean_relative": before}, "after": {"mean_relative": before}},
            "effects": [],
        }

    def predict(self, model: Path, heightmap: Path, segments: Segments, robot: Path, out: Path) -> FloatArray:
        return base_energy(model, heightmap, segments, robot)


class Oracle:
    """Knows the truth: names every effect, with a coefficient between 2 % below and above the true one, and adds
    exactly what the effects took."""

    def calibrate(
        self, model: Path, heightmap: Path, runs: Sequence[Path], robot: Path, out: Path, *, truth: CaseTruth
    ) -> dict[str, Any]:
        self._truth = truth
        _, segments = read_segments(runs, Robot.from_toml(robot), crs=read_heightmap(heightmap).frame.crs)
        before = _mean_error(base_energy(model, heightmap, segments, robot), segments)
        after = _mean_error(self.predict(model, heightmap, segments, robot, out), segments)
        known = {c.effect: c for c in truth.coefficients}
        return {
            "verdict": "effects_added" if truth.effects else "nothing_found",
            "error": {"before": {"mean_relative": before}, "after": {"mean_relative": after}},
            "effects": [{"name": n, "coefficients": [_stated(known[n])] if n in known else []} for n in truth.names],
        }

    def predict(self, model: Path, heightmap: Path, segments: Segments, robot: Path, out: Path) -> FloatArray:
        energy = base_energy(model, heightmap, segments, robot)
        for k, name in enumerate(segments.runs):
            mine = segments.run == k
            for place in ("new", "other_site"):
                run = self._truth.runs.get(f"{place}/{name}")
                if run is not None and run.t[0] - 60.0 < float(segments.t0[mine][0]) < run.t[-1]:
                    energy[mine] += extra_energy(run, segments.take(mine))
        return energy


def base_energy(model: Path, heightmap: Path, segments: Segments, robot: Path) -> FloatArray:
    """Prediction of the base model for segments [J], (n,)."""
    declared = Robot.from_toml(robot)
    ground = read_heightmap(heightmap)
    traction = load_predictor(model).segment_traction(ground, declared, segments.x, segments.y, segments.heading_rad)
    return np.array(declared.price_per_m(traction))


def _stated(known: Any) -> dict[str, Any]:
    low, high = sorted((0.98 * known.value, 1.02 * known.value))
    return {"name": known.effect, "value": known.value, "unit": known.unit, "ci95": [low, high]}


def _mean_error(predicted: FloatArray, segments: Segments) -> float:
    known = np.isfinite(predicted)
    return float(np.mean(np.abs(predicted - segments.energy_j)[known] / segments.energy_j[known]))
