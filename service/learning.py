"""From measured runs to a model, and from a model to how well it predicts them: what `train` and `evaluate` call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from model.energy.artifact import Artifact, load_artifact, read_artifact, save_artifact
from model.energy.evaluation import errors, evaluate_segments
from model.energy.examples import RESNET_SIZE, cut_examples
from model.energy.predictor import Predictor
from model.energy.resnet import ResNetEnergy, load_backbone
from model.energy.training import (
    Network,
    TrainingOptions,
    predicted_energy,
    train_network,
)
from model.errors import InputError, RunsError
from model.loop.calibrated import CalibratedPredictor
from model.loop.runs import Run, read_run
from model.loop.segments import Segments, concatenate, cut_segments
from model.robot import Robot
from model.terrain.heightmap import Heightmap
from service.calibrating import keep_base_runs
from service.pretraining import MAX_TURN_RAD

LEARNING_RATE = {"compact": 1e-3, "resnet18": 1e-4}  # the latter is the paper's (section V-A)
CHECKPOINT = "training.pt"
BATCH = 32  # a day of driving is about a thousand segments: large batches would leave too few steps


@dataclass(frozen=True)
class TrainedModel:
    """What a training left. segments : learned from and held out; held_out : errors on `held_out_runs`."""

    version: str
    segments: int
    runs: list[str]
    held_out_runs: list[str]
    held_out: dict[str, Any]
    epochs: int


def read_segments(files: Sequence[Path], robot: Robot, *, crs: str | None) -> tuple[list[Run], Segments]:
    """Every run, and their 1 m segments in joules.

    Of a run without voltage the energy is its charge times the robot's nominal voltage. Raises RunsError.
    """
    if not files:
        raise RunsError("there is no run to read: no file has such a name")
    runs = [read_run(file, crs=crs) for file in files]
    parts = []
    for run in runs:
        charge = run.voltage_v is None
        cut = cut_segments(run, charge=charge)
        parts.append(replace(cut, energy_j=cut.energy_j * robot.nominal_voltage_v, charge=False) if charge else cut)
    return runs, concatenate(parts)


def train_on_runs(
    heightmap: Heightmap,
    robot: Robot,
    files: Sequence[Path],
    *,
    out: Path,
    architecture: str = "compact",
    start_from: Path | None = None,
    backbone: Path | None = None,
    patch_size: int = RESNET_SIZE,
    epochs: int = 60,
    seed: int = 0,
    resume: bool = False,
    progress: Callable[[float], None] | None = None,
) -> TrainedModel:
    """Train on measured runs over a heightmap and write the model's folder `out`; segments in turns are left out.

    start_from : a model's folder to fine-tune; backbone : a ResNet18 file with torchvision's names (resnet18 only);
    patch_size : rows and columns of a resnet18 patch (256 in the paper); resume : go on where a training of the same
    data and settings was cut off (its state is kept in `out` until it ends). A share of the runs is held out whole; the
    best weights on those are kept. Raises InputError, ModelError, RunsError.
    """
    if backbone is not None and (architecture != "resnet18" or start_from is not None):
        raise InputError("weights for a backbone go with the resnet18 architecture, and not with a model to start from")
    runs, segments = read_segments(files, robot, crs=heightmap.frame.crs)
    straight = segments.take(np.abs(segments.heading_change_rad) < MAX_TURN_RAD)
    examples = cut_examples(
        heightmap, robot, straight.x, straight.y, straight.heading_rad, straight.energy_j,
        run=straight.run, architecture=architecture, size=patch_size,
    )  # fmt: skip
    parent = read_artifact(start_from) if start_from is not None else None
    start: Network | None = parent.net if parent is not None else None
    if backbone is not None:
        start = ResNetEnergy()
        start.backbone = load_backbone(backbone)
    options = TrainingOptions(epochs=epochs, batch=BATCH, learning_rate=LEARNING_RATE.get(architecture, 1e-3))
    checkpoint = out / CHECKPOINT
    out.mkdir(parents=True, exist_ok=True)
    if not resume:
        checkpoint.unlink(missing_ok=True)
    result = train_network(
        examples, architecture=architecture, seed=seed, start_from=start, options=options, checkpoint=checkpoint,
        progress=progress,
    )  # fmt: skip
    held = examples.select(np.isin(examples.run, result.held_out_runs))
    held_out = errors(predicted_energy(result.net, held), held.energy_j, held.run)
    names = [segments.runs[k] for k in result.held_out_runs]
    training = {
        "data": "measured runs",
        "data_hash": examples.data_hash,
        "heightmap": heightmap.data_hash,
        "robot": robot.as_dict(),
        "runs": list(segments.runs),
        "held_out_runs": names,
        "held_out": held_out,
        "seed": seed,
        "epochs": result.epochs,
        "started_from": str(start_from or backbone or ""),
    }
    size = {"size": patch_size} if architecture == "resnet18" else {}
    domain = examples.domain() if parent is None else parent.domain.joined(examples.domain())
    version = save_artifact(out, Artifact(result.net, domain, training=training, **size))
    checkpoint.unlink(missing_ok=True)
    if all(run.voltage_v is not None for run in runs):
        keep_base_runs(out, load_artifact(out), heightmap, robot, segments)
    return TrainedModel(version, len(examples), list(segments.runs), names, held_out, result.epochs)


def evaluate_on_runs(predictor: Predictor, heightmap: Heightmap, robot: Robot, files: Sequence[Path]) -> dict[str, Any]:
    """Errors of a predictor on measured runs over a heightmap, JSON-able.

    The numbers of `model.energy.training.errors`, with runs named; `unknown`: segments on unknown ground; `repairs`
    and `left_out`: what was mended in the logs, and what was not made a segment, by rule. Raises RunsError, InputError.
    """
    runs, segments = read_segments(files, robot, crs=heightmap.frame.crs)
    if isinstance(predictor, CalibratedPredictor):
        predicted = predictor.segment_energy(segments, heightmap, robot)
        known = np.isfinite(predicted)
        found = errors(predicted[known], segments.energy_j[known], segments.run[known])
        found |= {"unknown": int((~known).sum())}
    else:
        found = evaluate_segments(
            predictor, heightmap, robot, segments.x, segments.y, segments.heading_rad, segments.energy_j,
            run=segments.run,
        )  # fmt: skip
    by_run = {segments.runs[int(k)]: value for k, value in found.pop("route_relative_errors").items()}
    return {
        "model": predictor.name,
        **found,
        "route_relative_errors": by_run,
        "repairs": {run.name: run.repairs for run in runs if run.repairs},
        "left_out": segments.left_out,
        "warnings": predictor.warnings(heightmap, robot),
    }
