"""What a calibration found, in sentences: for the top of the report page and the answer of the command line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from joulemap.model.loop.forms import FORMS
from joulemap.model.runs.words import quantity_name, quantity_value
from joulemap.service.words import p_words

_FEW = 4  # coefficients of an effect that are all written out
_SAME = 0.005  # of what turning costs in plans: less than this is no further part of it
_MOVED = 1e-3  # of an interval's half: less is rounding, and the value is the one to start from
_SUGGESTED = 3  # effects to look for where none was found
_BASE = {
    "rolling_resistance": "rolling resistance",
    "energy_of_motion": "energy of motion, as a multiple of the model's",
    "idle_power_w": "idle power",
    "descents": "share of the energy of descents that is lost",
    "driving_power": "power drawn while driving, beside the idle power",
    "speeding_up": "energy of speeding up, as a multiple of the kinetic energy",
    "slowing_down": "energy saved by slowing down, as a multiple of the kinetic energy",
    "measured_slope": "weight of the slope that the robot measured, beside the map's",
    "per_metre": "charge per metre",
    "uphill": "charge per joule of traction",
    "downhill": "charge saved per joule of braking",
    "standing_current": "current drawn all the time",
}
_SAID_RANGES = ("speed", "grade", "turning")  # in sentences; the report's table has all


def curve_points(effect: Mapping[str, Any]) -> tuple[list[float], list[float]]:
    """Return a fitted curve of a report.

    Parameters
    ----------
    effect : mapping
        Of the form `curve`.

    Returns
    -------
    tuple of list of float
        Values of the covariate, and what is added there.
    """
    knots = list(effect["settings"]["knots"])
    values = [c["value"] for c in effect["coefficients"]]
    values.insert(len(knots) // 2, 0.0)
    return knots, values


@dataclass(frozen=True)
class NextStep:
    """Something to do with what was found.

    Attributes
    ----------
    purpose : str
        What it is for, as the beginning of a sentence.
    command : str
        To be typed as it is.
    """

    purpose: str
    command: str


def headline(document: Mapping[str, Any]) -> str:
    """Return the shortest answer to what was found.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    str
        Names of the effects found.
    """
    names = ", ".join(effect["label"] for effect in document["effects"])
    return f"Found: {names}" if names else "No missing effect was found"


def summary_lines(document: Mapping[str, Any]) -> list[str]:
    """Return the whole summary, as the command line and Python print it.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    list of str
        The headline; the base parameters; the effects found; what no effect explains; how much better the model
        predicts; what these runs cannot distinguish; in which ranges they were driven; and of several maps, which one
        the route is on. Details are indented.
    """
    first, *rest = found_words(document)
    lines = [headline(document), "Base parameters:", *(f"  {words}" for words in base_words(document))]
    lines += [first, *(f"  {words}" for words in rest), variation_words(document), *error_words(document)]
    return [*lines, *confounded_words(document), range_words(document), *site_words(document)]


def unit_of(document: Mapping[str, Any]) -> str:
    """Return the unit of measured and predicted values.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    str
        Ampere seconds where no voltage was logged.
    """
    return "A s" if document["target"] == "charge_as" else "J"


def base_name(key: str) -> str:
    """Return what a reader calls a base parameter.

    Parameters
    ----------
    key : str
        Its name in the report.

    Returns
    -------
    str
        Part of a sentence.
    """
    return _BASE.get(key, key.replace("_", " "))


def base_words(document: Mapping[str, Any]) -> list[str]:
    """Return what the runs say of the base model's own parameters.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    list of str
        One line for each that the runs show: what was declared, what the runs say, and its 95 % interval.
    """
    lines = []
    for parameter in document["base_parameters"]:
        if not is_shown(parameter):
            continue
        unit, (low, high) = f" {parameter['unit']}".rstrip(), parameter["ci95"]
        declared = "" if parameter["declared"] is None else f"{parameter['declared']:.3g}{unit} declared, "
        lines.append(
            f"{_capital(base_name(parameter['name']))}: {declared}{parameter['value']:.3g}{unit} by the runs "
            f"(95 % interval {low:.3g} to {high:.3g})."
        )
    return lines


def is_shown(parameter: Mapping[str, Any]) -> bool:
    """Return whether the runs say anything of a base parameter.

    Parameters
    ----------
    parameter : mapping
        From the report.

    Returns
    -------
    bool
        False where the value is the one to start from and the interval is wider than any value that makes sense.
    """
    start = parameter["declared"] or 0.0
    half = 0.5 * (parameter["ci95"][1] - parameter["ci95"][0])
    return half <= 1.0 or abs(parameter["value"] - start) > _MOVED * half


def found_words(document: Mapping[str, Any]) -> list[str]:
    """Return what was found, with coefficients and 95 % intervals.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    list of str
        Sentences: first how many effects, then one paragraph for each.
    """
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
    sentences = [
        f"{_capital(effect['label'])}: {'; '.join(coefficient_words(effect))}, p {p_words(effect['p_value'])}."
    ]
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
    """Return whether an effect is a fault of the log, such as a late meter, and nothing that costs energy.

    Parameters
    ----------
    effect : mapping
        From the report.

    Returns
    -------
    bool
        True for a form that no plan may contain.
    """
    return not FORMS[effect["form"]].on_map


def _curve_words(effect: Mapping[str, Any]) -> str:
    """A fitted curve without its points: whether it rises or falls, and between which values."""
    values = curve_points(effect)[1]
    steps = [after - before for before, after in zip(values, values[1:], strict=False)]
    unit = effect["coefficients"][0]["unit"]
    low, high = f"{min(values):+.3g}", f"{max(values):+.3g}"
    if all(step >= 0.0 for step in steps):
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
    words = f"In plans one radian of turning costs {total:.1f} J{volts}"
    if total - new < _SAME * abs(total):
        return f"{words}."
    return f"{words}: {new:.1f} J are new, the rest is in the model already or in what the baseline runs show."


def coefficient_words(effect: Mapping[str, Any]) -> list[str]:
    """Return the coefficients of an effect with their 95 % intervals.

    Parameters
    ----------
    effect : mapping
        From the report.

    Returns
    -------
    list of str
        Of a curve its ends; of other effects with many coefficients the smallest and the largest; of a field over the
        map, whose values mean something together only, their number.
    """
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
        low, high = c["ci95"]
        unit = f" {c['unit']}" if c["unit"] else ""
        words.append(f"{name}{c['value']:.3g}{unit} (95 % interval {low:.3g} to {high:.3g})")
    return words if few else [f"{len(found)} values, the smallest and the largest", *words]


def variation_words(document: Mapping[str, Any]) -> str:
    """Return by how much runs differ for no known reason.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    str
        A sentence.
    """
    share = document["variation"]["run_share"]
    if len(document["runs"]["names"]) < 2:
        return "One run alone does not show how much runs differ."
    if share < 5e-4:  # nothing in the digits that are shown
        return "The runs do not differ by more than the spread within them."
    return f"Run-to-run variation of {percent(share)} of the energy is left, cause unknown."


def validation_words(document: Mapping[str, Any]) -> str:
    """Return on what the errors were measured.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    str
        Part of a sentence, such as "on runs that had no part in the calibration".
    """
    found = document["validation"]
    if not found["whole_procedure"]:
        return "on the runs that the model was fitted to"
    left_out, folds = found["left_out"], found["folds"]
    return f"on {left_out} that had no part in the calibration that predicts them ({folds} calibrations)"


def error_words(document: Mapping[str, Any]) -> list[str]:
    """Return how much better the calibrated model predicts.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    list of str
        Sentences: on test runs where there are some; on the runs themselves; and how far these may be trusted.
    """
    lines = []
    if test := document.get("test_set"):
        runs = len(test["error"]["before"]["by_run"])
        count = "one test run" if runs == 1 else f"{runs} test runs"
        lines.append(
            f"Errors on {count} that had no part in the calibration ({test['segments']:,} segments): "
            f"{_states(test['error'], unit_of(document))}."
        )
    states = _states(document["error"], unit_of(document))
    lines.append(f"Errors {validation_words(document)}: {states}.")
    if not document["validation"]["whole_procedure"]:
        lines.append(
            "WARNING: these are errors of the fit, because a quick calibration was asked for. Errors on other runs are "
            "larger. Calibrate without `--quick` (over HTTP and in Python: `quick`) to measure them."
        )
    elif document["validation"]["left_out"] == "blocks":
        lines.append(
            "There are too few runs to leave whole ones out, so parts of each run were left out. Errors on another day "
            "may be larger."
        )
    return lines


def _states(error: Mapping[str, Any], unit: str) -> str:
    """Errors of each state of the model."""
    return "; ".join(
        f"{words} {percent(error[key]['mean_relative'])} mean relative, {error[key]['rmse']:.3g} {unit} root mean "
        f"square, {percent(error[key]['absolute_share'])} of the {'charge' if unit == 'A s' else 'energy'}"
        for key, words in error_states(error).items()
    )


def error_states(error: Mapping[str, Any]) -> dict[str, str]:
    """Return words for each state of the model that errors are stated of.

    Parameters
    ----------
    error : mapping
        From the report.

    Returns
    -------
    dict
        Key of the state -> words, without those of no difference to before or after.
    """
    states = {
        "before": "before",
        "corrected": "with the base parameters",
        "after": "after",
        "after_planner": "after, plan-time prediction",
    }
    pairs = (("corrected", "before"), ("after", "corrected"), ("after_planner", "after"))
    same = {key for key, other in pairs if error[key] == error[other]}
    if "after" in same:  # the base parameters are all that was found
        states["corrected"] = "after, with the base parameters"
    return {key: words for key, words in states.items() if key not in same}


def percent(share: float, digits: int = 1) -> str:
    """Return a share in percent.

    Parameters
    ----------
    share : float
        0..1.
    digits : int
        After the decimal point.

    Returns
    -------
    str
        With the sign of percent.
    """
    return f"{100.0 * share:.{digits}f} %"


def labels_of(document: Mapping[str, Any]) -> dict[str, str]:
    """Return what a reader calls each effect of a report.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    dict of str to str
        Name -> label, of the candidates and of the effects found.
    """
    return {row["name"]: row["label"] for row in (*document["candidates"], *document["effects"])}


def confounded_words(document: Mapping[str, Any]) -> list[str]:
    """Return what these runs cannot distinguish, and what would.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    list of str
        A line for each effect that another candidate would replace as well.
    """
    labels, lines = labels_of(document), []
    for name, *rivals in document["confounded"]:
        others = _or([labels.get(rival, rival) for rival in rivals])
        drive = document["to_separate"].get(name)
        more = f" This would: {drive}." if drive else ""
        lines.append(f"These runs cannot distinguish {labels.get(name, name)} from {others}.{more}")
    return lines


def range_words(document: Mapping[str, Any]) -> str:
    """Return in which ranges the calibrated model holds.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    str
        Sentences.
    """
    ranges = document["ranges"]
    driven = [
        f"{quantity_name(key)} {ranges[key][0]:.3g} to {quantity_value(key, ranges[key][1])}"
        for key in _SAID_RANGES
        if key in ranges
    ]
    return f"Driven: {', '.join(driven)}. Beyond these, effects keep their value at the border."


def site_words(document: Mapping[str, Any]) -> list[str]:
    """Return on which of several maps the route was compared.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    list of str
        One sentence, none for a single map.
    """
    sites = document.get("sites", [])
    if len(sites) < 2:
        return []
    main = next(site for site in sites if site["main"])
    return [
        f"Of {len(sites)} maps, the most metres were driven on {main['heightmap']} (run {main['runs'][0]}): the maps, "
        "the route, the next drive and the warnings of this report are for that one."
    ]


def drive_words(drive: Mapping[str, Any]) -> str:
    """Return what to drive next.

    Parameters
    ----------
    drive : mapping
        A suggested drive, or `why_not`.

    Returns
    -------
    str
        Sentences, without the corners of the route.
    """
    if "why_not" in drive:
        return f"No drive is suggested: {drive['why_not']}."
    (x, y), points = drive["points"][0], drive["points"]
    sides = [max(values) - min(values) for values in zip(*points, strict=True)]
    where = (
        f"near x {x:.1f}, y {y:.1f}"
        if drive["placed"]
        else f"on {sides[0]:.1f} x {sides[1]:.1f} m of level ground, wherever there is room"
    )
    pace = " and ".join(f"{speed:.2f} m/s" for speed in drive["speeds_mps"])
    share = percent(drive["expected_interval_share"], 0)
    aim = (
        f"to distinguish {drive['label']} from {_or(drive['confounded_labels'])}"
        if drive["confounded_labels"]
        else f"to measure {drive['label']} more precisely"
    )
    return (
        f"Drive {drive['kind']} {where}, repeated for {drive['total_length_m']:.0f} m at {pace}, {aim}. The 95 % "
        f"interval of its coefficient is then expected to be {share} as wide as now."
    )


def likeliest(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return what could be driven to find an effect where none was found.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    list of tuple of str
        (label, drive that shows it) of the candidates with the smallest p-values below 1.
    """
    able = [c for c in document["candidates"] if not c["taken"] and c["p_value"] < 1.0]
    ranked = sorted(able, key=lambda c: c["p_value"])
    return [(c["label"], c["reveals"]) for c in ranked][:_SUGGESTED]


def _or(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
