"""Calibrate: what a base model lacks on measured runs, and how well it predicts runs that had no part in the fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from joulemap.model.energy.mean_level import MeanLevel, mean_level
from joulemap.model.energy.metrics import errors_of
from joulemap.model.loop._procedure import Fitted, fit
from joulemap.model.loop._proposal import CALIBRATED, proposed
from joulemap.model.loop._selection import LEAST_GAIN, within_one_error
from joulemap.model.loop.terms import Effect
from joulemap.model.runs.features import FloatArray
from joulemap.model.runs.refused_columns import refused_columns
from joulemap.model.runs.residuals import Residuals, joined

__all__ = ["CALIBRATED", "Calibration", "Effect", "calibrate"]


@dataclass(frozen=True, eq=False)
class Calibration:
    """The result of a calibration."""

    fitted: Fitted  # From all runs
    residuals: Residuals  # Of the new runs
    baseline: Residuals | None  # Of the baseline runs
    # By state: `before`, `corrected` (with the base parameters), `after`, `after_planner`, `constant`, `least_squares`,
    # and `proposed`. Each prediction is of a procedure that had no part of the run
    errors: dict[str, dict[str, Any]]
    held_out: dict[str, FloatArray] = field(repr=False)  # (n,): The predictions themselves
    refused: dict[str, str]  # Logged columns that no effect may depend on, and why
    folds: int  # How often the whole procedure was repeated
    proposal: str  # Which of the predictions plans use. For `proposed` it is chosen without the run
    # Of `after` and of `proposed`: how far sums were off on left-out runs, and what they are multiplied by
    levels: dict[str, MeanLevel]
    test_errors: dict[str, dict[str, Any]] | None = None  # As `errors`, on the test runs

    def confirmed(self, state: str = "after") -> bool | None:
        """Return whether left-out and test runs are predicted better than before; if not, nobody should change models.

        Result: by the squared error, which is less by more than one standard error on left-out runs, and by enough to
        matter there, as of an effect; None where every run had a part in the calibration.
        """
        judged = [errors for errors in (self.errors, self.test_errors) if errors is not None]
        better = all(errors[state]["rmse"] < errors["before"]["rmse"] for errors in judged)
        before, after = (_squares(self.residuals, self.held_out[key]) for key in ("before", state))
        gains = np.bincount(self.residuals.unit, weights=before - after).astype(np.float64)
        if self.folds:
            better = better and not within_one_error(gains) and bool(gains.sum() >= LEAST_GAIN * before.sum())
        return None if better and not self.folds and self.test_errors is None else better

    @property
    def rivals(self) -> dict[str, list[str]]:
        """Candidates that these runs cannot distinguish from the effects that were found, by effect."""
        return self.fitted.selection.rivals

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects that were found, those that explain most first."""
        return self.fitted.effects

    def errors_on(self, others: Residuals, *, elsewhere: bool = False) -> dict[str, Any]:
        """Return the errors on other runs of the same meter, which had no part in this calibration."""
        return {key: errors_of(others, energy) for key, energy in self.states(others, elsewhere=elsewhere).items()}

    def states(self, others: Residuals, *, elsewhere: bool = False) -> dict[str, FloatArray]:
        """Return the predictions for other runs, by state. The result is (n,)."""
        states = self.fitted.states(others, elsewhere=elsewhere)
        states["after"] = self.levels["after"].factor * states["after"]
        states["proposed"] = self.levels["proposed"].factor * states[self.proposal]
        return states


def calibrate(
    measured: Residuals,
    *,
    electric: Mapping[str, FloatArray] | None = None,
    base: Residuals | None = None,
    test: Residuals | None = None,
    groups: Sequence[str] | None = None,
    cross_validate: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Find the effects that the base model lacks on new runs."""
    if base is not None and base.charge != measured.charge:
        base = None  # amperes and joules cannot be compared
    refused, own_fold = refused_columns(measured, electric or {}), measured.folds(groups)
    measured = replace(measured, refused=frozenset(refused))
    rows = measured if base is None else joined([base, measured])
    new = np.arange(len(rows)) >= len(rows) - len(measured)
    fold = np.append(np.full(len(rows) - len(measured), -1), own_fold)
    count = int(fold.max()) + 1 if cross_validate else 0
    done = 0

    def _step(share: float) -> None:
        if progress is not None:
            progress((done + share) / (count + 1))

    with threadpool_limits(1, user_api="blas"):  # the matrices are small: threads would wait for each other
        fitted = fit(rows, new, progress=_step)
        held = fitted.states(measured)
        for k in range(count):
            done = k + 1
            _step(0.0)
            kept, left_out = rows.take(fold != k), rows.take(fold == k)
            for key, energy in fit(kept, new[fold != k]).states(left_out).items():
                held[key][own_fold == k] = energy
    proposal, held["proposed"] = proposed(measured, held, own_fold) if count else (CALIBRATED, held[CALIBRATED])
    levels = dict.fromkeys(("after", "proposed"), MeanLevel())
    for key in levels if count else ():  # sums of the runs that were fitted to agree
        levels[key], held[key] = _levelled(measured, held[key], own_fold)
    errors = {key: errors_of(measured, energy) for key, energy in held.items()}
    found = Calibration(fitted, measured, base, errors, held, refused, count, proposal, levels)
    return found if test is None else replace(found, test_errors=found.errors_on(test))


def _squares(measured: Residuals, said: FloatArray) -> FloatArray:
    """Squared errors of metres, (n,)."""
    return np.where(measured.moving, (measured.measured - said) ** 2, 0.0)


def _levelled(measured: Residuals, said: FloatArray, fold: NDArray[np.int64]) -> tuple[MeanLevel, FloatArray]:
    """How far sums are off on left-out runs, and predictions multiplied by what the other folds say of that, unless
    that makes metres worse: then the difference hangs on a few of them.
    """

    def _level(some: NDArray[np.bool_]) -> MeanLevel:
        return mean_level(measured.measured[some], said[some], fold[some])

    level, out = _level(measured.moving), said.copy()
    for k in range(int(fold.max()) + 1 if level.factor != 1.0 else 0):
        out[fold == k] *= _level(measured.moving & (fold != k)).ratio
    if _squares(measured, out).sum() > _squares(measured, said).sum():
        return replace(level, factor=1.0), said
    return level, out
