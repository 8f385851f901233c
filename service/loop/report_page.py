"""report.html: what a calibration found and what to do with it, in one file that loads nothing else."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from joulemap.model.energy.metrics import LEAST_J
from joulemap.model.loop.report import ALPHA
from joulemap.model.runs.words import count_words, number_words, quantity_name, quantity_words
from joulemap.service.loop.base_words import base_name, is_shown
from joulemap.service.loop.calibration import Calibrated
from joulemap.service.loop.effect_words import coefficient_words, found_words, is_centred, is_log_fault, labels_of
from joulemap.service.loop.error_words import (
    error_states,
    error_words,
    level_words,
    odds_words,
    plan_words,
    site_words,
    unit_of,
    unknown_words,
    validation_words,
    variation_words,
)
from joulemap.service.loop.next_words import NextStep, drive_words, likeliest
from joulemap.service.loop.report_figures import (
    LEAST_SPAN,
    against_figures,
    change_figure,
    curve_figure,
    error_figure,
    prediction_figures,
    residual_maps,
)
from joulemap.service.loop.summary import headline, range_words
from joulemap.service.pictures import route_picture
from joulemap.service.words import p_words, percent

_STYLE = """
:root { color-scheme: light dark; --back: #f6f7f8; --card: #fff; --ink: #1d2329; --quiet: #56606a; --line: #d6dbe0;
  --warn: #8a5200; --accent: #0067a3 }
@media (prefers-color-scheme: dark) { :root { --back: #14181c; --card: #1d2329; --ink: #e8ecef; --quiet: #a5afb8;
  --line: #3a434c; --warn: #f0b860; --accent: #6cb8ee } }
body { font: 15px/1.5 system-ui, "Segoe UI", Roboto, "Noto Sans", sans-serif; color: var(--ink);
  background: var(--back); max-width: 62rem; margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.5rem } h2 { font-size: 1.1rem; margin-top: 2.2rem } li { margin: .3rem 0 } a { color: var(--accent) }
table { border-collapse: collapse; width: 100%; min-width: 36rem } div.table { overflow-x: auto }
th, td { text-align: left; padding: .3rem .6rem; border-bottom: 1px solid var(--line); vertical-align: top;
  font-variant-numeric: tabular-nums }
th { font-weight: 600 } td.number { white-space: nowrap } div.full { max-width: 46rem }
svg, img { width: 100%; height: auto; margin-top: .6rem; background: #fff; border-radius: 8px }
div.figures { display: grid; gap: 1rem; grid-template-columns: repeat(auto-fit, minmax(min(24rem, 100%), 1fr)) }
div.small { grid-template-columns: repeat(auto-fill, minmax(min(14rem, 100%), 1fr)) }
p.note { color: var(--quiet) } p.warning { color: var(--warn) }
code.command { display: block; white-space: pre-wrap; overflow-wrap: anywhere; background: var(--card);
  border: 1px solid var(--line); border-radius: 7px; padding: .5rem .7rem; font-size: .9rem }
"""
_AGAINST = (
    '<p class="note">Mean residual in bins with equal numbers of segments, with two standard errors: red before, green '
    "after. A line that stays at zero means that the quantity explains nothing more.</p>"
)
_ALIKE = 0.005  # of the mean energy per metre: less than this is no change of the map


def report_page(made: Calibrated, *, steps: Sequence[NextStep] = ()) -> str:
    """Return the page."""
    document, found = made.document, made.found
    unit, title = unit_of(document), headline(document)
    parts = [
        f"<h1>{escape(title)}</h1>" + _lead(document, steps),
        "".join(f'<p class="warning">Warning: {escape(warning)}</p>' for warning in document["warnings"]),
        "<h2>Base parameters</h2>" + _base_parameters(document),
        "<h2>Effects found</h2>" + _effects(document),
        "<h2>Variation that no effect explains</h2>" + _variation(document),
        "<h2>Prediction error</h2>" + _errors(document, unit) + _full(error_figure(found)),
        "<h2>Track used</h2>" + _coverage(document),
        _confounded(document),
        "<h2>Ranges of these runs</h2>" + _ranges(document),
        "<h2>Change of the cost map</h2>" + _map(made),
        "<h2>A route before and after</h2>" + _route(made),
        "<h2>What to drive next</h2>" + _next_drive(document),
        "<h2>Measured against predicted</h2>" + _figures(prediction_figures(found, unit)),
        "<h2>Residuals on the map</h2>" + _figures(residual_maps(found, _runs_of_main(document))),
        f"<h2>Residual [{unit}] against each quantity</h2>{_AGAINST}",
        _figures(against_figures(found, unit), "figures small"),
        "<h2>All candidate effects</h2>" + _candidates(document),
        "<h2>What was read from the logs</h2>" + _repairs(document["runs"]),
    ]
    body = re.sub(r"(?<=\d) (?=%)", "&nbsp;", "".join(parts))
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style><body>{body}</body></html>\n"
    )


def _runs_of_main(document: Mapping[str, Any]) -> list[str] | None:
    """Of the map that routes are compared on."""
    return next((site["runs"] for site in document.get("sites", []) if site["main"]), None)


def _lead(document: Mapping[str, Any], steps: Sequence[NextStep]) -> str:
    """What was found, how much better the model is, and what to do next."""
    first, *rest = found_words(document)
    words = "".join(f"<p>{_text(sentence)}</p>" for sentence in (*level_words(document), first))
    if rest:
        words += "<ul>" + "".join(f"<li>{_text(sentence)}</li>" for sentence in rest) + "</ul>"
    words += f"<p>{_text(variation_words(document))}</p>"
    words += "".join(f"<p>{_text(sentence)}</p>" for sentence in site_words(document))
    told = (*error_words(document), *unknown_words(document), *plan_words(document), *odds_words(document))
    words += "".join(f"<p{_loud(sentence)}>{_text(sentence)}</p>" for sentence in told)
    if steps:
        words += "<p>Next:</p>" + "".join(
            f'<p>{escape(step.purpose)}:<code class="command">{escape(step.command)}</code></p>' for step in steps
        )
    base, runs = document["model"]["before"], _count(len(document["runs"]["names"]), "run")
    return (
        f'{words}<p class="note">{document["segments"]["fit"]:,} segments of 1 m from {runs}, compared with the model '
        f"{escape(base['name'])} (version {escape(base['version'])}). Residual = measured - predicted.</p>"
    )


def _loud(words: str) -> str:
    return ' class="warning"' if words.startswith("WARNING") else ""


def _text(words: str) -> str:
    """Escaped; what is in backticks is code."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", escape(words))


def _count(number: int, name: str) -> str:
    return f"{number} {name}" if number == 1 else f"{number} {name}s"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    cells = "".join(f"<th>{h}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td{_kind(c)}>{c}</td>" for c in row) + "</tr>" for row in rows)
    return f'<div class="table"><table><tr>{cells}</tr>{body}</table></div>'


def _kind(cell: str) -> str:
    return ' class="number"' if re.fullmatch(r"(&lt;= )?[-+]?[\d.,e]+( \S+){0,3}", cell) else ""


def _full(figure: str) -> str:
    return f'<div class="full">{figure}</div>'


def _figures(figures: Sequence[str], kind: str = "figures") -> str:
    return f'<div class="{kind}">' + "".join(f"<div>{figure}</div>" for figure in figures) + "</div>"


def _base_parameters(document: Mapping[str, Any]) -> str:
    rows = [
        [
            escape(base_name(p["name"])),
            "" if p["declared"] is None else _quantity(p["declared"], p["unit"]),
            _quantity(p["value"], p["unit"]) if is_shown(p) else "not shown by these runs",
            " to ".join(map(number_words, p["ci95"])) if is_shown(p) else "",
        ]
        for p in document["base_parameters"]
    ]
    note = (
        '<p class="note">These are fitted before any effect is looked for. The calibrated model contains what the runs '
        "say. An interval that does not contain the declared value means that the declaration, or the base model, does "
        "not fit this robot and ground.</p>"
    )
    return _table(["base parameter", "declared", "by the runs", "95 % interval"], rows) + note


def _quantity(value: float, unit: str) -> str:
    return escape(f"{number_words(value)} {unit}".rstrip())


def _effects(document: Mapping[str, Any]) -> str:
    remaining = _remaining(document)
    if not document["effects"]:
        return f"<p>None. {escape(remaining)}</p>"
    rows = []
    for e in document["effects"]:
        values = "<br>".join(escape(words) for words in coefficient_words(e))
        rows.append(
            [
                escape(e["label"]),
                f"{values}<br>{escape(e['meaning'])}",
                escape(e["where"]),
                _number(e["p_value"]),
                percent(e["share_of_residual_variance"], 0),
                "yes" if e["in_plans"] else "no: a fault of the log" if is_log_fault(e) else "no: needs a log",
            ]
        )
    note = (
        '<p class="note">p: p-value of a significance test that allows for all candidate effects tried. Share: of the '
        "squared error on left-out runs that the effect explains. In plans: whether what the effect depends on is "
        f"known before a drive. {escape(remaining)}</p>"
    )
    head = ["effect", "coefficients and their meaning", "where it acts", "p", "share", "in plans"]
    curves = [e for e in document["effects"] if e["form"] == "curve"]
    return _table(head, rows) + note + (_curves(curves) if curves else "")


def _curves(effects: Sequence[Mapping[str, Any]]) -> str:
    names = ", ".join(escape(e["label"]) for e in effects)
    centred = [is_centred(e) for e in effects]
    zero = " A curve is zero at its middle point." if all(centred) else " Zero is what the baseline runs show."
    if any(centred) and not all(centred):
        labels = ", ".join(escape(e["label"]) for e in effects if is_centred(e))
        zero += f" These curves are zero at their middle point instead: {labels}."
    note = (
        f'<p class="note">Fitted curves with 95 % intervals ({names}). No formula of the library describes them.{zero} '
        "Beyond its ends a curve keeps its value there.</p>"
    )
    return note + _figures([curve_figure(e) for e in effects], "figures small")


def _variation(document: Mapping[str, Any]) -> str:
    found = document["variation"]
    words = escape(variation_words(document))
    if found["serial_share"] > 0.005:
        words += (
            f" {percent(found['serial_share'], 0)} of the variance within a run is correlated from segment to segment, "
            f"over about {found['correlation_segments']:.0f} segments."
        )
    words += f" {percent(found['outlier_share'])} of the segments are outliers. They count less and are not left out."
    return f"<p>{words} All of this is in the uncertainty of plans.</p>"


def _coverage(document: Mapping[str, Any]) -> str:
    coverage = document["runs"]["coverage"]
    rows = [["used", _metres(coverage["used_m"], coverage)]]
    left_out = sorted(coverage["left_out_m"].items(), key=lambda item: -item[1])
    rows += [[f"left out: {escape(key.replace('_', ' '))}", _metres(m, coverage)] for key, m in left_out if m >= 0.5]
    note = '<p class="note">No part of the track is left out because of its energy.</p>'
    return _table(["track", "length"], rows) + note


def _metres(metres: float, coverage: Mapping[str, Any]) -> str:
    share = f" ({percent(metres / coverage['track_m'])})" if coverage["track_m"] > 0 else ""
    return f"{metres:,.0f} m{share}"


def _ranges(document: Mapping[str, Any]) -> str:
    rows = []
    for key, (low, high) in document["ranges"].items():
        name, unit = quantity_words(key)
        rows.append([escape(name), escape(f"{number_words(low)} to {number_words(high)} {unit}".rstrip())])
    note = (
        '<p class="note">Each range leaves out the outermost hundredth at either end. A cost map, a route or a verdict '
        "beyond a range says so.</p>"
    )
    return f"<p>{escape(range_words(document))}</p>" + _table(["quantity", "driven"], rows) + note


def _remaining(document: Mapping[str, Any]) -> str:
    """What the significance test says of the candidates that were not taken."""
    p_value, further = document["remaining"]["p_value"], "further " if document["effects"] else ""
    if p_value <= ALPHA:
        return (
            f"A {further}effect may be at work: the smallest p-value of the other candidates is p {p_words(p_value)}."
        )
    least = f": the smallest p-value is {p_value:.2g}" if p_value < 1.0 else ""
    return f"No {further}candidate effect that is large enough to matter is significant{least}."


def _confounded(document: Mapping[str, Any]) -> str:
    if not document["confounded"]:
        return ""
    labels = labels_of(document)
    groups = "".join(
        f"<li>{escape(', '.join(labels.get(name, name) for name in group))}</li>" for group in document["confounded"]
    )
    drives = "".join(
        f"<li>{escape(labels.get(name, name))}: {escape(reveals)}</li>"
        for name, reveals in document["to_separate"].items()
    )
    return (
        f"<h2>Effects that these runs cannot distinguish</h2><ul>{groups}</ul><p>Drives that distinguish them:</p>"
        f"<ul>{drives}</ul>"
    )


def _errors(document: Mapping[str, Any], unit: str) -> str:
    judged = [(f"these runs: {validation_words(document)}", document["segments"]["fit"], document["error"])]
    if "test_set" in document:
        test = document["test_set"]
        judged.insert(0, ("test runs", test["segments"], test["error"]))
    rows = [
        [
            f"{where} ({segments:,} segments)",
            state,
            percent(error[key]["mean_relative"]),
            f"{number_words(error[key]['rmse'])} {unit}",
            percent(error[key]["absolute_share"]),
            f"{number_words(error[key]['bias'], signed=True)} {unit}",
        ]
        for where, segments, error in judged
        for key, state in error_states(error).items()
    ]
    states = {state for _, _, error in judged for state in error_states(error)}
    note = (
        "Mean relative error: |measured - predicted| / |measured|, mean over the segments of 1 m; a measured energy "
        f"below {LEAST_J:g} J counts as {LEAST_J:g} J. Absolute share: sum of the magnitudes of the errors over the "
        "energy. Bias: mean residual. All states are judged on the same segments."
    )
    if "test_set" in document:
        note += " Test runs had no part in the calibration."
    if any("base parameters" in state for state in states):
        note += " With the base parameters: the values of the table above, and no effect."
    if "after_planner" in states:
        note += " Plan-time prediction: only with what is known before a drive."
    head = ["measured on", "model", "mean relative error", "root mean square", "absolute share", "bias"]
    return _table(head, rows) + f'<p class="note">{note}</p>'


def _map(made: Calibrated) -> str:
    if made.routes is None:
        return f"<p>Not compared: {escape(made.document['route']['why_not'])}.</p>"
    found = made.document["map"]
    price, change, turn = found["mean_price_per_m"], found["change_per_m"], found["turn_j_per_rad"]
    lead = (
        f"The mean energy per metre, over the map and all headings, is {price['before']:.1f} J/m before and "
        f"{price['after']:.1f} J/m after. A turn of 90 degrees adds {turn['before'] * math.pi / 2:.0f} J before and "
        f"{turn['after'] * math.pi / 2:.0f} J after."
    )
    if max(abs(change["low"]), abs(change["high"])) < _ALIKE * abs(price["after"]):
        return f"<p>{lead} The energy per metre of the cells does not change.</p>"
    spread = f"In 95 % of the cells the change lies between {change['low']:+.1f} and {change['high']:+.1f} J/m."
    caption = (
        "Change of the energy per metre in each cell, mean over the headings. The mean energy per metre is "
        f"{price['after']:.1f} J/m. The colour scale contains zero and reaches at least {percent(LEAST_SPAN, 0)} of "
        "that mean."
    )
    return f'<p>{lead} {spread}</p>{_full(change_figure(made.routes))}<p class="note">{caption}</p>'


def _route(made: Calibrated) -> str:
    if made.routes is None:
        return f"<p>None: {escape(made.document['route']['why_not'])}.</p>"
    route, shown = made.document["route"], made.routes.shown
    (x0, y0), (x1, y1) = shown.task
    lead = (
        f"From x {x0:.1f}, y {y0:.1f} to x {x1:.1f}, y {y1:.1f} ({escape(route['task']['chosen'])}). By the calibrated "
        f"model, the route planned with it takes {route['saving_percent']:.1f} % less energy than the route planned "
        "with the model before. These are predictions: nobody has driven the two routes yet."
    )
    if "nominal_voltage_v" in route:
        lead += f" No voltage was logged: energy is charge times {route['nominal_voltage_v']:g} V."
    if len(route["tried"]) > 1:
        savings = ", ".join(f"{task['saving_percent']:.1f} %" for task in route["tried"])
        lead += f" Savings of all tasks tried: {savings}."
    rows = [
        [
            name,
            f"{route[key]['length_m']:.1f} m",
            f"{route[key]['energy_at_old_prices_j'] / 1000.0:.2f} kJ",
            _energy(route[key]),
        ]
        for key, name in (("before", "planned before"), ("after", "planned after"))
    ]
    names = ("planned after", "planned before")
    picture = route_picture(made.heightmap, shown.after, shown.repriced, title="", names=names)
    data = base64.b64encode(picture).decode("ascii")
    head = ["route", "length", "energy by the model before", "energy by the calibrated model"]
    return f'<p>{lead}</p>{_table(head, rows)}<img alt="both routes on the terrain" src="data:image/png;base64,{data}">'


def _energy(route: Mapping[str, Any]) -> str:
    spread = "" if route["energy_std_j"] is None else f" \N{PLUS-MINUS SIGN} {route['energy_std_j'] / 1000.0:.2f}"
    return f"{route['energy_j'] / 1000.0:.2f}{spread} kJ"


def _next_drive(document: Mapping[str, Any]) -> str:
    drive = document["next_drive"]
    if "why_not" not in drive:
        return (
            f"<p>{escape(drive_words(drive))} It is the best of some hundred simple routes on this map. Its corners "
            "are in report.json; <code>joulemap suggest-drive</code> takes another effect or length.</p>"
        )
    if document["effects"]:
        return f"<p>{escape(drive_words(drive))}</p>"
    drives = "".join(f"<li>{escape(name)}: {escape(reveals)}</li>" for name, reveals in likeliest(document))
    return (
        "<p>To find out whether the model lacks something, drive what separates the candidate effects with the "
        f"smallest p-values:</p><ul>{drives}</ul><p><code>joulemap suggest-drive</code> with <code>--effect</code> "
        "and such a name finds a route on this map.</p>"
        if drives
        else "<p>No candidate effect comes near to being significant. Drive what these runs do not contain: "
        "curves, slopes, other speeds, other ground.</p>"
    )


def _candidates(document: Mapping[str, Any]) -> str:
    rows = [
        [
            escape(c["label"]),
            _number(c["p_value"]),
            "" if c["held_out_gain"] is None or c["p_value"] > ALPHA else percent(c["held_out_gain"]),
            escape(c.get("why_not", "found")),
        ]
        for c in document["candidates"]
    ]
    rows += [
        [escape(quantity_name(f"column:{name}")), "", "", f"not tried: {escape(why)}"]
        for name, why in document["refused"].items()
    ]
    note = (
        '<p class="note">p and gain are of the candidate effect alone, before any was found. p allows for everything '
        "that was tried. Gain: by which share the squared error on left-out runs falls, of significant candidates. The "
        "last column says why a candidate was not taken beside the effects found.</p>"
    )
    return note + _table(["candidate effect", "p alone", "gain alone", "beside the effects found"], rows)


def _number(value: float | None) -> str:
    return "" if value is None else escape(p_words(value).removeprefix("= "))


def _repairs(runs: Mapping[str, Any]) -> str:
    left_out = count_words(runs["left_out"])
    note = f"<p>{runs['rows']:,} rows were read. Not used: {escape(left_out or 'nothing')}.</p>"
    rows = [[escape(name), escape(count_words(counts))] for name, counts in runs["repairs"].items()]
    return note + (_table(["run", "rows repaired or dropped, by reason"], rows) if rows else "")
