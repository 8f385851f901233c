"""What a cost map is coloured by, the one scale of its colours, and the map in them on axes of matplotlib."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_hex
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.transforms import Affine2D, offset_copy
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.pricing.integrator import interpolation_matrix
from joulemap.service.render.ground_drawing import blocked_everywhere, draw_blocked
from joulemap.service.render.raster_shading import FAINT, INK, Image, hillshade, style_map, thinned

VIEWS = ("mean", "directionality", "heading")
"""What a cost map can be coloured by."""

COLOURS = {"mean": "YlGnBu", "heading": "YlGnBu", "directionality": "YlGn"}
"""Colour maps by view. All grow darker evenly, which people with any colour vision see."""

_SAMPLE = 40_000  # cells that a colour scale is taken from
_ENERGY_ALPHA = 0.82


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


def free_values(lattice: CostLattice, view: str, heading_deg: float | None) -> Image:
    """Return what a view colours. Result (rows, cols): NaN where blocked."""
    values, codes, _ = values_of_view(lattice, view, heading_deg)
    return np.where(codes == Blocked.FREE, values, np.nan).astype(np.float32)


def energy_image(values: Image, light: Image, scale: tuple[float, float], view: str) -> Image:
    """Return energy per metre in colour, shaded.

    `values` (rows, cols): as of `free_values`; `light` (rows, cols): as of `hillshade`. Result (rows, cols, 4): red,
    green, blue and opacity, 0 to 1.
    """
    low, high = scale
    image = colormaps[COLOURS[view]](np.clip((np.nan_to_num(values, nan=low) - low) / (high - low), 0.0, 1.0))
    image[..., :3] *= (0.72 + 0.28 * light)[..., None]
    image[..., 3] = np.where(np.isfinite(values), _ENERGY_ALPHA, 0.0)
    return np.clip(image, 0.0, 1.0)


def colour_scale(lattice: CostLattice, view: str) -> tuple[float, float]:
    """Return the values at the two ends of the colours, the same for all headings so that they can be compared.

    Result: 2 % and 98 % quantiles [J/m], at least a tenth of the mean apart: where all prices are nearly equal, the map
    looks so.
    """
    step = max(1, int(np.sqrt(lattice.frame.rows * lattice.frame.cols / _SAMPLE)))
    frame = lattice.frame
    rows, cols = -(-frame.rows // step), -(-frame.cols // step)
    coarse = GridFrame(frame.west_m, frame.north_m, frame.resolution_m * step, rows, cols)
    traction, elevation, gradient, blocked = (part[::step, ::step] for part in arrays_of(lattice))
    few = CostLattice(coarse, lattice.robot, traction, elevation, gradient, blocked)
    price = np.where(few.blocked_by_heading() == Blocked.FREE, few.energy_per_m, np.nan)
    if view != "heading":
        price = price[np.isfinite(price).any(axis=2)]
        price = np.nanmean(price, axis=1) if view == "mean" else np.nanmax(price, axis=1) - np.nanmin(price, axis=1)
    price = price[np.isfinite(price)]
    if price.size == 0:
        return 0.0, 1.0
    low, high = (float(q) for q in np.quantile(price, [0.02, 0.98]))
    return low, max(high, low + max(0.1 * float(np.abs(price).mean()), 1e-3))


def scale_colours(view: str) -> list[str]:
    """Return evenly spaced colours of a scale, from low to high."""
    return [to_hex(colour) for colour in colormaps[COLOURS[view]](np.linspace(0.0, 1.0, 9))]


def arrays_of(lattice: CostLattice) -> tuple[Image, Image, Image, Image]:
    """Return what a cost map has for each cell."""
    return lattice.traction_per_m, lattice.elevation_m, lattice.gradient, lattice.blocked


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
