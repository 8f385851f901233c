"""report.html: what a calibration found and what follows from it, in one file without anything to load."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from joulemap.model.terrain.heightmap import Heightmap
from joulemap.service.loop.calibration import Calibrated
from joulemap.service.loop.report_figures import (
    against_figures,
    change_figure,
    error_figure,
    prediction_figures,
    residual_maps,
)
from joulemap.service.pictures import route_picture

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1d2424; background: #fbfaf7; max-width: 62rem; margin: 2rem auto;
  padding: 0 1rem } h1 { font-size: 1.6rem } h2 { font-size: 1.15rem; margin-top: 2.2rem } table { border-collapse:
  collapse; width: 100% } th, td { text-align: left; padding: .3rem .6rem; border-bottom: 1px solid #ddd8cc;
  vertical-align: top; font-variant-numeric: tabular-nums } th { font-weight: 600 } div.table { overflow-x: auto }
  svg, img { width: 100%; height: auto; margin-top: .6rem } div.figures { display: grid; gap: 1rem;
  grid-template-columns: repeat(auto-fit, minmax(min(24rem, 100%), 1fr)) } div.small { grid-template-columns:
  repeat(auto-fill, minmax(min(14rem, 100%), 1fr)) } p.note { color: #5a6464 } p.warning { color: #b9532f }
"""
_AGAINST = (
    '<p class="note">Mean residual in equal shares of the segments with two standard errors: red before, green after, '
    "run held out. What is level at zero explains nothing more.</p>"
)
_FEW = 4  # coefficients of an effect that are all told
_ALIKE = 0.005  # of the mean price: less than this is no change of the map


def report_page(made: Calibrated, heightmap: Heightmap) -> str:
    """The page. heightmap : that the runs were driven on."""
    document, found = made.document, made.found
    unit = "A s" if document["target"] == "charge_as" else "J"
    names = ", ".join(e["name"] for e in document["effects"])
    title = f"Found: {names}" if names else "Nothing found that the model lacks"
    runs, base = _count(len(document["runs"]["names"]), "run"), document["model"]["before"]
    lead = (
        f"{document['segments']['fit']:,} segments of 1 m in {runs}, held against the model {escape(base['name'])} "
        f"(version {escape(base['version'])}). Residual = measured - predicted."
    )
    parts = [
        f"<h1>{escape(title)}</h1><p>{lead}</p>",
        "".join(f'<p class="warning">Warning: {escape(warning)}</p>' for warning in document["warnings"]),
        "<h2>Effects</h2>" + _effects(document),
        _confounded(document),
        "<h2>How far off the model is</h2>" + _errors(document, unit) + error_figure(found),
        "<h2>What changes on the map</h2>" + _map(made),
        "<h2>A route before and after</h2>" + _route(made, heightmap),
        "<h2>What to drive next</h2>" + _next_drive(document["next_drive"]),
        "<h2>Prediction against measurement</h2>" + _figures(prediction_figures(found, unit)),
        "<h2>Where the residual lies</h2>" + _figures(residual_maps(found)),
        f"<h2>Residual [{unit}] against each candidate</h2>{_AGAINST}",
        _figures(against_figures(found, unit), "figures small"),
        "<h2>All that was tried</h2>" + _candidates(document),
        "<h2>What was mended in the logs</h2>" + _repairs(document["runs"]),
    ]
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style><body>{''.join(parts)}</body></html>\n"
    )


def _count(number: int, name: str) -> str:
    return f"{number} {name}" if number == 1 else f"{number} {name}s"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    cells = "".join(f"<th>{h}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>" for row in rows)
    return f'<div class="table"><table><tr>{cells}</tr>{body}</table></div>'


def _figures(figures: Sequence[str], kind: str = "figures") -> str:
    return f'<div class="{kind}">' + "".join(f"<div>{figure}</div>" for figure in figures) + "</div>"


