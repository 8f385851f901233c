"""The base parameters alone, before any effect: where the drives coast, what was declared, the scale of charge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from joulemap.model.loop.design import Design, fit_model, limits_of
from joulemap.model.loop.features import Drives
from joulemap.model.loop.forms import NOT_OF_SLOPE
from joulemap.model.loop.forms.base_parameters import SCALE, BaseParameters, with_base_parameters
from joulemap.model.loop.residuals import Residuals
from joulemap.model.loop.terms import Term
from joulemap.model.loop.variation import HUBER

FloatArray = NDArray[np.float64]

_MOST_LOST = 0.6
"""Share of the declared rolling resistance that may be losses of the drives, which hold no robot back on a descent:
an efficiency of 40 %, about that of a small gear motor."""
_STEEPEST = 0.3
"""Largest tangent on which a robot coasts beyond the declared one: sand (Wong 2008, table 4.1)."""


def drives_of(residuals: Residuals) -> Drives:
    """Return where the drives coast.

    Parameters
    ----------
    residuals : Residuals
        Of all runs, as declared.

    Returns
    -------
    Drives
        With the largest likelihood of the base parameters beside effects that say nothing of the slope, with Huber's
        density and a scale in proportion to the energy. As declared where the Bayesian information criterion says so.

    Notes
    -----
    A point that the runs show but the model lacks bends the prediction, and the bend looks like an effect of the square
    of the force. The criterion is that of a prior worth one row, as of every coefficient (Kass & Wasserman 1995).
    """
    scale = np.maximum(np.abs(residuals.said), float(np.median(np.abs(residuals.measured))))
    levels = [(residuals.unit == u) * np.maximum(residuals.said, 0.0) for u in np.unique(residuals.unit)]

    def _rest(drives: Drives) -> FloatArray:
        moved = residuals.driven_by(drives)
        forms = (next(kind.variants(moved.features), None) for kind in NOT_OF_SLOPE)
        others = [form.columns(moved.features) for form in forms if form is not None]
        base = BaseParameters.of(charge=moved.charge, motors=moved.motors)
        x = np.column_stack([base.columns(moved.features), *others, *levels]) / scale[:, None]
        z = (moved.measured - moved.said) / scale
        return np.abs(z - x @ np.linalg.solve(x.T @ x + 1e-9 * len(z) * np.eye(x.shape[1]), x.T @ z))

    declared = residuals.features.drives
    limit = max(HUBER * 1.4826 * float(np.median(_rest(declared))), 1e-12)

    def _error(drives: Drives) -> float:
        away = _rest(drives) / limit
        return float(np.where(away < 1.0, away**2, 2.0 * away - 1.0).sum())

    tried = np.linspace(-_MOST_LOST * residuals.features.robot.rolling_resistance, _STEEPEST, 17)
    k = int(np.argmin([_error(replace(declared, coasting_shift=float(shift))) for shift in tried]))
    found = minimize_scalar(
        lambda shift: _error(replace(declared, coasting_shift=float(shift))),
        bounds=(tried[max(k - 1, 0)], tried[min(k + 1, len(tried) - 1)]),
        method="bounded",
        options={"xatol": 1e-3},
    )
    ratio = HUBER**2 * (_error(declared) - float(found.fun))  # minus two log likelihoods
    return replace(declared, coasting_shift=float(found.x)) if ratio > np.log(len(scale)) else declared


def base_step(residuals: Residuals, known: Residuals) -> tuple[Residuals, Term]:
    """Fit the base parameters alone, before any effect.

    Parameters
    ----------
    residuals : Residuals
        Of all runs, as declared.
    known : Residuals
        Of the runs to fit: those of the baseline, where there are any, since no effect is at work there.

    Returns
    -------
    tuple of (Residuals, Term)
        All rows with what the base parameters make of the energy of motion; and the base parameters.
    """
    drives = drives_of(known)
    moved, fitted = residuals.driven_by(drives), known.driven_by(drives)
    base = BaseParameters.of(charge=fitted.charge, motors=fitted.motors)
    term = _alone(fitted, base)
    return replace(moved, features=with_base_parameters(moved.features, base, np.asarray(term.coefficients))), term


def scale_of(residuals: Residuals) -> Term:
    """Fit the scale and the zero that make a charge of the base model's prediction, as that of a battery.

    Parameters
    ----------
    residuals : Residuals
        Of a charge.

    Returns
    -------
    Term
        What the base model says before a calibration.
    """
    plain = replace(residuals, features=replace(residuals.features, drives=Drives(), corrected=None))
    return _alone(plain, BaseParameters(SCALE))


def _alone(residuals: Residuals, base: BaseParameters) -> Term:
    """Base parameters fitted without any effect."""
    empty = Design(residuals, np.ones(len(residuals), dtype=bool), base.columns(residuals.features), base, ())
    _, model = fit_model(empty, [])
    index, low, high = limits_of(empty, [])
    return Term(base, tuple(model.estimate(index, low, high, index[:0]).coefficients.tolist()))
