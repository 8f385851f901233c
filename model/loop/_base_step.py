"""The base parameters alone, before any effect: where the drives coast, what was declared, the scale of charge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from joulemap.model.loop._design import Design, fit_model
from joulemap.model.loop._variation import HUBER, spread_of
from joulemap.model.loop.forms import NOT_OF_SLOPE
from joulemap.model.loop.forms._base_parameters import SCALE, BaseParameters, with_base_parameters
from joulemap.model.loop.terms import Term
from joulemap.model.runs.features import Drives, FloatArray
from joulemap.model.runs.residuals import Residuals

_STEEPEST = 0.3
"""Largest tangent on which a robot coasts beyond the declared one: sand (Wong 2008, table 4.1)."""
_ROUNDS = 6
_ROUNDING = 1e-9


def drives_of(residuals: Residuals) -> Drives:
    """Where the drives coast, by the rows of all runs as declared.

    It has the largest posterior density: the likelihood of the base parameters beside effects that say nothing of the
    slope and beside levels of the runs, with Huber's density; and a normal prior around the declared rolling
    resistance, as wide as that is large, which decides where no run coasts. Levels are shares of the prediction with
    the point that is tried: shares of another would know that one too.
    """
    declared, width = residuals.features.drives, max(residuals.features.robot.rolling_resistance, _ROUNDING)

    def _rest(drives: Drives, scale: FloatArray, limit: float | None = None) -> tuple[FloatArray, FloatArray]:
        moved = residuals.driven_by(drives)
        forms = (next(kind.variants(moved.features), None) for kind in NOT_OF_SLOPE)
        others = [columns for form in forms if form is not None and (columns := form.columns(moved.features)).any()]
        rows = moved.features
        of_run = np.stack([np.maximum(rows.predicted, 0.0), rows.weight_length * rows.pulling], axis=1)
        levels = [(moved.unit == u)[:, None] * of_run for u in np.unique(moved.unit)]
        base = BaseParameters.of(charge=moved.charge, motors=moved.motors)
        x = np.column_stack([base.columns(rows), *others, *levels]) / scale[:, None]
        x /= np.maximum(np.sqrt((x**2).mean(axis=0)), _ROUNDING)
        z = (moved.measured - moved.said) / scale
        weight = np.ones(len(z))
        for _ in range(_ROUNDS):  # iteratively reweighted least squares
            normal = (x.T * weight) @ x + _ROUNDING * len(z) * np.eye(x.shape[1])
            rest = z - x @ np.linalg.solve(normal, x.T @ (weight * z))
            size = limit or HUBER * 1.4826 * float(np.median(np.abs(rest)))
            weight = np.minimum(1.0, size / np.maximum(np.abs(rest), _ROUNDING))
        return rest * scale, weight

    usual = float(np.median(np.abs(residuals.measured)))
    rest, _ = _rest(declared, np.maximum(np.abs(residuals.said), usual))
    scale = spread_of(residuals.measured - rest, rest, residuals.moving)
    noise = 1.4826 * float(np.median(np.abs(_rest(declared, scale)[0] / scale)))

    def _loss(shift: float) -> float:
        rest, weight = _rest(replace(declared, coasting_shift=shift), noise * scale, HUBER)
        away = rest / (noise * scale)
        return float((weight * (2.0 - weight) * away**2).sum()) + (shift / width) ** 2  # -2 log density

    tried = np.linspace(-residuals.features.robot.rolling_resistance, _STEEPEST, 17)
    k = int(np.argmin([_loss(float(shift)) for shift in tried]))
    bounds = (tried[max(k - 1, 0)], tried[min(k + 1, len(tried) - 1)])
    found = minimize_scalar(_loss, bounds=bounds, method="bounded", options={"xatol": 1e-5})
    return replace(declared, coasting_shift=float(found.x))


def base_step(residuals: Residuals, new: NDArray[np.bool_]) -> tuple[Residuals, Term, Term | None]:
    """Fit the base parameters alone, before any effect: all rows with what they make of the energy of motion; they; and
    the scale and the zero that make a charge of the base model's prediction, as that of a battery: what it says before
    a calibration.

    new : False in the baseline runs, (n,). Where there are any they alone are fitted, since no effect is at work there.
    """
    known = residuals if new.all() else residuals.take(~new)
    level = not known.features.grades.any()
    drives = known.features.drives if level else drives_of(known)
    plain, moved, fitted = residuals.driven_by(Drives()), residuals.driven_by(drives), known.driven_by(drives)
    base = BaseParameters.of(charge=fitted.charge, motors=fitted.motors, level=level)
    scaled = BaseParameters(tuple(name for name in SCALE if name in base.names))
    term, scale = _alone(fitted, base), _alone(plain, scaled) if plain.charge else None
    moved = replace(moved, features=with_base_parameters(moved.features, base, term.coefficients))
    return moved, term, scale


def _alone(residuals: Residuals, base: BaseParameters) -> Term:
    """Base parameters fitted without any effect."""
    rows, count = residuals.features, len(base.names)
    low, high = base.lowest(rows), np.full(count, np.inf)
    empty = Design(residuals, np.ones(len(residuals), dtype=bool), base.columns(rows), low, high, base, ())
    return Term(base, tuple(fit_model(empty, []).coefficients(np.arange(count), low, high).tolist()))
