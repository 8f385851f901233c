"""Measured rows beside the prediction of a model: what a calibration works on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import InputError, RunsError
from joulemap.model.runs.features import Drives, Features, concatenate_features

FloatArray = NDArray[np.float64]

LEAST_SEGMENTS = 20
"""A calibration needs at least so many."""
LEAST_FOLDS = 4
"""Of fewer runs, blocks are left out instead of whole runs."""
MOST_FOLDS = 40
"""Setting: times that a whole procedure is repeated for its errors. Up to so many runs each is left out by itself; of
more, neighbours are left out together."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Measured energy of segments in driving order, and of stationary intervals after them, with their features.

    Attributes
    ----------
    features : Features
        Of the rows.
    measured : ndarray of float, (n,)
        Energy [J], or charge [A s].
    runs : tuple of str
        Names by number.
    charge : bool
        Whether the energy is charge, whose scale and zero are unknown.
    informed : ndarray of float, (n,), optional
        Prediction with the turns and loads that the model was trained on.
    refused : frozenset of str
        Logged columns that no effect may depend on.
    """

    features: Features
    measured: FloatArray
    runs: tuple[str, ...]
    charge: bool = False
    informed: FloatArray | None = None
    refused: frozenset[str] = frozenset()

    def __len__(self) -> int:
        return len(self.features)

    @property
    def said(self) -> FloatArray:
        """Prediction of the base model from all that it knows of, (n,) [J]; nothing for a charge."""
        if self.charge:
            return np.zeros(len(self))
        plain = replace(self.features, drives=Drives(), added_resistance=None).predicted
        beyond = np.zeros(len(self)) if self.informed is None else np.nan_to_num(self.informed - plain)
        return self.features.predicted + beyond

    def driven_by(self, drives: Drives) -> Residuals:
        """Return the same rows for other drives."""
        return replace(self, features=replace(self.features, drives=drives))

    @property
    def motors(self) -> bool:
        """Whether the measured charge is that of the motors."""
        return self.features.drives.motor_speed_mps is not None

    @property
    def run(self) -> NDArray[np.int64]:
        """Number of the run of each row, (n,)."""
        return self.features.run

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Whether each row is a segment and no stationary interval, (n,)."""
        return ~self.features.standing

    @cached_property
    def whole_runs(self) -> bool:
        """Whether there are enough runs to leave whole ones out."""
        return bool(np.unique(self.run).size >= LEAST_FOLDS)

    @cached_property
    def unit(self) -> NDArray[np.int64]:
        """What is left out together, (n,): the run, or blocks of a run where there are fewer than four runs."""
        runs = np.unique(self.run)
        if self.whole_runs:
            return np.searchsorted(runs, self.run)
        blocks = -(-LEAST_FOLDS // runs.size)
        out = np.zeros(len(self), dtype=np.int64)
        for k, run in enumerate(runs):
            mine = np.flatnonzero(self.run == run)
            out[mine] = k * blocks + np.minimum(np.arange(mine.size) * blocks // max(mine.size, 1), blocks - 1)
        return out

    def folds(self, groups: Sequence[str] | None = None) -> NDArray[np.int64]:
        """Return what is left out together by the cross-validation of a whole procedure.

        Result (n,): number of the fold: at most `MOST_FOLDS` of whole groups; `unit` where there are too few runs or
        one group.
        """
        names = np.asarray(groups if groups is not None else self.features.runs)[self.run]
        _, group = np.unique(names, return_inverse=True)
        count = int(group.max()) + 1
        if not self.whole_runs or count < 2:
            return self.unit
        return np.asarray(group * min(count, MOST_FOLDS) // count, dtype=np.int64)

    def take(self, which: ArrayLike) -> Residuals:
        """Return some of the rows."""
        index = np.asarray(which)
        informed = None if self.informed is None else self.informed[index]
        return replace(self, features=self.features.take(index), measured=self.measured[index], informed=informed)


def residuals_of(
    features: Features,
    measured: FloatArray,
    runs: tuple[str, ...],
    *,
    charge: bool,
    informed: FloatArray | None = None,
    least: int = LEAST_SEGMENTS,
) -> tuple[Residuals, NDArray[np.int64]]:
    """Return the residuals of rows whose ground is known.

    `measured` (n,): energy [J], or charge [A s]; `informed` (n,): see `Residuals`. Result: of the usable rows, in runs:
    the stationary intervals of each after its segments; and the numbers of these rows.
    """
    known = features.standing | (np.isfinite(features.traction_per_m) & np.isfinite(features.grade))
    kept = int((known & ~features.standing).sum())
    if kept < least:
        driven = int((~features.standing).sum())
        raise RunsError(
            f"only {kept} of {driven} segments of 1 m lie on ground that the heightmap knows; at least {least} are "
            "needed. Do the runs and the heightmap belong together?",
            segments=kept,
            limit=least,
        )
    order = np.flatnonzero(known)
    order = order[np.argsort(features.run[order], kind="stable")]
    informed = None if informed is None else informed[order]
    rows = Residuals(features.take(order), measured[order], runs, charge, informed)
    return rows, order


def joined(parts: Sequence[Residuals]) -> Residuals:
    """Join the rows of several sets of runs."""
    if len({part.charge for part in parts}) > 1:
        raise InputError("runs with a voltage and runs without cannot be calibrated together")
    return Residuals(
        concatenate_features([part.features for part in parts]),
        np.concatenate([part.measured for part in parts]),
        tuple(name for part in parts for name in part.runs),
        parts[0].charge,
        np.concatenate([part.said for part in parts]),
        frozenset().union(*(part.refused for part in parts)),
    )
