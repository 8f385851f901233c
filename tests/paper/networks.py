"""How the reproduction trains networks on many segments, and the paper's network; and how it asks them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import save_file

from joulemap.model.energy.architectures.compact.architecture import Compact
from joulemap.model.energy.architectures.network import Network
from joulemap.model.energy.architectures.resnet18 import ResNet18, ResNetEnergy
from joulemap.model.energy.artifact import CONFIG_FILE, Artifact, read_artifact, save_artifact
from joulemap.model.energy.examples import MAX_TURN_RAD, Examples, concatenate, cut_examples
from joulemap.model.energy.prediction import predict_segments
from joulemap.model.energy.predictor import SHIPPED_WEIGHTS, Predictor, load_predictor
from joulemap.model.errors import ModelError
from joulemap.model.field.drives import drive_along, random_waypoints
from joulemap.model.field.robot_dynamics import FieldRobot
from joulemap.model.field.simulation import simulate_segments
from joulemap.model.field.sites import SURVEYS, random_site
from joulemap.model.robot import Robot
from joulemap.model.training.fold_fits import CHECKPOINT
from joulemap.model.training.optimisation import TrainingOptions, train_network
from tests.paper.measured import Measured
from tests.paper.profiles import STRATEGIES, Profile

FloatArray = NDArray[np.float64]

SHIPPED = Path(str(SHIPPED_WEIGHTS))
"""Folder of the shipped network."""
BACKBONE_FILE = "backbone.safetensors"

_MORE_BATCH = 128  # twenty times the data do not need small batches
_PAPER_BATCH = 32
_BACKBONE_SLOPE_DEG = 12.0
_BACKBONE_WAYPOINTS = 12


def compact_on_more(examples: Examples, *, out: Path, seed: int, epochs: int) -> Predictor:
    """Train the shipped network on very many segments, unless that is done already."""
    if not (out / CONFIG_FILE).exists():
        parent = read_artifact(SHIPPED)
        options = TrainingOptions(
            epochs=epochs, patience=epochs, batch=_MORE_BATCH, learning_rate=Compact.training.learning_rate
        )
        result = train_network(examples, seed=seed, start_from=parent.net, options=options)
        save_artifact(out, Artifact(result.net, parent.domain.joined(examples.domain())))
    return load_predictor(out)


def pretrained_backbone(out: Path, *, profile: Profile, seed: int) -> Path:
    """Train a backbone on the energy of one nominal robot on random sites, unless it is there already.

    Result: file of weights with torchvision's names.
    """
    file = out / BACKBONE_FILE
    if file.exists():
        return file
    truth = FieldRobot.nominal(Robot())
    parts = []
    for number in range(profile.backbone_sites):
        rng = np.random.default_rng([seed, 4, number])
        site = random_site(rng, max_slope_deg=_BACKBONE_SLOPE_DEG, survey=SURVEYS["scanner"])
        points = random_waypoints(site.drivable, _BACKBONE_WAYPOINTS, rng)
        drive = drive_along(points, speed_mps=truth.declared.speed_mps, rng=rng)
        found = simulate_segments(site, truth, drive, rng=rng)
        keep = np.abs(found.heading_change_rad) < MAX_TURN_RAD
        ends = np.array_split(np.flatnonzero(keep), 2)  # two runs per site: a single site can then be trained on, too
        for half, mine in enumerate(ends):
            parts.append(
                cut_examples(
                    site.survey,
                    truth.declared,
                    found.x[mine],
                    found.y[mine],
                    found.heading_rad[mine],
                    found.energy_j[mine],
                    run=2 * number + half,
                    architecture=ResNet18.name,
                    size=profile.resnet_size,
                )
            )
    net = _trained_resnet(
        concatenate(parts),
        start=None,
        epochs=profile.backbone_epochs,
        seed=seed,
        frozen=False,
        checkpoint=out / CHECKPOINT,
        learning_rate=1e-3,
    )
    partial = file.with_name(f".{file.name}.partial")
    save_file({key: value.contiguous() for key, value in net.backbone.state_dict().items()}, partial)
    partial.replace(file)
    (out / CHECKPOINT).unlink(missing_ok=True)
    return file


def trained_resnet(
    measured: Measured,
    robot: Robot,
    *,
    out: Path,
    strategy: str,
    size: int,
    epochs: int,
    seed: int,
    start: Path | None,
) -> Predictor:
    """Train the paper's network with the paper's loss and learning rate, unless it is there already.

    `start`: a file with a backbone's weights, or the folder of such a network; a network from scratch needs neither.
    """
    if strategy not in STRATEGIES:
        raise ModelError(f"no training strategy {strategy!r}: known are {', '.join(STRATEGIES)}", name=strategy)
    if not (out / CONFIG_FILE).exists():
        torch.manual_seed(seed)  # of the head on a backbone
        straight = measured.segments.take(measured.straight)
        examples = cut_examples(
            measured.heightmap,
            robot,
            straight.x,
            straight.y,
            straight.heading_rad,
            straight.energy_j,
            run=straight.run,
            architecture=ResNet18.name,
            size=size,
        )
        net = _trained_resnet(
            examples,
            start=_start(strategy, start),
            epochs=epochs,
            seed=seed,
            frozen=strategy == "frozen",
            checkpoint=out / CHECKPOINT,
        )
        save_artifact(out, Artifact(net, examples.domain(), size))
        (out / CHECKPOINT).unlink(missing_ok=True)
    return load_predictor(out)


def _start(strategy: str, start: Path | None) -> ResNetEnergy | None:
    if strategy == "scratch":
        return None
    if start is None:
        raise ModelError(f"the strategy {strategy!r} needs a backbone's weights")
    return _resnet(read_artifact(start).net) if start.is_dir() else ResNet18().from_backbone(start)


def _trained_resnet(
    examples: Examples,
    *,
    start: ResNetEnergy | None,
    epochs: int,
    seed: int,
    frozen: bool,
    checkpoint: Path,
    learning_rate: float = ResNet18.training.learning_rate,
) -> ResNetEnergy:
    checkpoint.parent.mkdir(parents=True, exist_ok=True)
    options = TrainingOptions(
        epochs=epochs,
        patience=epochs,
        batch=_PAPER_BATCH,
        learning_rate=learning_rate,
        augment=False,
        freeze_backbone=frozen,
        loss="mse",
    )
    result = train_network(
        examples, architecture=ResNet18.name, seed=seed, start_from=start, options=options, checkpoint=checkpoint
    )
    return _resnet(result.net)


def _resnet(net: Network) -> ResNetEnergy:
    if not isinstance(net, ResNetEnergy):
        raise ModelError(f"the reproduction needs a {ResNet18.name}, not a {net.architecture}")
    return net


def predicted_j(predictor: Predictor, measured: Measured, robot: Robot) -> FloatArray:
    """Predict the energy of every segment of a drive. Result (n,): energy [J]; NaN on unknown ground."""
    return predict_segments(predictor, measured.heightmap, robot, measured.segments).energy_j


def described(backbone: Path | None) -> dict[str, Any]:
    """Say where the backbone of the paper's network comes from. Result: one sentence under `backbone`, JSON-able."""
    if backbone is None:
        return {"backbone": "pre-trained on simulated terrain: another robot on random sites (no ImageNet file given)"}
    return {"backbone": f"read from {backbone.name}"}
