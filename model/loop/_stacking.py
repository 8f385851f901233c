"""The weights of what plans use: those with which a mean of predictions errs least on left-out runs (stacking).

The calibrated model, the model before and two simple ones err in different ways: a coefficient that is too large in
one is too small in another. Weights are non-negative and sum to 1, which needs no penalty (Breiman 1996, "Stacked
regressions"; Wolpert 1992). The calibrated model is taken alone where the mean is not surely better.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from joulemap.model.loop._selection import within_one_error
from joulemap.model.loop.forms.simple_costs import SimpleCosts
from joulemap.model.loop.mixture import CALIBRATED, PREDICTIONS, SIMPLE, mean_of
from joulemap.model.loop.terms import Term
from joulemap.model.runs.features import FloatArray
from joulemap.model.runs.residuals import Residuals

IntArray = NDArray[np.int64]
LEAST_SHARE = 0.05
"""Setting: a prediction of less weight is left out."""
_HEAVY = 1e4  # weight of the row that makes shares sum to 1, beside the predictions


def simple_models(rows: Residuals) -> dict[str, Term]:
    """Fit the simple models."""
    forms = {name: SimpleCosts(columns) for name, columns in SIMPLE.items()}
    return {name: Term(form, form.fitted(rows)) for name, form in forms.items()}


def best_shares(measured: FloatArray, said: Mapping[str, FloatArray], fold: IntArray) -> dict[str, float]:
    """Return the shares under which the mean of predictions, (n,), errs least (least squares), none below
    `LEAST_SHARE`; the calibrated model alone where that errs more by no more than one standard error over folds, (n,).
    """
    names = list(PREDICTIONS)
    while True:
        x = np.stack([said[name] for name in names], axis=1)
        heavy = _HEAVY * float(np.linalg.norm(measured))
        found = nnls(np.vstack([x, np.full(len(names), heavy)]), np.append(measured, heavy))[0]
        small = found < LEAST_SHARE * found.sum()
        if not small.any():
            break
        names = [name for name, little in zip(names, small, strict=True) if not little]
    shares = dict(zip(names, (found / found.sum()).tolist(), strict=True))
    gains = (measured - said[CALIBRATED]) ** 2 - (measured - mean_of(shares, said)) ** 2
    by_fold = np.bincount(np.unique(fold, return_inverse=True)[1], weights=gains).astype(np.float64)
    return {CALIBRATED: 1.0} if by_fold.size < 2 or within_one_error(by_fold) else shares


def stacked(
    measured: FloatArray, said: Mapping[str, FloatArray], moving: NDArray[np.bool_], fold: IntArray
) -> tuple[dict[str, float], FloatArray]:
    """Return the best shares on rows that move, and each fold, (n,), predicted with the best shares on the others."""

    def _shares(of: NDArray[np.bool_]) -> dict[str, float]:
        return best_shares(measured[of], {name: said[name][of] for name in PREDICTIONS}, fold[of])

    out = np.empty(len(measured))
    for k in np.unique(fold):
        out[fold == k] = mean_of(_shares(moving & (fold != k)), said)[fold == k]
    return _shares(moving), out
