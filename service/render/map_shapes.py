"""What a page draws by itself on a map: contour lines, roses of the energy by heading, places in degrees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from contourpy import contour_generator
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from joulemap.model.errors import HeightmapError
from joulemap.model.frames import GridFrame, heading_bins
from joulemap.model.terrain.crs_text import transformer
from joulemap.planner.lattice import Blocked, CostLattice
from joulemap.planner.lattice.stored_lattice import StoredLattice
from joulemap.service.render.raster_shading import Image, centres, thinned

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
