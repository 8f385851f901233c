"""Coordinate reference systems: their names, and why a map in one of them is not measured in true metres."""

from __future__ import annotations

import math
import re

import numpy as np
import rasterio
from numpy.typing import ArrayLike, NDArray
from rasterio import warp
from rasterio.crs import CRS

from joulemap.model.errors import HeightmapError
from joulemap.model.terrain.crs_text import known_crs, proj_crs, transformer
from joulemap.model.terrain.formats.gdal import GDAL_OPTIONS, is_gdal_error

Bounds = tuple[float, float, float, float]
"""West, south, east, north, in the units of the CRS."""

_PROJECTION = re.compile(r'PROJECTION\["([^"]+)"')
_MERCATOR = ("mercator_1sp", "mercator_2sp", "mercator_auxiliary_sphere", "popular_visualisation_pseudo_mercator")
_UTM_LATITUDES = (-80.0, 84.0)
_EARTH_M = 6_378_137.0  # WGS 84
_SAME_BODY = 0.01  # spheres and old ellipsoids of the Earth differ by less


def crs_name(crs: CRS | str, bounds: Bounds | None = None, *, nodata_declared: bool = False) -> str:
    """Return the name of a CRS whose coordinates are true metres; refuse any other.

    `bounds`: west, south, east and north of the map, in the units of the CRS. The refusal then says which UTM zone the
    map lies in. Result: "EPSG:n" where the CRS has such a code, else WKT.

    A Mercator projection stretches every length by 1 / cos(latitude): Snyder 1987, Map Projections: A Working Manual
    (USGS Professional Paper 1395), eq. 7-3 on the sphere. UTM stretches by 0.9996 to 1.001.
    """
    crs = known_crs(crs)
    try:
        with rasterio.Env(**GDAL_OPTIONS):
            code, wkt = crs.to_epsg(), crs.to_wkt()
            geographic, projected = crs.is_geographic, crs.is_projected
            unit, metres = crs.linear_units_factor if projected else ("", 1.0)
    except Exception as error:
        if not (is_gdal_error(error) or isinstance(error, (ValueError, OverflowError))):
            raise
        raise HeightmapError(
            f"the coordinate reference system {str(crs)[:80]!r} is not known: give EPSG:n or its WKT", crs=str(crs)[:80]
        ) from error
    name = f"EPSG:{code}" if code else wkt
    short = name[:80]
    centre = _centre(crs, bounds)
    if geographic:
        raise HeightmapError(
            f"the map is in degrees ({short}), not in metres: {_advice(centre, nodata_declared)}", crs=short
        )
    if projected:
        if abs(metres - 1.0) > 1e-9:
            raise HeightmapError(
                f"the map is in {unit} ({metres:g} m), not in metres ({short}): {_advice(centre, nodata_declared)}",
                crs=short,
                unit=unit,
            )
        if not code:
            _check_projection(wkt, short)
        projection = _PROJECTION.search(wkt)
        if projection is not None and projection.group(1).lower() in _MERCATOR:
            raise HeightmapError(
                f"the map is in a Mercator projection ({short}), whose metres are stretched by 1/cos(latitude)"
                f"{_stretch_here(centre)}: {_advice(centre, nodata_declared)}",
                crs=short,
            )
    elif not wkt.upper().startswith(("LOCAL_CS", "ENGCRS", "ENGINEERINGCRS")) or "FOOT" in wkt.upper():
        raise HeightmapError(f"the map's coordinate reference system is no plane in metres: {short}", crs=short)
    return name


def geographic(crs: CRS | str) -> str:
    """Return the longitudes and latitudes of the body that a CRS lies on.

    Result: "EPSG:4326" on the Earth, else the geographic CRS in WKT that `crs` is based on.
    """
    known = proj_crs(crs)
    if known.ellipsoid is None or known.geodetic_crs is None or on_earth(crs):
        return "EPSG:4326"
    return str(known.geodetic_crs.to_wkt())


def on_earth(crs: CRS | str) -> bool:
    """Decide whether a CRS lies on the Earth, by the size of its ellipsoid. Result: True also where it names none."""
    body = proj_crs(crs).ellipsoid
    return body is None or abs(body.semi_major_metre / _EARTH_M - 1.0) < _SAME_BODY


