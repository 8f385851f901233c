"""The compact network on the paper's segments: cross-fitted as `joulemap train` does, with turning as its only cost.

`joulemap train` uses all that a robot drives and fits what turning, time and speeding up cost beside the network. The
paper leaves out segments that turn, so that here the network learns from straight chords alone.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.architectures.compact.architecture import Compact
from joulemap.model.energy.artifact import CONFIG_FILE, Artifact, predictor_of, read_artifact, save_artifact
from joulemap.model.energy.drive_costs import DriveCosts
from joulemap.model.energy.examples import MAX_TURN_RAD, Examples, concatenate, cut_examples
from joulemap.model.energy.mean_level import mean_level
from joulemap.model.energy.prediction import predict_segments
from joulemap.model.energy.predictor import Predictor, load_predictor
from joulemap.model.energy.uncertainty import FEWEST, LEAST_SHARE
from joulemap.model.robot import Robot
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.training.fold_fits import CHECKPOINT, FOLDS
from joulemap.model.training.optimisation import TrainingOptions, averaged, choose_held_out, train_network
from tests.paper.measured import Measured

FloatArray = NDArray[np.float64]


def trained_compact(
    measured: Measured, robot: Robot, *, out: Path, start_from: Path | None, seed: int, epochs: int
) -> Predictor:
    """Train a compact network, unless it is there already. `start_from`: a model's folder, None for a fresh network."""
    if not (out / CONFIG_FILE).exists():
        out.mkdir(parents=True, exist_ok=True)
        save_artifact(out, _fitted(measured, robot, out, start_from, seed, epochs))
        for checkpoint in out.glob(f"*.{CHECKPOINT}"):
            checkpoint.unlink()
    return load_predictor(out)


def _fitted(measured: Measured, robot: Robot, out: Path, start_from: Path | None, seed: int, epochs: int) -> Artifact:
    ground, segments, usual = measured.heightmap.without_noise, measured.segments, Compact.training
    examples = _from_all_directions(ground, robot, segments.take(measured.straight), seed)
    turned_rad = round(float(segments.turned_abs_rad[measured.straight].mean()), 5)
    domain = replace(examples.domain(), turned_rad=turned_rad)
    options = TrainingOptions(epochs=epochs, batch=usual.batch, learning_rate=usual.learning_rate)
    if start_from is None:
        start, folds = None, [choose_held_out(examples, options, seed)]
    else:
        parent = read_artifact(start_from)
        start, domain = parent.net, parent.domain.joined(domain)
        runs = np.random.default_rng(seed).permutation(np.unique(examples.run))
        folds = [fold.tolist() for fold in np.array_split(runs, min(FOLDS, runs.size))]
        options = replace(options, learning_rate=usual.fine_tuning_rate or usual.learning_rate, keep_last=True)
    nets, energy = [], np.full(len(segments), np.nan)  # of segments that a fit has not seen
    for number, fold in enumerate(folds):
        net = train_network(
            examples,
            architecture=Compact.name,
            seed=seed,
            start_from=start,
            held_out_runs=fold,
            options=options,
            checkpoint=out / f"{number}.{CHECKPOINT}",
        ).net
        mine = np.isin(segments.run, fold)
        predictor = predictor_of(Artifact(net, domain))
        energy[mine] = predict_segments(predictor, ground, robot, segments.take(mine)).energy_j
        nets.append(net)
    turned = segments.turned_abs_rad - turned_rad
    turn = _turn_j_per_rad(segments, energy, turned)
    energy += turn * turned
    known = np.isfinite(energy)
    declared = robot.idle_power_w * segments.duration_s + robot.turn_j_per_rad * segments.turned_abs_rad
    factor = mean_level(segments.energy_j[known], energy[known], segments.run[known], beside=declared[known]).factor
    net, costs = averaged(nets), DriveCosts(turn_j_per_rad=turn)
    if factor != 1.0:
        net, costs = Compact().scaled(net, factor), costs.scaled(factor)
    return Artifact(net, domain, costs=costs)


def _from_all_directions(ground: Heightmap, robot: Robot, straight: Segments, seed: int) -> Examples:
    """The segments as they were driven, and turned with their ground by random angles."""
    copies, n = Compact.training.copies, len(straight)
    angles = np.random.default_rng([seed, n]).uniform(0.0, 2.0 * math.pi, (copies - 1, n))
    places = straight.x, straight.y, straight.heading_rad, straight.energy_j
    return concatenate(
        [
            cut_examples(ground, robot, *places, run=straight.run, architecture=Compact.name, turned_rad=turned)
            for turned in (np.zeros(n), *angles)
        ]
    )


def _turn_j_per_rad(segments: Segments, predicted_j: FloatArray, turned: FloatArray) -> float:
    """Energy of turning [J/rad] beyond straight driving, at least 0: the weighted least-squares slope of the residual.

    turned : (n,) turn of each segment beyond the mean turn of straight ones [rad]. Weights are one over the square of
    the prediction. The idle power of the additional time that turns take is included.
    """
    rest = segments.energy_j - predicted_j
    use = np.isfinite(rest) & (np.abs(segments.heading_change_rad) >= MAX_TURN_RAD)
    if use.sum() < FEWEST:
        return 0.0
    rest = rest[use] - np.nanmedian(rest[~use]) if (~use).any() else rest[use]
    weight = 1.0 / np.maximum(predicted_j[use], LEAST_SHARE * np.nanmedian(predicted_j)) ** 2
    slope = float((weight * rest * turned[use]).sum() / (weight * turned[use] ** 2).sum())
    return round(max(slope, 0.0), 3) if math.isfinite(slope) else 0.0
