"""Joulemap's own calibrator, as the harness wants it: `--calibrator tests.loop.ours:Ours`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.field.blind_case import BlindTruth
from model.loop.calibrated import CalibratedPredictor
from model.loop.segments import Segments
from model.robot import Robot
from model.terrain.readers import read_heightmap
from service.calibrating import calibrate_on_runs, load_model
from tests.loop.calibrators import base_energy

FloatArray = NDArray[np.float64]


class Ours:
    """What `joulemap calibrate` does, without a look at the truth."""

    def calibrate(
        self, model: Path, heightmap: Path, runs: Sequence[Path], robot: Path, out: Path, *, truth: BlindTruth
    ) -> dict[str, Any]:
        report, _ = calibrate_on_runs(model, read_heightmap(heightmap), Robot.from_toml(robot), runs, out=out)
        return report

    def predict(self, model: Path, heightmap: Path, segments: Segments, robot: Path, out: Path) -> FloatArray:
        if not (out / "model").is_dir():
            return base_energy(model, heightmap, segments, robot)
        calibrated = load_model(out / "model")
        assert isinstance(calibrated, CalibratedPredictor)
        return calibrated.segment_energy(segments, read_heightmap(heightmap), Robot.from_toml(robot))
