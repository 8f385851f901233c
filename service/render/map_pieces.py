"""What a page draws of a large map as it is zoomed in: pieces as fine as the cells; contour lines, roses, degrees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from contourpy import contour_generator
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError, NotFoundError
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.terrain.crs_text import transformer
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.service.render.energy_colours import VIEWS, colour_scale, energy_image, free_values
from joulemap.service.render.ground_drawing import tint_range, tinted_relief
from joulemap.service.render.map_layers import blocked_codes, blocked_image, png, sampled
from joulemap.service.render.raster_shading import Image, centres, hillshade, steepness, thinned, thinning

PIECE_PIXELS = 512
"""Longest side of a piece."""

MOST_LEVELS = 3
"""A pixel of the coarsest pieces is 4 x 4 cells, so that a piece never needs more than 4.2 million cells."""

MOST_PIECES = 1_000_000
"""Along a side of a map: more than any map has."""


@dataclass(frozen=True)
class Look:
    """What pieces have in common with the picture of the whole map, so that they fit together.

    Attributes
    ----------
    tints : tuple of float
        As of `tint_range`.
    steep : float
        As of `steepness`.
    scales : dict of str to (float, float)
        `colour_scale` by view.
    """

    tints: tuple[float, float]
    steep: float
    scales: dict[str, tuple[float, float]]


def look_of(lattice: CostLattice) -> Look:
    """Return what the pieces of a cost map have in common."""
    ground, extent = thinned(lattice.elevation_m, lattice.frame)
    scales = {view: colour_scale(lattice, view) for view in VIEWS}
    return Look(tint_range(ground), steepness(ground, extent), scales)


def levels_of(shape: tuple[int, int]) -> int:
    """Return on how many levels a map has pieces that are finer than its layers."""
    return min(int(np.ceil(np.log2(thinning(shape)))), MOST_LEVELS)


def draw_piece(
    lattice: CostLattice | StoredLattice,
    look: Look,
    place: tuple[int, int, int],
    *,
    view: str | None,
    heading_deg: float | None = None,
    blocked: bool = True,
) -> bytes:
    """Draw ground, energy and blocked ground of a piece over each other.

    `place`: level, and row and column among the pieces of this level, counted from the north-west; `view`: as for
    `energy_layer`, None for the ground alone. Result: a PNG. Cells at the edge of the map that fill no pixel are not
    drawn. Raises NotFoundError if the map has no such piece.
    """
    frame, (level, *_) = lattice.frame, place
    step = 2**level
    spans = [_span(cells, step, which) for cells, which in zip(frame.shape, place[1:], strict=True)]
    if not 0 <= level < levels_of(frame.shape) or not all(len(span) for span in spans):
        raise NotFoundError(f"this map has no piece {place[1]}, {place[2]} of level {level}", piece=list(place))
    wider = [_wider(span, cells) for span, cells in zip(spans, frame.shape, strict=True)]
    part = sampled(lattice, wider[0], wider[1])
    west, south, east, north = part.frame.bounds
    extent, ground = (west, east, south, north), part.elevation_m
    image = np.dstack(
        [tinted_relief(ground, extent, between=look.tints, steep=look.steep), np.isfinite(ground).astype(np.float64)]
    )
    if view is not None:
        light = hillshade(ground, extent, steep=look.steep)
        image = _over(image, energy_image(free_values(part, view, heading_deg), light, look.scales[view], view))
    top, left = ((span.start - wide.start) // step for span, wide in zip(spans, wider, strict=True))
    inner = np.s_[top : top + len(spans[0]), left : left + len(spans[1])]
    image = image[inner]
    if blocked:
        image = _over(image, blocked_image(blocked_codes(part, heading_deg)[inner]))
    return png(image)


def _span(cells: int, step: int, which: int) -> range:
    """The cells in the middle of each pixel of a piece, along a side of the map; empty where it lies outside."""
    begin = which * PIECE_PIXELS * step
    pixels = min(max(cells - begin, 0) // step, PIECE_PIXELS) if which >= 0 else 0
    return range(begin + step // 2, begin + pixels * step, step)


def _wider(span: range, cells: int) -> range:
    """With a pixel more on either side where there is one: slopes at the edge of a piece need it."""
    start = span.start - span.step if span.start >= span.step else span.start
    end = span[-1] + span.step
    return range(start, end + 1 if end + (span.step + 1) // 2 <= cells else span[-1] + 1, span.step)


def _over(lower: Image, upper: Image) -> Image:
    """An image seen through the one above it."""
    seen, below = upper[..., 3:], lower[..., 3:] * (1.0 - upper[..., 3:])
    opacity = seen + below
    colour = (upper[..., :3] * seen + lower[..., :3] * below) / np.where(opacity > 0.0, opacity, 1.0)
    return np.dstack([colour, opacity])


_CONTOUR_PIXELS, _CONTOURS, _SHORTEST_CONTOUR = 260, 14, 6


def contours(heights: Image, frame: GridFrame) -> list[tuple[float, list[NDArray[np.float64]]]]:
    """Return contour lines of the ground, simplified to what can be seen of the whole map.

    `heights` (rows, cols): NaN where unknown. Result: height [m] and lines, each (N, 2) world x, y [m].
    """
    ground, extent = thinned(heights, frame, most=_CONTOUR_PIXELS)
    known = ground[np.isfinite(ground)]
    if min(ground.shape) < 2 or known.size == 0 or known.max() - known.min() < 0.05:
        return []
    generator = contour_generator(*centres(ground, extent), np.ma.masked_invalid(ground))
    levels = MaxNLocator(_CONTOURS, steps=[1, 2, 5, 10]).tick_values(float(known.min()), float(known.max()))
    found = []
    for level in levels:
        lines: list[Any] = [line for line in generator.lines(level) if len(line) >= _SHORTEST_CONTOUR]
        if lines:
            found.append((float(level), lines))
    return found


def roses(
    lattice: CostLattice | StoredLattice, bounds: tuple[float, float, float, float], *, across: int
) -> Mapping[str, Any]:
    """Return energy per metre by heading at evenly spaced cells of a part of the map.

    `bounds`: west, south, east, north of the part [m], what lies outside the map is left out. Result: ``headings_deg``
    (K), ``points`` (n, 2) [m] and ``energy_per_m`` (n, K) [J/m], None where blocked.
    """
    west, south, east, north = bounds
    (top, left), (bottom, right) = (lattice.frame.rowcol(x, y) for x, y in ((west, north), (east, south)))
    rows = np.arange(max(int(np.ceil(top)), 0), min(int(np.floor(bottom)) + 1, lattice.frame.rows))
    cols = np.arange(max(int(np.ceil(left)), 0), min(int(np.floor(right)) + 1, lattice.frame.cols))
    step = max(1, -(-max(len(rows), len(cols)) // across))
    rows, cols = rows[step // 2 :: step], cols[step // 2 :: step]
    row, col = (part.ravel() for part in np.meshgrid(rows, cols, indexing="ij"))
    x, y = lattice.frame.xy(row, col)
    points, price = np.stack([x, y], axis=-1), np.empty((row.size, lattice.headings))
    for k, (r, c) in enumerate(zip(row.tolist(), col.tolist(), strict=True)):
        cell = lattice.window(r, r + 1, c, c + 1)
        free = cell.blocked_by_heading()[0, 0] == Blocked.FREE
        price[k] = np.where(free, lattice.robot.price_per_m(cell.traction_per_m[0, 0]), np.nan)
    return {
        "headings_deg": np.rad2deg(heading_bins(lattice.headings)).tolist(),
        "points": points.tolist(),
        "energy_per_m": [[value if np.isfinite(value) else None for value in one] for one in price.tolist()],
    }


def lat_lon(frame: GridFrame) -> list[list[list[float]]] | None:
    """Return latitude and longitude of nine places of a map, between which a page can interpolate.

    Result: (3, 3, 2): from north to south, from west to east, latitude and longitude [deg]. None where the CRS is
    unknown or has no place on Earth.
    """
    if frame.crs is None:
        return None
    west, south, east, north = frame.bounds
    x, y = np.meshgrid([west, (west + east) / 2, east], [north, (south + north) / 2, south])
    try:
        lon, lat = transformer(frame.crs, "EPSG:4326").transform(x, y)
    except (HeightmapError, RuntimeError, ValueError):  # pyproj's errors: a local CRS has no place on Earth
        return None
    places = np.stack([lat, lon], axis=-1)
    return places.tolist() if np.isfinite(places).all() else None