def flat_crs(wkt: str) -> str:
    """Return the part of a CRS that says where on the ground a place is."""
    crs = proj_crs(wkt)
    return wkt if len(crs.axis_info) < 3 else str(crs.to_2d().to_wkt("WKT1_GDAL"))


def scale_errors(crs: str, longitude: ArrayLike, latitude: ArrayLike) -> NDArray[np.float64]:
    """Return by how much a CRS stretches lengths.

    `longitude`, `latitude` (n,): WGS 84 [deg]. Result (2 n,): length in the CRS over true length, less one: along the
    meridians, then along the parallels.
    """
    from pyproj import Proj
    from pyproj.exceptions import ProjError

    lon, lat = np.atleast_1d(longitude), np.atleast_1d(latitude)
    try:
        factors = Proj(proj_crs(crs)).get_factors(lon, lat, errcheck=True)
    except ProjError:
        return np.zeros(2 * lon.size)
    return np.concatenate([np.atleast_1d(factors.meridional_scale), np.atleast_1d(factors.parallel_scale)]) - 1.0


def _check_projection(wkt: str, short: str) -> None:
    """Refuse parameters that no projection can have, such as a latitude of 999; GDAL finds them only as it is used."""
    from pyproj.exceptions import ProjError

    try:
        transformer(geographic(wkt), wkt)
    except ProjError as error:
        raise HeightmapError(
            f"the coordinate reference system cannot be used ({short}): {str(error)[:200]}", crs=short
        ) from error


def _centre(crs: CRS, bounds: Bounds | None) -> tuple[float, float] | None:
    """Longitude and latitude [deg] of the middle of the map, None where they cannot be known."""
    if bounds is None:
        return None
    west, south, east, north = bounds
    try:
        with rasterio.Env(**GDAL_OPTIONS):
            if not on_earth(crs):
                return None
            (longitude,), (latitude,) = warp.transform(crs, "EPSG:4326", [(west + east) / 2], [(south + north) / 2])
    except Exception as error:
        if not is_gdal_error(error):
            raise
        return None
    if not (abs(longitude) <= 180.0 and abs(latitude) < 90.0):  # also where one is not finite
        return None
    return longitude, latitude


def _stretch_here(centre: tuple[float, float] | None) -> str:
    if centre is None:
        return ""
    latitude = centre[1]
    percent = 100.0 * (1.0 / math.cos(math.radians(latitude)) - 1.0)
    return f"; here, at {abs(latitude):.1f} degrees {'north' if latitude >= 0 else 'south'}, by {percent:.1f} %"


def warp_command(options: str, *, nodata_declared: bool) -> str:
    """Return the command that resamples a raster; `rio` is installed with rasterio."""
    nodata = "" if nodata_declared else " --src-nodata -9999 --dst-nodata -9999"
    return f"`rio warp IN OUT {options} --resampling bilinear{nodata}`"


def utm_zone(longitude: float, latitude: float) -> str | None:
    """Return the UTM zone of a place.

    `longitude`, `latitude`: WGS 84 [deg]. Result: such as EPSG:32630; None beyond 80 degrees south and 84 degrees
    north, where there is none.

    The zones are six degrees wide; the exceptions around Norway and Svalbard are not made, because their regular zones
    serve as well.
    """
    if not _UTM_LATITUDES[0] <= latitude <= _UTM_LATITUDES[1]:
        return None
    zone = int((longitude + 180.0) % 360.0 // 6.0) + 1
    return f"EPSG:{326 if latitude >= 0 else 327}{zone:02d}"


def _advice(centre: tuple[float, float] | None, nodata_declared: bool) -> str:
    """What to do instead, and what to type for it."""
    target = utm_zone(*centre) if centre is not None else None
    if target is None:
        words = "reproject it to its UTM zone (EPSG:326 and the two digits of the zone, EPSG:327 in the south)"
        target = "EPSG:326xx"
    else:
        words = f"reproject it to UTM zone {target[-2:].lstrip('0')}{'N' if target[5:8] == '326' else 'S'}"
    command = warp_command(f"--dst-crs {target}", nodata_declared=nodata_declared)
    return f"give `reproject` as auto, or {words} with {command}"
