"""Calibrate: base parameters first, then the effects that the model lacks, and how well it predicts with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.metrics import errors_of
from joulemap.model.loop._base_step import base_step, scale_of
from joulemap.model.loop._design import make_design
from joulemap.model.loop._selection import Selection, rivals_of, select
from joulemap.model.loop.forms import Form
from joulemap.model.loop.forms._base_parameters import MEASURED_SLOPE, BaseParameters
from joulemap.model.loop.terms import Correction, Term
from joulemap.model.runs.features import Drives, FloatArray, driven_ranges
from joulemap.model.runs.refused_columns import refused_columns
from joulemap.model.runs.residuals import Residuals, joined

Progress = Callable[[float], None]

MOST_FOLDS = 10
"""Times that the whole procedure is repeated without a part of the runs (Kohavi 1995: ten folds)."""


@dataclass(frozen=True)
class Effect:
    """An effect that was found.

    Attributes
    ----------
    term : Term
        What is new in these runs and not in the baseline runs.
    low, high : ndarray of float, (k,)
        95 % confidence intervals of its coefficients.
    p_value : float
        Allowing for every test.
    share : float
        Share of the squared error that it explains on left-out runs.
    between : bool
        Whether it was found in the differences between runs.
    """

    term: Term
    low: FloatArray
    high: FloatArray
    p_value: float
    share: float
    between: bool


@dataclass(frozen=True, eq=False)
class Fitted:
    """One run of the whole procedure.

    Attributes
    ----------
    selection : Selection
        The effects that were chosen.
    base : Term
        Corrections of the base parameters.
    base_low, base_high : ndarray of float
        Their 95 % confidence intervals.
    effects : tuple of Effect
        Those that explain most first.
    correction : Correction
        What is added to the base model's prediction, by everything and by what is known before a drive.
    base_terms : tuple of Term
        What is added by the base parameters alone, fitted for themselves.
    scale : Term, optional
        What makes a charge of the base model's prediction before any of this.
    run_share : float
        Standard deviation between runs that no effect explains, as a share of the energy.
    """

    selection: Selection
    base: Term
    base_low: FloatArray
    base_high: FloatArray
    effects: tuple[Effect, ...]
    correction: Correction
    base_terms: tuple[Term, ...]
    scale: Term | None
    run_share: float

    def predict(self, residuals: Residuals, terms: Sequence[Term]) -> FloatArray:
        """Return the energy of rows with some of its terms.

        Parameters
        ----------
        residuals : Residuals
            Against the same base model.
        terms : sequence of Term
            Of `correction`, or `base_terms`.

        Returns
        -------
        ndarray of float, (n,)
            Energy [J], or charge [A s].
        """
        moved = residuals.driven_by(self.correction.drives)
        return moved.said + replace(self.correction, terms=tuple(terms)).added_energy(moved.features, planned=False)


@dataclass(frozen=True, eq=False)
class Calibration:
    """The result of a calibration.

    Attributes
    ----------
    fitted : Fitted
        From all runs.
    residuals : Residuals
        Of the new runs.
    baseline : Residuals, optional
        Of the baseline runs.
    errors : dict of str to dict
        By state: `before`, `corrected` (with the base parameters), `after` and `after_planner`. Each prediction is of a
        procedure that had no part of the run.
    held_out : dict of str to ndarray of float, (n,)
        The predictions themselves.
    refused : dict of str to str
        Logged columns that no effect may depend on, and why.
    folds : int
        How often the whole procedure was repeated.
    rivals : dict of str to list of str
        See `rivals_of`.
    """

    fitted: Fitted
    residuals: Residuals
    baseline: Residuals | None
    errors: dict[str, dict[str, Any]]
    held_out: dict[str, FloatArray] = field(repr=False)
    refused: dict[str, str]
    folds: int
    rivals: dict[str, list[str]]

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects that were found, those that explain most first."""
        return self.fitted.effects

    def errors_on(self, others: Residuals, *, elsewhere: bool = False) -> dict[str, Any]:
        """Return the errors on other runs of the same meter, which had no part in this calibration.

        Parameters
        ----------
        others : Residuals
            Against the same base model.
        elsewhere : bool
            Whether they were driven on another map.

        Returns
        -------
        dict
            As `errors`.
        """
        states = _states(self.fitted, others, elsewhere=elsewhere)
        return {key: errors_of(others, energy) for key, energy in states.items()}


