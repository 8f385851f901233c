"""Errors of the base model that the baseline runs show already: they are not new, and no evidence of an effect.

A model is never perfect on the runs it was made from: it may know nothing of turns, or its scale may be some per cent
off. Such terms are found there by held-out runs and added to the prediction before new runs are traced.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from joulemap.model.loop.effects import Term
from joulemap.model.loop.evidence import Evidence
from joulemap.model.loop.residual import Residuals

_LEAST_GAIN = 0.01
_FURTHER = 1.5
_USUAL_DOUBT = 0.05
_LEAST_DOUBT = 0.035
_LEAST_RUNS = 3


@dataclass(frozen=True)
class SharedErrors:
    """Errors of the base model in the baseline runs.

    Attributes
    ----------
    terms : tuple of Term
        Corrections of the base prediction, fitted.
    level_doubt : float
        Relative uncertainty of the base model's scale on another day.
    residuals : Residuals, optional
        Of the baseline runs, corrected.
    """

    terms: tuple[Term, ...] = ()
    level_doubt: float = _USUAL_DOUBT
    residuals: Residuals | None = field(default=None, repr=False)

    @property
    def level_freedom(self) -> int:
        """Degrees of freedom with which `level_doubt` is known; 0 where it is assumed."""
        runs = 0 if self.residuals is None else np.unique(self.residuals.drive.run[self.residuals.moving]).size
        return runs - 1 if runs >= _LEAST_RUNS else 0

    def gains(self, terms: Sequence[Term]) -> np.ndarray:
        """Return how much of the baseline runs' own squared error each term explains there, held out.

        Parameters
        ----------
        terms : sequence of Term
            To test.

        Returns
        -------
        ndarray of float, (terms,)
            Shares; 0 without baseline runs.
        """
        if self.residuals is None:
            return np.zeros(len(terms))
        evidence = Evidence(self.residuals, terms, level_doubt=self.level_doubt)
        before = evidence.held_out(evidence.columns_of([]), free=True).sum()
        after = [evidence.held_out(c, free=True).sum() for c in evidence.columns]
        return np.maximum(1.0 - np.array(after) / before, 0.0)

    def shows(self, term: Term) -> float:
        """Return the smallest share of a fitted effect that the baseline runs show as well.

        Parameters
        ----------
        term : Term
            Fitted.

        Returns
        -------
        float
            Least squares scale of its shape there, minus one standard error; 0 without baseline runs, or where its
            quantity was absent.
        """
        if self.residuals is None:
            return 0.0
        z = self.residuals.residual / self.residuals.scale
        shape = term.energy(self.residuals.drive) / self.residuals.scale
        size = float(shape @ shape)
        return float((shape @ z - z.std() * np.sqrt(size)) / size) if size > 0.0 else 0.0


def shared_errors(base: Residuals | None, carried_kg: float = 0.0) -> SharedErrors:
    """Fit the corrections that hold over the baseline runs.

    Parameters
    ----------
    base : Residuals, optional
        Of the baseline runs.
    carried_kg : float
        Largest payload in the new runs [kg].

    Returns
    -------
    SharedErrors
        Empty without baseline runs.
    """
    if base is None:
        return SharedErrors()
    always = [Term("level", "level", ("",))]
    if base.drive.standing.any():
        always.append(Term("standing", "standing", ("W",)))
    evidence = Evidence(base, [*always, *_known_forms(base, carried_kg)], level_doubt=_USUAL_DOUBT)
    chosen = list(range(len(always)))
    while True:
        error = evidence.held_out(evidence.columns_of(chosen), free=True).sum()
        rest = [k for k in range(len(evidence.terms)) if k not in chosen]
        after = {k: evidence.held_out(evidence.columns_of([*chosen, k]), free=True).sum() for k in rest}
        best = min(after, key=lambda k: after[k], default=None)
        if best is None or after[best] > (1.0 - _LEAST_GAIN) * error:
            break
        chosen.append(best)
    values = evidence.coefficients(evidence.columns_of(chosen))
    terms = tuple(evidence.terms[k].fitted(values[i : i + 1]) for i, k in enumerate(chosen))
    corrected = base.corrected(np.sum([t.energy(base.drive) for t in terms], axis=0))
    return SharedErrors(terms, _level_spread(corrected), corrected)


def _known_forms(base: Residuals, carried_kg: float) -> list[Term]:
    """The physical forms that are known to cost energy, one coefficient each."""
    forms = [
        Term("turning", "turning", ("J/rad",), {"limit_radps": None}),
        Term("cross_slope", "cross_slope", ("",), {"power": 1}),
        Term("climbing", "climbing", ("",)),
        Term("braking", "braking", ("",), {"from_grade": None}),
        Term("battery", "battery", ("ohm",)),
        Term("acceleration", "acceleration", ("kg",)),
    ]
    if 0.0 < carried_kg <= _FURTHER * most_carried(base):  # a few kilograms say little about many
        forms.append(Term("payload", "payload", ("",), {"column": "payload", "reference": 0.0}))
    return forms


def most_carried(residuals: Residuals) -> float:
    """Return the largest payload that was logged.

    Parameters
    ----------
    residuals : Residuals
        Of the runs.

    Returns
    -------
    float
        Payload [kg]; 0 where none was logged.
    """
    logged = residuals.drive.columns.get("payload", np.zeros(1))
    return float(np.max(logged, initial=0.0, where=np.isfinite(logged)))


def _level_spread(base: Residuals) -> float:
    """Relative uncertainty of the scale of a day's runs: two standard deviations of single runs, within limits."""
    moving = base.moving
    run, z = base.drive.run[moving], base.residual[moving]
    shares = np.array([z[run == k].sum() / base.predicted[moving][run == k].sum() for k in np.unique(run)])
    if shares.size < _LEAST_RUNS:
        return _USUAL_DOUBT
    return float(np.clip(2.0 * shares.std(ddof=1), _LEAST_DOUBT, _USUAL_DOUBT))
