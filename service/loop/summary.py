"""What a calibration found, in sentences: for the top of the report page and the answer of the command line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from joulemap.model.loop.residual import LEAST_FOLDS
from joulemap.model.loop.words import effect_name, quantity_name

_FEW = 4  # coefficients of an effect that are all written out
_SAME = 0.005  # of what turning costs in plans: less than this is no further part of it
_SUGGESTED = 3  # effects to look for where none was found
_OWN_RUNS = (
    "All these runs took part in the choice of the effects. To measure the error on runs that had no part in it, "
    "name some of them as test runs (`--test-runs`, over HTTP `test_runs`)."
)


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
        The headline, how many effects, one indented line for each, and how much better the model predicts.
    """
    first, *rest = found_words(document)
    return [headline(document), first, *(f"  {words}" for words in rest), error_words(document)]


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


def found_words(document: Mapping[str, Any]) -> list[str]:
    """Return what was found, with coefficients and 95 % intervals.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    list of str
        Sentences: first how many effects, then one for each, then what these runs cannot decide.
    """
    model, effects = document["model"]["before"]["name"], document["effects"]
    if not effects:
        return [
            f"These runs show no effect that the model {model} lacks: no candidate effect is both significant and "
            "large enough to improve the prediction of held-out runs."
        ]
    count = "one effect" if len(effects) == 1 else f"{len(effects)} effects"
    words = [f"These runs show {count} that the model {model} lacks."]
    for effect in effects:
        plans = "" if effect["in_plans"] else " Plans do not contain it: it depends on what only a log records."
        meaning = f" This is the {effect['meaning']}." if effect["meaning"] else ""
        size = f"{_capital(effect['label'])}: {'; '.join(coefficient_words(effect))}.{meaning}"
        if effect["form"] == "smooth":
            size = f"{_curve_words(effect)}."
        words.append(f"{size} It acts {effect['where']}.{plans}")
    if "turning_in_plans" in document:
        words.append(_turning_words(document))
    for name, *rivals in document["confounded"]:
        words.append(
            f"These runs cannot distinguish {effect_name(name)} from {_or(rivals)}: either may be the cause until "
            "other runs separate them."
        )
    return words