def coefficient_words(effect: Mapping[str, Any]) -> list[str]:
    """Each coefficient of an effect with its 95 % interval; of many the least and the greatest. Those of a field mean
    something together only: its place is told in `where`.
    """
    found = effect["coefficients"]
    if effect["form"] == "place":
        return [f"{len(found)} values"]
    told = found if len(found) <= _FEW else [f(found, key=lambda c: c["value"]) for f in (min, max)]
    words = [
        f"{c['name']}: {c['value']:.4g} {c['unit']} ({c['ci95'][0]:.4g} to {c['ci95'][1]:.4g})".replace("  ", " ")
        for c in told
    ]
    return words if told is found else [f"{len(found)} values, the least and the greatest", *words]


def _effects(document: Mapping[str, Any]) -> str:
    if not document["effects"]:
        return f"<p>None. What remains: p = {document['remaining']['p_value']:.2g}.</p>"
    rows = []
    for e in document["effects"]:
        values = "<br>".join(escape(words) for words in coefficient_words(e))
        rows.append(
            [
                escape(e["name"]),
                escape(e["where"]),
                values,
                f"{e['p_value']:.2g}",
                f"{e['share_of_residual_variance']:.0%}",
                "yes" if e["in_plans"] else "no: needs a log",
            ]
        )
    note = (
        '<p class="note">Coefficients have a 95 % interval. p: how often chance does as well, all that was tried '
        "allowed for. Share: of the residual's variance that the effect explains. In plans: whether a planner knows "
        "beforehand what the effect goes with. That there is more to find in what remains has p = "
        f"{document['remaining']['p_value']:.2g}.</p>"
    )
    return _table(["effect", "where", "coefficients", "p", "share", "in plans"], rows) + note + _shadows(document)


def _shadows(document: Mapping[str, Any]) -> str:
    names = shadow_words(document)
    return f"<p>{escape(names)}</p>" if names else ""


def shadow_words(document: Mapping[str, Any]) -> str:
    """What mends the form of the effects found; empty where nothing does."""
    names = ", ".join(shadow["name"] for shadow in document["shadows"])
    return f"{names}: in the model, to mend the form of the effects; no cause of its own" if names else ""


def _confounded(document: Mapping[str, Any]) -> str:
    if not document["confounded"]:
        return ""
    groups = "".join(f"<li>{escape(', '.join(group))}</li>" for group in document["confounded"])
    drives = "".join(f"<li>{escape(name)}: {escape(reveals)}</li>" for name, reveals in document["to_separate"].items())
    return f"<h2>What these runs cannot tell apart</h2><ul>{groups}</ul><p>Drives that would:</p><ul>{drives}</ul>"


def error_states(error: Mapping[str, Any]) -> dict[str, str]:
    """Words for each state that errors are stated of; what the base model's own runs correct where that is anything."""
    states = {
        "before": "before",
        "corrected": "corrected by what the base model's own runs show",
        "after": "after",
        "after_planner": "after, as a planner knows it",
    }
    return {key: words for key, words in states.items() if key != "corrected" or error[key] != error["before"]}


def _errors(document: Mapping[str, Any], unit: str) -> str:
    judged = [("each run held out in turn", document["segments"]["fit"], document["error"])]
    if "kept_aside" in document:
        aside = document["kept_aside"]
        judged.append(("runs kept aside, in which nothing was sought", aside["segments"], aside["error"]))
    rows = [
        [
            f"{where}, {segments:,} segments: {state}",
            f"{error[key]['mean_relative']:.1%}",
            f"{error[key]['rmse']:.3g} {unit}",
            f"{error[key]['bias']:+.3g} {unit}",
        ]
        for where, segments, error in judged
        for key, state in error_states(error).items()
    ]
    return _table(["judged by", "mean relative", "root mean square", "bias"], rows)


def _map(made: Calibrated) -> str:
    if made.routes is None:
        return f"<p>Not compared: {escape(made.document['route']['why_not'])}.</p>"
    found = made.document["map"]
    price, change, turn = found["mean_price_per_m"], found["change_per_m"], found["turn_j_per_rad"]
    lead = (
        f"A metre costs {price['before']:.1f} J before and {price['after']:.1f} J after, mean over the map and all "
        f"headings; a turn of 90 degrees {turn['before'] * np.pi / 2:.0f} J before and "
        f"{turn['after'] * np.pi / 2:.0f} J after (what a metre took over how far it turned, in least squares)."
    )
    if max(abs(change["low"]), abs(change["high"])) < _ALIKE * abs(price["after"]):
        return f"<p>{lead} No place becomes dearer than another.</p>"
    return (
        f"<p>{lead} At nineteen places in twenty the change lies between {change['low']:+.1f} and "
        f"{change['high']:+.1f} J/m.</p>{change_figure(made.routes)}"
    )


