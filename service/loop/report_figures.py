"""The figures of a calibration's report, each as SVG whose text can be read on a narrow screen too."""

from __future__ import annotations

import io
from collections.abc import Callable, Collection, Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from joulemap.model.energy.metrics import relative_errors
from joulemap.model.loop.calibrate import Calibration
from joulemap.model.runs.features import quantity
from joulemap.model.runs.words import quantity_words
from joulemap.service.loop.effect_words import curve_points
from joulemap.service.loop.rerouting import Comparison

matplotlib.use("Agg")

FloatArray = NDArray[np.float64]

_BEFORE, _AFTER = "#b9532f", "#2b6f6b"
_QUANTITIES = {
    "heading change [rad]": "turning",
    "speed [m/s]": "speed",
    "gain of squared speed [m2/s2]": "squared_speed",
    "cross slope, tangent": "cross_slope",
    "grade, tangent": "grade",
    "roughness [m]": "roughness",
    "heading [deg]": "heading_deg",
    "time since the start [s]": "since_start",
    "time per segment [s]": "duration",
    "predicted energy [{unit}]": "predicted",
}
LEAST_SPAN = 0.05
"""Of the mean energy per metre: colour scales of changes reach at least so far from zero, so that a small change looks
small."""

_BINS = 14
_WIDE, _HIGH = 4.4, 3.7  # inches of half a page
_FULL = 5.8  # of a page
_SMALL = (2.6, 2.0)
_CURVE = (3.2, 2.2)


def _figure(draw: Callable[[Axes], None], size: tuple[float, float]) -> str:
    buffer = io.StringIO()
    # names of files and of columns are no formulas
    with matplotlib.rc_context({"svg.hashsalt": "joulemap", "svg.fonttype": "none", "text.parse_math": False}):
        figure = Figure(figsize=size, layout="constrained" if size != _SMALL else None)
        if size == _SMALL:  # of these there are many, and room is not worth a second of looking for it
            figure.subplots_adjust(left=0.14, right=0.97, bottom=0.22, top=0.96)
        draw(figure.subplots())
        figure.savefig(buffer, format="svg", dpi=110, transparent=True, metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def names_of(found: Calibration) -> tuple[str, str]:
    """Return what the predictions before and after are called in figures.

    Result: the second says whether the calibration had a part in the rows that it predicts.
    """
    return "before", "after, left out of the calibration" if found.folds else "after, fitted to these runs"


def curve_figure(effect: Mapping[str, Any]) -> str:
    """Draw a fitted curve with its 95 % intervals."""
    over = effect["settings"]["over"]
    knots, values, intervals = (np.asarray(part) for part in curve_points(effect))
    low, high = intervals.T
    name, unit = quantity_words(over)
    if over == "heading":  # a circle: the first point is the last one too
        knots, unit = np.degrees(np.append(knots, 2.0 * np.pi)), "deg"
        values, low, high = (np.append(part, part[0]) for part in (values, low, high))

    def _draw(ax: Axes) -> None:
        ax.fill_between(knots, low, high, color=_AFTER, alpha=0.2, lw=0.0)
        ax.plot(knots, values, ".-", color=_AFTER, ms=5, lw=1.2)
        ax.axhline(0, color="k", lw=0.6)
        ax.set_xlabel(f"{name} [{unit}]" if unit else name, fontsize=8)
        ax.set_ylabel(effect["coefficients"][0]["unit"], fontsize=8)
        ax.tick_params(labelsize=7)

    return _figure(_draw, _CURVE)


def prediction_figures(found: Calibration, unit: str) -> list[str]:
    """Draw measured against predicted energy of every segment, before and after."""
    moving = found.residuals.moving
    measured = found.residuals.measured[moving]
    top = float(np.quantile(measured, 0.995))

    def _panel(name: str, predicted: FloatArray, colour: str) -> str:
        def _draw(ax: Axes) -> None:
            ax.plot(predicted[moving], measured, ".", ms=3, alpha=0.35, color=colour, rasterized=True)
            ax.plot([0, top], [0, top], "k-", lw=0.8)
            ax.set(xlim=(0, top), ylim=(0, top), title=name, xlabel=f"predicted [{unit}]", ylabel=f"measured [{unit}]")

        return _figure(_draw, (_WIDE, _HIGH))

    panels = zip(names_of(found), (found.held_out["before"], found.held_out["after"]), (_BEFORE, _AFTER), strict=True)
    return [_panel(*panel) for panel in panels]


def error_figure(found: Calibration) -> str:
    """Draw the mean relative error of every run, before and after, with 95 % bootstrap intervals."""
    residuals, moving, unit_j = found.residuals, found.residuals.moving, found.residuals.features.unit_j
    runs = np.unique(residuals.run[moving])

    def _draw(ax: Axes) -> None:
        rng = np.random.default_rng(0)
        for shift, predicted, colour, label in (
            (-0.15, found.held_out["before"], _BEFORE, names_of(found)[0]),
            (0.15, found.held_out["after"], _AFTER, names_of(found)[1]),
        ):
            relative = relative_errors(unit_j * predicted, unit_j * residuals.measured)
            for k, run in enumerate(runs):
                mine = relative[moving & (residuals.run == run)]
                draws = mine[rng.integers(0, mine.size, (200, mine.size))].mean(axis=1)
                low, high = np.quantile(draws, [0.025, 0.975])
                middle = float(mine.mean())
                ax.errorbar(
                    100 * middle,
                    k + shift,
                    xerr=[[100 * (middle - low)], [100 * (high - middle)]],
                    fmt="o",
                    ms=5,
                    color=colour,
                    label=label if k == 0 else None,
                )
        ax.set_yticks(range(runs.size), [residuals.runs[r] for r in runs], fontsize=8)
        ax.set(xlabel="mean relative error [%]", xlim=(0, None), ylim=(runs.size - 0.5, -0.5))
        ax.grid(axis="x", lw=0.4)
        ax.legend(frameon=False, fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))

    return _figure(_draw, (_FULL, 1.3 + 0.34 * runs.size))


