"""What a calibration found, as a JSON-able document."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from joulemap.model.loop._selection import ALPHA
from joulemap.model.loop.calibrate import Calibration, Effect
from joulemap.model.loop.terms import Term
from joulemap.model.runs.features import FloatArray

__all__ = ["ALPHA", "report_document"]


def report_document(found: Calibration, *, before: Mapping[str, Any], after: str | None) -> dict[str, Any]:
    """Return the report of a calibration.

    Result: `error` has the states before, corrected (with the base parameters), after, and after_planner (with what is
    known before a drive), each of procedures that had no part of the run; `validation` says of which. `base_parameters`
    are what the runs say of the declared values.
    """
    fitted, moving = found.fitted, found.residuals.moving
    segments = int(moving.sum())
    variation = fitted.selection.model.variation
    confounded = dict.fromkeys(name for key, rivals in found.rivals.items() for name in (key, *rivals))
    return {
        "verdict": "effects_added" if found.effects else "nothing_found",
        "target": "charge_as" if found.residuals.charge else "energy_j",
        "segments": {"fit": segments, "held_out": segments},
        "validation": {
            "folds": found.folds,
            "left_out": "runs" if found.residuals.whole_runs else "blocks",
            "whole_procedure": found.folds > 0,
        },
        "baseline_runs": found.baseline is not None,
        "error": dict(found.errors),
        "confirmed": found.confirmed(),
        "confirmed_in_plans": found.confirmed("proposed"),
        "proposal": found.proposal,
        "level_ground": bool(getattr(fitted.base.form, "level", False)),
        "mean": {key: level.as_dict() for key, level in found.levels.items()},
        "base_parameters": _base_parameters(found),
        "effects": [_effect(found, e) for e in found.effects],
        "variation": {
            "run_share": fitted.run_share,
            "serial_share": variation.serial_share,
            "correlation_segments": variation.length_rows if variation.process > 0.0 else 0.0,
            "outlier_share": float(np.mean(variation.weight < 1.0)),
        },
        "candidates": _candidates(found),
        "confounded": [[name, *rivals] for name, rivals in found.rivals.items()],
        "to_separate": {name: fitted.selection.design.first_of[name].form.reveals for name in confounded},
        "remaining": _remaining(found),
        "refused": dict(found.refused),
        "ranges": {key: list(ends) for key, ends in fitted.correction.ranges.items()},
        "model": {"before": {"name": before["name"], "version": before["version"]}, "after": after},
    }


def _coefficients(
    found: Calibration, term: Term, low: FloatArray, high: FloatArray, declared: Mapping[str, float]
) -> list[dict[str, Any]]:
    names, units = term.form.coefficient_names(), term.form.units("A s" if found.residuals.charge else "J")
    rows = zip(names, units, term.coefficients, low.tolist(), high.tolist(), strict=True)
    return [
        {"name": n, "value": declared.get(n, 0.0) + v, "unit": u, "ci95": [declared.get(n, 0.0) + end for end in ends]}
        for n, u, v, *ends in rows
    ]


def _base_parameters(found: Calibration) -> list[dict[str, Any]]:
    fitted, robot = found.fitted, found.residuals.features.robot
    declared = {
        "rolling_resistance": robot.rolling_resistance,
        "energy_of_motion": 1.0,
        "idle_power_w": robot.idle_power_w,
    }
    coasting = robot.rolling_resistance + fitted.correction.drives.coasting_shift  # what the coefficient is added to
    known = declared | {"rolling_resistance": coasting}
    rows = _coefficients(found, fitted.base, fitted.base_low, fitted.base_high, known)
    return [row | {"declared": declared.get(row["name"])} for row in rows]


def _effect(found: Calibration, effect: Effect) -> dict[str, Any]:
    form = effect.term.form
    return {
        "name": form.name,
        "label": form.title,
        "where": form.where(effect.term.coefficients),
        "form": form.key,
        "meaning": form.meaning,
        "settings": {key: value for key, value in form.as_dict().items() if key != "form"},
        "coefficients": _coefficients(found, effect.term, effect.low, effect.high, {}),
        "p_value": effect.p_value,
        "share_of_residual_variance": effect.share,
        "between_runs": effect.between,
        "in_plans": form.known_before,
        "reveals": form.reveals,
    }


def _candidates(found: Calibration) -> list[dict[str, Any]]:
    taken = [verdict.name for verdict in found.fitted.selection.taken]
    out = []
    for name, (alone, last) in found.fitted.selection.by_name.items():
        form = alone.candidate.form
        row: dict[str, Any] = {
            "name": name,
            "label": form.title,
            "p_value": alone.p_value,
            "held_out_gain": alone.gain if math.isfinite(alone.gain) else None,
            "taken": name in taken,
            "reveals": form.reveals,
        }
        if name not in taken:
            row["why_not"] = alone.why_not or f"beside the effects found, {last.why_not or 'not significant'}"
        out.append(row)
    order = {name: k for k, name in enumerate(taken)}
    return sorted(out, key=lambda row: (order.get(row["name"], len(order)), row["p_value"]))


def _remaining(found: Calibration) -> dict[str, Any]:
    """What is left beside the effects: the smallest p-value of any candidate, and the spread on left-out runs."""
    selection = found.fitted.selection
    names = {verdict.name for verdict in selection.taken}
    p_values = [verdict.p_value for verdict in selection.last if verdict.name not in names]
    moving = found.residuals.moving
    after = found.held_out["after"][moving]
    away = found.residuals.measured[moving] - after
    usual = float(np.median(np.abs(found.residuals.measured[moving])))
    return {
        "p_value": min(p_values, default=1.0),
        "alpha": ALPHA,
        "std_relative": float((away / np.maximum(after, 0.05 * usual)).std()),
    }
