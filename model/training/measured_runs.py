"""From measured runs to a trained model: the work of `joulemap train --runs`."""

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
from joulemap.model.energy.examples import MAX_TURN_RAD, Examples, cut_examples
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
from joulemap.model.training.run_record import runs_record

CHECKPOINT = "training.pt"
FOLDS = 5
"""Parts into which the runs are divided for cross-fitting, whole runs at a time."""
_STRETCHES = 4  # parts of a single run, each then held out whole


@dataclass(frozen=True)
class TrainedModel:
    """The result of a training.

    Attributes
    ----------
    version : str
        Of the model.
    segments : int
        Straight segments on known ground, held-out ones included.
    runs : list of str
        All runs.
    held_out_runs : list of str
        Runs that `held_out` is about, each predicted by a network that had not seen it.
    held_out : dict
        Errors on them, as `evaluation.errors`.
    epochs : int
        Passes over the data.
    turn_j_per_rad : float
        Energy of turning beyond straight driving [J/rad].
    stopped_by_held_out : bool
        Whether the held-out runs also decided when the training stopped, which makes the errors a little too small.
    keeps_runs : bool
        Whether the model's folder keeps its runs as the baseline of later calibrations.
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
    """Train on measured runs over a heightmap and write the model's folder.

    A network whose architecture says so is cross-fitted when it starts from another one: the runs are divided whole
    into `FOLDS` parts, one network is fine-tuned without each part, and the model is the mean of their weights. Every
    run is then predicted by a network that has not seen it, which gives held-out errors and the model's spread without
    losing a run for training. Otherwise a share of the runs is held out whole, and training stops when the error on
    them no longer improves. Networks learn from straight segments. The energy of turning beyond them is fitted to the
    held-out segments.

    Parameters
    ----------
    heightmap : Heightmap
        The ground.
    robot : Robot
        As its file declares it.
    files : sequence of Path
        The logs.
    out : Path
        Folder to write.
    architecture : str, optional
        One of `ARCHITECTURES`.
    start_from : Path, optional
        Folder of a model to fine-tune.
    backbone : Path, optional
        File of a backbone's weights: for resnet18 with torchvision's names.
    patch_size : int, optional
        Rows and columns of an input, where the architecture leaves the choice. Those of the model to start from, else
        the architecture's usual size (resnet18: 64; 256 in the paper).
    epochs : int, optional
        Passes over the data, at most. The architecture's usual number by default.
    seed : int, optional
        The same seed and data give the same weights.
    charge : bool, optional
        Count charge times the nominal voltage instead of energy.
    resume : bool, optional
        Go on where a training of the same data and settings was cut off. Its state is kept in `out` until it ends.
    progress : callable, optional
        Gets the share of the work that is done, 0 to 1.

    Returns
    -------
    TrainedModel
        The model and its held-out errors.

    Raises
    ------
    InputError
        If settings contradict each other, or no segment is left.
    ModelError
        If the architecture is unknown, or the model to start from is of another one.
    RunsError
        If a log cannot be read, or does not fit the map and the robot.
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
    judged, said = work.held_out()
    turned = np.abs(judged.heading_change_rad) - work.domain.turned_rad
    turn = _turning(judged, said.energy_j, turned)
    predicted = said.energy_j + turn * turned
    known = np.isfinite(predicted)
    held_out = errors(predicted[known], judged.energy_j[known], judged.run[known])
    spread = Spread()
    if known.sum() >= FEWEST and said.std_j is not None:
        spread = fit_spread(judged.energy_j[known], predicted[known], said.std_j[known], judged.run[known])
    names = [segments.runs[int(k)] for k in np.unique(judged.run)]
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
        keeps_runs = keep_base_runs(out, heightmap, robot, judged, said.traction_per_m)
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
        self.known = len(seen[0])  # the corners of a turned square may be off the map
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
        self._said: list[tuple[NDArray[np.int64], Prediction]] = []  # by networks that had not seen the segments

    def artifact(self, net: Network) -> Artifact:
        return Artifact(net, self.domain, self.patch_size)

    def fit(self, options: TrainingOptions, seed: int, progress: Callable[[float], None] | None) -> tuple[Network, int]:
        """One network, stopped by held-out parts, on which it is then judged; and its epochs."""
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
        """The mean of the networks without one fold of the parts, each judged on its fold; and their epochs."""
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
        """All held-out segments with turns, in driving order, and what networks that had not seen them predict."""
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
