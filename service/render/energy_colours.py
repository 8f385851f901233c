"""What a cost map is coloured by, and the one scale of its colours, in pictures, on the page and in notebooks."""

from __future__ import annotations

import math

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.pricing.integrator import interpolation_matrix
from joulemap.service.render.ground_drawing import blocked_everywhere
from joulemap.service.render.raster_shading import Image

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
