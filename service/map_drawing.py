"""Cost maps on matplotlib axes: energy per metre in colour over hillshade, and what is blocked."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.transforms import Affine2D, offset_copy
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.pricing.integrator import interpolation_matrix
from joulemap.service.ground_drawing import blocked_everywhere, draw_blocked
from joulemap.service.map_style import FAINT, INK, style_map
from joulemap.service.raster_shading import Image, hillshade, thinned

VIEWS = ("mean", "directionality", "heading")
"""What a cost map can be coloured by."""

_ARROW = [(0, 1), (0.55, 0.1), (0.16, 0.1), (0.16, -1), (-0.16, -1), (-0.16, 0.1), (-0.55, 0.1), (0, 1)]  # to north
_LEAST_SPAN = 0.1
"""Least span of the colours, as a share of the mean price: a map on which all prices are nearly equal looks so."""


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
    priced = shown[np.isfinite(shown)]
    low, high = (float(q) for q in np.quantile(priced, [0.02, 0.98])) if priced.size else (0.0, 1.0)
    mean = float(np.abs(priced).mean()) if priced.size else 1.0
    high = max(high, low + max(_LEAST_SPAN * mean, 1e-3))
    norm = Normalize(low, high)
    colours = colormaps["YlGn" if view == "directionality" else "YlGnBu"]
    image = colours(norm(np.nan_to_num(shown, nan=low)))[..., :3] * (0.75 + 0.25 * hillshade(ground, extent))[..., None]
    image[np.isnan(shown)] = 1.0
    axes.imshow(np.clip(image, 0.0, 1.0), extent=extent, interpolation="nearest")
    handles = draw_blocked(axes, codes, extent)
    if view == "heading":
        _compass(axes, math.radians(heading_deg or 0.0))
    below, above = bool((priced < low).any()), bool((priced > high).any())
    extend = "both" if below and above else "min" if below else "max" if above else "neither"
    label = f"{'dearest - cheapest heading' if view == 'directionality' else 'energy per metre'} [J/m]"
    return CostmapDrawing(ScalarMappable(norm, colours), extend, label, title, handles)


def values_of_view(lattice: CostLattice, view: str, heading_deg: float | None) -> tuple[Image, NDArray[np.uint8], str]:
    """Return what a cost map is coloured by.

    Returns `values` (rows, cols): to be coloured where nothing is blocked; `codes` (rows, cols): `Blocked` codes;
    `title`: what is shown.
    """
    if view == "heading":
        if heading_deg is None or not math.isfinite(heading_deg):
            raise InputError(f"the view of one heading needs heading_deg, a finite number, got {heading_deg}")
        heading = np.array([math.radians(heading_deg)])
        weights = interpolation_matrix(heading, lattice.headings)[0]
        price = lattice.robot.price_per_m(lattice.traction_per_m @ weights.astype(np.float32))
        return price, lattice.blocked_at(heading)[..., 0], f"Energy per metre, heading {heading_deg % 360.0:g}°"
    if view not in VIEWS:
        raise InputError(f"view must be one of {', '.join(VIEWS)}, got {view!r}", view=view)
    codes = blocked_everywhere(lattice)
    if view == "mean":
        return lattice.mean_energy_per_m(), codes, "Energy per metre, mean over headings"
    free = lattice.blocked_by_heading() == Blocked.FREE
    by_bin = lattice.energy_per_m
    dearest = np.where(free, by_bin, -np.inf).max(axis=2)
    cheapest = np.where(free, by_bin, np.inf).min(axis=2)
    return np.where(codes == Blocked.FREE, dearest - cheapest, np.nan), codes, "How much the heading matters"


def _compass(axes: Axes, heading_rad: float) -> None:
    """An arrow along the heading on a white badge in the north-east corner."""
    corner = offset_copy(axes.transAxes, axes.get_figure(root=True), -0.32, -0.32)
    axes.plot(1.0, 1.0, "o", ms=34, mfc="white", mec=FAINT, mew=0.6, transform=corner, zorder=5)
    arrow = Path(_ARROW).transformed(Affine2D().rotate(-heading_rad))
    axes.plot(1.0, 1.0, marker=arrow, ms=22, mfc=INK, mew=0.0, transform=corner, zorder=6)