def residual_maps(found: Calibration, runs: Collection[str] | None = None) -> list[str]:
    """Draw the residual of every segment at its place, before and after.

    Result: two SVG figures with the same colour scale.
    """
    rows, moving = found.residuals.features, found.residuals.moving
    if runs is not None:
        moving = moving & np.array([name in runs for name in found.residuals.runs])[rows.run]
    x, y = rows.x[moving] - rows.x[moving].min(), rows.y[moving] - rows.y[moving].min()
    before = (found.residuals.measured - found.held_out["before"])[moving]
    after = (found.residuals.measured - found.held_out["after"])[moving]
    usual = float(np.median(found.residuals.measured[moving]))
    top = max(float(np.quantile(np.abs(before), 0.95)), LEAST_SPAN * abs(usual), 1e-9)
    unit = "A s" if found.residuals.charge else "J"
    high = float(np.clip(0.8 * _WIDE * np.ptp(y) / max(np.ptp(x), 1.0) + 0.7, 1.8, 1.5 * _WIDE))

    def _panel(values: FloatArray, name: str) -> str:
        def _draw(ax: Axes) -> None:
            dots = ax.scatter(x, y, c=values, s=5, cmap="RdBu_r", vmin=-top, vmax=top, rasterized=True)
            ax.set(title=name, xlabel="east [m]", ylabel="north [m]", aspect="equal")
            ax.figure.colorbar(dots, ax=ax, extend="both", label=f"residual [{unit}]")

        return _figure(_draw, (_WIDE, high))

    return [_panel(values, name) for values, name in zip((before, after), names_of(found), strict=True)]


