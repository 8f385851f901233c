"""What a calibration found, as a JSON-able document."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import heading_vector
from joulemap.model.loop.calibration import Calibration, Effect, verdict_words
from joulemap.model.loop.effects import Term
from joulemap.model.loop.evidence import Verdict
from joulemap.model.loop.formulas import driven_heights

FloatArray = NDArray[np.float64]

_UNITS = {
    "roughness": "m",
    "elevation": "m",
    "hollow": "m",
    "speed": "m/s",
    "column:temperature": "degC",
    "column:motor_temperature": "degC",
    "column:wind_speed": "m/s",
    "column:wind_from": "deg",
    "column:roll": "deg",
    "column:pitch": "deg",
    "column:payload": "kg",
}
"""Of what effects go over; slopes have none, and what other columns are in nobody knows."""
_SHARES = {"all": "of the predicted energy", "motion": "of the motion's energy"}


def report_document(found: Calibration, *, before: Mapping[str, Any], after: str | None) -> dict[str, Any]:
    """The report. before : the base model's provenance; after : the calibrated model's version, None where there is
    none. `effects` are causes; `shadows` are in the model too, and mend the form of the effects. `corrected` errors are
    the base model's with what its own runs show of its errors, before any effect.
    """
    moving = found.residuals.moving
    held = (found.residuals.measured - found.held_out)[moving]
    held = held / np.maximum(found.held_out[moving], 0.05 * np.median(found.residuals.measured[moving]))
    segments = int(moving.sum())
    return {
        "verdict": "effects_added" if found.effects else "nothing_found",
        "target": "charge_as" if found.residuals.charge else "energy_j",
        "segments": {"fit": segments, "held_out": segments},
        "error": {
            "before": found.before,
            "corrected": found.corrected,
            "after": found.after,
            "after_planner": found.after_planner,
        },
        "effects": [_effect(e) for e in found.effects if not e.shadow],
        "shadows": [_effect(e) for e in found.effects if e.shadow],
        "candidates": _candidates(found),
        "confounded": [[name, *rivals] for name, rivals in found.trace.confounded.items()],
        "to_separate": {
            c.name: c.reveals for c in found.candidates if any(c.name in (n, *r) for n, r in _groups(found).items())
        },
        "remaining": {"p_value": found.trace.remaining_p, "std_relative": float(held.std())},
        "refused": dict(found.refused),
        "base_corrections": [t.as_dict() for t in (*found.shared.terms, *found.silent)],
        "model": {"before": {"name": before["name"], "version": before["version"]}, "after": after},
    }


def _groups(found: Calibration) -> dict[str, list[str]]:
    return found.trace.confounded


def _effect(effect: Effect) -> dict[str, Any]:
    names, units = coefficient_names(effect.term), coefficient_units(effect.term)
    return {
        "name": effect.term.name,
        "where": where_words(replace(effect.term, coefficients=tuple(effect.coefficients.tolist()))),
        "form": effect.term.formula,
        "settings": dict(effect.term.settings),
        "coefficients": [
            {"name": name, "value": value, "unit": unit, "ci95": [float(low), float(high)]}
            for name, value, unit, low, high in zip(
                names, effect.coefficients.tolist(), units, effect.low, effect.high, strict=True
            )
        ],
        "p_value": effect.p_value,
        "share_of_residual_variance": effect.share,
        "in_plans": effect.planner,
        "reveals": effect.reveals,
    }


def _candidates(found: Calibration) -> list[dict[str, Any]]:
    taken = {e.term.name: e for e in found.effects}
    last = {c.name: v for c, v in found.trace.remaining}
    out = []
    for candidate, verdict in found.trace.ranking:
        row: dict[str, Any] = {
            "name": candidate.name,
            "p_value": _finite(verdict.p_value),
            "held_out_gain": _finite(verdict.gain),
            "taken": candidate.name in taken,
        }
        if candidate.name not in taken:
            row["why_not"] = _why_not(verdict, last.get(candidate.name)) if taken else verdict_words(verdict)
        elif taken[candidate.name].shadow:
            row |= {"taken": False, "why_not": "it mends the form of the effects found, and is no cause of its own"}
        out.append(row)
    first = [r for r in out if r["taken"]]
    return [*sorted(first, key=lambda r: list(taken).index(r["name"])), *(r for r in out if not r["taken"])]


def _why_not(alone: Verdict, beside: Verdict | None) -> str:
    """Why a candidate was not taken where others were; it may be well above chance alone. beside : beside those, None
    where it was not tried with them.
    """
    if alone.why:
        return alone.why
    if beside is None:
        return "one of the effects found says the same, or leaves it no sense"
    return f"beside the effects found, {verdict_words(beside)}"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def coefficient_units(term: Term) -> list[str]:
    """Of each coefficient; of a learned curve without a unit, what it is a share of."""
    settings = term.settings
    share = next((words for of, words in _SHARES.items() if settings.get("of") == of or settings.get(f"of_{of}")), "")
    return [unit or share if term.name.startswith("learned:") else unit for unit in term.units]


def _with_unit(value: float, over: str) -> str:
    digits = ".1f" if over == "elevation" else ".4g"  # heights may be large and their differences small
    return f"{value:{digits}} {_UNITS.get(over, '')}".rstrip()


def coefficient_names(term: Term) -> list[str]:
    """What each coefficient of a term is called."""
    count, settings = len(term.coefficients), term.settings
    if term.formula == "by_run":
        per = count // len(settings["runs"])
        parts = [""] if per == 1 else [" east", " north"]
        return [f"{run}{part}" for run in settings["runs"] for part in parts]
    if term.formula in ("words", "turning_words"):
        return [str(word) for word in settings["values"]]
    if term.formula == "smooth":
        knots, level = settings["knots"], settings.get("level")
        names = [f"at {_with_unit(knot, settings['over'])}" for knot in knots]
        return [name for k, name in enumerate(names) if level or k != len(knots) // 2]
    if term.formula == "place":
        return [f"at x {x:.1f}, y {y:.1f}" for x, y in settings["centres"]]
    if term.formula == "wind_constant":
        return ["east", "north"]
    if term.formula == "heading":
        waves = [f"{wave} {k}h" for k in range(1, settings["harmonics"] + 1) for wave in ("sin", "cos")]
        return ["level", *waves] if settings.get("level") else waves
    if term.formula == "turning_both":
        return ["turning", f"turning up to {settings['limit_radps']:g} rad/s"]
    if term.formula == "turning_sides":
        return ["right", "left"]
    return ["at the start" if term.name == "drift" else "at the reference", term.name] if count == 2 else [term.name]


def where_words(term: Term) -> str:
    """Where a term acts, in words."""
    if term.formula == "disk":
        s = term.settings
        return f"within {s['radius_m']:g} m of x {s['x']:.1f}, y {s['y']:.1f}"
    if term.formula == "place":
        return _field_words(term)
    if term.formula == "turning" and term.settings.get("limit_radps"):
        gentle = term.coefficients[0] / term.settings.get("share", 1.0)
        slow = f"{gentle:.4g} {term.units[0]} up to {term.settings['limit_radps']:g} rad/s, no more above"
        return f"everywhere; {slow} (the coefficient is over all turns)"
    if not term.where and term.settings.get("over") == "elevation":
        low, high = driven_heights(term.settings["knots"])
        return f"at heights about those driven, {low:.1f} to {high:.1f} m; nothing at others"
    if not term.where:
        return "everywhere"
    if "runs" in term.where:
        return "in these runs only: another day has its own"
    if "word" in term.where:
        return f"where {term.where['word']} is {term.where['is']}"
    side = "above" if "above" in term.where else "below"
    over = term.where["over"]
    return f"where {over.removeprefix('column:')} is {side} {_with_unit(term.where[side], over)}"


def _field_words(term: Term) -> str:
    """Where a field of bell curves is largest, and how far from there it falls to half, mean over all bearings."""
    centres, width = np.asarray(term.settings["centres"]), term.settings["width_m"]

    def field(at: FloatArray) -> FloatArray:
        away = at[..., None, :] - centres  # (..., centres, 2)
        return np.exp(-0.5 * (away**2).sum(axis=-1) / width**2) @ np.asarray(term.coefficients)

    at_centres = field(centres)
    peak = int(np.argmax(np.abs(at_centres)))
    radii = width * np.arange(1, 41) / 4.0
    dx, dy = heading_vector(np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False))
    around = field(centres[peak] + radii[:, None, None] * np.stack([dx, dy], axis=-1)).mean(axis=1)
    beyond = np.abs(around) < 0.5 * abs(at_centres[peak])
    half = f", half of it {radii[np.argmax(beyond)]:.0f} m away" if beyond.any() else ""
    x, y = centres[peak]
    return f"a field over the map, strongest at x {x:.1f}, y {y:.1f}: {at_centres[peak]:+.2g}{half}"
