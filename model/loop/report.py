"""What a calibration found, as a JSON-able document."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import heading_vector
from joulemap.model.loop.calibration import Calibration, Effect
from joulemap.model.loop.candidates import Candidate
from joulemap.model.loop.effects import Term
from joulemap.model.loop.evidence import Verdict
from joulemap.model.loop.quantities import driven_heights
from joulemap.model.loop.selection import ALPHA
from joulemap.model.loop.words import coefficient_meaning, effect_name, quantity_name, quantity_value

FloatArray = NDArray[np.float64]

_SHARES = {"all": "of the predicted energy", "motion": "of the motion's energy"}
_COLLINEAR = "collinear with the effects found: it corrects their form and is not an effect of its own"
_CURVES = {
    "length": "energy per metre added, at points of a fitted curve",
    "all": "share of the predicted energy added, at points of a fitted curve",
    "motion": "share of the motion's energy added, at points of a fitted curve",
}


def report_document(found: Calibration, *, before: Mapping[str, Any], after: str | None) -> dict[str, Any]:
    """Return the report of a calibration.

    Parameters
    ----------
    found : Calibration
        What was found.
    before : mapping
        Provenance of the base model.
    after : str, optional
        Version of the calibrated model. Without it there is none.

    Returns
    -------
    dict
        JSON-able. `effects` are the missing effects. `collinear` are in the calibrated model too: they correct the form
        of the effects and are no effects of their own. `error` has the states before, corrected (with what the baseline
        runs show of the base model's errors), after, and after_planner (with what is known before a drive).
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
            "corrected": found.corrected if has_baseline(found) else found.before,
            "after": found.after,
            "after_planner": found.after_planner,
        },
        "effects": [_effect(e) for e in found.effects if not e.shadow],
        "collinear": [_effect(e) for e in found.effects if e.shadow],
        "candidates": _candidates(found),
        "confounded": [[name, *rivals] for name, rivals in found.trace.confounded.items()],
        "to_separate": {
            c.name: c.reveals
            for c in found.candidates
            if any(c.name in (name, *rivals) for name, rivals in found.trace.confounded.items())
        },
        "remaining": {"p_value": found.trace.remaining_p, "std_relative": float(held.std())},
        "refused": dict(found.refused),
        "baseline_corrections": [t.as_dict() for t in (*found.shared.terms, *found.silent)],
        "model": {"before": {"name": before["name"], "version": before["version"]}, "after": after},
    }


def has_baseline(found: Calibration) -> bool:
    """Return whether the runs were compared with baseline runs: only then is there anything that these show.

    Parameters
    ----------
    found : Calibration
        What was found.

    Returns
    -------
    bool
        False too where only charge was logged, of which baseline runs are not used.
    """
    return found.shared.residuals is not None


def _effect(effect: Effect) -> dict[str, Any]:
    names, units = coefficient_names(effect.term), coefficient_units(effect.term)
    return {
        "name": effect.term.name,
        "label": effect_name(effect.term.name),
        "where": where_words(replace(effect.term, coefficients=tuple(effect.coefficients.tolist()))),
        "form": effect.term.formula,
        "meaning": _meaning(effect.term),
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
            "label": effect_name(candidate.name),
            "p_value": _finite(verdict.p_value),
            "held_out_gain": _finite(verdict.gain),
            "taken": candidate.name in taken,
            "reveals": candidate.reveals,
        }
        if candidate.name not in taken:
            why_not = _why_not(verdict, last.get(candidate.name)) if taken else _verdict_words(verdict)
            row["why_not"] = why_not if _recorded(candidate) else f"not recorded; as a constant of the run: {why_not}"
        elif taken[candidate.name].shadow:
            row |= {"taken": False, "why_not": _COLLINEAR}
        out.append(row)
    first = [r for r in out if r["taken"]]
    return [*sorted(first, key=lambda r: list(taken).index(r["name"])), *(r for r in out if not r["taken"])]


def _recorded(candidate: Candidate) -> bool:
    """Whether a log has what the candidate depends on; the wind and the load are looked for without it, too."""
    return any(term.formula not in ("wind_constant", "by_run") for term in candidate.variants)


def _why_not(alone: Verdict, beside: Verdict | None) -> str:
    """Why a candidate was not taken where others were; alone it may be significant. beside : with those in the model,
    None where it was not tried with them.
    """
    if alone.why:
        return alone.why
    if beside is None:
        return "it duplicates one of the effects found, or has no physical size beside them"
    return f"beside the effects found, {_verdict_words(beside)}"


