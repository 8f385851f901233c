"""report.html: what a calibration found, in one file without anything to load."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Mapping
from html import escape
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from model.loop.calibration import Calibration
from model.loop.formulas import quantity
from model.terrain.heightmap import Heightmap
from service.loop.calibrating import Calibrated
from service.pictures import route_picture

matplotlib.use("Agg")

FloatArray = NDArray[np.float64]

_BEFORE, _AFTER = "#b9532f", "#2b6f6b"
_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1d2424; background: #fbfaf7; max-width: 62rem; margin: 2rem auto;
  padding: 0 1rem } h1 { font-size: 1.6rem } h2 { font-size: 1.15rem; margin-top: 2.2rem } table { border-collapse:
  collapse; width: 100% } th, td { text-align: left; padding: .3rem .6rem; border-bottom: 1px solid #ddd8cc;
  vertical-align: top } th { font-weight: 600 } svg, img { max-width: 100%; height: auto } .n { text-align: right;
  font-variant-numeric: tabular-nums } p.note { color: #5a6464 }
"""
_QUANTITIES = {
    "turning": ("heading change [rad]", "turning"),
    "speed": ("speed [m/s]", "speed"),
    "acceleration": ("spin-up [m2/s2]", "spin_up"),
    "cross_slope": ("cross slope, tangent", "cross_slope"),
    "braking, climbing": ("grade, tangent", "grade"),
    "roughness": ("roughness [m]", "roughness"),
    "wind, heading": ("heading [deg]", "heading_deg"),
    "drift": ("time since the start [s]", "since_start"),
    "hotel_load": ("time per segment [s]", "duration"),
    "level, payload, sensor_gain": ("predicted energy", "predicted"),
}
_BINS = 14


def report_page(made: Calibrated, heightmap: Heightmap) -> str:
    """The page. heightmap : that the runs were driven on."""
    document, found = made.document, made.found
    unit = "A s" if document["target"] == "charge_as" else "J"
    names = ", ".join(e["name"] for e in document["effects"])
    title = f"Found: {names}" if names else "Nothing found that the model lacks"
    error = document["error"]
    lead = (
        f"{document['segments']['fit']} segments of 1 m in {len(error['before']['by_run'])} runs. Mean relative error "
        f"on held-out runs: {error['before']['mean_relative']:.1%} before, {error['after']['mean_relative']:.1%} after "
        f"({error['after_planner']['mean_relative']:.1%} with what a planner knows); root mean square "
        f"{error['before']['rmse']:.3g} to {error['after']['rmse']:.3g} {unit}. Residual = measured - predicted."
    )
    parts = [
        f"<h1>{escape(title)}</h1><p>{lead}</p>",
        _kept_aside(document, unit),
        "<h2>Effects</h2>" + _effects(document),
        _confounded(document),
        "<h2>A route before and after</h2>" + _route(made, heightmap),
        "<h2>Prediction against measurement</h2>" + _figure(_prediction(found, unit), 8.4, 4.0, 2),
        "<h2>Error by run</h2>" + _figure(_by_run(found), 8.4, 3.0, 1),
        "<h2>Where the residual lies</h2>" + _figure(_maps(found), 8.4, 3.8, 2),
        "<h2>Residual against each candidate</h2>" + _against(found, unit),
        "<h2>Tried and rejected</h2>" + _candidates(document),
    ]
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{_STYLE}</style><body>{''.join(parts)}</body></html>\n"
    )


def _kept_aside(document: Mapping[str, Any], unit: str) -> str:
    if "kept_aside" not in document:
        return ""
    found = document["kept_aside"]
    error = found["error"]
    names = {"before": "before", "after": "after", "after_planner": "after, with what a planner knows"}
    rows = [
        [
            name,
            f"{error[key]['mean_relative']:.1%}",
            f"{error[key]['rmse']:.3g} {unit}",
            f"{error[key]['bias']:+.3g} {unit}",
        ]
        for key, name in names.items()
    ]
    lead = (
        f"{found['segments']} segments of {len(error['before']['by_run'])} runs that nothing was sought or fitted in."
    )
    return f"<h2>Runs kept aside</h2><p>{lead}</p>" + _table(["", "mean relative", "root mean square", "bias"], rows)


def _table(head: list[str], rows: list[list[str]]) -> str:
    cells = "".join(f"<th>{h}</th>" for h in head)
    body = "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>" for row in rows)
    return f"<table><tr>{cells}</tr>{body}</table>"


