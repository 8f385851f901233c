"""Training on the runs of one site, and judging a model by them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from joulemap.model.energy.predictor import Predictor
from joulemap.model.robot import Robot
from joulemap.model.runs.sites import Site
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.training.evaluation import evaluate_on_sites
from joulemap.model.training.measured_runs import Learner, TrainedModel, train_on_sites


def train_on_runs(
    heightmap: Heightmap,
    robot: Robot,
    files: Sequence[Path],
    *,
    out: Path,
    charge: bool = False,
    resume: bool = False,
    progress: Callable[[float], None] | None = None,
    **learner: Any,
) -> TrainedModel:
    """Train on runs over one heightmap, with the fields of `Learner`."""
    site = Site(heightmap, tuple(files), robot)
    return train_on_sites([site], Learner(**learner), out=out, charge=charge, resume=resume, progress=progress)


def evaluate_on_runs(
    predictor: Predictor, heightmap: Heightmap, robot: Robot, files: Sequence[Path], *, charge: bool = False
) -> dict[str, Any]:
    """Judge a predictor by runs over one heightmap."""
    return evaluate_on_sites(predictor, [Site(heightmap, tuple(files), robot)], charge=charge)
