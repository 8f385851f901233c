"""The ground on matplotlib axes: tinted hillshade, contour lines, and what may not be driven, by reason."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgb
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from joulemap.model.frames import GridFrame
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.service.render.raster_shading import Extent, Image, centres, hillshade, style_map, thinned

_TERRAIN = LinearSegmentedColormap.from_list("terrain", ["#9dbb94", "#d5d5a4", "#ead9b0", "#f4ead8"])
REASONS = {  # face colour, hatch, colour of the hatch: none of them is a colour of the price
    Blocked.OUTSIDE: ("#e4e6e8", "", "#9aa1a8"),
    Blocked.UNKNOWN: ("#ffffff", "////", "#9aa1a8"),
    Blocked.STEP: ("#8a8f94", "xxxx", "#f4f5f6"),
    Blocked.OBSTACLE: ("#6f7479", "....", "#f4f5f6"),
    Blocked.GRADE: ("#b3264a", "", "#9aa1a8"),
    Blocked.CROSS_SLOPE: ("#f2a7b8", "", "#9aa1a8"),
}
"""How blocked ground is painted, by reason: face colour, hatch, colour of the hatch."""
_PARTLY = ("#f8d7df", 0.8)
"""Colour and opacity of what is blocked in some headings: pale, because routes cross it."""


def draw_ground(
    axes: Axes, heights: Image, frame: GridFrame, *, blocked: NDArray[np.uint8] | None = None
) -> list[Patch]:
    """Draw tinted hillshade, contour lines with their heights, and what may not be driven.

    `heights` (rows, cols): NaN where unknown; `blocked` (rows, cols): `Blocked` codes of cells that may not be driven
    in any heading. Result: a legend handle for unknown ground and for each reason that occurs.
    """
    ground, extent = thinned(heights, frame)
    style_map(axes, frame)
    known = ground[np.isfinite(ground)]
    axes.imshow(tinted_relief(ground, extent), extent=extent, interpolation="bilinear")
    if min(ground.shape) >= 2 and known.size and known.max() - known.min() > 0.05:
        levels: list[float] = list(MaxNLocator(14, steps=[1, 2, 5, 10]).tick_values(known.min(), known.max()))
        lines = axes.contour(
            *centres(ground, extent), ground, levels=levels, colors="#5d5346", linewidths=0.6, alpha=0.55
        )
        axes.clabel(lines, levels[::2], fontsize=7, fmt="%g m", inline=True)
    if blocked is None:
        codes = np.where(np.isnan(heights), np.uint8(Blocked.UNKNOWN), np.uint8(Blocked.FREE))
    else:
        codes = blocked
    west, south, east, north = frame.bounds
    return draw_blocked(axes, codes, (west, east, south, north))


def tinted_relief(
    ground: Image, extent: Extent, *, between: tuple[float, float] | None = None, steep: float | None = None
) -> Image:
    """Return ground as an image: shaded relief, tinted by height.

    `ground` (rows, cols): heights, NaN where unknown; `extent`: west, east, south, north [m]. Result (rows, cols, 3):
    red, green and blue, 0 to 1; white where unknown.
    """
    low, high = tint_range(ground) if between is None else between
    norm = Normalize(low, high, clip=True)
    light = hillshade(ground, extent, steep=steep)
    image = _TERRAIN(norm(np.nan_to_num(ground, nan=low)))[..., :3] * light[..., None]
    image[np.isnan(ground)] = 1.0
    return np.clip(np.asarray(image), 0.0, 1.0)


def tint_range(ground: Image) -> tuple[float, float]:
    """Return the heights at the two ends of the tints of `tinted_relief`.

    `ground` (rows, cols): heights, NaN where unknown. Result: 2 % and 98 % quantiles [m].
    """
    known = ground[np.isfinite(ground)]
    low, high = (float(q) for q in np.quantile(known, [0.02, 0.98])) if known.size else (0.0, 1.0)
    return low, max(high, low + 0.1)


def draw_lattice_ground(axes: Axes, lattice: CostLattice) -> list[Patch]:
    """Draw the terrain of a cost map, and what may not be driven in any heading, or not in some."""
    codes = blocked_everywhere(lattice)
    handles = draw_ground(axes, lattice.elevation_m, lattice.frame, blocked=codes)
    partly = (codes == Blocked.FREE) & (lattice.blocked_by_heading() != Blocked.FREE).any(axis=2)
    if not partly.any():
        return handles
    colour, opacity = _PARTLY
    paint = np.zeros((*partly.shape, 4))
    paint[partly] = (*to_rgb(colour), opacity)
    west, south, east, north = lattice.frame.bounds
    axes.imshow(paint, extent=(west, east, south, north), interpolation="nearest", zorder=1)
    label = "blocked in some headings"
    return [*handles, Patch(facecolor=colour, edgecolor=REASONS[Blocked.CROSS_SLOPE][0], linewidth=0.5, label=label)]


def blocked_everywhere(lattice: CostLattice) -> NDArray[np.uint8]:
    """Return what may not be driven in any heading, and why. The result is (rows, cols)."""
    by_heading = lattice.blocked_by_heading()
    some = (by_heading == Blocked.FREE).any(axis=2)
    return np.where(some, np.uint8(Blocked.FREE), by_heading.min(axis=2)).astype(np.uint8)


def draw_blocked(axes: Axes, codes: NDArray[np.uint8], extent: Extent) -> list[Patch]:
    """Paint blocked cells by reason. `codes` (rows, cols); `extent`: west, east, south, north [m]."""
    handles = []
    paint = np.zeros((*codes.shape, 4))
    for reason, (colour, hatch, _) in REASONS.items():
        here = codes == reason
        if not here.any():
            continue
        paint[here] = (*to_rgb(colour), 1.0)
        if hatch:
            hatch_area(axes, here, extent, *REASONS[reason][1:])
        handles.append(_patch(reason))
    if handles:
        axes.imshow(paint, extent=extent, interpolation="nearest", zorder=1)
    return handles


def hatch_area(axes: Axes, mask: NDArray[np.bool_], extent: Extent, hatch: str, colour: str) -> None:
    """Hatch cells. `mask` (rows, cols); `extent`: west, east, south, north [m]."""
    padded = np.pad(mask.astype(np.float64), 1)
    dx = (extent[1] - extent[0]) / mask.shape[1]
    dy = (extent[3] - extent[2]) / mask.shape[0]
    wider = (extent[0] - dx, extent[1] + dx, extent[2] - dy, extent[3] + dy)
    area = axes.contourf(*centres(padded, wider), padded, levels=[0.5, 1.5], colors="none", hatches=[hatch], zorder=2)
    area.set_edgecolor(colour)
    area.set_linewidth(0.0)


def _patch(reason: Blocked) -> Patch:
    colour, hatch, line = REASONS[reason]
    label = f"blocked: {reason.label.replace('_', ' ')}"
    return Patch(facecolor=colour, edgecolor=line, linewidth=0.5, hatch=hatch, label=label)
