"""What plans use: the prediction that errs least on left-out runs; the calibrated one if no other is surely better."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from joulemap.model.energy.route_errors import stretches_of
from joulemap.model.loop.forms.simple_costs import SimpleCosts
from joulemap.model.loop.terms import Term
from joulemap.model.runs.features import FloatArray
from joulemap.model.runs.residuals import Residuals

IntArray = NDArray[np.int64]
CALIBRATED, BEFORE = "after_planner", "before"
_SIMPLE = {
    "least_squares": ("length", "climb", "turned", "time", "drag", "speeding_up", "kinetic_energy"),
    "constant": ("length",),
}
_PREDICTIONS = (CALIBRATED, *_SIMPLE, BEFORE)
_CONFIDENCE = 0.95


def simple_models(rows: Residuals) -> dict[str, Term]:
    """Fit the simple models, by name."""
    forms = {name: SimpleCosts(columns) for name, columns in _SIMPLE.items()}
    return {name: Term(form, form.fitted(rows)) for name, form in forms.items()}


def proposed(rows: Residuals, said: Mapping[str, FloatArray], fold: IntArray) -> tuple[str, FloatArray]:
    """Return which prediction plans use, and what each fold, (n,), is predicted with by the choice of the others.

    said : left-out predictions, (n,), by name. What counts is what plans are made of: the energy of routes of 20 to
    160 m and of whole runs with their stops, each weighted as if the errors of metres were independent. Folds count
    alike.
    """
    folds = np.unique(fold)
    routes = [list(_routes(rows, fold == one)) for one in folds]

    def _errors(away: FloatArray) -> list[float]:
        return [float(np.mean([away[route].sum() ** 2 / route.size for route in mine])) for mine in routes]

    errors = np.array([_errors(rows.measured - said[name]) for name in _PREDICTIONS])  # (predictions, folds)

    def _best(errors: FloatArray) -> str:
        least = int(np.argmin(errors.sum(axis=1)))
        return _PREDICTIONS[least if surely_positive(errors[0] - errors[least]) else 0]

    out = said[CALIBRATED].copy()
    for k, one in enumerate(folds):
        out[fold == one] = said[_best(np.delete(errors, k, axis=1))][fold == one]
    return _best(errors), out


def surely_positive(gains: FloatArray) -> bool:
    """Whether the mean of gains, (folds,), is above 0 with a confidence of 95 %, by Student's t: three campaigns show
    little.
    """
    if gains.size < 2 or not gains.any():
        return False
    least = float(student.ppf(_CONFIDENCE, gains.size - 1)) * float(gains.std(ddof=1)) * np.sqrt(gains.size)
    return float(gains.sum()) > least


def _routes(rows: Residuals, mine: NDArray[np.bool_]) -> Iterator[IntArray]:
    """Rows of each route in some rows, (n,), and of each run, or as much of it as is there."""
    for run in np.unique(rows.run[mine]):
        whole = np.flatnonzero(mine & (rows.run == run))
        yield from stretches_of(whole[rows.moving[whole]])
        yield whole
