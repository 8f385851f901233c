"""What plans use: the prediction that errs least on left-out runs; the calibrated one if no other is surely better."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from joulemap.model.energy.route_errors import STRETCHES, stretches_of
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
    160 m and of whole runs with their stops. Each is weighted as if the errors of metres were independent, and every
    length counts alike in every fold.
    """
    routes = list(_routes(rows, fold))
    of, cell, count = np.unique(
        [(fold[route[0]], length) for length, route in routes], axis=0, return_inverse=True, return_counts=True
    )
    metres = np.array([max(int(rows.moving[route].sum()), 1) for _, route in routes])
    folds, number = np.unique(of[cell.ravel(), 0], return_inverse=True)

    def _errors(name: str) -> FloatArray:
        away = rows.measured - said[name]
        squares = np.array([away[route].sum() for _, route in routes]) ** 2 / metres / count[cell.ravel()]
        return np.bincount(number, weights=squares).astype(np.float64)

    errors = np.stack([_errors(name) for name in _PREDICTIONS])  # (predictions, folds)

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


def _routes(rows: Residuals, fold: IntArray) -> Iterator[tuple[int, IntArray]]:
    """Length in metres and rows of each route; 0 metres for a whole run, or as much of it as is in one fold."""
    for one, run in np.unique(np.stack([fold, rows.run]), axis=1).T:
        whole = np.flatnonzero((fold == one) & (rows.run == run))
        driven = whole[rows.moving[whole]]
        yield from ((len(part), part) for part in stretches_of(driven) if len(part) in STRETCHES)
        yield 0, whole
