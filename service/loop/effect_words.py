"""What a calibration says of base parameters and effects, and of what these runs cannot distinguish, in sentences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from joulemap.model.loop.forms import FORMS
from joulemap.model.runs.words import number_words, quantity_name
from joulemap.service.words import any_of, capital, p_words, percent

_FEW = 4  # coefficients of an effect that are all written out
_SAME = 0.005  # of what turning costs in plans: less than this is no further part of it


def curve_points(effect: Mapping[str, Any]) -> tuple[list[float], list[float], list[list[float]]]:
    """Return a fitted curve: values of the covariate, what is added there, and its 95 % intervals."""
    knots = list(effect["settings"]["knots"])
    points = [(c["value"], list(c["ci95"])) for c in effect["coefficients"]]
    if is_centred(effect):
        points.insert(len(knots) // 2, (0.0, [0.0, 0.0]))
    return knots, [value for value, _ in points], [interval for _, interval in points]


def is_centred(curve: Mapping[str, Any]) -> bool:
    """Return whether a fitted curve is nil at its middle point; if not, baseline runs say where it is."""
    return bool(curve["settings"].get("centred", True))  # not in reports of older versions


def found_words(document: Mapping[str, Any]) -> list[str]:
    """Return what was found, with coefficients and 95 % intervals."""
    model, effects = document["model"]["before"]["name"], document["effects"]
    if not effects:
        return [
            f"These runs show no effect that the model {model} lacks: no candidate effect is both significant and "
            "large enough to improve the prediction of left-out runs."
        ]
    count = "one effect" if len(effects) == 1 else f"{len(effects)} effects"
    words = [f"These runs show {count} that the model {model} lacks."]
    words += [_effect_words(effect) for effect in effects]
    return [*words, _turning_words(document)] if "turning_in_plans" in document else words


def _effect_words(effect: Mapping[str, Any]) -> str:
    sentences = [f"{capital(effect['label'])}: {'; '.join(coefficient_words(effect))}, p {p_words(effect['p_value'])}."]
    if effect["form"] == "curve":
        sentences.append("The report shows the curve.")
    elif effect["meaning"]:
        sentences.append(f"This is the {effect['meaning']}.")
    sentences.append(f"It acts {effect['where']}.")
    sentences.append(f"It explains {percent(effect['share_of_residual_variance'], 0)} of the squared error.")
    if effect["between_runs"]:
        sentences.append("The differences between runs show it, not the course within a run.")
    return " ".join([*sentences, *_plan_words(effect)])


def _plan_words(effect: Mapping[str, Any]) -> list[str]:
    if effect["in_plans"]:
        return []
    if is_log_fault(effect):
        return ["It is a fault of the log: plans never contain it."]
    return ["Plans do not contain it: it depends on what only a log records."]


def is_log_fault(effect: Mapping[str, Any]) -> bool:
    """Return whether an effect is a fault of the log, such as a late meter, and nothing that costs energy."""
    return not FORMS[effect["form"]].on_map


def _curve_words(effect: Mapping[str, Any]) -> str:
    """A fitted curve without its points: whether it rises or falls, and between which values."""
    values = curve_points(effect)[1]
    steps = [after - before for before, after in zip(values, values[1:], strict=False)]
    unit = effect["coefficients"][0]["unit"]
    low, high = (number_words(end, signed=True) for end in (min(values), max(values)))
    if low == high:
        ends = f"{low} {unit} everywhere"
    elif all(step >= 0.0 for step in steps):
        ends = f"rising from {low} to {high} {unit}"
    elif all(step <= 0.0 for step in steps):
        ends = f"falling from {high} to {low} {unit}"
    else:
        ends = f"between {low} and {high} {unit}"
    return f"a fitted curve over {quantity_name(effect['settings']['over'])}, {ends}"


def _turning_words(document: Mapping[str, Any]) -> str:
    """What turning costs in plans: the effect found is a part of it only where there is more."""
    turn = document["turning_in_plans"]
    total, new = turn["j_per_rad"], turn["new_j_per_rad"]
    volts = " (charge times the nominal voltage)" if document["target"] == "charge_as" else ""
    words = f"In plans one radian of turning costs {number_words(total)} J{volts}"
    if total - new < _SAME * abs(total):
        return f"{words}{_why_other(document)}."
    return (
        f"{words}: {number_words(new)} J are new, the rest is in the model already or in what the baseline runs show."
    )


def _why_other(document: Mapping[str, Any]) -> str:
    """Why turning costs something else in plans than the effect says; empty where it does not."""
    effect = next((e for e in document["effects"] if e["name"] == "turning"), None)
    if document.get("proposal", "after_planner") != "after_planner":
        return ", by the prediction that plans use"
    if effect is None or not (effect["form"] == "curve" or any(effect["settings"].values())):
        return ""
    return ", the mean over the turns of these runs, of which the sharpest take no more power"


def coefficient_words(effect: Mapping[str, Any]) -> list[str]:
    """Return the coefficients of an effect with their 95 % intervals."""
    found = effect["coefficients"]
    if effect["form"] == "curve":
        return [_curve_words(effect)]
    if effect["form"] == "local_friction":
        return [f"{len(found)} values"]
    few = len(found) <= _FEW
    shown = found if few else [f(found, key=lambda c: c["value"]) for f in (min, max)]
    words = []
    for c in shown:
        own = c["name"] == effect["name"]
        name = "" if own and len(found) == 1 else f"{effect['label'] if own else c['name']}: "
        value, low, high = map(number_words, (c["value"], *c["ci95"]))
        unit = f" {c['unit']}" if c["unit"] else ""
        words.append(f"{name}{value}{unit} (95 % interval {low} to {high})")
    return words if few else [f"{len(found)} values, the smallest and the largest", *words]


def labels_of(document: Mapping[str, Any]) -> dict[str, str]:
    """Return what a reader calls each candidate and each effect found, by its name."""
    return {row["name"]: row["label"] for row in (*document["candidates"], *document["effects"])}


def confounded_words(document: Mapping[str, Any]) -> list[str]:
    """Return what these runs cannot distinguish, and what would."""
    labels, lines = labels_of(document), []
    for name, *rivals in document["confounded"]:
        others = any_of([labels.get(rival, rival) for rival in rivals])
        drive = document["to_separate"].get(name)
        more = f" This would: {drive}." if drive else ""
        lines.append(f"These runs cannot distinguish {labels.get(name, name)} from {others}.{more}")
    return lines


_NOTHING = 1e-9  # half a width of an interval: rounding
_BASE = {
    "rolling_resistance": "rolling resistance",
    "energy_of_motion": "energy of motion, as a multiple of the model's",
    "idle_power_w": "idle power",
    "descents": "share of the energy of descents that is lost",
    "driving_power": "power drawn while driving, beside the idle power",
    "speeding_up": "energy of speeding up, as a multiple of the kinetic energy",
    "slowing_down": "energy saved by slowing down, as a multiple of the kinetic energy",
    "measured_slope": "weight of the slope measured by the robot, against that of the map",
    "per_metre": "charge per metre",
    "uphill": "charge per joule of traction",
    "downhill": "charge saved per joule of braking",
    "standing_current": "current drawn all the time",
}


def base_name(key: str) -> str:
    """Return what a reader calls a base parameter."""
    return _BASE.get(key, key.replace("_", " "))


def base_words(document: Mapping[str, Any]) -> list[str]:
    """Return what the runs say of the base model's own parameters."""
    lines = []
    for parameter in document["base_parameters"]:
        if not is_shown(parameter):
            continue
        unit = f" {parameter['unit']}".rstrip()
        value, low, high = map(number_words, (parameter["value"], *parameter["ci95"]))
        declared = "" if parameter["declared"] is None else f"{number_words(parameter['declared'])}{unit} declared, "
        lines.append(
            f"{capital(base_name(parameter['name']))}: {declared}{value}{unit} by the runs "
            f"(95 % interval {low} to {high})."
        )
    return lines


def is_shown(parameter: Mapping[str, Any]) -> bool:
    """Return whether the runs say anything of a base parameter; an interval without a width is of what they lack."""
    half = 0.5 * (parameter["ci95"][1] - parameter["ci95"][0])
    return _NOTHING < half <= max(1.0, abs(parameter["value"]))