def _effects(document: Mapping[str, Any]) -> str:
    if not document["effects"]:
        return f"<p>None. What remains: p = {document['remaining']['p_value']:.2g}.</p>"
    rows = []
    for e in document["effects"]:
        values = "<br>".join(
            escape(f"{c['name']}: {c['value']:.4g} {c['unit']} ({c['ci95'][0]:.4g} to {c['ci95'][1]:.4g})")
            for c in e["coefficients"][:8]
        )
        rows.append([
            escape(e["name"]), escape(e["where"]), values, f"{e['p_value']:.2g}",
            f"{e['share_of_residual_variance']:.0%}", "yes" if e["in_plans"] else "no: needs a log",
        ])  # fmt: skip
    return _table(["effect", "where", "coefficients (95 %)", "p", "share of residual", "in plans"], rows)


def _route(made: Calibrated, heightmap: Heightmap) -> str:
    if made.routes is None:
        return f"<p>None: {escape(made.document['route']['why_not'])}.</p>"
    route, shown = made.document["route"], made.routes.shown
    (x0, y0), (x1, y1) = shown.task
    lead = (
        f"From {x0:.1f}, {y0:.1f} to {x1:.1f}, {y1:.1f} ({escape(route['task']['chosen'])}). At the new prices the old "
        f"route costs {_energy(route['before'])}, the new one {_energy(route['after'])}: by the new model it saves "
        f"{route['saving_percent']:.1f} %. The old model said {shown.before.energy_j / 1000.0:.2f} kJ of the old route "
        f"and would have said {shown.old_j / 1000.0:.2f} kJ of the new one. Nobody has driven either yet."
    )
    if "nominal_voltage_v" in route:
        lead += f" No voltage was logged: energy is charge times {route['nominal_voltage_v']:g} V."
    if len(route["tried"]) > 1:
        savings = ", ".join(f"{task['saving_percent']:.1f} %" for task in route["tried"])
        lead += f" Savings of all tasks tried: {savings}."
    picture = route_picture(heightmap, shown.after, shown.repriced, title="", names=("new route", "old route"))
    data = base64.b64encode(picture).decode("ascii")
    return f'<p>{lead}</p><img alt="both routes on the terrain" src="data:image/png;base64,{data}">'


def _energy(route: Mapping[str, Any]) -> str:
    doubt = "" if route["energy_std_j"] is None else f" +- {route['energy_std_j'] / 1000.0:.2f}"
    return f"{route['energy_j'] / 1000.0:.2f}{doubt} kJ over {route['length_m']:.0f} m"


def _confounded(document: Mapping[str, Any]) -> str:
    if not document["confounded"]:
        return ""
    groups = "".join(f"<li>{escape(', '.join(group))}</li>" for group in document["confounded"])
    drives = "".join(f"<li>{escape(name)}: {escape(reveals)}</li>" for name, reveals in document["to_separate"].items())
    return f"<h2>What these runs cannot tell apart</h2><ul>{groups}</ul><p>Drives that would:</p><ul>{drives}</ul>"


def _candidates(document: Mapping[str, Any]) -> str:
    rows = [
        [escape(c["name"]), _number(c["p_value"]), f"{c['held_out_gain']:.1%}", escape(c.get("why_not", "taken"))]
        for c in document["candidates"]
    ]
    rows += [[escape(name), "", "", f"refused: {escape(why)}"] for name, why in document["refused"].items()]
    note = '<p class="note">p allows for everything that was tried; gain is the share of the squared error of held-out '
    note += "runs that the candidate alone would take away.</p>"
    return note + _table(["candidate", "p", "held-out gain", ""], rows)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2g}"


