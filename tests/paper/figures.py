"""The paper's figures: predictions and measurements along the track, sites with their drives, the learning curve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from numpy.typing import NDArray

from joulemap.model.robot import Robot
from joulemap.model.runs.reader import read_run
from tests.paper.fieldwork import SITE_OF, SITES, read_site_heightmap
from tests.paper.profiles import FIRST_SEED
from tests.paper.setting import Setting
from tests.paper.summary import PAPER, Summary

FloatArray = NDArray[np.float64]

MEASURED, OURS, THEIRS, PLAIN = "#D55E00", "#0072B2", "#009E73", "#7b838c"
SHOWN = 250
"""Segments along the track in one picture."""

_TRACES: Mapping[str, tuple[str, tuple[tuple[str, tuple[str, ...]], ...]]] = {
    "fig05_back_and_forth": ("Fig. 5", (("V-A", ("compact", "resnet")),)),
    "fig06_random_waypoints": ("Fig. 6", (("V-B", ("compact", "resnet")),)),
    "fig07_another_site": ("Fig. 7", (("V-C", ("compact", "resnet")),)),
    "fig08_friction": ("Fig. 8", (("V-A", ("physics",)), ("V-D", ("physics",)))),
    "fig10_dirt": ("Fig. 10", (("V-E", ("compact", "resnet")), ("V-E shifted", ("compact", "resnet")))),
    "fig11_dirt_fine_tuned": ("Fig. 11", (("V-E rest", ("compact", "resnet")), ("V-E other", ("compact", "resnet")))),
}
_COLOURS = {"compact": OURS, "resnet": THEIRS, "physics": PLAIN}
_NAMES = {"compact": "compact", "resnet": "ResNet18", "physics": "friction"}


def draw_all(setting: Setting, summary: Summary) -> list[str]:
    """Draw all figures for which the first seed has results, into the folder's figures/."""
    folder = setting.folder / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    drawn = []
    arrays = _predictions(setting)
    if any(key.startswith("measured/") for key in arrays):
        for name, (title, panels) in _TRACES.items():
            drawn.append(_save(_traces(title, panels, arrays, summary, setting), folder / f"{name}.png"))
    if (setting.field(FIRST_SEED) / "field.json").exists():
        drawn.append(_save(_sites(setting), folder / "fig03_sites_and_drives.png"))
    if summary.rows("curve_shipped"):
        drawn.append(_save(_curve(summary), folder / "learning_curve.png"))
    return sorted(drawn)


def _predictions(setting: Setting) -> dict[str, FloatArray]:
    """All predictions for the first seed's segments, by "method/row"."""
    found: dict[str, FloatArray] = {}
    for file in sorted((setting.folder / "results").glob(f"*_{FIRST_SEED}.npz")):
        with np.load(file) as kept:
            found |= {key: kept[key] for key in kept.files}
    return found


def _save(figure: Figure, path: Path) -> str:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=90)
    return path.name


def _traces(
    title: str,
    panels: Sequence[tuple[str, tuple[str, ...]]],
    arrays: Mapping[str, FloatArray],
    summary: Summary,
    setting: Setting,
) -> Figure:
    """Scaled energy e = E / V along the track, measured and predicted."""
    volts = Robot.from_toml(setting.field(FIRST_SEED) / "robot.toml").nominal_voltage_v
    figure = Figure(figsize=(9.0, 2.6 * len(panels)), layout="constrained")
    for axes, (row, columns) in zip(figure.subplots(len(panels), 1, squeeze=False)[:, 0], panels, strict=True):
        straight = arrays[f"straight/{row}"] > 0
        shown = np.flatnonzero(straight)[:SHOWN]
        axes.plot(arrays[f"measured/{row}"][shown] / volts, color=MEASURED, lw=1.0, label="measured")
        said = []
        for column in columns:
            method = summary.name_of(column)
            if f"{method}/{row}" not in arrays:
                continue
            axes.plot(arrays[f"{method}/{row}"][shown] / volts, color=_COLOURS[column], lw=1.0, label=_NAMES[column])
            error = summary.seeds(method, row)[FIRST_SEED]
            said.append(f"{_NAMES[column]} {100 * error:.1f} %")
        paper = f", paper {100 * PAPER[row]:.1f} %" if row in PAPER and columns != ("physics",) else ""
        axes.set_title(f"{title}, {row}: mean error {', '.join(said)}{paper}", fontsize=9, loc="left")
        axes.set_xlabel("segment along the track")
        axes.set_ylabel("E / V  [A s]")
        axes.margins(x=0.01)
        axes.legend(fontsize=8, ncols=3, frameon=False, loc="upper right")
    return figure


