"""Fits of networks and costs to measured runs, each without some whole runs, which it then predicts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.architectures.contract import Architecture
from joulemap.model.energy.architectures.network import Network
from joulemap.model.energy.artifact import Artifact, predictor_of
from joulemap.model.energy.domain import Domain
from joulemap.model.energy.drive_costs import DriveCosts
from joulemap.model.energy.examples import Examples, concatenate, examples_of
from joulemap.model.energy.grade import tan_grade
from joulemap.model.energy.prediction import predict_segments
from joulemap.model.energy.shape_features import shape_features
from joulemap.model.errors import InputError
from joulemap.model.runs.segments import Segments
from joulemap.model.runs.sites import SiteRuns
from joulemap.model.training.baselines import baseline_predictions
from joulemap.model.training.cost_regression import CostFit, CostRows, fit_costs
from joulemap.model.training.evaluation import segment_errors
from joulemap.model.training.optimisation import TrainingOptions, averaged, choose_held_out, train_network

FloatArray = NDArray[np.float64]

CHECKPOINT = "training.pt"
FOLDS = 5
"""Parts into which the runs are divided for cross-fitting, whole runs at a time."""
NOT_TUNED = "the same without fine-tuning"
"""Name of the network to start from with fitted costs, among the simple models."""
_STRETCHES = 4  # parts of a single run, each then held out whole
_SHOWN = 0.01  # of the segments beyond either end of a range: one odd segment in a hundred widens none


@dataclass(frozen=True, eq=False)
class Judged:
    """What fits say of segments that they had not seen, in driving order."""

    index: NDArray[np.int64]  # (n,): Which segments of the training
    segments: Segments  # The same
    energy_j: FloatArray  # (n,): Predicted; NaN on unknown ground
    std_j: FloatArray  # (n,): Its standard deviation [J]
    traction_per_m: FloatArray  # (n,): Of the ground [J/m]
    costs: DriveCosts  # Of all runs: what the model keeps
    beside_j: FloatArray  # (n,): Declared energy of idle power and turning, which is in `energy_j` [J]

    def scaled(self, factor: float) -> Judged:
        """Return what a model would say that asks for so many times as much beside what is declared.

        Its standard deviations are multiplied too.
        """
        return replace(
            self,
            energy_j=self.beside_j + factor * (self.energy_j - self.beside_j),
            std_j=factor * self.std_j,
            traction_per_m=factor * self.traction_per_m,
            costs=self.costs.scaled(factor),
        )

    @property
    def known(self) -> NDArray[np.bool_]:
        """Where the ground is known, (n,)."""
        return np.isfinite(self.energy_j)


class FoldFits:
    """The examples of one training, and the two ways to fit a network to them."""

    def __init__(
        self,
        measured: SiteRuns,
        kind: Architecture[Any],
        patch_size: int,
        start: Network | None,
        parent: Artifact | None,
        out: Path,
        seed: int,
    ) -> None:
        self.measured, self.kind, self.patch_size, self.start = measured, kind, patch_size, start
        self.out, self.seed = out, seed
        self.part = _parts(measured.segments)
        self.examples, self._index, self.known = self._cut()
        self.domain = self._domain(parent)
        self._rows = self._cost_rows(parent)
        # what was said of segments, (n,), by fits that had not seen them, and by simple models
        self._energy, self._std, self._traction = (np.full(len(measured.segments), np.nan) for _ in range(3))
        self._simple: dict[str, FloatArray] = {}
        self._held = np.zeros(len(measured.segments), dtype=np.bool_)

    def artifact(self, net: Network, costs: DriveCosts) -> Artifact:
        """Make a model of a network."""
        return Artifact(net, self.domain, self.patch_size, costs=costs)

    def fit(self, options: TrainingOptions, progress: Callable[[float], None] | None) -> tuple[Network, int]:
        """Fit one network, stopped by parts that are held out, on which it is then judged."""
        held = choose_held_out(self.examples, options, self.seed)
        fitted, start = self._costs_without(held)
        result = train_network(
            self._beside(fitted),
            architecture=self.kind.name,
            seed=self.seed,
            start_from=start,
            held_out_runs=held,
            options=options,
            checkpoint=self.out / CHECKPOINT,
            progress=progress,
        )
        self._judge(result.net, held, fitted)
        return result.net, result.epochs

    def cross_fit(self, options: TrainingOptions, progress: Callable[[float], None] | None) -> tuple[Network, int]:
        """Fit a network without each fold of the parts, each judged on its fold; with no epochs its costs alone."""
        parts = np.random.default_rng(self.seed).permutation(np.unique(self.examples.run))
        folds = [fold.tolist() for fold in np.array_split(parts, min(FOLDS, parts.size))]
        nets = []
        for k, fold in enumerate(folds):
            fitted, net = self._costs_without(fold)
            if net is None or options.epochs:
                net = train_network(
                    self._beside(fitted),
                    architecture=self.kind.name,
                    seed=self.seed,
                    start_from=net,
                    held_out_runs=fold,
                    options=options,
                    checkpoint=self._checkpoint(k),
                    progress=None if progress is None else _share(progress, k, len(folds)),
                ).net
            nets.append(net)
            self._judge(net, fold, fitted)
        return averaged(nets), options.epochs

    def judged(self) -> Judged:
        """Return what fits said of the parts that they had not seen, with the costs of all runs."""
        index, costs = np.flatnonzero(self._held), fit_costs(self._rows).costs
        said = self._energy[index], self._std[index], self._traction[index]
        return Judged(index, self.measured.segments.take(index), *said, costs, self._declared_j()[index])

    def baseline_errors(self, judged: Judged) -> dict[str, dict[str, Any]]:
        """Return the errors of simple models on the segments that networks were judged on, by model."""
        simple = {name: np.where(judged.known, energy[judged.index], np.nan) for name, energy in self._simple.items()}
        return {name: segment_errors(said, judged.segments) for name, said in simple.items() if np.isfinite(said).any()}

    def forget(self) -> None:
        """Remove the state of trainings that were cut off."""
        for k in range(FOLDS):
            self._checkpoint(k).unlink(missing_ok=True)
        (self.out / CHECKPOINT).unlink(missing_ok=True)

    def _cut(self) -> tuple[Examples, NDArray[np.int64], int]:
        """Examples from all directions, the segment of each, and the number of segments that one shows."""
        copies, segments = self.kind.training.copies, self.measured.segments
        n = len(segments)
        angles = np.random.default_rng([self.seed, n]).uniform(0.0, 2.0 * math.pi, (copies - 1, n))
        turns = np.concatenate([np.zeros((1, n)), angles])
        seen: list[Examples] = []
        for number, site in enumerate(self.measured.sites):
            mine = self.measured.on(number)
            s = segments.take(mine)
            kind = self.kind.name
            seen += examples_of(
                site.ground, site.robot, s, turns[:, mine], run=mine, architecture=kind, size=self.patch_size
            )
        known = sum(len(part) for part in seen[:: turns.shape[0]])  # corners of turned squares may be off the map
        if known == 0:
            raise InputError(f"none of the {n} segments lies on ground that the heightmap knows", segments=n)
        examples = concatenate(seen)
        return replace(examples, run=self.part[examples.run]), examples.run, known

    def _domain(self, parent: Artifact | None) -> Domain:
        segments = self.measured.segments
        payload = np.nan_to_num(segments.extras.get("payload", np.zeros(len(segments))))
        domain = replace(self.examples.domain(), payload_kg=(min(0.0, payload.min()), max(0.0, payload.max())))
        moving = np.maximum(segments.duration_s - segments.standing_s, 1e-3)
        grade = np.concatenate([self._grade(k) for k in range(len(self.measured.sites))])
        shown = {
            "speed_mps": segments.driven_m / moving,
            "turn_rad_per_m": segments.turned_abs_rad / segments.driven_m,
            "turn_radps": segments.turned_abs_rad / moving,
            "grade_deg": np.degrees(np.arctan(grade[np.isfinite(grade)])),
        }
        ends = {key: np.quantile(values, (_SHOWN, 1.0 - _SHOWN)) for key, values in shown.items() if values.size}
        domain = replace(domain, driven={k: (round(float(a), 4), round(float(b), 4)) for k, (a, b) in ends.items()})
        return domain if parent is None else parent.domain.joined(domain)

    def _declared_j(self) -> FloatArray:
        """Declared energy of idle power and turning, (n,)."""
        segments, robots = self.measured.segments, [site.robot for site in self.measured.sites]
        idle, turn = (
            np.array([getattr(r, key) for r in robots])[self.measured.site]
            for key in ("idle_power_w", "turn_j_per_rad")
        )
        return np.asarray(idle * segments.duration_s + turn * segments.turned_abs_rad)

    def _grade(self, number: int) -> FloatArray:
        s = self.measured.segments.take(self.measured.on(number))
        return tan_grade(self.measured.sites[number].ground, s.x, s.y, s.heading_rad)

    def _cost_rows(self, parent: Artifact | None) -> CostRows:
        """What the regression of costs reads: the traction of the network to start from, or of equation 5."""
        measured = self.measured
        n = len(measured.segments)
        traction, shape, grade = np.full(n, np.nan), np.zeros(n), np.full(n, np.nan)
        self.shapes = np.full((n, 11), np.nan)
        for k, site in enumerate(measured.sites):
            mine = measured.on(k)
            s = measured.segments.take(mine)
            grade[mine] = self._grade(k)
            self.shapes[mine] = shape_features(site.ground, site.robot, s.x, s.y, s.heading_rad)
            if parent is None or self.start is None:
                traction[mine] = site.robot.weight_n * (site.robot.rolling_resistance + grade[mine])
                continue
            without = self.kind.adapted(self.start, level=0.0, climb=0.0, shape=-1.0)
            full, plain = (
                predictor_of(self.artifact(net, DriveCosts())).segment_traction(
                    site.ground, site.robot, s.x, s.y, s.heading_rad
                )
                for net in (self.start, without)
            )
            traction[mine], shape[mine] = full, full - plain
        robots = tuple(site.robot for site in measured.sites)
        return CostRows(measured.segments, robots, measured.site, traction, shape, grade)

    def _costs_without(self, parts: Sequence[int]) -> tuple[CostFit, Network | None]:
        """Costs that were fitted without some parts, and the network to start from with its level put right."""
        out = np.isin(self.part, parts)
        fitted = fit_costs(self._rows.take(~out))
        simple = baseline_predictions(self._rows, self.shapes, ~out)
        simple[NOT_TUNED] = fitted.predict_j(self._rows.take(out))
        for name, said in simple.items():
            self._simple.setdefault(name, np.full(len(out), np.nan))[out] = said
        if self.start is None:
            return fitted, None
        return fitted, self.kind.adapted(self.start, level=fitted.level, climb=fitted.climb, shape=fitted.shape)

    def _beside(self, fitted: CostFit) -> Examples:
        """The examples with the energy that costs explain."""
        segments = self.measured.segments
        beside = np.empty(len(segments))
        for k, site in enumerate(self.measured.sites):
            mine = self.measured.on(k)
            s = segments.take(mine)
            beside[mine] = site.robot.turn_j_per_rad * s.turned_abs_rad + fitted.costs.energy_j(site.robot, s)
        return replace(self.examples, beside_j=beside[self._index].astype(np.float32))

    def _judge(self, net: Network, parts: Sequence[int], fitted: CostFit) -> None:
        predictor, held = predictor_of(self.artifact(net, fitted.costs)), np.isin(self.part, parts)
        self._held |= held
        for k, site in enumerate(self.measured.sites):
            mine = np.flatnonzero(held & (self.measured.site == k))
            if mine.size:
                said = predict_segments(predictor, site.ground, site.robot, self.measured.segments.take(mine))
                self._energy[mine], self._traction[mine] = said.energy_j, said.traction_per_m
                self._std[mine] = np.nan if said.std_j is None else said.std_j

    def _checkpoint(self, fold: int) -> Path:
        return self.out / f"{fold}.{CHECKPOINT}"


def _share(progress: Callable[[float], None], k: int, count: int) -> Callable[[float], None]:
    return lambda done: progress((k + done) / count)


def _parts(segments: Segments) -> NDArray[np.int64]:
    """What is held out together, (n,): a run; or a stretch of it, where there is only one."""
    if np.unique(segments.run).size > 1:
        return segments.run
    return np.arange(len(segments)) * _STRETCHES // max(len(segments), 1)
