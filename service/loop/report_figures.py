"""The figures of a calibration's report, each as SVG whose letters can be read on a narrow screen too."""

from __future__ import annotations

import io
from collections.abc import Callable

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from joulemap.model.loop.calibration import Calibration
from joulemap.model.loop.formulas import quantity
from joulemap.service.loop.rerouting import Comparison

matplotlib.use("Agg")

FloatArray = NDArray[np.float64]

_BEFORE, _AFTER = "#b9532f", "#2b6f6b"
_QUANTITIES = {
    "heading change [rad]": "turning",
    "speed [m/s]": "speed",
    "spin-up [m2/s2]": "spin_up",
    "cross slope, tangent": "cross_slope",
    "grade, tangent": "grade",
    "roughness [m]": "roughness",
    "heading of the way [deg]": "heading_deg",
    "time since the start [s]": "since_start",
    "time per segment [s]": "duration",
    "predicted energy [{unit}]": "predicted",
}
_BINS = 14
_WIDE, _HIGH = 4.4, 3.7  # inches of half a page
_SMALL = (2.6, 2.0)


def _figure(draw: Callable[[Axes], None], size: tuple[float, float]) -> str:
    figure = Figure(figsize=size, layout="constrained" if size != _SMALL else None)
    if size == _SMALL:  # of these there are many, and room is not worth a second of looking for it
        figure.subplots_adjust(left=0.14, right=0.97, bottom=0.22, top=0.96)
    draw(figure.subplots())
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "joulemap", "svg.fonttype": "none"}):
        figure.savefig(buffer, format="svg", dpi=110, transparent=True, metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def prediction_figures(found: Calibration, unit: str) -> list[str]:
    """Measured against predicted energy of every segment, before and after."""
    moving = found.residuals.moving
    measured = found.residuals.measured[moving]
    top = float(np.quantile(measured, 0.995))

    def panel(name: str, predicted: FloatArray, colour: str) -> str:
        def draw(ax: Axes) -> None:
            ax.plot(predicted[moving], measured, ".", ms=3, alpha=0.35, color=colour, rasterized=True)
            ax.plot([0, top], [0, top], "k-", lw=0.8)
            ax.set(xlim=(0, top), ylim=(0, top), title=name, xlabel=f"predicted [{unit}]", ylabel=f"measured [{unit}]")

        return _figure(draw, (_WIDE, _HIGH))

    return [panel("before", found.first, _BEFORE), panel("after, run held out", found.held_out, _AFTER)]


def error_figure(found: Calibration) -> str:
    """Mean relative error of every run, before and after."""
    residuals, moving = found.residuals, found.residuals.moving
    runs = np.unique(residuals.drive.run[moving])

    def draw(ax: Axes) -> None:
        rng = np.random.default_rng(0)
        for shift, predicted, colour, label in (
            (-0.15, found.first, _BEFORE, "before"),
            (0.15, found.held_out, _AFTER, "after, run held out"),
        ):
            relative = np.abs(residuals.measured - predicted) / np.maximum(np.abs(residuals.measured), 1e-9)
            for k, run in enumerate(runs):
                mine = relative[moving & (residuals.drive.run == run)]
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
        ax.invert_yaxis()
        ax.grid(axis="y", lw=0.4)
        ax.set(xlabel="mean relative error [%]", xlim=(0, None))
        ax.legend(frameon=False, fontsize=8)

    return _figure(draw, (2 * _WIDE, 1.2 + 0.28 * runs.size))


def residual_maps(found: Calibration) -> list[str]:
    """Where on the map the residual lies, before and after."""
    drive, moving = found.residuals.drive, found.residuals.moving
    x, y = drive.x[moving] - drive.x[moving].min(), drive.y[moving] - drive.y[moving].min()
    before = (found.residuals.measured - found.first)[moving]
    after = (found.residuals.measured - found.held_out)[moving]
    top = max(float(np.quantile(np.abs(before), 0.95)), 1e-9)
    unit = "A s" if found.residuals.charge else "J"
    high = float(np.clip(0.8 * _WIDE * np.ptp(y) / max(np.ptp(x), 1.0) + 0.7, 1.8, 1.5 * _WIDE))

    def panel(values: FloatArray, name: str) -> str:
        def draw(ax: Axes) -> None:
            dots = ax.scatter(x, y, c=values, s=5, cmap="RdBu_r", vmin=-top, vmax=top, rasterized=True)
            ax.set(title=name, xlabel="east [m]", ylabel="north [m]", aspect="equal")
            ax.figure.colorbar(dots, ax=ax, extend="both", label=f"residual [{unit}]")

        return _figure(draw, (_WIDE, high))

    return [panel(before, "before"), panel(after, "after, run held out")]


def change_figure(routes: Comparison) -> str:
    """By how much the price of each cell changes, mean over headings, with the old route and the new one."""
    west, south, east, north = routes.frame.bounds
    before, after = routes.price_per_m
    change = after - before
    low, high = routes.map_as_dict()["change_per_m"].values()
    colours = "Reds" if low > 0 else "Blues_r"
    if low <= 0 <= high:
        colours, low, high = "RdBu_r", -max(-low, high), max(-low, high)

    def draw(ax: Axes) -> None:
        shown = ax.imshow(change, extent=(0, east - west, 0, north - south), cmap=colours, vmin=low, vmax=high)
        for route, line, name in ((routes.shown.before, "--", "old route"), (routes.shown.after, "-", "new route")):
            x, y = route.points[:, 0] - west, route.points[:, 1] - south
            ax.plot(x, y, line, color="k", lw=1.8, label=name, path_effects=[withStroke(linewidth=4, foreground="w")])
        ax.set(xlabel="east of the map's edge [m]", ylabel="north of it [m]")
        ax.legend(fontsize=8)
        ax.figure.colorbar(shown, ax=ax, shrink=0.8, extend="both", label="dearer by [J/m]")

    return _figure(draw, (2 * _WIDE, 4.4))


def against_figures(found: Calibration, unit: str) -> list[str]:
    """A panel for every quantity: mean residual in bins of it, before and after."""
    drive, moving = found.residuals.drive, found.residuals.moving
    panels = [(label.format(unit=unit), _values(found, key)) for label, key in _QUANTITIES.items()]
    panels += [
        (f"logged: {name}", quantity(drive, f"column:{name}"))
        for name in drive.columns
        if f"learned:{name}" not in found.refused
    ]
    away = (
        ("before", found.residuals.measured - found.first, _BEFORE),
        ("after", found.residuals.measured - found.held_out, _AFTER),
    )

    def panel(name: str, values: FloatArray) -> str:
        known = np.isfinite(values)
        edges = np.unique(np.quantile(values[known], np.linspace(0, 1, _BINS + 1)))
        bins = np.clip(np.searchsorted(edges, values[known], side="right") - 1, 0, max(edges.size - 2, 0))
        kept = [bins == b for b in np.unique(bins) if (bins == b).sum() >= 3]

        def draw(ax: Axes) -> None:
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

        return _figure(draw, _SMALL)

    shown = [(n, v[moving]) for n, v in panels]
    return [panel(n, v) for n, v in shown if np.isfinite(v).sum() > 20 and np.nanstd(v) > 1e-12]


def _values(found: Calibration, key: str) -> FloatArray:
    drive = found.residuals.drive
    special = {
        "spin_up": drive.gained_m2ps2,
        "heading_deg": np.degrees(drive.heading_rad),
        "duration": drive.duration_s,
        "predicted": found.first,
    }
    return special[key] if key in special else quantity(drive, key)
