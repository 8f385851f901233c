"""The baselines and any models on a user's own measured runs: the work of `python -m tests.paper baselines`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.energy.predictor import Predictor
from joulemap.model.robot import Robot
from joulemap.model.terrain.heightmap import Heightmap
from tests.paper import baselines, networks
from tests.paper.chords import read_chords
from tests.paper.measured import Measured, judged

_FITTED = {
    "fitted friction": baselines.global_friction,
    "fitted friction and weight": baselines.friction_and_weight,
    "friction map (Gaussian process)": baselines.friction_map,
    "ridge on shape": baselines.shape_ridge,
}


def compare(
    heightmap: Heightmap,
    robot: Robot,
    learned: Sequence[Path],
    tested: Sequence[Path],
    *,
    tested_heightmap: Heightmap | None = None,
    models: Sequence[Predictor] = (),
) -> dict[str, dict[str, Any]]:
    """Fit every baseline to some runs, and judge the baselines and models by other runs.

    Result: the numbers of `judged` by method, JSON-able.
    """
    mine = _measured(heightmap, robot, learned, "")
    elsewhere = tested_heightmap is not None
    test = _measured(tested_heightmap or heightmap, robot, tested, "elsewhere" if elsewhere else "")
    found = {name: judged(fit(mine, robot)(test), test) for name, fit in _FITTED.items()}
    return found | {model.name: judged(networks.predicted_j(model, test, robot), test) for model in models}


def _measured(heightmap: Heightmap, robot: Robot, files: Sequence[Path], site: str) -> Measured:
    segments = read_chords(files, robot, crs=heightmap.frame.crs)
    return Measured(site, heightmap, tuple(files), segments, np.full(len(segments), np.nan))
