"""Cost maps on matplotlib axes: energy per metre in colour over hillshade, and what is blocked."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.transforms import Affine2D, offset_copy

from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.service.render.energy_colours import COLOURS, colour_scale, energy_image, values_of_view
from joulemap.service.render.ground_drawing import draw_blocked
from joulemap.service.render.map_style import FAINT, INK, style_map
from joulemap.service.render.raster_shading import hillshade, thinned

_ARROW = [(0, 1), (0.55, 0.1), (0.16, 0.1), (0.16, -1), (-0.16, -1), (-0.16, 0.1), (-0.55, 0.1), (0, 1)]  # to north


@dataclass(frozen=True)
class CostmapDrawing:
    """What was drawn of a cost map.

    Attributes
    ----------
    scale : matplotlib.cm.ScalarMappable
        Prices and their colours, for a colour bar.
    extend : str
        At which ends prices lie beyond the colours: "neither", "min", "max" or "both".
    label : str
        What the colours mean, with the unit.
    title : str
        What is shown.
    handles : list of matplotlib.patches.Patch
        A legend handle for each reason that something is blocked.
    """

    scale: ScalarMappable
    extend: str
    label: str
    title: str
    handles: list[Patch]


def draw_costmap(
    axes: Axes, lattice: CostLattice, *, view: str = "mean", heading_deg: float | None = None
) -> CostmapDrawing:
    """Draw a cost map in colour, with what is blocked and why.

    `heading_deg`: the heading of the view "heading", clockwise from north, any angle. Result: what a colour bar, a
    title and a legend need.
    """
    values, codes, title = values_of_view(lattice, view, heading_deg)
    shown, extent = thinned(np.where(codes == Blocked.FREE, values, np.nan), lattice.frame)
    ground, _ = thinned(lattice.elevation_m, lattice.frame)
    style_map(axes, lattice.frame)
    low, high = colour_scale(lattice, view)
    image = energy_image(shown, hillshade(ground, extent), (low, high), view)[..., :3]
    image[np.isnan(shown)] = 1.0
    axes.imshow(image, extent=extent, interpolation="nearest")
    handles = draw_blocked(axes, codes, extent)
    if view == "heading":
        _compass(axes, math.radians(heading_deg or 0.0))
    below, above = bool((shown < low).any()), bool((shown > high).any())
    extend = "both" if below and above else "min" if below else "max" if above else "neither"
    label = f"{'dearest - cheapest heading' if view == 'directionality' else 'energy per metre'} [J/m]"
    return CostmapDrawing(ScalarMappable(Normalize(low, high), COLOURS[view]), extend, label, title, handles)


def _compass(axes: Axes, heading_rad: float) -> None:
    """An arrow along the heading on a white badge in the north-east corner."""
    corner = offset_copy(axes.transAxes, axes.get_figure(root=True), -0.32, -0.32)
    axes.plot(1.0, 1.0, "o", ms=34, mfc="white", mec=FAINT, mew=0.6, transform=corner, zorder=5)
    arrow = Path(_ARROW).transformed(Affine2D().rotate(-heading_rad))
    axes.plot(1.0, 1.0, marker=arrow, ms=22, mfc=INK, mew=0.0, transform=corner, zorder=6)
