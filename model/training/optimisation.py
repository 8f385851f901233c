"""Fit a network to measured segments: seeded, stopped on whole held-out runs, and resumable."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from joulemap.model.energy.architectures import DEFAULT_ARCHITECTURE, find_architecture
from joulemap.model.energy.architectures.contract import Architecture, check_start
from joulemap.model.energy.architectures.network import Network
from joulemap.model.energy.examples import Examples
from joulemap.model.energy.tensors import CPU, ExampleTensors, NetworkOutput
from joulemap.model.energy.uncertainty import LEAST_SHARE
from joulemap.model.errors import InputError, ModelError

_LEAK = 0.02
"""Slope of the energy below zero traction in training, so that a segment wrongly taken for braking has a gradient."""
_SPREAD_SHARE = 0.01
"""Weight of the spread's likelihood: it has weights of its own, so this only keeps it out of the gradient's norm."""


@dataclass(frozen=True)
class TrainingOptions:
    """How to train."""

    epochs: int = 60  # Passes over the data, at most
    patience: int = 12  # Epochs without a better held-out error before the training stops
    batch: int = 256  # Segments per step
    learning_rate: float = 1e-3  # At the start of a cosine
    weight_decay: float = 1e-4  # Of AdamW
    augment: bool = True  # Whether inputs are mirrored and, where the architecture allows it, turned by quarter turns
    freeze_backbone: bool = False  # Train the head alone, where the architecture has a backbone
    held_out_share: float = 0.15  # Share of the runs to hold out, where none are named
    # Noise on the robot's features, over their ranges, so that the network cannot recognise a robot by them
    feature_jitter: float = 0.0
    # "relative" (squared error over the prediction) or "mse" (of the scaled energy e = E / V, as in the paper)
    loss: str = "relative"
    # Train for all `epochs` and keep the last weights: the held-out runs then decide nothing, and errors on them are
    # held-out errors
    keep_last: bool = False

    def __post_init__(self) -> None:
        if self.loss not in ("relative", "mse"):
            raise InputError(f"no loss {self.loss!r}: known are relative, mse", loss=self.loss)


@dataclass
class TrainingResult:
    """A trained network and how its training went."""

    net: Network  # With the best weights
    # Mean of |error| / `NetworkOutput.scale` on the held-out runs, by which the weights were chosen. Where no segment
    # takes little energy it is the mean relative error of `metrics`.
    held_out_error: float
    held_out_runs: list[int]  # Their ids
    seed: int  # As used
    history: list[dict[str, float]] = field(default_factory=list)  # train_loss and held_out_error of every epoch

    @property
    def epochs(self) -> int:
        """Passes over the data."""
        return len(self.history)


def train_network(
    examples: Examples,
    *,
    architecture: str = DEFAULT_ARCHITECTURE,
    seed: int = 0,
    start_from: Network | None = None,
    held_out_runs: Sequence[int] | None = None,
    options: TrainingOptions | None = None,
    checkpoint: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> TrainingResult:
    """Train on every run but the held-out ones, and stop when the error on those no longer improves."""
    options = options or TrainingOptions()
    kind = find_architecture(architecture)
    check_start(kind, start_from)
    held = sorted(held_out_runs) if held_out_runs is not None else choose_held_out(examples, options, seed)
    out = np.isin(examples.run, held)
    if out.all() or not out.any():
        raise InputError(
            f"{len(examples)} segments in {len(np.unique(examples.run))} runs leave nothing to "
            f"{'train on' if out.all() else 'judge by'}: at least two runs are needed",
            runs=len(np.unique(examples.run)),
        )
    with torch.random.fork_rng(devices=[]), _threads(kind.training.threads):
        torch.manual_seed(seed)
        net = kind.initial(examples, start_from).to(kind.device())
        trainer = _Trainer(kind, net, examples, np.flatnonzero(~out), np.flatnonzero(out), options, seed)
        trainer.run(Path(checkpoint) if checkpoint is not None else None, progress)
    return TrainingResult(net, trainer.best_error, held, seed, trainer.history)


def choose_held_out(examples: Examples, options: TrainingOptions, seed: int) -> list[int]:
    """Choose whole runs to hold out."""
    runs = np.unique(examples.run)
    count = min(max(1, round(options.held_out_share * runs.size)), max(runs.size - 1, 1))
    return sorted(int(r) for r in np.random.default_rng(seed).choice(runs, count, replace=False))


def averaged(nets: Sequence[Network]) -> Network:
    """Return the network with the mean weights of several networks that were fine-tuned from the same one.

    Such networks lie in one basin of the loss. Their mean predicts as well as their ensemble and costs as much as one.

    Reference: Wortsman et al. 2022, "Model soups".
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
    """Use this many threads inside (None: as they are)."""
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    torch.set_flush_denormal(True)  # momenta of silent units decay to numbers that cost a hundred times as much
    try:
        yield
    finally:
        torch.set_flush_denormal(False)
        torch.set_num_threads(before)


class _Trainer:
    """One training: the state that a checkpoint keeps, epoch by epoch."""

    def __init__(
        self,
        kind: Architecture[Any],
        net: Network,
        examples: Examples,
        train: NDArray[np.int64],
        held: NDArray[np.int64],
        options: TrainingOptions,
        seed: int,
    ) -> None:
        self.kind, self.net, self.options, self.seed, self.device = kind, net, options, seed, kind.device()
        start = hashlib.sha256(b"".join(v.contiguous().cpu().numpy().tobytes() for v in net.state_dict().values()))
        without = np.unique(examples.run[held]).tolist()
        self.identity = f"{examples.data_hash} seed {seed} {options} without {without} from {start.hexdigest()[:16]}"
        self.data = ExampleTensors(examples, self.device)
        self.train, self.held = (torch.from_numpy(part).to(self.device) for part in (train, held))
        self.frozen = kind.backbone_of(net) if options.freeze_backbone else None
        if self.frozen is not None:
            self.frozen.requires_grad_(False)
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
        if len(batches) > 1 and len(batches[-1]) < self.kind.training.least_batch:
            batches = batches[:-1]  # one patch alone has no batch to be normalised over
        self.net.train()
        if self.frozen is not None:
            self.frozen.eval()
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

    def _loss(self, answer: NetworkOutput, part: Tensor) -> Tensor:
        measured = self.data.measured[part]
        if self.options.loss == "mse":
            return torch.mean(((answer.energy - measured) / self.data.voltage[part]) ** 2)
        # The quasi-likelihood of a mean whose standard deviation is in proportion to it (McCullagh & Nelder 1989,
        # chapter 9). Relative to the measured energy, or with a bound on outliers, predicting too little would pay:
        # noise is skewed, and sums of routes came out 2 to 4 % short.
        least = LEAST_SHARE * (self.data.hotel[part] + self.data.weight[part] * self.data.rolling[part])
        error = (answer.energy - measured) / torch.maximum(answer.energy.detach(), least)
        loss = 0.5 * torch.mean(error**2)
        if answer.spread is None:
            return loss
        # Laplace's likelihood, robust against outliers; sqrt(2) mean |error| is its standard deviation.
        likelihood = answer.spread + math.sqrt(2.0) * error.detach().abs() * torch.exp(-answer.spread)
        return loss + _SPREAD_SHARE * likelihood.mean()

    def _held_out_error(self) -> float:
        self.net.eval()
        total = 0.0
        with torch.inference_mode():
            for part in self.held.split(self.kind.at_once):
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
