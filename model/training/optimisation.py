"""Fit a network to measured segments: seeded, stopped on whole held-out runs, and resumable."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from zipfile import is_zipfile

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from joulemap.model.energy.compact import CompactNet
from joulemap.model.energy.examples import ARCHITECTURES, Examples
from joulemap.model.energy.resnet import ResNetEnergy, fastest_device
from joulemap.model.energy.tensors import CPU, Answer, ExampleTensors, Network, at_once
from joulemap.model.errors import InputError, ModelError

_LEAK = 0.02
"""Slope of the price below zero traction in training, so that a segment wrongly held for braking can be corrected."""
_HUBER = 0.3
"""Relative error below which the loss is quadratic."""
_SPREAD_SHARE = 0.01
"""Weight of the spread's likelihood: it has weights of its own, so this only keeps it out of the gradient's norm."""


@dataclass(frozen=True)
class TrainingOptions:
    """How to train.

    epochs : at most; patience : epochs without a better held-out error before stopping; batch : segments.
    learning_rate : at the start of a cosine; weight_decay : of AdamW. augment : exact rotations by 90 degrees and
    mirror images (compact), mirror images (resnet18). freeze_backbone : train the resnet18 head alone. held_out_share
    : of the runs, where none are named. feature_jitter : noise on what a compact network is told of the robot, over
    the features' ranges, so that it cannot know a robot again by its numbers. loss : "relative" (Huber of the
    relative error) or "mse" (of the scaled energy e = E / V, as in the paper). keep_last : train for all `epochs` and
    keep the last weights, so that the held-out runs chose nothing and judge fairly.
    """

    epochs: int = 60
    patience: int = 12
    batch: int = 256
    learning_rate: float = 1e-3
    weight_decay: float = 1e-4
    augment: bool = True
    freeze_backbone: bool = False
    held_out_share: float = 0.15
    feature_jitter: float = 0.0
    loss: str = "relative"
    keep_last: bool = False

    def __post_init__(self) -> None:
        if self.loss not in ("relative", "mse"):
            raise InputError(f"no loss {self.loss!r}: known are relative, mse", loss=self.loss)


@dataclass
class TrainingResult:
    """net : with the best weights. held_out_error : its mean relative error on the held-out runs. history : one entry
    per epoch (train_loss, held_out_error). held_out_runs : ids. seed, epochs : as used.
    """

    net: Network
    held_out_error: float
    held_out_runs: list[int]
    seed: int
    history: list[dict[str, float]] = field(default_factory=list)

    @property
    def epochs(self) -> int:
        return len(self.history)


def train_network(
    examples: Examples,
    *,
    architecture: str = "compact",
    seed: int = 0,
    start_from: Network | None = None,
    held_out_runs: Sequence[int] | None = None,
    options: TrainingOptions | None = None,
    checkpoint: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> TrainingResult:
    """Train on every run but the held-out ones, stop when those no longer improve, return the best weights.

    start_from : a network to fine-tune (itself left as it is). checkpoint : a file written after every epoch, and
    continued from where it exists: the same seed and data then give the weights of an undisturbed training. Raises
    ModelError for an unknown architecture or a checkpoint of another training,
    InputError where nothing is left to train on.
    """
    options = options or TrainingOptions()
    if architecture not in ARCHITECTURES:
        raise ModelError(f"no architecture {architecture!r}: known are {', '.join(ARCHITECTURES)}", name=architecture)
    held = sorted(held_out_runs) if held_out_runs is not None else choose_held_out(examples, options, seed)
    aside = np.isin(examples.run, held)
    if aside.all() or not aside.any():
        raise InputError(
            f"{len(examples)} segments in {len(np.unique(examples.run))} runs leave nothing to "
            f"{'train on' if aside.all() else 'judge by'}: at least two runs are needed",
            runs=len(np.unique(examples.run)),
        )
    device = CPU if architecture == "compact" else fastest_device()
    with torch.random.fork_rng(devices=[]), _threads(1 if architecture == "compact" else None):
        torch.manual_seed(seed)
        net = _prepared(examples, architecture, start_from).to(device)
        trainer = _Trainer(net, examples, np.flatnonzero(~aside), np.flatnonzero(aside), options, seed, device)
        trainer.run(Path(checkpoint) if checkpoint is not None else None, progress)
    return TrainingResult(net, trainer.best_error, held, seed, trainer.history)


def choose_held_out(examples: Examples, options: TrainingOptions, seed: int) -> list[int]:
    """A seeded choice of whole runs, at least one, about `held_out_share` of them."""
    runs = np.unique(examples.run)
    count = min(max(1, round(options.held_out_share * runs.size)), max(runs.size - 1, 1))
    return sorted(int(r) for r in np.random.default_rng(seed).choice(runs, count, replace=False))


def averaged(nets: Sequence[Network]) -> Network:
    """The network with the mean of the weights of several that were fine-tuned from one: they lie in one valley, and
    their mean predicts as well as their ensemble at the price of one (Wortsman et al. 2022, "model soups").
    """
    mean = deepcopy(nets[0])
    states = [net.state_dict() for net in nets]
    mean.load_state_dict(
        {
            key: torch.stack([s[key] for s in states]).mean(0) if value.is_floating_point() else value
            for key, value in states[0].items()
        }
    )
    return mean.eval()


@contextmanager
def _threads(count: int | None) -> Iterator[None]:
    """So many threads inside (None: as they are). The compact network's layers are too small to share between cores:
    one thread is nearly as fast on an idle machine and many times faster on a busy one, and its sums never reorder.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    torch.set_flush_denormal(True)  # momenta of silent units decay to numbers that cost a hundred times as much
    try:
        yield
    finally:
        torch.set_flush_denormal(False)
        torch.set_num_threads(before)


