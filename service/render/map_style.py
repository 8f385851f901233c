"""How pictures look: colours, and axes that are a map to scale."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MaxNLocator

from joulemap.model.frames import GridFrame

OPTIMAL, SHORTEST = "#0072B2", "#D55E00"
"""Colours of the two routes: blue and vermilion of Okabe & Ito, which people with any colour vision distinguish."""
INK, FAINT = "#22262b", "#7b838c"
"""Colours of words and of lines that stay in the background."""


def new_axes() -> Axes:
    """Make axes on a new figure of pyplot, so that a notebook shows it."""
    import matplotlib.pyplot as plt

    return plt.subplots(figsize=(8.0, 6.0), layout="constrained")[1]


def style_map(axes: Axes, frame: GridFrame) -> None:
    """Make axes a map: in metres of the map's CRS, to scale, over the map's bounds."""
    west, south, east, north = frame.bounds
    slender = max(frame.shape) > 12 * min(frame.shape)  # to scale, nothing would be seen of it
    axes.set_aspect("auto" if slender else "equal")
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)
    for axis, low, high, name in ((axes.xaxis, west, east, "x"), (axes.yaxis, south, north, "y")):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}".replace(",", " ")))
        share = 1.0 if slender else (high - low) / max(east - west, north - south)
        most = 4 if max(abs(low), abs(high)) >= 10_000.0 else 7  # long numbers need room
        axis.set_major_locator(MaxNLocator(max(1, round(most * share))))
        axis.set_label_text(f"{name} [m]")
    quiet(axes)


def quiet(axes: Axes) -> None:
    """Take away what distracts from what is drawn."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#b9bfc5")
    axes.tick_params(colors=FAINT, labelsize=8.5, length=3)
    for label in (axes.xaxis.label, axes.yaxis.label):
        label.set_color(INK)
        label.set_fontsize(9.5)