def _route(made: Calibrated, heightmap: Heightmap) -> str:
    if made.routes is None:
        return f"<p>None: {escape(made.document['route']['why_not'])}.</p>"
    route, shown = made.document["route"], made.routes.shown
    (x0, y0), (x1, y1) = shown.task
    lead = (
        f"From {x0:.1f}, {y0:.1f} to {x1:.1f}, {y1:.1f} ({escape(route['task']['chosen'])}). By the new model the new "
        f"route saves {route['saving_percent']:.1f} %. Nobody has driven either yet."
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
        for key, name in (("before", "old route"), ("after", "new route"))
    ]
    picture = route_picture(heightmap, shown.after, shown.repriced, title="", names=("new route", "old route"))
    data = base64.b64encode(picture).decode("ascii")
    return (
        f"<p>{lead}</p>{_table(['', 'length', 'by the old model', 'by the new model'], rows)}"
        f'<img alt="both routes on the terrain" src="data:image/png;base64,{data}">'
    )


def _energy(route: Mapping[str, Any]) -> str:
    doubt = "" if route["energy_std_j"] is None else f" +- {route['energy_std_j'] / 1000.0:.2f}"
    return f"{route['energy_j'] / 1000.0:.2f}{doubt} kJ"


def _next_drive(drive: Mapping[str, Any]) -> str:
    if "why_not" in drive:
        return f"<p>No suggestion: {escape(drive['why_not'])}.</p>"
    aim = (
        f"tells {drive['effect']} from {', '.join(drive['tells_from'])}"
        if drive["tells_from"]
        else (f"pins the coefficient of {drive['effect']}")
    )
    points = np.array(drive["points"])
    (west, south), (east, north) = points.min(axis=0), points.max(axis=0)
    where = (
        f"within x {west:.1f} to {east:.1f} and y {south:.1f} to {north:.1f}"
        if drive["placed"]
        else (f"on {east - west:.1f} x {north - south:.1f} m of level ground")
    )
    pace = " and ".join(f"{speed:.2f} m/s" for speed in drive["speeds_mps"])
    return (
        f"<p>{escape(drive['kind'].capitalize())}, {where}, "
        f"over and over for {drive['total_length_m']:.0f} m at {pace}: of some hundred simple routes on this map this "
        f"one best {escape(aim)}, to an interval {drive['expected_interval_share']:.0%} as wide as now. Its corners "
        "are in report.json; <code>joulemap suggest-drive</code> takes another effect or length.</p>"
    )


def _candidates(document: Mapping[str, Any]) -> str:
    rows = [
        [escape(c["name"]), _number(c["p_value"]), f"{c['held_out_gain']:.1%}", escape(c.get("why_not", "taken"))]
        for c in document["candidates"]
    ]
    rows += [[escape(name), "", "", f"refused: {escape(why)}"] for name, why in document["refused"].items()]
    note = (
        '<p class="note">p and gain are of the candidate alone, before anything was taken: p allows for everything '
        "that was tried, the gain is the share of the squared error of held-out runs that it would take away. The last "
        "column says what it still explains beside all that was taken.</p>"
    )
    return note + _table(["candidate", "p alone", "gain alone", "beside what was taken"], rows)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2g}"


def _repairs(runs: Mapping[str, Any]) -> str:
    def words(counts: Mapping[str, int]) -> str:
        return escape(", ".join(f"{count} {rule.replace('_', ' ')}" for rule, count in counts.items() if count))

    left_out = words(runs["left_out"])
    note = f"<p>{runs['rows']:,} rows read; made no segment: {left_out or 'nothing'}.</p>"
    rows = [[escape(name), words(counts)] for name, counts in runs["repairs"].items()]
    return note + (_table(["run", "rows mended or dropped, by rule"], rows) if rows else "")
