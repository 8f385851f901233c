"""A picture of a run that was read: its track with the power along it, and the power over the distance."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from joulemap.service.render.raster_shading import INK

_NAME_LETTERS = 60


def run_picture(name: str, track: Sequence[Sequence[float | None]], *, charge: bool) -> bytes:
    """Draw a run. `track`: x, y [m], what is drawn [W or A], and the height [m], None where it is not known."""
    x, y, drawn, z = (np.array(values, dtype=np.float64) for values in track)
    drawn = np.nan_to_num(drawn)
    unit = "current [A]" if charge else "power [W]"
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    placed = bool(np.ptp(x) > 0)
    figure = Figure(figsize=(8.0, 9.0 if placed else 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(2 if placed else 1, 1, squeeze=False, height_ratios=[2, 1] if placed else None)[:, 0]
    if placed:
        points = np.stack([x - x.min(), y - y.min()], axis=1)
        line = LineCollection(np.stack([points[:-1], points[1:]], axis=1).tolist(), cmap="viridis", linewidths=2.5)
        line.set_array(0.5 * (drawn[:-1] + drawn[1:]))
        low, high = np.quantile(drawn, [0.02, 0.98])
        line.set_clim(low, max(high, low + 1e-9))
        rows[0].add_collection(line)
        rows[0].autoscale()
        rows[0].set_aspect("equal", adjustable="datalim")
        rows[0].plot(*points[0], "o", color=INK, label="start")
        rows[0].set(xlabel="east [m]", ylabel="north [m]")
        rows[0].legend(frameon=False)
        figure.colorbar(line, ax=rows[0], label=unit, shrink=0.8)
    rows[-1].plot(along, drawn, color=INK, linewidth=0.8)
    rows[-1].set(xlabel="distance [m]", ylabel=unit)
    if np.isfinite(z).any():
        heights = rows[-1].twinx()
        heights.plot(along, z, color="#9a9a9a", linewidth=1.2)
        heights.set_ylabel("height [m]", color="#6d6d6d")
    rows[0].set_title(name[:_NAME_LETTERS].replace("$", r"\$"), loc="left", color=INK)
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110)
    return out.getvalue()
