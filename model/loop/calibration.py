"""Calibrate: from residuals to the effects that the model lacks, and how much better it predicts with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from joulemap.model.energy.metrics import relative_errors
from joulemap.model.loop.bounds import bounded
from joulemap.model.loop.candidates import Candidate, find_candidates
from joulemap.model.loop.effects import Term
from joulemap.model.loop.fitting import Fit, fit_terms
from joulemap.model.loop.localise import localised
from joulemap.model.loop.residual import Residuals
from joulemap.model.loop.selection import Floors, Found, interactions_of
from joulemap.model.loop.shared import SharedErrors, most_carried, shared_errors
from joulemap.model.loop.trace import Trace, trace

FloatArray = NDArray[np.float64]

_MOST_SHOWN = 0.5  # of an effect, by baseline runs: more is in the baseline already
_SMALL = 0.2  # share of the residual's sum of squares below which an effect must differ from nil
_WITH_BASE = Floors(physical=0.055, learned=0.08, place=0.08)


@dataclass(frozen=True)
class Effect:
    """An effect that was found, with its fitted size.

    Attributes
    ----------
    term : Term
        With all coefficients, also what the baseline runs show.
    coefficients : ndarray of float, (k,)
        What is new in these runs and not in the baseline.
    low, high : ndarray of float, (k,)
        95 % confidence intervals of `coefficients`.
    p_value : float
        Allowing for everything that was tested.
    share : float
        Share of the residual's sum of squares that the effect explains, together with the interactions it is part of.
    planner : bool
        Whether what it depends on is known before a drive.
    reveals : str
        Runs that would measure it better.
    shadow : bool
        Whether it is a collinear covariate: it corrects the form of other effects and is no cause of its own.
    """

    term: Term
    coefficients: FloatArray
    low: FloatArray
    high: FloatArray
    p_value: float
    share: float
    planner: bool
    reveals: str
    shadow: bool = False


@dataclass(frozen=True)
class Calibration:
    """The result of a calibration.

    Attributes
    ----------
    effects : tuple of Effect
        In order of their share.
    silent : tuple of Term
        What was refitted without being an effect: the base model's scale.
    shared : SharedErrors
        Errors of the base model that its own runs show already.
    before, corrected, after, after_planner : dict
        Errors on held-out runs (mean_relative, rmse, bias, by_run): of the base model, with `shared` alone, with the
        effects, and with those effects that are known before a drive.
    trace : Trace
        How the effects were selected.
    candidates : tuple of Candidate
        All that were tested.
    refused : dict
        Why others could not be tested, by name.
    residuals : Residuals
        In which effects were searched.
    first : ndarray of float, (n,)
        Prediction before the calibration.
    held_out, held_out_planner : ndarray of float, (n,)
        Prediction of each row by a fit without its run; and the same from what is known before the drive.
    first_terms, planner_terms : tuple of Term
        What is added to the base prediction for `before`, and for `after_planner`.
    """

    effects: tuple[Effect, ...]
    silent: tuple[Term, ...]
    shared: SharedErrors
    before: dict[str, Any]
    corrected: dict[str, Any]
    after: dict[str, Any]
    after_planner: dict[str, Any]
    trace: Trace = field(repr=False)
    candidates: tuple[Candidate, ...] = field(repr=False)
    refused: dict[str, str]
    residuals: Residuals = field(repr=False)
    first: FloatArray = field(repr=False)
    held_out: FloatArray = field(repr=False)
    held_out_planner: FloatArray = field(repr=False)
    first_terms: tuple[Term, ...]
    planner_terms: tuple[Term, ...]

    @property
    def terms(self) -> tuple[Term, ...]:
        """Everything that is added to the base prediction: errors known from the baseline, the scale, the effects."""
        return (*self.shared.terms, *self.silent, *(e.term for e in self.effects))

    def errors_on(self, others: Residuals) -> dict[str, Any]:
        """Return the errors on other runs, which had no part in this calibration.

        Parameters
        ----------
        others : Residuals
            Against the same base model.

        Returns
        -------
        dict
            `before`, `corrected`, `after` and `after_planner`, each as in the attributes.
        """
        predicted = np.zeros(len(others)) if others.charge else others.predicted

        def _error_with(terms: Sequence[Term]) -> dict[str, Any]:
            return _errors(others, predicted + _total(terms, others))

        before = _error_with(self.first_terms) if others.charge else _errors(others, _said(others))
        return {
            "before": before,
            "corrected": before if others.charge else _error_with(self.shared.terms),
            "after": _error_with(self.terms),
            "after_planner": _error_with(self.planner_terms),
        }


def calibrate(
    measured: Residuals,
    *,
    electric: Mapping[str, FloatArray] | None = None,
    base: Residuals | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Find the effects that the base model lacks on new runs.

    Parameters
    ----------
    measured : Residuals
        Of the new runs against the base model.
    electric : mapping, optional
        Mean voltage, current and power of each row, (n,), which no candidate may copy.
    base : Residuals, optional
        Of the baseline runs: what they show as well is not new.
    seed : int
        Of the permutations.
    progress : callable, optional
        Called with the share of the work that is done, 0..1.

    Returns
    -------
    Calibration
        With no effects where none is significant.

    Notes
    -----
    The scale and the zero of a charge are unknown. A plane in the base model's traction is fitted first, and `before`
    is its error.
    """
    shared = shared_errors(None if measured.charge else base, most_carried(measured))
    plane = _plane_terms(measured)
    first_terms: tuple[Term, ...] = ()
    if plane:
        first_fit = fit_terms(measured.without_prediction(), plane)
        first_terms = first_fit.terms
        before_energy = first_fit.held_out
        residuals = measured.without_prediction().corrected(_total(first_fit.terms, measured))
    else:
        before_energy = _said(measured)
        residuals = measured.corrected(_total(shared.terms, measured))
    candidates, refused = find_candidates(residuals, electric or {}, usual=_usual(base))
    terms = [v for c in candidates for v in c.variants]
    known = shared.gains(terms)
    floors = _WITH_BASE if shared.residuals is not None else Floors()
    traced = trace(
        residuals,
        candidates,
        level_doubt=shared.level_doubt,
        level_freedom=shared.level_freedom,
        floors=floors,
        shared=lambda k: float(known[k]),
        seed=seed,
        progress=progress,
    )
    start = measured.without_prediction() if plane else residuals
    fitted = _fitted(traced.causes, start, plane, shared)
    while idle := _idle(traced.causes, fitted, shared):
        traced = traced.without(idle)
        fitted = _fitted(traced.causes, start, plane, shared)
    if traced.shadows:
        fitted = _fitted(traced, start, plane, shared)
    fit, silent, level, start = fitted
    effects = _effects(traced, fit, len(silent))
    corrected = before_energy if plane else residuals.predicted
    held = start.predicted + fit.held_out if effects else corrected
    planner = [e.term for e in effects if e.planner]
    held_planner, planner_terms = corrected, first_terms or shared.terms
    if planner:
        known_before = fit_terms(start, [*silent, *planner])
        held_planner = start.predicted + known_before.held_out
        planner_terms = (*shared.terms, *level, *known_before.terms)
    return Calibration(
        effects,
        (*level, *fit.terms[: len(silent)]) if effects or plane else (),
        shared,
        _errors(measured, before_energy),
        _errors(measured, corrected),
        _errors(measured, held),
        _errors(measured, held_planner),
        traced,
        tuple(candidates),
        refused,
        residuals,
        before_energy,
        held,
        held_planner,
        first_terms,
        planner_terms,
    )


