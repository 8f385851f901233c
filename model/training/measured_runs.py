"""From measured runs to a trained model: the work of `joulemap train`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from joulemap.model.energy.architectures import DEFAULT_ARCHITECTURE, find_architecture
from joulemap.model.energy.architectures.contract import Architecture, check_start
from joulemap.model.energy.architectures.network import Network
from joulemap.model.energy.artifact import Artifact, read_artifact, save_artifact
from joulemap.model.energy.mean_level import MeanLevel, mean_level
from joulemap.model.energy.prediction import Prediction
from joulemap.model.energy.residuals_of_runs import keep_base_runs
from joulemap.model.errors import InputError
from joulemap.model.runs.record import RECORD_FILE
from joulemap.model.runs.sites import Site, read_sites
from joulemap.model.training.evaluation import segment_errors, segment_spread
from joulemap.model.training.fold_fits import NOT_TUNED, FoldFits
from joulemap.model.training.model_card import card_of_runs
from joulemap.model.training.optimisation import TrainingOptions
from joulemap.model.training.run_record import runs_record

CARD_FILE = "MODEL_CARD.md"
_RECORDED = ("held_out_runs", "held_out", "baselines", "coverage", "warnings", "stopped_by_held_out", "epochs")


@dataclass(frozen=True)
class TrainedModel:
    """The result of a training."""

    version: str  # Of the model
    segments: int  # Segments on known ground that networks learned from, held-out ones included
    runs: list[str]  # All runs
    held_out_runs: list[str]  # Runs that `held_out` is about, each predicted by a network that had not seen it
    held_out: dict[str, Any]  # Errors on them, as `evaluation.errors`
    epochs: int  # Passes over the data
    turn_j_per_rad: float  # Energy of turning in plans beyond what the robot's file declares [J/rad]
    # Whether the held-out runs also decided when the training stopped, which makes the errors a little too small
    stopped_by_held_out: bool
    keeps_runs: bool  # Whether the model's folder keeps its runs as the baseline of later calibrations
    drive_costs: dict[str, Any]  # Costs of turning, time and speeding up, as `DriveCosts.as_dict`
    # Errors of simple models on the same segments, each fitted without the run that it predicts, as
    # `evaluation.errors`
    baselines: dict[str, dict[str, Any]]
    mean: MeanLevel  # Measured over predicted energy of the held-out runs before the model was multiplied by the factor
    coverage: dict[str, Any]  # Metres driven, used, and left out by reason, as `Segments.coverage`
    warnings: list[str]  # What the user must not overlook


@dataclass(frozen=True)
class Learner:
    """What is trained, and from what."""

    architecture: str = DEFAULT_ARCHITECTURE
    start_from: Path | None = None  # folder of a model; None for random weights
    backbone: Path | None = None  # file of weights
    patch_size: int | None = None  # rows of the input; None: those of `start_from`, or the usual ones
    epochs: int | None = None  # None: the usual ones of the architecture
    seed: int = 0

    def __post_init__(self) -> None:
        if self.backbone is not None and self.start_from is not None:
            raise InputError("weights for a backbone do not go together with a model to start from")

    def begin(self, kind: Architecture[Any], *, mapped: bool) -> tuple[Artifact | None, Network | None, int]:
        """Return the model and the network to start from, where there are any, and the size of the input."""
        parent = read_artifact(self.start_from) if self.start_from is not None else None
        start: Network | None = parent.net if parent is not None else None
        check_start(kind, start)
        if not mapped:
            start = _without_shape(kind, start)
        if self.backbone is not None:
            start = kind.from_backbone(self.backbone)
        size = kind.input_size(self.patch_size or (parent.size if parent is not None else None))
        if parent is not None and size != parent.size:
            words = f"the network of {self.start_from} reads patches of {parent.size} rows, not {size}"
            raise InputError(words, size=size)
        return parent, start, size


def train_on_sites(
    sites: Sequence[Site],
    learner: Learner,
    *,
    out: Path,
    charge: bool = False,
    resume: bool = False,
    progress: Callable[[float], None] | None = None,
) -> TrainedModel:
    """Train on measured runs over their heightmaps and write the model's folder.

    First a regression on all metres finds what turning, time and speeding up cost, and by how much the network to start
    from is off in level, climbing and shape (`cost_regression`). Then the network learns what these leave.

    A network whose architecture says so is cross-fitted when it starts from another one: the runs are divided whole
    into `fold_fits.FOLDS` parts, regression and network are fitted without each part, and the model is the mean of the
    weights with the costs of all runs. Every run is then predicted by a fit that has not seen it, which gives held-out
    errors and the model's spread without losing a run for training. Otherwise a share of the runs is held out whole,
    and training stops when the error on them no longer improves.

    Runs without a map show rolling and climbing, but not the shape of the ground: the network's part for the shape is
    taken away, and the regression alone is fitted.
    """
    kind = find_architecture(learner.architecture)
    measured = read_sites(sites, charge=charge)
    mapped = all(site.placed for site in sites)
    parent, start, size = learner.begin(kind, mapped=mapped)
    fits = FoldFits(measured, kind, size, start, parent, out, learner.seed)
    if not resume:
        fits.forget()
    out.mkdir(parents=True, exist_ok=True)
    usual = kind.training
    crossed = (usual.cross_fitted and parent is not None) or not mapped
    rate = (usual.fine_tuning_rate if crossed else None) or usual.learning_rate
    options = TrainingOptions(
        epochs=(learner.epochs or usual.epochs) if mapped else 0, batch=usual.batch, learning_rate=rate
    )
    if crossed:
        net, passes = fits.cross_fit(replace(options, keep_last=True), progress)
    else:
        net, passes = fits.fit(options, progress)
    judged = fits.judged()
    known = judged.known
    level = mean_level(
        judged.segments.energy_j[known],
        judged.energy_j[known],
        fits.part[judged.index][known],
        beside=judged.beside_j[known],
    )
    if level.factor != 1.0 and (scaled := kind.scaled(net, level.factor)) is not None:
        judged, net = judged.scaled(level.factor), scaled
    elif not level.agrees:
        level = replace(level, factor=1.0)
    costs = judged.costs
    held_out = segment_errors(judged.energy_j, judged.segments)
    said = Prediction(judged.energy_j, judged.std_j, judged.traction_per_m)
    segments, robot = measured.segments, sites[0].robot
    names = [segments.runs[int(k)] for k in np.unique(judged.segments.run)]
    baselines = fits.baseline_errors(judged)
    warnings = _warnings(held_out, baselines, sites)
    if not mapped:
        warnings.append("the runs have no map: in this model the shape of the ground, beyond its slope, costs nothing")
    if not level.agrees:
        done = "made up for" if level.factor != 1.0 else "left, because this architecture cannot be multiplied"
        warnings.append(f"measured sums of left-out runs were {level.ratio:.1%} of the predicted ones, which is {done}")
    (out / RECORD_FILE).unlink(missing_ok=True)  # an earlier model's, in the same folder
    kept = None
    if len(sites) == 1 and all(run.has_energy for run in measured.runs) and not charge:
        kept = keep_base_runs(out, sites[0].ground, robot, judged.segments, judged.traction_per_m, judged.energy_j)
    found = TrainedModel(
        "",
        fits.known,
        list(segments.runs),
        names,
        held_out,
        passes,
        round(costs.planned_turn_j_per_rad(robot), 3),
        not crossed,
        kept is not None,
        costs.as_dict(),
        baselines,
        level,
        segments.coverage(),
        warnings,
    )
    training = {
        "data": "measured runs",
        "data_hash": fits.examples.data_hash,
        "heightmap": sites[0].heightmap.data_hash,
        "heightmaps": [site.heightmap.data_hash for site in sites],
        "robot": robot.as_dict(),
        **runs_record(measured.runs),
        **{name: getattr(found, name) for name in _RECORDED},
        "mean": level.as_dict(),
        "seed": learner.seed,
        "started_from": str(learner.start_from or learner.backbone or ""),
        "base_runs": kept,
    }
    artifact = replace(fits.artifact(net, costs), spread=segment_spread(said, judged.segments), training=training)
    version = save_artifact(out, artifact)
    card = card_of_runs(version, training, fits.domain, costs)
    (out / CARD_FILE).write_text(card, encoding="utf-8")
    fits.forget()
    return replace(found, version=version)


def _without_shape(kind: Architecture[Any], start: Network | None) -> Network:
    """What runs without a map can be fitted with."""
    if start is None or not kind.shape_free:
        learner = "a network with random weights" if kind.shape_free else kind.name
        raise InputError(
            f"the runs have no map, and {learner} learns from the shape of the ground: give the heightmap, or train "
            "`compact`, starting from `default` or your own compact model",
            architecture=kind.name,
        )
    return kind.adapted(start, level=0.0, climb=0.0, shape=-1.0)


def _warnings(held_out: dict[str, Any], baselines: dict[str, dict[str, Any]], sites: Sequence[Site]) -> list[str]:
    found = []
    if baselines:
        others = {name: found for name, found in baselines.items() if name != NOT_TUNED}
        name, best = min(others.items(), key=lambda item: float(item[1]["rmse_j"]))
        if best["rmse_j"] < held_out["rmse_j"]:
            found.append(
                f"{name} predicts runs that were left out better than this model (root mean square error "
                f"{best['rmse_j']:.0f} J against {held_out['rmse_j']:.0f} J per segment): drive more metres before you "
                "rely on it, or calibrate `physics` on these runs instead"
            )
    masses = sorted({site.robot.mass_kg for site in sites})
    if len(masses) > 1:
        listed = ", ".join(f"{mass:g}" for mass in masses)
        found.append(
            f"robots of {listed} kg drove: their costs of turning and speeding up are taken as proportional to the mass"
        )
    return found