def calibrate(
    measured: Residuals,
    *,
    electric: Mapping[str, FloatArray] | None = None,
    base: Residuals | None = None,
    groups: Sequence[str] | None = None,
    cross_validate: bool = True,
    progress: Progress | None = None,
) -> Calibration:
    """Find the effects that the base model lacks on new runs.

    Parameters
    ----------
    measured : Residuals
        Of the new runs against the base model.
    electric : mapping, optional
        Mean voltage, current and power of each row, (n,), which no effect may copy.
    base : Residuals, optional
        Of the baseline runs: what they show as well is not new.
    groups : sequence of str, optional
        Of each run, such as its day: groups are left out together. Without it every run is a group.
    cross_validate : bool
        Repeat the whole procedure without each group for the errors. Otherwise they are those of the fit, as `folds` 0
        says.
    progress : callable, optional
        Called with the share of the work that is done, 0..1.

    Returns
    -------
    Calibration
        With no effects where none is significant.
    """
    if base is not None and base.charge != measured.charge:
        base = None  # amperes and joules cannot be compared
    refused = refused_columns(measured, electric or {})
    fold = _folds(measured, groups)
    count = int(fold.max()) + 1 if cross_validate else 0
    done = 0

    def _step(share: float) -> None:
        if progress is not None:
            progress((done + share) / (count + 1))

    fitted = _fit(measured, base, refused, progress=_step)
    held = _states(fitted, measured)
    for k in range(count):
        done = k + 1
        _step(0.0)
        out = np.flatnonzero(fold == k)
        other = _fit(measured.take(np.flatnonzero(fold != k)), base, refused)
        for key, energy in _states(other, measured.take(out)).items():
            held[key][out] = energy
    errors = {key: errors_of(measured, energy) for key, energy in held.items()}
    return Calibration(fitted, measured, base, errors, held, refused, count, rivals_of(fitted.selection))


def _fit(
    measured: Residuals, base: Residuals | None, refused: Mapping[str, str], *, progress: Progress | None = None
) -> Fitted:
    """Run the whole procedure once."""
    rows = measured if base is None else joined([base, measured])
    new = np.arange(len(rows)) >= len(rows) - len(measured)
    rows, first = base_step(rows, rows if base is None else base)
    chosen = select(make_design(rows, new, tuple(refused), first), progress=progress)
    _, estimate, index = chosen.estimate()
    low, high = estimate.interval()
    count = len(chosen.design.fixed)
    effects, at = [], count
    for candidate, verdict in zip(chosen.chosen, chosen.verdicts, strict=True):
        k = len(candidate.tested)
        own = slice(at, at + k)
        term = Term(candidate.form, tuple(estimate.coefficients[own].tolist()))
        effects.append(Effect(term, low[own], high[own], verdict.p_value, verdict.gain, verdict.between))
        at += k + len(candidate.beside)
    terms = _terms(chosen, lambda form: True)
    run_share = np.sqrt(chosen.model.tau2(index) * chosen.model.sigma2(index))
    return Fitted(
        chosen,
        terms[0],
        low[:count],
        high[:count],
        tuple(sorted(effects, key=lambda e: -e.share)),
        Correction(
            terms,
            _terms(chosen, lambda form: form.known_before, without=(MEASURED_SLOPE,)),
            driven_ranges(measured.features),
            rows.features.drives,
            first,
            rows.charge,
        ),
        _terms(chosen, lambda form: False),
        scale_of(rows) if rows.charge else None,
        float(run_share),
    )


def _terms(chosen: Selection, keep: Callable[[Form], bool], *, without: Sequence[str] = ()) -> tuple[Term, ...]:
    """Some base parameters and the effects that are kept, fitted together, as new runs have them."""
    every = chosen.design.base.names
    names = tuple(name for name in every if name not in without)
    kept, estimate, _ = chosen.estimate(keep, None if names == every else names)
    at = len(names)
    terms = [Term(BaseParameters(names), tuple(estimate.coefficients[:at].tolist()))]
    for candidate in kept:
        k = len(candidate.tested)
        total = estimate.coefficients[at : at + k].copy()
        total[candidate.shared] += estimate.coefficients[
            at + k : at + len(candidate.both)
        ]  # the base model's own error
        terms.append(Term(candidate.form, tuple(total.tolist())))
        at += len(candidate.both)
    return tuple(terms)


def _states(fitted: Fitted, rows: Residuals, *, elsewhere: bool = False) -> dict[str, FloatArray]:
    """Predictions by state; `elsewhere` without what belongs to the map on which it was found."""
    terms, planned = (
        [term for term in of if not (elsewhere and term.form.of_map)]
        for of in (fitted.correction.terms, fitted.correction.planner_terms)
    )
    return {
        "before": rows.said if fitted.scale is None else fitted.scale.energy(rows.driven_by(Drives()).features),
        "corrected": fitted.predict(rows, fitted.base_terms),
        "after": fitted.predict(rows, terms),
        "after_planner": fitted.predict(rows, planned),
    }


def _folds(measured: Residuals, groups: Sequence[str] | None) -> NDArray[np.int64]:
    """What is left out together by the outer cross-validation, (n,): groups of runs, at most ten folds of them."""
    if not measured.whole_runs:
        return measured.unit
    names = np.asarray(groups if groups is not None else measured.features.runs)[measured.run]
    _, group = np.unique(names, return_inverse=True)
    count = int(group.max()) + 1
    if count < 2:
        return measured.unit
    return np.asarray(group * min(count, MOST_FOLDS) // count, dtype=np.int64)
