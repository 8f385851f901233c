"""Rasters made ready for drawing (averaged, shaded as relief, placed in the world), and the style of maps on axes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

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


Image = NDArray[Any]
Extent = tuple[float, float, float, float]
"""West, east, south, north [m]."""

MAX_PIXELS = 1400
"""Longest side of a raster that is drawn; finer ones are averaged first."""


def thinned(values: Image, frame: GridFrame, *, most: int = 0) -> tuple[Image, Extent]:
    """Return a raster of at most so many pixels a side.

    `values` (rows, cols): NaN where unknown. Returns `values` (rows, cols): means over square blocks of cells, NaN
    where none of them is known; `extent`: west, east, south, north [m] of what is left: cells that fill no block are
    not drawn.
    """
    step = thinning(values.shape, most=most)
    rows, cols = (max(n // step, 1) for n in values.shape)
    west, south, east, north = frame.window(0, min(rows * step, frame.rows), 0, min(cols * step, frame.cols)).bounds
    extent = (west, east, south, north)
    return block_means(values, step), extent


def block_means(values: Image, step: int) -> Image:
    """Return the means over square blocks of cells.

    `values` (rows, cols): NaN where unknown. Result (rows // step, cols // step): NaN where no cell of a block is
    known.
    """
    if step == 1:
        return values
    rows, cols = (max(n // step, 1) for n in values.shape)
    blocks = values[: rows * step, : cols * step].reshape(rows, step, cols, step)
    known = np.isfinite(blocks)
    total = np.where(known, blocks, 0.0).sum(axis=(1, 3))
    count = known.sum(axis=(1, 3))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def thinning(shape: tuple[int, ...], *, most: int = 0) -> int:
    """Return how many cells a pixel has on a side after `thinned`."""
    return math.ceil(max(shape) / (most or MAX_PIXELS))


def steepness(heights: Image, extent: Extent) -> float:
    """Return the slope that `hillshade` shades most: most ground is less steep.

    `heights` (rows, cols): NaN where unknown; `extent`: west, east, south, north [m]. Result: 95 % quantile of the
    slopes [m/m]; 0 where none is known.
    """
    if min(heights.shape) < 2:
        return 0.0
    slope = np.hypot(*_gradient(heights, extent))
    return float(np.nanquantile(slope, 0.95)) if np.isfinite(slope).any() else 0.0


def _gradient(heights: Image, extent: Extent) -> tuple[Image, Image]:
    pixel = (extent[1] - extent[0]) / heights.shape[1]
    south, east = (np.asarray(part) for part in np.gradient(heights.astype(np.float64), pixel))
    return south, east


def hillshade(heights: Image, extent: Extent, *, steep: float | None = None) -> Image:
    """Return the brightness of ground lit from the north-west, exaggerated so that gentle slopes show.

    `heights` (rows, cols): NaN where unknown; `extent`: west, east, south, north [m]. The result is (rows, cols).
    """
    if min(heights.shape) < 2:
        return np.ones(heights.shape)
    south, east = _gradient(heights, extent)
    steep = steepness(heights, extent) if steep is None else steep
    gain = 0.7 / steep if steep > 1e-9 else 0.0
    nx, ny = -east * gain, south * gain
    light = np.array([-0.5, 0.5, math.sqrt(0.5)])
    lit = (nx * light[0] + ny * light[1] + light[2]) / np.sqrt(nx**2 + ny**2 + 1.0)
    return np.nan_to_num(np.clip(0.45 + 0.75 * lit / light[2] * 0.72, 0.45, 1.2), nan=1.0)


def centres(values: Image, extent: Extent) -> tuple[Image, Image]:
    """Return the coordinates of cell centres.

    `values` (rows, cols): any raster; `extent`: west, east, south, north [m]. Returns `x` (cols,): from west to east;
    `y` (rows,): from north to south.
    """
    west, east, south, north = extent
    rows, cols = values.shape
    x = west + (np.arange(cols) + 0.5) * (east - west) / cols
    return x, north - (np.arange(rows) + 0.5) * (north - south) / rows