def _verdict_words(verdict: Verdict) -> str:
    if verdict.why:
        return verdict.why
    if verdict.p_value > ALPHA:
        return "not significant"
    return "its gain on held-out runs is below the threshold"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def coefficient_units(term: Term) -> list[str]:
    """Return the unit of each coefficient of a term.

    Parameters
    ----------
    term : Term
        With or without coefficients.

    Returns
    -------
    list of str
        For a fitted curve without a unit: what its values are a share of.
    """
    settings = term.settings
    share = next((words for of, words in _SHARES.items() if settings.get("of") == of or settings.get(f"of_{of}")), "")
    return [unit or share if term.name.startswith("learned:") else unit for unit in term.units]


def _meaning(term: Term) -> str:
    if term.formula == "smooth":
        return _CURVES[term.settings["of"]]
    return coefficient_meaning(term.settings["of"] if term.formula == "by_run" else term.formula)


def coefficient_names(term: Term) -> list[str]:
    """Return what each coefficient of a term is called.

    Parameters
    ----------
    term : Term
        With its coefficients.

    Returns
    -------
    list of str
        A single coefficient has the key of the effect.
    """
    count, settings = len(term.coefficients), term.settings
    if term.formula == "by_run":
        per = count // len(settings["runs"])
        parts = [""] if per == 1 else [" east", " north"]
        return [f"{run}{part}" for run in settings["runs"] for part in parts]
    if term.formula in ("words", "turning_words"):
        return [str(word) for word in settings["values"]]
    if term.formula == "smooth":
        knots, level = settings["knots"], settings.get("level")
        names = [f"at {quantity_value(settings['over'], knot)}" for knot in knots]
        return [name for k, name in enumerate(names) if level or k != len(knots) // 2]
    if term.formula == "place":
        return [f"at x {x:.1f}, y {y:.1f}" for x, y in settings["centres"]]
    if term.formula == "wind_constant":
        return ["east", "north"]
    if term.formula == "heading":
        waves = [f"{wave} {k}h" for k in range(1, settings["harmonics"] + 1) for wave in ("sin", "cos")]
        return ["constant", *waves] if settings.get("level") else waves
    if term.formula == "turning_both":
        return ["turning", f"turning up to {settings['limit_radps']:g} rad/s"]
    if term.formula == "turning_sides":
        return ["right", "left"]
    return ["at the start" if term.name == "drift" else "at the reference", term.name] if count == 2 else [term.name]


def where_words(term: Term) -> str:
    """Return where a term acts, in words.

    Parameters
    ----------
    term : Term
        With its coefficients.

    Returns
    -------
    str
        A part of a sentence, such as "everywhere".
    """
    if term.formula == "disk":
        s = term.settings
        return f"within {s['radius_m']:g} m of x {s['x']:.1f}, y {s['y']:.1f}"
    if term.formula == "place":
        return _field_words(term)
    if term.formula == "turning" and (limit := term.settings.get("limit_radps")):
        usual, unit = term.coefficients[0], term.units[0]
        return (
            f"{where_words(replace(term, settings={}))}: turns slower than {limit:g} rad/s cost "
            f"{usual / term.settings.get('share', 1.0):.3g} {unit}. Above that rate the power no longer grows, so a "
            f"faster turn costs less per radian; the mean over all turns is {usual:.3g} {unit}"
        )
    if not term.where and term.settings.get("over") == "elevation":
        low, high = driven_heights(term.settings["knots"])
        return f"at heights about those driven, {low:.1f} to {high:.1f} m; nothing at others"
    if not term.where:
        return "everywhere"
    if "runs" in term.where:
        return "in these runs only: it differs from day to day"
    if "word" in term.where:
        return f"where {term.where['word']} is {term.where['is']}"
    side = "above" if "above" in term.where else "below"
    over = term.where["over"]
    shown = {"above": "below", "below": "above"}[side] if over == "hollow" else side  # written with the other sign
    return f"where {quantity_name(over)} is {shown} {quantity_value(over, term.where[side])}"


def _field_words(term: Term) -> str:
    """Where a field of Gaussian bumps is largest, and how far from there it falls to half, mean over all bearings."""
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