class _Fitted(NamedTuple):
    """The effects of a trace, fitted with `silent` terms to `start`, which is corrected by `level` already."""

    fit: Fit
    silent: list[Term]
    level: list[Term]
    start: Residuals


def _fitted(traced: Trace, start: Residuals, plane: Sequence[Term], shared: SharedErrors) -> _Fitted:
    silent, level = list(plane), []
    chosen = [traced.evidence.terms[f.verdict.term] for f in traced.found]
    if chosen and not plane and not traced.evidence.moves_level(traced.chosen):
        silent = [Term("level", "level", ("",))]
    parts = {name for f in traced.found for name in f.candidate.parts}  # their interaction describes where they differ
    chosen, others = bounded(start, localised(start, chosen, silent, whole=parts), silent)

    def fitted() -> Fit:
        return fit_terms(
            start,
            [*silent, *chosen],
            level_doubt=0.0 if silent else shared.level_doubt,
            base=shared.residuals,
            others=[[*silent, *terms] for terms in others],
        )

    fit = fitted()
    if silent and not plane and abs(share := fit.terms[0].coefficients[0]) > shared.level_doubt:
        level = [silent.pop().fitted(np.array([np.copysign(shared.level_doubt, share)]))]  # as far as while tracing
        start = start.corrected(_total(level, start))
        fit = fitted()
    return _Fitted(fit, silent, level, start)


