"""The grid that a map is resampled to: its CRS, the side of its cells, and where it lies."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from rasterio.transform import Affine

from joulemap.model.errors import HeightmapError
from joulemap.model.ranges import RESOLUTION_M
from joulemap.model.terrain.coordinate_systems import crs_name, geographic, on_earth, scale_errors, utm_zone
from joulemap.model.terrain.crs_text import known_crs, proj_crs, transformer

FloatArray = NDArray[np.float64]

AUTO = "auto"
"""Reproject to the UTM zone of the map, or keep its CRS where that is in true metres."""

MOST_SCALE_ERROR = 0.002
"""UTM stretches lengths by 0.9996 to 1.001; a CRS that stretches more at the middle of a map is not kept."""

_SAID_SCALE_ERROR = 0.0005  # areas are then off by a thousandth, as near the edge of a zone at the equator

EDGE_POINTS = 41
"""Of each edge of a grid, by which its bounds in another CRS are found."""

_MOST_SPREAD = 0.01  # of the scale over a map, in the CRS it is reprojected to


def choose_crs(crs: str | None, transform: Affine, rows: int, cols: int, to: str) -> tuple[str | None, str]:
    """Return the CRS that a map is reprojected to."""
    if to != AUTO:
        target = crs_name(to)
        return target, ""
    if crs is None:
        return None, ""
    lon, lat = _places(crs, transform, [cols / 2], [rows / 2])
    if not (math.isfinite(lon[0]) and abs(lat[0]) <= 90.0):
        raise HeightmapError(
            f"the middle of the map has no latitude and longitude: is {short_name(crs)} its CRS?", crs=short_name(crs)
        )
    try:
        kept = crs_name(crs)
        if float(np.abs(scale_errors(kept, lon, lat)).max()) <= MOST_SCALE_ERROR:
            return kept, " (kept: it is in true metres)"
    except HeightmapError:
        pass
    if not on_earth(crs):
        return _local_plane(geographic(crs), float(lon[0]), float(lat[0])), " (a plane around the middle of the map)"
    zone = utm_zone(float(lon[0]), float(lat[0]))
    if zone is not None:
        error = float(scale_errors(zone, lon, lat).max())
        here = f", which stretches lengths by {100 * error:.2f} % here" if abs(error) > _SAID_SCALE_ERROR else ""
        return zone, f" (UTM zone {int(zone[-2:])}{'N' if zone[5:8] == '326' else 'S'}{here})"
    pole = 90 if lat[0] > 0 else -90
    wkt = known_crs(
        f"+proj=stere +lat_0={pole} +lat_ts={lat[0]:.4f} +lon_0={lon[0]:.4f} +datum=WGS84 +units=m +no_defs"
    ).to_wkt()
    return wkt, " (polar stereographic, true to scale at this latitude)"


def _local_plane(body: str, lon: float, lat: float) -> str:
    """A transverse Mercator projection of another body, through a place on it."""
    shape = proj_crs(body).ellipsoid
    assert shape is not None
    size = f"+a={shape.semi_major_metre} +b={shape.semi_minor_metre}"
    return str(known_crs(f"+proj=tmerc +lat_0={lat:.4f} +lon_0={lon:.4f} +k=1 {size} +units=m +no_defs").to_wkt())


def new_grid(
    crs: str | None, target: str | None, transform: Affine, rows: int, cols: int, resolution_m: float | None
) -> tuple[Affine, tuple[int, int], float]:
    """Return the north-up grid that holds all of a map.

    Result: the new grid, its rows and columns, and the side of a cell of the file in the new CRS.
    """
    along = np.linspace(0.0, 1.0, EDGE_POINTS)
    zero, one = np.zeros(EDGE_POINTS), np.ones(EDGE_POINTS)
    edge_col = cols * np.concatenate([along, along, zero, one])
    edge_row = rows * np.concatenate([zero, one, along, along])
    middle_col, middle_row = cols / 2 + np.array([-0.5, 0.5, 0.0, 0.0]), rows / 2 + np.array([0.0, 0.0, -0.5, 0.5])
    x, y = moved(crs, target, transform, np.append(edge_col, middle_col), np.append(edge_row, middle_row))
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise HeightmapError(
            f"parts of the map cannot be expressed in {short_name(target)}: choose the CRS of its place",
            crs=short_name(target),
        )
    (x0, x1, x2, x3), (y0, y1, y2, y3) = x[-4:], y[-4:]
    size = math.sqrt(abs((x1 - x0) * (y3 - y2) - (x3 - x2) * (y1 - y0)))
    if not size > 0:
        raise HeightmapError("a cell of the file has no area: its transform is corrupt", transform=list(transform)[:6])
    _check_spread(target, x[:-4], y[:-4])
    side = _round(size) if resolution_m is None else resolution_m
    if side not in RESOLUTION_M:
        raise HeightmapError(f"`resolution_m` must be {RESOLUTION_M} metres, got {side:g}", resolution_m=side)
    west, north = math.floor(x[:-4].min() / side + 1e-6) * side, math.ceil(y[:-4].max() / side - 1e-6) * side
    width = math.ceil((x[:-4].max() - west) / side - 1e-6)
    height = math.ceil((north - y[:-4].min()) / side - 1e-6)
    return Affine(side, 0.0, west, 0.0, -side, north), (height, width), size


def _check_spread(target: str | None, x: FloatArray, y: FloatArray) -> None:
    """Refuse a map of which parts are stretched otherwise than others."""
    if target is None:
        return
    lon, lat = transformer(target, geographic(target)).transform(x, y)
    errors = scale_errors(target, lon, lat)
    if errors.size and float(errors.max() - errors.min()) > _MOST_SPREAD:
        raise HeightmapError(
            f"the map is too large for one CRS: {short_name(target)} stretches lengths by {100 * errors.min():.1f} to "
            f"{100 * errors.max():.1f} % on it, the limit is {100 * _MOST_SPREAD:g} %: cut it into parts",
            crs=short_name(target),
        )


def moved(
    crs: str | None, target: str | None, transform: Affine, col: FloatArray, row: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return places of a grid in another CRS.

    `crs`, `target`: before and after, None leaves them as they are; `col`, `row` (n,): places on it, from its outer
    corner. The result is (n,).
    """
    x = transform.a * col + transform.b * row + transform.c
    y = transform.d * col + transform.e * row + transform.f
    if crs is None or target is None:
        return x, y
    from pyproj.exceptions import ProjError

    try:
        found = transformer(crs, target).transform(x, y)
    except ProjError as error:
        raise HeightmapError(
            f"a map in {short_name(crs)} cannot be reprojected to {short_name(target)}: {str(error)[:200]}",
            crs=short_name(crs),
        ) from error
    return np.asarray(found[0]), np.asarray(found[1])


def _places(crs: str, transform: Affine, col: list[float], row: list[float]) -> tuple[FloatArray, FloatArray]:
    """Longitudes and latitudes [deg] of places on the file's grid."""
    return moved(crs, geographic(crs), transform, np.array(col), np.array(row))


def short_name(crs: str | None) -> str:
    """Return a CRS for a message."""
    if crs is None:
        return "no CRS"
    code = known_crs(crs).to_epsg()
    return f"EPSG:{code}" if code else crs[:60]


def _round(size: float) -> float:
    """Three significant digits."""
    return float(f"{size:.3g}")