def _curve_words(effect: Mapping[str, Any]) -> str:
    """A fitted curve without its points: whether it rises or falls, and between which values."""
    found, settings = effect["coefficients"], effect["settings"]
    values = [c["value"] for c in found]
    if not settings.get("level"):
        values.insert(len(settings["knots"]) // 2, 0.0)  # the curve is nil at its middle point
    steps = [after - before for before, after in zip(values, values[1:], strict=False)]
    unit = f" {found[0]['unit']}" if found[0]["unit"] else ""
    digits = "+.3g" if settings["of"] == "length" else "+.2f"  # J/m, else shares
    low, high = f"{min(values):{digits}}", f"{max(values):{digits}}"
    if all(step >= 0.0 for step in steps):
        ends = f"rising from {low} to {high}{unit}"
    elif all(step <= 0.0 for step in steps):
        ends = f"falling from {high} to {low}{unit}"
    else:
        ends = f"between {low} and {high}{unit}"
    return f"A fitted curve over {quantity_name(settings['over'])}, {ends}; see the figure in the report"


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
        Of many coefficients the smallest and the largest; of a field over the map, whose values mean something together
        only, their number.
    """
    found = effect["coefficients"]
    if effect["form"] == "place":
        return [f"{len(found)} values"]
    few = len(found) <= _FEW
    shown = found if few else [f(found, key=lambda c: c["value"]) for f in (min, max)]
    words = []
    for c in shown:
        own = c["name"] == effect["name"]
        name = "" if own and len(found) == 1 else f"{effect_name(c['name']) if own else c['name']}: "
        low, high = c["ci95"]
        unit = f" {c['unit']}" if c["unit"] else ""
        words.append(f"{name}{c['value']:.3g}{unit} (95 % interval {low:.3g} to {high:.3g})")
    return words if few else [f"{len(found)} values, the smallest and the largest", *words]


def error_words(document: Mapping[str, Any]) -> str:
    """Return how much better the calibrated model predicts.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    str
        Sentences: on test runs where there are some, else on the runs themselves, held out of the fit.
    """
    test, unit = document.get("test_set"), unit_of(document)
    error = (test or document)["error"]
    before, after, plans = error["before"], error["after"], error["after_planner"]
    runs = len(before["by_run"])
    if test:
        count = "one test run" if runs == 1 else f"{runs} test runs"
        where = f"On {count} that had no part in the calibration ({test['segments']:,} segments of 1 m)"
    elif document["effects"]:
        where = f"On these runs, {_held_out_words(document, runs)}"
    else:
        where = "On these runs"
    relative = {state: percent(error[state]["mean_relative"]) for state in ("before", "after", "after_planner")}
    if document["model"]["after"] is None:
        return f"{where}, the mean relative error of the model is {relative['before']}. No model was written."
    if error["corrected"] == before:
        moves = "falls" if after["mean_relative"] < before["mean_relative"] else "does not fall: it goes"
        words = (
            f"{where}, the mean relative error {moves} from {relative['before']} to {relative['after']} (root mean "
            f"square error from {before['rmse']:.3g} to {after['rmse']:.3g} {unit} per segment)."
        )
    else:
        words = f"{where}, the mean relative error is {_three_errors(document, error)}."
    if not document["effects"]:
        words += " The calibrated model contains only corrections that the baseline runs show as well."
    if plans["mean_relative"] != after["mean_relative"]:
        words += f" With what is known before a drive, as in plans, it is {relative['after_planner']}."
    return words if test or not document["effects"] else f"{words} {_OWN_RUNS}"


def _held_out_words(document: Mapping[str, Any], runs: int) -> str:
    """How the errors on the runs themselves were held out, as `Residuals.fold` and `Residuals.block` divide them."""
    by_run = any(effect["form"] == "by_run" for effect in (*document["effects"], *document["collinear"]))
    if runs < LEAST_FOLDS or by_run:
        return "each part of a run predicted by a model fitted to the other parts"
    return "each run predicted by a model fitted to the other runs"


def _three_errors(document: Mapping[str, Any], error: Mapping[str, Any]) -> str:
    """Errors of three models, so that what the baseline runs show already is not credited to the effects."""
    states = {"before": "before", "corrected": "after correcting what the baseline runs show already"}
    if document["effects"]:
        states["after"] = f"with {_and([effect['label'] for effect in document['effects']])}"
    sizes = "; ".join(f"{percent(error[key]['mean_relative'])} {words}" for key, words in states.items())
    rmse = _and([f"{error[key]['rmse']:.3g}" for key in states])
    return f"{sizes} (root mean square error {rmse} {unit_of(document)} per segment)"


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
        "corrected": "with corrections from the baseline runs",
        "after": "after",
        "after_planner": "after, plan-time prediction",
    }
    pairs = (("corrected", "before"), ("corrected", "after"), ("after_planner", "after"))
    same = {key for key, other in pairs if error[key] == error[other]}
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


def collinear_words(document: Mapping[str, Any]) -> str:
    """Return what the calibrated model contains besides the effects found.

    Parameters
    ----------
    document : mapping
        The report.

    Returns
    -------
    str
        A sentence; empty where there is nothing.
    """
    names = " and ".join(effect["label"] for effect in document["collinear"])
    if not names:
        return ""
    one = len(document["collinear"]) == 1
    return (
        f"{_capital(names)} {'is' if one else 'are'} in the calibrated model too: collinear with the effects found, "
        f"{'it corrects' if one else 'they correct'} their form and {'is' if one else 'are'} not counted as "
        f"{'an effect' if one else 'effects'}."
    )


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
    effect, share = effect_name(drive["effect"]), percent(drive["expected_interval_share"], 0)
    aim = (
        f"to distinguish {effect} from {_or(drive['confounded_with'])}"
        if drive["confounded_with"]
        else f"to measure {effect} more precisely"
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
        (name, drive that shows it) of the candidates with the largest gain on held-out runs.
    """
    ranked = sorted(document["candidates"], key=lambda c: -(c["held_out_gain"] or 0.0))
    return [(c["label"], c["reveals"]) for c in ranked if (c["held_out_gain"] or 0.0) > 0.0][:_SUGGESTED]


def _or(names: Sequence[str]) -> str:
    words = [effect_name(name) for name in names]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _and(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