def _idle(causes: Trace, fitted: _Fitted, shared: SharedErrors) -> Found | None:
    """The least important cause that is not new, whatever helped to find it.

    The baseline runs show most of it, or it explains little and its one or two coefficients may be nil (those of a
    curve share what is there). Heterogeneity between baseline runs is part of the p-value of what differs between runs.
    A cause with an interaction is kept.
    """
    skip = len(fitted.silent)
    for k, found in reversed(list(enumerate(causes.found))):
        term, low, high = fitted.fit.terms[skip + k], fitted.fit.low[skip + k], fitted.fit.high[skip + k]
        nil = low.size <= 2 and bool(np.all(low * high <= 0.0)) and not causes.evidence.differs[found.verdict.term]
        idle = shared.shows(term) > _MOST_SHOWN or (nil and _share(causes, found) < _SMALL)
        if idle and not interactions_of(found, causes.found):
            return found
    return None


def _share(traced: Trace, one: Found) -> float:
    """Share of the residual's sum of squares that an effect explains, with the interactions that it is part of."""
    gone = [one, *interactions_of(one, traced.found)]
    lost = _error(traced, [f.verdict.term for f in traced.found if f not in gone]) - _error(traced, traced.chosen)
    return float(np.clip(lost / float(traced.evidence.by_fold[:, -1, -1].sum()), 0.0, 1.0))


def _total(terms: Sequence[Term], residuals: Residuals) -> FloatArray:
    return np.sum([t.energy(residuals.drive) for t in terms], axis=0) if terms else np.zeros(len(residuals))


def _said(measured: Residuals) -> FloatArray:
    """(n,) prediction of the base model from everything it was given; its plain prediction where that is not known."""
    if measured.told is None:
        return measured.predicted
    return np.where(np.isfinite(measured.told), measured.told, measured.predicted)


def _plane_terms(measured: Residuals) -> tuple[Term, ...]:
    """Of a charge: what replaces the prediction, whose scale and zero are unknown."""
    return (Term("level", "plane", ("A s/m", "1/V", "1/V")),) if measured.charge else ()


def _usual(base: Residuals | None) -> dict[str, float]:
    """Means of the logged columns over the baseline runs, where the base model holds."""
    if base is None:
        return {}
    means = {k: v[np.isfinite(v)] for k, v in base.drive.columns.items()}
    return {k: round(float(v.mean()), 3) for k, v in means.items() if v.size}


def _effects(traced: Trace, fit: Fit, skip: int) -> tuple[Effect, ...]:
    out = []
    for k, found in enumerate(traced.found):
        term, low, high = fit.terms[skip + k], fit.low[skip + k], fit.high[skip + k]
        out.append(
            Effect(
                term,
                np.asarray(term.coefficients) - fit.own[skip + k],
                low,
                high,
                found.verdict.p_value,
                _share(traced, found),
                found.candidate.in_plans(term),
                found.candidate.reveals,
                found in traced.shadows,
            )
        )
    return tuple(out)


def _error(traced: Trace, chosen: Sequence[int]) -> float:
    """Held-out squared error [scaled] of a choice of terms."""
    return float(traced.evidence.held_out(traced.evidence.columns_of(chosen)).sum())


def _errors(measured: Residuals, predicted: FloatArray) -> dict[str, Any]:
    """Mean relative error, root mean square and bias (measured - predicted) over all moving rows, and by run."""
    moving = measured.moving
    energy, away = measured.measured[moving], (measured.measured - predicted)[moving]
    run = measured.drive.run[moving]
    unit_j = measured.drive.unit_j
    relative = relative_errors(unit_j * (energy - away), unit_j * energy)
    return {
        "mean_relative": float(relative.mean()),
        "rmse": float(np.sqrt(np.mean(away**2))),
        "bias": float(away.mean()),
        "by_run": {measured.runs[k]: float(relative[run == k].mean()) for k in np.unique(run)},
    }