def _sites(setting: Setting) -> Figure:
    """Heightmaps of all sites with the drives over them, and site A's as fitted to the driven positions."""
    folder = setting.field(FIRST_SEED)
    panels = [(site, "survey") for site in SITES] + [("grass_a", "driven")]
    figure = Figure(figsize=(11.0, 7.6), layout="constrained")
    for axes, (site, kind) in zip(figure.subplots(2, 2).ravel(), panels, strict=True):
        heightmap = read_site_heightmap(folder, site, kind)
        west, south, east, north = heightmap.frame.bounds
        extent = (0.0, east - west, 0.0, north - south)
        heights = np.where(np.isfinite(heightmap.heights), heightmap.heights, np.nanmin(heightmap.heights))
        light = LightSource(315, 45).hillshade(heights, vert_exag=4.0, dx=heightmap.resolution_m)
        image = axes.imshow(heightmap.heights - np.nanmin(heights), extent=extent, cmap="YlGn_r")
        axes.imshow(light, extent=extent, cmap="gray", alpha=0.35)
        figure.colorbar(image, ax=axes, shrink=0.7, label="m")
        for drive, place in SITE_OF.items():
            if place != site or drive.endswith("short"):
                continue
            waypoints = drive.endswith("waypoints")
            for file in sorted(folder.glob(f"{drive}_*.csv")):
                run = read_run(file)
                axes.plot(
                    run.x - west, run.y - south, color=OURS if waypoints else PLAIN, lw=0.8 if waypoints else 0.35
                )
        axes.set_xlim(extent[:2])
        axes.set_ylim(extent[2:])
        axes.set_title(f"{site}, {kind}: lawnmower grey, waypoints blue", fontsize=9, loc="left")
        axes.set_xlabel("east [m]")
        axes.set_ylabel("north [m]")
    return figure


def _curve(summary: Summary) -> Figure:
    """Error against driven metres, from the shipped network and from scratch."""
    metres = sorted({int(row.split()[0]) for row in summary.rows("curve_shipped")})
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    for axes, (row, where) in zip(figure.subplots(1, 2), (("V-B", "site A"), ("V-C", "site B")), strict=True):
        for method, colour, words in (
            ("curve_shipped", OURS, "from the shipped network"),
            ("curve_scratch", PLAIN, "from scratch"),
        ):
            found = [summary.interval(method, f"{amount} {row}") for amount in metres]
            known = [(k, one) for k, one in enumerate(found) if one is not None]
            at = [k for k, _ in known]
            axes.errorbar(
                at,
                [100 * one.mean for _, one in known],
                yerr=[0.0 if np.isnan(one.half) else 100 * one.half for _, one in known],
                color=colour,
                marker="o",
                capsize=3,
                lw=1.2,
                label=words,
            )
        axes.set_xticks(range(len(metres)), [str(amount) for amount in metres])
        axes.set_xlabel("driven metres")
        axes.set_ylabel("mean error [%]")
        axes.set_ylim(bottom=0.0)
        axes.set_title(f"{where}, random waypoints", fontsize=9, loc="left")
        axes.legend(fontsize=8, frameon=False)
    return figure