def change_scale(low: float, high: float, mean: float) -> tuple[str, float, float]:
    """Return the colour scale of a map of changes, with zero on it.

    `low`: smallest change that is to be shown [J/m]; `high`: largest change that is to be shown [J/m]; `mean`: mean
    energy per metre of the map [J/m]. Result: (name of the colour map, lower end, upper end): from zero where all
    changes have one sign, else symmetric about zero; at least `LEAST_SPAN` of `mean` long on every side that it has.
    """
    reach = max(-low, high, LEAST_SPAN * abs(mean), 1e-9)
    if low >= 0.0:
        return "Reds", 0.0, reach
    return ("Blues_r", -reach, 0.0) if high <= 0.0 else ("RdBu_r", -reach, reach)


def change_figure(routes: Comparison) -> str:
    """Draw by how much each cell's energy per metre changes, mean over headings, with the old and the new route."""
    west, south, east, north = routes.frame.bounds
    before, after = routes.price_per_m
    change = after - before
    document = routes.map_as_dict()
    span = document["change_per_m"]
    colours, low, high = change_scale(span["low"], span["high"], document["mean_price_per_m"]["after"])

    def _draw(ax: Axes) -> None:
        shown = ax.imshow(change, extent=(0, east - west, 0, north - south), cmap=colours, vmin=low, vmax=high)
        for route, line, name in (
            (routes.shown.before, "--", "route before"),
            (routes.shown.after, "-", "route after"),
        ):
            x, y = route.points[:, 0] - west, route.points[:, 1] - south
            ax.plot(x, y, line, color="k", lw=1.8, label=name, path_effects=[withStroke(linewidth=4, foreground="w")])
        ax.set(xlabel="distance from the western edge [m]", ylabel="distance from the southern edge [m]")
        ax.legend(fontsize=8)
        extend = "both" if low < 0.0 < high else "max" if high > 0.0 else "min"
        ax.figure.colorbar(shown, ax=ax, shrink=0.8, extend=extend, label="change of the energy per metre [J/m]")

    return _figure(_draw, (_FULL, 4.0))


def against_figures(found: Calibration, unit: str) -> list[str]:
    """Draw the mean residual in bins of every quantity, before and after."""
    rows, moving = found.residuals.features, found.residuals.moving
    panels = [(label.format(unit=unit), _values(found, key)) for label, key in _QUANTITIES.items()]
    panels += [
        (f"logged: {name}", quantity(rows, f"column:{name}")) for name in rows.columns if name not in found.refused
    ]
    away = (
        ("before", found.residuals.measured - found.held_out["before"], _BEFORE),
        ("after", found.residuals.measured - found.held_out["after"], _AFTER),
    )

    def _panel(name: str, values: FloatArray) -> str:
        known = np.isfinite(values)
        edges = np.unique(np.quantile(values[known], np.linspace(0, 1, _BINS + 1)))
        bins = np.clip(np.searchsorted(edges, values[known], side="right") - 1, 0, max(edges.size - 2, 0))
        kept = [bins == b for b in np.unique(bins) if (bins == b).sum() >= 3]

        def _draw(ax: Axes) -> None:
            for label, residuals, colour in away:
                residual = residuals[moving][known]
                ax.errorbar(
                    [values[known][b].mean() for b in kept],
                    [residual[b].mean() for b in kept],
                    yerr=[2.0 * residual[b].std() / np.sqrt(b.sum()) for b in kept],
                    fmt=".-",
                    ms=4,
                    lw=0.9,
                    color=colour,
                    label=label,
                )
            ax.axhline(0, color="k", lw=0.6)
            ax.set_xlabel(name, fontsize=8)
            ax.tick_params(labelsize=7)
            ax.locator_params(axis="x", nbins=5)

        return _figure(_draw, _SMALL)

    shown = [(n, v[moving]) for n, v in panels]
    return [_panel(n, v) for n, v in shown if np.isfinite(v).sum() > 20 and np.nanstd(v) > 1e-12]


def _values(found: Calibration, key: str) -> FloatArray:
    rows = found.residuals.features
    special = {
        "squared_speed": rows.gained_m2ps2,
        "heading_deg": np.degrees(rows.heading_rad),
        "duration": rows.duration_s,
        "predicted": found.held_out["before"],
    }
    return special[key] if key in special else quantity(rows, key)
