"""What the runs say for and against every way in which an effect may act.

Two questions are asked of each. *Does it help where it was not fitted?* Whole runs are held out in turn, and the share
by which the squared error falls there is the gain; all such fits are solved from one cross-product matrix per run. In
each fit the base model's scale may be off by as much as it usually is, and by no more: what changes the scale further
is an effect like any other.

*Is it significant?* For what varies within runs `by_shifts` decides, for what differs between them only,
`between_runs`. An effect on the scale of all runs could be an error of the base model itself. There a t-test over
left-out runs decides, which includes the uncertainty of that scale, and p is multiplied by the number of such effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from joulemap.model.loop.chance import apart, between_runs, by_shifts, orthonormal
from joulemap.model.loop.effects import Term
from joulemap.model.loop.formulas import FORMULAS
from joulemap.model.loop.quantities import quantity
from joulemap.model.loop.residual import Residuals
from joulemap.model.loop.steps import step_chance

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LEVEL_FORMULAS = frozenset({"hotel_load", "sensor_gain", "payload", "friction", "temperature", "battery"})
"""Formulas that are not nil on average: the refit of the scale would hide them."""

_FIELD_RIDGE = 5.0  # as if so many segments showed that a field is flat
_LEAST_RUNS = 3
_SLIGHT = 1e-4
_BETWEEN = 0.05  # what has a smaller share of its variance within runs differs between them only
_LEAST_SHARE = 0.05  # of the usual energy: a share of less means nothing
_NEAR_COPIES = 5  # effects on the scale are near-collinear


@dataclass(frozen=True)
class Verdict:
    """The evidence about one term.

    Attributes
    ----------
    term : int
        Index of the term.
    gain : float
        Share by which the held-out squared error falls.
    net : float
        The same with the scale free in both fits, for an effect that is not itself one of scale.
    p_value : float
        Allowing for everything that was tested; 1 where it cannot be tested.
    steady : float
        Share of the folds in which it helps.
    why : str
        Why it cannot be tested; empty where it can.
    """

    term: int
    gain: float
    net: float
    p_value: float
    steady: float
    why: str = ""


class Evidence:
    """The terms of all candidates on one set of residuals.

    Parameters
    ----------
    residuals : Residuals
        Of the runs.
    terms : sequence of Term
        Of all candidates.
    level_doubt : float
        Relative uncertainty of the base model's scale on any day: twice the standard deviation of the offsets of runs.
    level_freedom : int
        Degrees of freedom with which it is known; 0 if it is assumed.
    seed : int
        Of the permutations.
    """

    def __init__(
        self, residuals: Residuals, terms: Sequence[Term], *, level_doubt: float, level_freedom: int = 0, seed: int = 0
    ) -> None:
        self.residuals, self.terms, self.seed = residuals, list(terms), seed
        self.level_doubt, self.level_freedom = level_doubt, level_freedom
        drive, scale = residuals.drive, residuals.scale
        self.z = residuals.residual / scale
        blocks = [self._scaled(t.columns(drive)) for t in self.terms]
        nuisance = self._scaled(_level_columns(residuals))
        self.columns: list[IntArray] = []
        start = nuisance.shape[1]
        self.nuisance = np.arange(start)
        for block in blocks:
            self.columns.append(np.arange(start, start + block.shape[1]))
            start += block.shape[1]
        raw = np.concatenate([nuisance, *blocks], axis=1)
        self.size = np.sqrt(np.mean(raw**2, axis=0))
        self.size[self.size == 0] = 1.0
        self.x = raw / self.size  # (n, K) of mean square one
        self.ridge = np.full(self.x.shape[1], 1e-6 * len(residuals))
        for term, columns in zip(self.terms, self.columns, strict=True):
            if term.formula == "place":
                self.ridge[columns] = _FIELD_RIDGE
        self.folds = np.unique(residuals.fold)
        self.moving = np.flatnonzero(residuals.moving)
        self.moving = self.moving[np.lexsort((drive.since_s[self.moving], drive.run[self.moving]))]
        self.differs = [self._hardly_within_runs(term.goes_with) for term in self.terms]
        self._grams()

    def _hardly_within_runs(self, name: str | None) -> bool:
        """Whether a quantity has its values from run to run, as weather has; not if it is not known."""
        values = np.zeros(0) if name is None else quantity(self.residuals.drive, name)[self.moving]
        known = np.flatnonzero(np.isfinite(values))
        if known.size < 2:
            return False
        values, run = values[known], np.unique(self.residuals.drive.run[self.moving][known], return_inverse=True)[1]
        means = np.bincount(run, weights=values) / np.bincount(run)
        return bool(np.sum((values - means[run]) ** 2) < _BETWEEN * np.sum((values - values.mean()) ** 2))

    def _scaled(self, columns: FloatArray) -> FloatArray:
        return columns / self.residuals.scale[:, None]

    def _grams(self) -> None:
        both = np.concatenate([self.x, self.z[:, None]], axis=1)

        def products(fold: IntArray) -> FloatArray:
            rows = [np.flatnonzero(fold == f) for f in np.unique(fold)]
            return np.stack([both[r].T @ both[r] for r in rows])  # (F, K + 1, K + 1)

        self.by_fold, self.by_block = products(self.residuals.fold), products(self.residuals.block)
        self.own_of_runs = {
            int(c) for t, k in zip(self.terms, self.columns, strict=True) if t.formula == "by_run" for c in k
        }

    def moves_level(self, chosen: Sequence[int]) -> bool:
        """Return whether any of some effects changes the scale of the energy and is distinguished from it by its size
        only.

        Parameters
        ----------
        chosen : sequence of int
            Indices of terms.

        Returns
        -------
        bool
            False for charge, whose scale is free.
        """
        terms = [self.terms[k] for k in chosen if not self.terms[k].settings.get("begun")]
        return not self.residuals.charge and any(
            t.formula in LEVEL_FORMULAS or t.settings.get("of") in LEVEL_FORMULAS for t in terms
        )

    def columns_of(self, chosen: Sequence[int]) -> IntArray:
        """Return the columns of some terms.

        Parameters
        ----------
        chosen : sequence of int
            Indices of terms.

        Returns
        -------
        ndarray of int
            Indices of columns.
        """
        return np.concatenate([self.nuisance[:0], *(self.columns[k] for k in chosen)]).astype(np.int64)

    def held_out(self, active: IntArray, *, blocks: bool = False, free: bool = False) -> FloatArray:
        """Return the squared error of each fold, predicted by a fit to all others.

        Parameters
        ----------
        active : ndarray of int
            Columns of the fit.
        blocks : bool
            Hold out a third of every run at a time instead of whole runs; always so where runs have coefficients of
            their own.
        free : bool
            Refit the scale to any value, instead of within its uncertainty; always so for charge.

        Returns
        -------
        ndarray of float, (folds,)
            Sum of squares [scaled].
        """
        gram = self.by_block if blocks or self.own(active) else self.by_fold
        every = np.concatenate([self.nuisance, active])
        inner = gram[:, every[:, None], every]
        right = gram[:, every, -1]
        left = inner.sum(axis=0) - inner + np.diag(self.ridge[every])
        aim = right.sum(axis=0) - right
        beta = np.linalg.solve(left, aim[..., None])[..., 0]
        if not (free or self.residuals.charge):
            most = self.level_doubt * self.size[0]
            level = np.clip(beta[:, 0], -most, most)
            rest = aim[:, 1:] - left[:, 1:, 0] * level[:, None]
            beta = np.concatenate([level[:, None], np.linalg.solve(left[:, 1:, 1:], rest[..., None])[..., 0]], axis=1)
        error = np.einsum("fk,fkl,fl->f", beta, inner, beta) - 2.0 * np.einsum("fk,fk->f", beta, right)
        return np.asarray(gram[:, -1, -1] + error)

    def own(self, active: IntArray) -> bool:
        """Return whether runs have coefficients of their own among these columns.

        Parameters
        ----------
        active : ndarray of int
            Indices of columns.

        Returns
        -------
        bool
            True if so.
        """
        return not self.own_of_runs.isdisjoint(active.tolist())

    def coefficients(self, active: IntArray, *, without: int | None = None) -> FloatArray:
        """Return least squares coefficients.

        Parameters
        ----------
        active : ndarray of int, (k,)
            Columns of the fit.
        without : int, optional
            A fold to leave out.

        Returns
        -------
        ndarray of float, (k,)
            In the units of the terms.
        """
        keep = np.arange(self.folds.size) != (-1 if without is None else without)
        left = self.by_fold[:, active[:, None], active][keep].sum(axis=0) + np.diag(self.ridge[active])
        right = self.by_fold[:, active, -1][keep].sum(axis=0)
        return np.asarray(np.linalg.solve(left, right) / self.size[active])

    def size_of(self, chosen: Sequence[int], k: int) -> float:
        """Return the last coefficient of a term, given the chosen ones.

        Parameters
        ----------
        chosen : sequence of int
            Terms that are fitted along.
        k : int
            Index of the term.

        Returns
        -------
        float
            0 where the term has several coefficients of equal rank.
        """
        if self.columns[k].size > 1 and not self.terms[k].settings.get("begun"):
            return 0.0
        level = self.nuisance[: 0 if self.moves_level([*chosen, k]) else None]
        return float(self.coefficients(np.concatenate([level, self.columns_of([*chosen, k])]))[-1])

    def judge(self, chosen: Sequence[int], tried: Sequence[int]) -> list[Verdict]:
        """Return the evidence about terms, given the chosen ones.

        Parameters
        ----------
        chosen : sequence of int
            Terms that were taken already.
        tried : sequence of int
            Terms to judge.

        Returns
        -------
        list of Verdict
            In the order of `tried`.
        """
        selected = self.columns_of(chosen)
        before = {
            blocks: [self.held_out(selected, blocks=blocks, free=free) for free in (False, True)]
            for blocks in (False, True)
        }
        p_values, reasons = self._chances(chosen, tried)
        verdicts = []
        for k in tried:
            error, error_free = before[self.own(self.columns[k])]
            active = np.concatenate([selected, self.columns[k]])
            falls = error - self.held_out(active)
            gain = net = float(falls.sum() / error.sum())
            if not self.moves_level([k]):
                falls = error_free - self.held_out(active, free=True)
                net = float(falls.sum() / error_free.sum())
            verdicts.append(Verdict(k, gain, net, p_values[k], float((falls > 0).mean()), reasons.get(k, "")))
        return verdicts

    def _chances(self, chosen: Sequence[int], tried: Sequence[int]) -> tuple[dict[int, float], dict[int, str]]:
        """p-values by term, and why where one could not be tested."""
        drive, rows = self.residuals.drive, self.moving
        runs = np.unique(drive.run[rows], return_inverse=True)[1]
        asked = runs.max() + 1
        per_run = np.zeros((rows.size, asked))
        per_run[np.arange(rows.size), runs] = self.residuals.predicted[rows] / self.residuals.scale[rows]
        columns = self.columns_of(chosen)
        taken = np.concatenate([columns, self.nuisance])
        every, z = self.x[rows], self.z[rows]
        basis = orthonormal(np.concatenate([every[:, taken], per_run], axis=1))
        level_basis = orthonormal(every[:, taken])
        lefts = _without(basis, every)
        frees, z_free = _without(level_basis, every), _without(level_basis, z)
        level_of = (per_run / np.maximum((per_run**2).sum(axis=0), 1e-300)).T  # by how much each run is off
        within: dict[int, FloatArray] = {}
        between: dict[int, FloatArray] = {}
        level: list[int] = []
        p_values = dict.fromkeys(tried, 1.0)
        reasons: dict[int, str] = {}
        for k in tried:
            block, left, free = (all_[:, self.columns[k]] for all_ in (every, lefts, frees))
            if self.terms[k].settings.get("of") in LEVEL_FORMULAS:
                rest = _without(orthonormal(every[:, columns]), z)
                p_values[k] = apart(level_of @ rest, 0.5 * self.level_doubt)
            elif self.moves_level([k]):
                if (block**2).sum() < _SLIGHT * block.size:
                    reasons[k] = "it does not vary in these runs"
                elif asked < _LEAST_RUNS + len(chosen):
                    reasons[k] = "too few runs differ in it"
                else:
                    level.append(k)
            elif self.differs[k] or (left**2).sum() < _BETWEEN * max((free**2).sum(), 1e-12):
                free = self._beyond_level(k, free)
                if (free**2).sum() < _SLIGHT * free.size:
                    reasons[k] = "it does not vary in these runs"
                else:
                    between[k] = level_of @ free
            else:
                if asked < _LEAST_RUNS + len(chosen):
                    left = self._beyond_level(k, left)
                unique = orthonormal(left, least=0.02)
                if unique.shape[1] == 0:
                    reasons[k] = "these runs cannot distinguish it from other quantities that vary with it"
                else:
                    within[k] = unique
        for k in level:
            p_values[k] = min(1.0, self._beyond_doubt(chosen, k) * min(len(level) + len(between), _NEAR_COPIES))
        if between:
            told = between_runs(
                level_of @ z_free,
                between,
                usual=0.5 * self.level_doubt,
                freedom=self.level_freedom,
                taken=sum(self.differs[c] for c in chosen),
                seed=self.seed,
            )
            p_values |= told
            reasons |= {k: "too few runs differ in it" for k in between if k not in told}
        if within:
            p_values |= by_shifts(_without(basis, z), runs, basis, within, seed=self.seed)
            steps = self._by_steps(z_free, runs, list(within))
            p_values |= {k: min(p_values[k], p) for k, p in steps.items()}
        return p_values, reasons

    def _beyond_level(self, k: int, block: FloatArray) -> FloatArray:
        """Columns of a term without the constant part that it brings, if any: any column would do to carry that."""
        term = self.terms[k]
        if not (term.settings.get("level") or term.settings.get("begun")):
            return block
        sums = np.where(term.formula == "smooth", 1.0, np.arange(block.shape[1]) == 0)
        level = block @ (sums * self.size[self.columns[k]])
        return np.asarray(block - np.outer(level, level @ block) / max(float(level @ level), 1e-300))

    def _by_steps(self, z: FloatArray, runs: IntArray, tried: Sequence[int]) -> dict[int, float]:
        """p-values of the terms that follow a record which changes seldom, times the number of different records."""
        chances: dict[int, float] = {}
        of_state: dict[bytes, float] = {}
        for k in tried:
            state = self.terms[k].record(self.residuals.drive)
            if state is None or self.columns[k].size > 1:
                continue
            mine = np.nan_to_num(state[self.moving])
            key = mine.tobytes()
            if key not in of_state:
                of_state[key] = step_chance(z, mine, runs)
            chances[k] = of_state[key]
        asked = max(1, sum(p < 1.0 for p in of_state.values()))
        return {k: min(1.0, p * asked) for k, p in chances.items()}

    def _beyond_doubt(self, chosen: Sequence[int], k: int) -> float:
        """p-value of a t-test over left-out runs: does a term change the scale of all by more than its uncertainty?"""
        level = self.nuisance[: 0 if self.moves_level([*chosen, k]) else None]
        active = np.concatenate([self.columns_of(chosen), level, self.columns[k]])
        value = self.coefficients(active)[-1]
        spread = self.jackknife(active)[-1]
        share = self.x[self.moving][:, self.columns[k]] * self.size[self.columns[k]]
        predicted = self.residuals.predicted[self.moving]
        predicted = np.maximum(predicted, _LEAST_SHARE * np.median(predicted))  # it may be nil downhill
        lift = float(np.mean(share[:, 0] * self.residuals.scale[self.moving] / predicted))
        doubtful = self.moves_level([k]) and not self.moves_level(chosen)
        doubt = self.level_doubt / max(abs(lift), 1e-12) if doubtful else 0.0
        freedom = self.folds.size - 1 - len(chosen)
        beyond = max(abs(value) - doubt, 0.0)  # tests against the uncertainty, not against nothing
        return float(2.0 * student.sf(beyond / max(spread, 1e-300), max(freedom, 1)))

    def jackknife(self, active: IntArray) -> FloatArray:
        """Return the standard errors of `coefficients`, leaving out a fold at a time.

        Parameters
        ----------
        active : ndarray of int, (k,)
            Columns of the fit.

        Returns
        -------
        ndarray of float, (k,)
            In the units of the terms.
        """
        count = self.folds.size
        each = np.stack([self.coefficients(active, without=f) for f in range(count)])
        return np.asarray(np.sqrt((count - 1) / count * ((each - each.mean(axis=0)) ** 2).sum(axis=0)))


def _level_columns(residuals: Residuals) -> FloatArray:
    """What is refitted silently: one factor; of a charge, whose scale and zero are unknown, a plane in the traction."""
    if residuals.charge:
        return FORMULAS["plane"](residuals.drive)
    return np.where(residuals.moving, residuals.predicted, 0.0)[:, None]


def _without(basis: FloatArray, columns: FloatArray) -> FloatArray:
    """Columns without the span of an orthonormal basis."""
    return np.asarray(columns - basis @ (basis.T @ columns))