def _figure(draw: Callable[[list[Axes]], None], width: float, height: float, panels: int, rows: int = 1) -> str:
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(rows, panels, squeeze=False)
    draw(list(axes.ravel()))
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "joulemap", "svg.fonttype": "none"}):
        figure.savefig(buffer, format="svg", dpi=110, metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def _prediction(found: Calibration, unit: str) -> Callable[[list[Axes]], None]:
    def draw(axes: list[Axes]) -> None:
        moving = found.residuals.moving
        measured = found.residuals.measured[moving]
        top = float(np.quantile(measured, 0.995))
        pairs = (("before", found.first, _BEFORE), ("after, run held out", found.held_out, _AFTER))
        for ax, (name, predicted, colour) in zip(axes, pairs, strict=True):
            ax.plot(predicted[moving], measured, ".", ms=3, alpha=0.35, color=colour, rasterized=True)
            ax.plot([0, top], [0, top], "k-", lw=0.8)
            ax.set(xlim=(0, top), ylim=(0, top), title=name, xlabel=f"predicted [{unit}]", ylabel=f"measured [{unit}]")

    return draw


def _by_run(found: Calibration) -> Callable[[list[Axes]], None]:
    def draw(axes: list[Axes]) -> None:
        residuals, moving = found.residuals, found.residuals.moving
        rng = np.random.default_rng(0)
        runs = np.unique(residuals.drive.run[moving])
        for shift, predicted, colour, label in (
            (-0.15, found.first, _BEFORE, "before"), (0.15, found.held_out, _AFTER, "after, run held out"),
        ):  # fmt: skip
            relative = np.abs(residuals.measured - predicted) / np.maximum(np.abs(residuals.measured), 1e-9)
            for k, run in enumerate(runs):
                mine = relative[moving & (residuals.drive.run == run)]
                draws = mine[rng.integers(0, mine.size, (200, mine.size))].mean(axis=1)
                low, high = np.quantile(draws, [0.025, 0.975])
                middle = float(mine.mean())
                axes[0].errorbar(
                    k + shift, 100 * middle, yerr=[[100 * (middle - low)], [100 * (high - middle)]], fmt="o", ms=5,
                    color=colour, label=label if k == 0 else None,
                )  # fmt: skip
        axes[0].set_xticks(range(runs.size), [residuals.runs[r] for r in runs], rotation=30, ha="right", fontsize=8)
        axes[0].set(ylabel="mean relative error [%]", ylim=(0, None))
        axes[0].legend(frameon=False)

    return draw


def _maps(found: Calibration) -> Callable[[list[Axes]], None]:
    def draw(axes: list[Axes]) -> None:
        drive, moving = found.residuals.drive, found.residuals.moving
        x, y = drive.x[moving] - drive.x[moving].min(), drive.y[moving] - drive.y[moving].min()
        before = (found.residuals.measured - found.first)[moving]
        after = (found.residuals.measured - found.held_out)[moving]
        top = max(float(np.quantile(np.abs(before), 0.95)), 1e-9)
        for ax, values, name in zip(axes, (before, after), ("before", "after, run held out"), strict=True):
            dots = ax.scatter(x, y, c=values, s=5, cmap="RdBu_r", vmin=-top, vmax=top, rasterized=True)
            ax.set(title=f"residual {name}", xlabel="east [m]", ylabel="north [m]", aspect="equal")
        dots.figure.colorbar(dots, ax=axes, shrink=0.8)

    return draw


def _against(found: Calibration, unit: str) -> str:
    """A panel for every quantity: mean residual in bins of it, before and after."""
    drive, moving = found.residuals.drive, found.residuals.moving
    panels: list[tuple[str, FloatArray]] = [(label, _values(found, key)) for label, key in _QUANTITIES.values()]
    panels += [
        (name, quantity(drive, f"column:{name}")) for name in drive.columns if f"learned:{name}" not in found.refused
    ]
    shown = [(n, v[moving]) for n, v in panels if np.isfinite(v[moving]).sum() > 20 and np.nanstd(v[moving]) > 1e-12]
    away = {"before": found.residuals.measured - found.first, "after": found.residuals.measured - found.held_out}

    def draw(axes: list[Axes]) -> None:
        for ax, (name, values) in zip(axes, shown, strict=False):
            known = np.isfinite(values)
            edges = np.unique(np.quantile(values[known], np.linspace(0, 1, _BINS + 1)))
            bins = np.clip(np.searchsorted(edges, values[known], side="right") - 1, 0, max(edges.size - 2, 0))
            for key, colour in (("before", _BEFORE), ("after", _AFTER)):
                residual = away[key][moving][known]
                kept = [b for b in np.unique(bins) if (bins == b).sum() >= 3]
                at = [float(values[known][bins == b].mean()) for b in kept]
                mean = [float(residual[bins == b].mean()) for b in kept]
                error = [2.0 * float(residual[bins == b].std()) / np.sqrt((bins == b).sum()) for b in kept]
                ax.errorbar(at, mean, yerr=error, fmt=".-", ms=4, lw=0.9, color=colour, label=key)
            ax.axhline(0, color="k", lw=0.6)
            ax.set_xlabel(name, fontsize=8)
            ax.tick_params(labelsize=7)
        axes[0].set_ylabel(f"residual [{unit}]", fontsize=8)
        axes[0].legend(frameon=False, fontsize=7)
        for ax in axes[len(shown) :]:
            ax.set_axis_off()

    rows = -(-len(shown) // 4)
    return _figure(draw, 8.6, 1.9 * rows, 4, rows)


def _values(found: Calibration, key: str) -> FloatArray:
    drive = found.residuals.drive
    special = {
        "spin_up": drive.gained_m2ps2,
        "heading_deg": np.degrees(drive.heading_rad),
        "duration": drive.duration_s,
        "predicted": found.first,
    }
    return special[key] if key in special else quantity(drive, key)
