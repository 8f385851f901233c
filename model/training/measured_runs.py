"""From measured runs to a model: what `train` calls."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.architectures import DEFAULT_ARCHITECTURE, find_architecture
from joulemap.model.energy.architectures.contract import Architecture, Network, check_start
from joulemap.model.energy.artifact import Artifact, predictor_of, read_artifact, save_artifact
from joulemap.model.energy.domain import Domain
from joulemap.model.energy.examples import Examples, cut_examples
from joulemap.model.energy.examples import concatenate as concatenated
from joulemap.model.energy.uncertainty import FEWEST, LEAST_SHARE, Spread, fit_spread
from joulemap.model.errors import InputError
from joulemap.model.loop.prediction import Prediction, joined, predict_segments
from joulemap.model.loop.record import RECORD_FILE
from joulemap.model.loop.residuals_of_runs import keep_base_runs
from joulemap.model.robot import Robot
from joulemap.model.runs.consistency import check_runs
from joulemap.model.runs.files import read_segments
from joulemap.model.runs.segments import Segments
from joulemap.model.terrain.heightmap import Heightmap
from joulemap.model.training.evaluation import errors
from joulemap.model.training.optimisation import TrainingOptions, averaged, train_network
from joulemap.model.training.pretraining import MAX_TURN_RAD
from joulemap.model.training.run_record import runs_record

CHECKPOINT = "training.pt"
FOLDS = 5
"""Parts into which the runs are divided for cross-fitting, whole runs at a time."""
_STRETCHES = 4  # of a single run, each then held out whole


@dataclass(frozen=True)
class TrainedModel:
    """What a training left. segments : learned from and held out; held_out : errors on `held_out_runs`, each predicted
    by a network that had not seen it. stopped_by_held_out : whether the same runs said when to stop, which flatters
    the errors. turn_j_per_rad : what turning took beyond straight driving [J/rad]. keeps_runs : whether its folder
    keeps its runs, for calibrations to hold later ones against.
    """

    version: str
    segments: int
    runs: list[str]
    held_out_runs: list[str]
    held_out: dict[str, Any]
    epochs: int
    turn_j_per_rad: float
    stopped_by_held_out: bool
    keeps_runs: bool


def train_on_runs(
    heightmap: Heightmap,
    robot: Robot,
    files: Sequence[Path],
    *,
    out: Path,
    architecture: str = DEFAULT_ARCHITECTURE,
    start_from: Path | None = None,
    backbone: Path | None = None,
    patch_size: int | None = None,
    epochs: int | None = None,
    seed: int = 0,
    charge: bool = False,
    resume: bool = False,
    progress: Callable[[float], None] | None = None,
) -> TrainedModel:
    """Train on measured runs over a heightmap and write the model's folder `out`.

    A compact network that starts from another (`start_from`, a model's folder) is cross-fitted: the runs are dealt
    whole into `FOLDS` parts, one network is fine-tuned without each, and the model is the mean of their weights. So
    every run is predicted by a network that has not seen it: that gives the held-out errors and the model's spread,
    and no run is lost to the model. Otherwise a share of the runs is held out whole, and training stops when those no
    longer improve. Networks learn from straight segments; what turning takes beyond them is fitted to the held-out
    ones.

    backbone : a ResNet18 file with torchvision's names (resnet18 only); patch_size : rows and columns of a resnet18
    patch (256 in the paper) [those of the network it starts from, else 64]; epochs : at most [12 for compact, 60 for
    resnet18]; charge : as `read_segments`; resume : go on where a training of the same data and settings was cut off
    (its state is kept in `out` until it ends). Raises InputError, ModelError, RunsError.
    """
    kind = find_architecture(architecture)
    if backbone is not None and start_from is not None:
        raise InputError("weights for a backbone do not go together with a model to start from")
    runs, segments = read_segments(files, robot, crs=heightmap.frame.crs, charge=charge)
    check_runs(segments, heightmap, robot)
    parent = read_artifact(start_from) if start_from is not None else None
    start: Network | None = parent.net if parent is not None else None
    check_start(kind, start)
    if backbone is not None:
        start = kind.from_backbone(backbone)
    size = kind.input_size(patch_size or (parent.size if parent is not None else None))
    if parent is not None and size != parent.size:
        raise InputError(f"the network of {start_from} reads patches of {parent.size} rows, not {size}", size=size)
    work = _Training(heightmap, robot, segments, kind, size, start, parent.domain if parent else None, out, seed)
    if not resume:
        work.forget()
    out.mkdir(parents=True, exist_ok=True)
    usual = kind.training
    crossed = usual.cross_fitted and parent is not None
    rate = (usual.fine_tuning_rate if crossed else None) or usual.learning_rate
    options = TrainingOptions(epochs=epochs or usual.epochs, batch=usual.batch, learning_rate=rate)
    if crossed:
        net, passes = work.cross_fit(replace(options, keep_last=True), seed, progress)
    else:
        net, passes = work.fit(options, seed, progress)
    apart, said = work.held_out()
    turned = np.abs(apart.heading_change_rad) - work.domain.turned_rad
    turn = _turning(apart, said.energy_j, turned)
    predicted = said.energy_j + turn * turned
    known = np.isfinite(predicted)
    held_out = errors(predicted[known], apart.energy_j[known], apart.run[known])
    spread = Spread()
    if known.sum() >= FEWEST and said.std_j is not None:
        spread = fit_spread(apart.energy_j[known], predicted[known], said.std_j[known], apart.run[known])
    names = [segments.runs[int(k)] for k in np.unique(apart.run)]
    training = {
        "data": "measured runs",
        "data_hash": work.examples.data_hash,
        "heightmap": heightmap.data_hash,
        "robot": robot.as_dict(),
        **runs_record(runs),
        "held_out_runs": names,
        "held_out": held_out,
        "stopped_by_held_out": not crossed,
        "seed": seed,
        "epochs": passes,
        "started_from": str(start_from or backbone or ""),
    }
    artifact = replace(work.artifact(net), spread=spread, turn_j_per_rad=turn, training=training)
    version = save_artifact(out, artifact)
    (out / RECORD_FILE).unlink(missing_ok=True)  # an earlier model's, in the same folder
    keeps_runs = False
    if all(run.voltage_v is not None for run in runs) and not charge:
        keeps_runs = keep_base_runs(out, heightmap, robot, apart, said.traction_per_m)
    work.forget()
    return TrainedModel(
        version, work.known, list(segments.runs), names, held_out, passes, turn, not crossed, keeps_runs
    )


class _Training:
    """The examples of one training, and the two ways to fit a network to them."""

    def __init__(
        self,
        heightmap: Heightmap,
        robot: Robot,
        segments: Segments,
        kind: Architecture[Any],
        patch_size: int,
        start: Network | None,
        learned: Domain | None,
        out: Path,
        seed: int,
    ) -> None:
        self.heightmap, self.robot, self.segments, self.out = heightmap, robot, segments, out
        self.kind, self.start, self.patch_size = kind, start, patch_size
        self.part = _parts(segments)
        straight = np.flatnonzero(np.abs(segments.heading_change_rad) < MAX_TURN_RAD)
        s = segments.take(straight)
        payload = np.nan_to_num(s.extras.get("payload", np.zeros(len(s))))
        angles = np.random.default_rng([seed, len(s)]).uniform(0.0, 2.0 * math.pi, (kind.training.copies - 1, len(s)))
        turns = np.concatenate([np.zeros((1, len(s))), angles])
        seen = [
            cut_examples(
                heightmap,
                robot,
                s.x,
                s.y,
                s.heading_rad,
                s.energy_j,
                run=self.part[straight],
                payload_kg=payload,
                architecture=kind.name,
                size=patch_size,
                turned_rad=turned,
            )
            for turned in turns
        ]
        self.known = len(seen[0])  # a turned square has corners elsewhere: at the map's edge it may be unknown
        if self.known == 0:
            raise InputError(
                f"none of the {len(segments)} segments goes straight over ground that the heightmap knows",
                segments=len(segments),
            )
        self.examples: Examples = concatenated(seen)
        carried = (min(0.0, float(payload.min())), max(0.0, float(payload.max())))
        self.domain = replace(self.examples.domain(), payload_kg=carried)
        if learned is not None:
            self.domain = learned.joined(self.domain)
        self.domain = replace(self.domain, turned_rad=round(float(np.abs(s.heading_change_rad).mean()), 5))
        self._said: list[tuple[NDArray[np.int64], Prediction]] = []  # of segments by networks that had not seen them

    def artifact(self, net: Network) -> Artifact:
        return Artifact(net, self.domain, self.patch_size)

    def fit(self, options: TrainingOptions, seed: int, progress: Callable[[float], None] | None) -> tuple[Network, int]:
        """(one network, stopped by held-out parts, which it is then judged on; epochs)."""
        result = train_network(
            self.examples,
            architecture=self.kind.name,
            seed=seed,
            start_from=self.start,
            options=options,
            checkpoint=self.out / CHECKPOINT,
            progress=progress,
        )
        self._judge(result.net, result.held_out_runs)
        return result.net, result.epochs

    def cross_fit(
        self, options: TrainingOptions, seed: int, progress: Callable[[float], None] | None
    ) -> tuple[Network, int]:
        """(the mean of a network without each fold of the parts, each judged on its fold; epochs)."""
        parts = np.random.default_rng(seed).permutation(np.unique(self.examples.run))
        folds = [fold.tolist() for fold in np.array_split(parts, min(FOLDS, parts.size))]
        nets = []
        for k, fold in enumerate(folds):
            result = train_network(
                self.examples,
                architecture=self.kind.name,
                seed=seed,
                start_from=self.start,
                held_out_runs=fold,
                options=options,
                checkpoint=self._checkpoint(k),
                progress=None if progress is None else _share(progress, k, len(folds)),
            )
            nets.append(result.net)
            self._judge(result.net, fold)
        return averaged(nets), options.epochs

    def _judge(self, net: Network, parts: Sequence[int]) -> None:
        mine = np.flatnonzero(np.isin(self.part, parts))
        predictor = predictor_of(self.artifact(net), {}, name="")
        said = predict_segments(predictor, self.heightmap, self.robot, self.segments.take(mine))
        self._said.append((mine, said))

    def held_out(self) -> tuple[Segments, Prediction]:
        """All segments that were held out, turns too, in driving order; what networks that had not seen them say."""
        mine = np.concatenate([segments for segments, _ in self._said])
        order = np.argsort(mine)
        return self.segments.take(mine[order]), joined([said for _, said in self._said]).take(order)

    def forget(self) -> None:
        """Remove the state of trainings that were cut off."""
        for k in range(FOLDS):
            self._checkpoint(k).unlink(missing_ok=True)
        (self.out / CHECKPOINT).unlink(missing_ok=True)

    def _checkpoint(self, fold: int) -> Path:
        return self.out / f"{fold}.{CHECKPOINT}"


def _share(progress: Callable[[float], None], k: int, count: int) -> Callable[[float], None]:
    return lambda done: progress((k + done) / count)


def _parts(segments: Segments) -> NDArray[np.int64]:
    """What is held out together, (n,): a run; or a stretch of it, where there is only one."""
    if np.unique(segments.run).size > 1:
        return segments.run
    return np.arange(len(segments)) * _STRETCHES // max(len(segments), 1)


def _turning(segments: Segments, predicted_j: NDArray[np.float64], turned: NDArray[np.float64]) -> float:
    """Energy of turning [J/rad] beyond what straight driving explains, at least 0: the least-squares slope of what is
    left, over the square of the prediction. turned : (n,) by how much more than straight segments do. The idle power of
    the time that turns take longer is in it.
    """
    rest = segments.energy_j - predicted_j
    use = np.isfinite(rest) & (np.abs(segments.heading_change_rad) >= MAX_TURN_RAD)
    if use.sum() < FEWEST:
        return 0.0
    rest = rest[use] - np.nanmedian(rest[~use]) if (~use).any() else rest[use]
    weight = 1.0 / np.maximum(predicted_j[use], LEAST_SHARE * np.nanmedian(predicted_j)) ** 2
    slope = float((weight * rest * turned[use]).sum() / (weight * turned[use] ** 2).sum())
    return round(max(slope, 0.0), 3) if math.isfinite(slope) else 0.0
