"""What a calibration found, how well it predicts, what to do next, in sentences: for the page and the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from joulemap.model.runs.words import number_words, quantity_name, quantity_value
from joulemap.service.loop.effect_words import base_words, confounded_words, found_words
from joulemap.service.words import any_of, percent


def unit_of(document: Mapping[str, Any]) -> str:
    """Return the unit of measured and predicted values. Result: ampere seconds where no voltage was logged."""
    return "A s" if document["target"] == "charge_as" else "J"


def variation_words(document: Mapping[str, Any]) -> str:
    """Return by how much runs differ for no known reason."""
    share = document["variation"]["run_share"]
    if len(document["runs"]["names"]) < 2:
        return "One run alone does not show how much runs differ."
    if share < 5e-4:  # nothing in the digits that are shown
        return "The runs do not differ by more than the spread within them."
    return f"Run-to-run variation of {percent(share)} of the energy is left, cause unknown."


def validation_words(document: Mapping[str, Any]) -> str:
    """Return on what the errors were measured.

    Result: part of a sentence, such as "on runs that had no part in the calibration".
    """
    found = document["validation"]
    if not found["whole_procedure"]:
        return "on the runs that the model was fitted to"
    left_out, folds = found["left_out"], found["folds"]
    return f"on {left_out} that had no part in the calibration that predicts them ({folds} calibrations)"


def error_words(document: Mapping[str, Any]) -> list[str]:
    """Return how much better the calibrated model predicts."""
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
    lines += _worse_words(document)
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


_PLANS = {
    "after_planner": "the calibrated model",
    "least_squares": "least squares of length, climb, turned angle, time, drag and kinetic energy",
    "constant": "a constant energy per metre",
    "before": "the model before",
}


def plan_words(document: Mapping[str, Any]) -> list[str]:
    """Return what plans are made with, and why; and whether it is right on average."""
    if not document["validation"]["whole_procedure"]:
        return []
    error, chosen = document["error"], document["proposal"]
    why = (
        "errs least on routes and runs"
        if chosen != "after_planner"
        else "no other prediction surely errs less on routes"
    )
    size = {key: f"{number_words(error[key]['rmse'])} {unit_of(document)}" for key in (*_PLANS, "proposed")}
    others = ", ".join(f"{size[key]} of {words}" for key, words in _PLANS.items() if key != chosen)
    what = f"Plans use {_PLANS[chosen]} ({why}): {size['proposed']} root mean square {validation_words(document)}"
    lines, level = [f"{what}, against {others}."], document["mean"]["proposed"]
    if level["std"] is None:  # one run alone says nothing
        return lines
    ratio, error = percent(level["ratio"]), percent(level["std"])
    what = f"The measured energy is {ratio} of the predicted one (standard error {error})"
    if not level["agrees"] and level["factor"] == 1.0:
        return [
            *lines,
            f"WARNING: {what}. A factor would make metres worse, because it hangs on a few: none is applied.",
        ]
    if level["agrees"]:
        return [*lines, f"Right on average: {what[0].lower()}{what[1:]}, which is no difference."]
    return [*lines, f"WARNING: {what}: all predictions of plans are multiplied by {level['factor']:.3f}."]


def unknown_words(document: Mapping[str, Any]) -> list[str]:
    """Return how much of the error of plans comes from what only a log knows."""
    error, known = document["error"], document["validation"]
    names = [effect["label"] for effect in document["effects"] if not effect["in_plans"]]
    with_log, planned = (error[key].get("run_energy_rms") for key in ("after", "after_planner"))
    if not names or not known["whole_procedure"] or known["left_out"] == "blocks" or not with_log or not planned:
        return []
    what = f"The energy of a whole run is off by {percent(planned)} at plan time (root mean square)"
    if planned <= with_log:
        return [f"{what}, and by {percent(with_log)} with what only a log knows: {', '.join(names)}."]
    share = percent(1.0 - (with_log / planned) ** 2, 0)
    return [
        f"{what}, and by {percent(with_log)} with what only a log knows: {', '.join(names)}. So {share} of the "
        "variance of plans is theirs."
    ]


def odds_words(document: Mapping[str, Any]) -> list[str]:
    """Return whether the odds of the calibrated model were right on runs that had no part in them."""
    if not (found := document.get("reliability")) or not document["validation"]["whole_procedure"]:
        return []
    inside = ", ".join(f"{percent(share, 0)} inside the {level} % interval" for level, share in found["inside"].items())
    curve = ", ".join(f"{percent(said, 0)} said, {percent(happened, 0)} happened" for said, happened in found["curve"])
    lines = [
        f"Odds on {found['routes']} stretches of runs that had no part in them: {inside}. No more energy: {curve}."
    ]
    if found["factor"] != 1.0:
        lines.append(f"These intervals held too little or too much: they are made {found['factor']:.2f} times as wide.")
    return lines


def level_words(document: Mapping[str, Any]) -> list[str]:
    """Return what runs on level ground do not say."""
    if not document["level_ground"]:
        return []
    return ["All runs are on level ground, which says nothing of slopes: a climb costs what the model before says."]


def advice(document: Mapping[str, Any]) -> str:
    """Return whether to keep the model before."""
    for key, where in (("confirmed", ""), ("confirmed_in_plans", " for plans")):
        if document.get(key) is False:
            return f"Not confirmed{where}: keep the model that you have."
    return ""


def _worse_words(document: Mapping[str, Any]) -> list[str]:
    """A warning where other runs are predicted no better than before."""
    if not (words := advice(document)):
        return []
    state = "after" if document["confirmed"] is False else "proposed"
    judged = [part["error"] for part in (document.get("test_set"), document) if part]
    sizes = ", and ".join(
        f"{number_words(error[state]['rmse'])} against {number_words(error['before']['rmse'])} {unit_of(document)}"
        for error in judged
    )
    return [
        f"WARNING: {words} The calibrated model errs no less than the model before ({sizes} root mean square). "
        "Calibrate on more runs. If the model before was trained on these very runs, its error on other runs is larger "
        "than stated here."
    ]


def _states(error: Mapping[str, Any], unit: str) -> str:
    """Errors of each state of the model."""
    return "; ".join(
        f"{words} {percent(error[key]['mean_relative'])} mean relative, {number_words(error[key]['rmse'])} {unit} "
        f"root mean square, {percent(error[key]['absolute_share'])} of the {'charge' if unit == 'A s' else 'energy'}"
        for key, words in error_states(error).items()
    )


def error_states(error: Mapping[str, Any]) -> dict[str, str]:
    """Return words for each state of the model that errors are stated of."""
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


def site_words(document: Mapping[str, Any]) -> list[str]:
    """Return on which of several maps the route was compared."""
    sites = document.get("sites", [])
    if len(sites) < 2:
        return []
    main = next(site for site in sites if site["main"])
    return [
        f"Of {len(sites)} maps, the most metres were driven on {main['heightmap']} (run {main['runs'][0]}): the maps, "
        "the route, the next drive and the warnings of this report are for that one."
    ]


_SUGGESTED = 3  # effects to look for where none was found


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


def drive_words(drive: Mapping[str, Any]) -> str:
    """Return what to drive next. Result: sentences, without the corners of the route."""
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
        f"to distinguish {drive['label']} from {any_of(drive['confounded_labels'])}"
        if drive["confounded_labels"]
        else f"to measure {drive['label']} more precisely"
    )
    return (
        f"Drive {drive['kind']} {where}, repeated for {drive['total_length_m']:.0f} m at {pace}, {aim}. The 95 % "
        f"interval of its coefficient is then expected to be {share} as wide as now."
    )


def likeliest(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return what could be driven to find an effect where none was found."""
    able = [c for c in document["candidates"] if not c["taken"] and c["p_value"] < 1.0]
    ranked = sorted(able, key=lambda c: c["p_value"])
    return [(c["label"], c["reveals"]) for c in ranked][:_SUGGESTED]


