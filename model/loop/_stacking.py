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


def stacked(rows: Residuals, said: Mapping[str, FloatArray], fold: IntArray) -> tuple[dict[str, float], FloatArray]:
    """Return the best shares of predictions, (n,), and what each fold, (n,), is predicted with those of the others."""
    out = np.empty(len(rows))
    for k in np.unique(fold):
        others = fold != k
        found = best_shares(rows.take(others), {name: value[others] for name, value in said.items()}, fold[others])
        out[~others] = mean_of(found, said)[~others]
    return best_shares(rows, said, fold), out


def best_shares(rows: Residuals, said: Mapping[str, FloatArray], fold: IntArray) -> dict[str, float]:
    """Return the shares under which the mean of predictions, (n,), errs least (least squares), none below
    `LEAST_SHARE`; the calibrated model alone where that errs more by no more than one standard error over folds, (n,).

    What counts are metres and whole runs with their stops, the error of a run over the root of its metres: were the
    errors of metres independent, both would say the same.
    """
    pairs, together = np.unique(np.stack([fold, rows.run]), axis=1, return_inverse=True)
    metres = np.bincount(together, weights=rows.moving)
    share = np.where(metres > 0.0, 1.0 / np.sqrt(np.maximum(metres, 1.0)), 0.0)
    part = np.unique(np.append(fold[rows.moving], pairs[0]), return_inverse=True)[1]

    def _judged(energy: FloatArray) -> FloatArray:
        return np.append(energy[rows.moving], share * np.bincount(together, weights=energy))

    measured, names = _judged(rows.measured), list(PREDICTIONS)
    while True:
        x = np.stack([_judged(said[name]) for name in names], axis=1)
        heavy = _HEAVY * float(np.linalg.norm(measured))
        found = nnls(np.vstack([x, np.full(len(names), heavy)]), np.append(measured, heavy))[0]
        small = found < LEAST_SHARE * found.sum()
        if not small.any():
            break
        names = [name for name, little in zip(names, small, strict=True) if not little]
    shares = dict(zip(names, (found / found.sum()).tolist(), strict=True))
    gains = (measured - _judged(said[CALIBRATED])) ** 2 - (measured - x @ (found / found.sum())) ** 2
    by_fold = np.bincount(part, weights=gains).astype(np.float64)
    return {CALIBRATED: 1.0} if by_fold.size < 2 or within_one_error(by_fold) else shares