def _prepared(examples: Examples, architecture: str, start_from: Network | None) -> Network:
    """A fresh network, or a copy of the given one, that knows the ranges of these examples."""
    low, high = examples.features.min(axis=0), examples.features.max(axis=0)
    if architecture == "compact":
        if start_from is None:
            net = CompactNet()
            net.set_feature_ranges(low, high)
        elif isinstance(start_from, CompactNet):
            net = CompactNet(start_from.config)  # the ranges stay: moving them would change what every robot means
            net.load_state_dict(start_from.state_dict())
        else:
            raise ModelError("a compact network cannot be fine-tuned from a resnet18")
        return net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    if start_from is not None and not isinstance(start_from, ResNetEnergy):
        raise ModelError("a resnet18 cannot be fine-tuned from a compact network")
    fresh = ResNetEnergy()
    if start_from is not None:
        fresh.load_state_dict(start_from.state_dict())
    if not fresh.target_scale.any():  # not trained yet: the head starts at the data's mean and spread
        scaled = examples.energy_j / examples.voltage_v
        fresh.target_mean = torch.as_tensor(float(scaled.mean()))
        fresh.target_scale = torch.tensor(max(float(scaled.std()), 1e-6))
    return fresh


class _Trainer:
    """One training: the state that a checkpoint keeps, epoch by epoch."""

    def __init__(
        self,
        net: Network,
        examples: Examples,
        train: NDArray[np.int64],
        held: NDArray[np.int64],
        options: TrainingOptions,
        seed: int,
        device: torch.device,
    ) -> None:
        self.net, self.options, self.seed, self.device = net, options, seed, device
        start = hashlib.sha256(b"".join(v.contiguous().cpu().numpy().tobytes() for v in net.state_dict().values()))
        aside = np.unique(examples.run[held]).tolist()
        self.identity = f"{examples.data_hash} seed {seed} {options} without {aside} from {start.hexdigest()[:16]}"
        self.data = ExampleTensors(examples, device)
        self.train, self.held = (torch.from_numpy(part).to(device) for part in (train, held))
        if isinstance(net, ResNetEnergy) and options.freeze_backbone:
            net.backbone.requires_grad_(False)
        trained = [p for p in net.parameters() if p.requires_grad]
        self.optimizer = torch.optim.AdamW(trained, lr=options.learning_rate, weight_decay=options.weight_decay)
        self.best: dict[str, Tensor] = {k: v.clone() for k, v in net.state_dict().items()}
        self.best_error = self._held_out_error()
        self.best_epoch = 0
        self.history: list[dict[str, float]] = []

    def run(self, checkpoint: Path | None, progress: Callable[[float], None] | None) -> None:
        if checkpoint is not None and checkpoint.exists():
            self._resume(checkpoint)
        patience = self.options.epochs if self.options.keep_last else self.options.patience
        while len(self.history) < self.options.epochs and len(self.history) - self.best_epoch < patience:
            loss = self._epoch(len(self.history))
            error = self._held_out_error()
            self.history.append({"train_loss": loss, "held_out_error": error})
            if error < self.best_error or self.options.keep_last:
                self.best = {k: v.clone() for k, v in self.net.state_dict().items()}
                self.best_error, self.best_epoch = error, len(self.history)
            if checkpoint is not None:
                self._save(checkpoint)
            if progress is not None:
                progress(len(self.history) / self.options.epochs)
        self.net.load_state_dict(self.best)
        self.net.requires_grad_(True)
        self.net.to(CPU).eval()
        if progress is not None:
            progress(1.0)

    def _epoch(self, epoch: int) -> float:
        """One pass over the training segments; its randomness depends on seed and epoch alone."""
        options = self.options
        rng = np.random.default_rng([self.seed, epoch])
        torch.manual_seed(int(rng.integers(2**31)))
        order = self.train[torch.from_numpy(rng.permutation(len(self.train))).to(self.device)]
        batches = order.split(options.batch)
        if isinstance(self.net, ResNetEnergy) and len(batches) > 1 and len(batches[-1]) == 1:
            batches = batches[:-1]  # one patch alone has no batch to be normalised over
        self.net.train()
        if isinstance(self.net, ResNetEnergy) and options.freeze_backbone:
            self.net.backbone.eval()
        total = 0.0
        for k, part in enumerate(batches):
            done = (epoch + k / len(batches)) / options.epochs
            warm = min(1.0, (epoch * len(batches) + k + 1) / 200.0)
            for group in self.optimizer.param_groups:
                group["lr"] = options.learning_rate * warm * (0.02 + 0.49 * (1.0 + math.cos(math.pi * done)))
            turns = int(rng.integers(4)) if options.augment else 0
            mirror = bool(rng.integers(2)) if options.augment else False
            answer = self.data.answer(
                self.net, part, leak=_LEAK, quarter_turns=turns, mirror=mirror, jitter=options.feature_jitter
            )
            loss = self._loss(answer, part)
            self.optimizer.zero_grad(set_to_none=True)
            loss.backward()
            nn.utils.clip_grad_norm_(self.net.parameters(), 1.0)
            self.optimizer.step()
            total += float(loss.detach()) * len(part)
        return total / len(self.train)

    def _loss(self, answer: Answer, part: Tensor) -> Tensor:
        measured = self.data.measured[part]
        if self.options.loss == "mse":
            return torch.mean(((answer.energy - measured) / self.data.voltage[part]) ** 2)
        # Relative to the mean of both: relative to the measured energy alone, predicting too little would pay, since
        # the noise of a small measurement then weighs more than that of a large one, and whole routes came out short.
        middle = torch.maximum(0.5 * (answer.scale + answer.energy.detach()), 0.5 * answer.scale)
        error = (answer.energy - measured) / middle
        loss = nn.functional.smooth_l1_loss(error, torch.zeros_like(error), beta=_HUBER)
        if answer.spread is None:
            return loss
        # Laplace's likelihood, robust against outliers; sqrt(2) mean |error| is its standard deviation.
        likelihood = answer.spread + math.sqrt(2.0) * error.detach().abs() * torch.exp(-answer.spread)
        return loss + _SPREAD_SHARE * likelihood.mean()

    def _held_out_error(self) -> float:
        self.net.eval()
        total = 0.0
        with torch.inference_mode():
            for part in self.held.split(at_once(self.net)):
                answer = self.data.answer(self.net, part, leak=0.0)
                total += float(((answer.energy - self.data.measured[part]).abs() / answer.scale).sum())
        return total / len(self.held)

    def _save(self, checkpoint: Path) -> None:
        state = {
            "identity": self.identity,
            "net": self.net.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "best": self.best,
            "best_error": self.best_error,
            "best_epoch": self.best_epoch,
            "history": self.history,
        }
        partial = checkpoint.with_name(f".{checkpoint.name}.partial")
        torch.save(state, partial)
        partial.replace(checkpoint)

    def _resume(self, checkpoint: Path) -> None:
        if not is_zipfile(checkpoint):  # its list of contents is written last
            raise ModelError(f"{checkpoint} is damaged: train again without going on from it")
        state = torch.load(checkpoint, map_location=self.device, weights_only=True)
        if state["identity"] != self.identity:
            raise ModelError(
                f"{checkpoint} belongs to another training (other data, held-out runs, start, seed or options)"
            )
        self.net.load_state_dict(state["net"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.best, self.best_error, self.best_epoch = state["best"], state["best_error"], state["best_epoch"]
        self.history = state["history"]