FORMER_KEYS = {
    "test_set": "kept_aside",
    "confounded_with": "tells_from",
}
"""Key today -> the key of versions before 0.2."""


def with_former_keys(document: dict[str, Any]) -> dict[str, Any]:
    """Return a document that has its renamed values under their former keys too."""
    out = {key: with_former_keys(value) if isinstance(value, dict) else value for key, value in document.items()}
    return out | {former: out[key] for key, former in FORMER_KEYS.items() if key in out}


_SAID_RANGES = ("speed", "grade", "turning")  # in sentences; the report's table has all


def headline(document: Mapping[str, Any]) -> str:
    """Return the shortest answer to what was found."""
    names = ", ".join(effect["label"] for effect in document["effects"])
    found = f"Found: {names}" if names else "No missing effect was found"
    return f"{found}. {words}" if (words := advice(document)) else found


def summary_lines(document: Mapping[str, Any]) -> list[str]:
    """Return the whole summary, as the command line and Python print it."""
    first, *rest = found_words(document)
    lines = [
        headline(document),
        *level_words(document),
        "Base parameters:",
        *(f"  {words}" for words in base_words(document)),
    ]
    lines += [first, *(f"  {words}" for words in rest), variation_words(document), *error_words(document)]
    lines += [*unknown_words(document), *plan_words(document), *odds_words(document)]
    return [*lines, *confounded_words(document), range_words(document), *site_words(document)]


def range_words(document: Mapping[str, Any]) -> str:
    """Return in which ranges the calibrated model holds."""
    ranges = document["ranges"]
    driven = [
        f"{quantity_name(key)} {number_words(ranges[key][0])} to {quantity_value(key, ranges[key][1])}"
        for key in _SAID_RANGES
        if key in ranges
    ]
    return f"Driven: {', '.join(driven)}. Beyond these, effects keep their value at the border."
