"""Places on Earth: WGS 84 longitude and latitude from and to the map's own coordinates, and which of both was meant."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from joulemap.model.errors import HeightmapError, InputError, PointError
from joulemap.model.frames import GridFrame

if TYPE_CHECKING:
    from pyproj import Transformer

PlaceLike = Sequence[float] | Mapping[str, float]
"""World x, y [m] in the CRS of the map, or {"lat": ..., "lon": ...} [degrees]."""

DECIMALS = 9
"""Of degrees in files: 0.1 mm, a hundredth of the 1 cm within which positions hold."""

_LATITUDE, _LONGITUDE = ("lat", "latitude"), ("lon", "longitude", "lng")


def to_wgs84(crs: str | None, xy: ArrayLike) -> NDArray[np.float64]:
    """Return points of a map as longitude and latitude.

    `xy` (n, 2 or more): world x, y [m], further columns are not used. Result (n, 2): longitude, latitude [degrees], WGS
    84.
    """
    points = np.asarray(xy, dtype=np.float64)
    found = np.column_stack(_transformer(known_crs(crs), True).transform(points[:, 0], points[:, 1]))
    if not np.isfinite(found).all():
        raise InputError(f"the map's points are no places on Earth in its coordinate system {_short(crs)}")
    return found


def from_wgs84(crs: str | None, lonlat: ArrayLike) -> NDArray[np.float64]:
    """Return places on Earth in the coordinates of a map.

    `lonlat` (n, 2 or more): longitude, latitude [degrees], WGS 84, further columns are not used. Result (n, 2): world
    x, y [m]; infinite where the CRS does not reach.
    """
    points = np.asarray(lonlat, dtype=np.float64)
    return np.column_stack(_transformer(known_crs(crs), False).transform(points[:, 0], points[:, 1]))


def known_crs(crs: str | None) -> str:
    """Return the CRS of a map that has one."""
    if crs is None:
        raise InputError(
            "the map has no coordinate reference system, so its places have no latitude and longitude: make it from a "
            "heightmap that names one, or name it yourself with `crs`, like EPSG:32630"
        )
    return crs


@dataclass(frozen=True)
class WorldPoint:
    """A place in the coordinates of a map.

    Attributes
    ----------
    x, y : float
        World coordinates [m].
    note : str or None
        What the user should know, where numbers were read as latitude and longitude.
    """

    x: float
    y: float
    note: str | None = None


def world_point(frame: GridFrame, place: Any, *, name: str = "point") -> WorldPoint:
    """Return the place that is meant, in the coordinates of a map.

    Two numbers are x, y where they lie on the map. Elsewhere they are latitude, longitude if that is a place on the
    map, and a note says so. An object with `lat` and `lon` is always in degrees.

    `place`: world x, y [m], latitude, longitude [degrees], or an object with `lat` and `lon`. The result may lie
    outside the map, if nothing else can be meant.
    """
    if isinstance(place, Mapping):
        return _of_object(frame, place, name)
    try:
        if isinstance(place, str) or not 2 <= len(place) <= 3:
            raise ValueError
        x, y = float(place[0]), float(place[1])
    except (TypeError, ValueError):
        raise InputError(
            f'{name} is {str(place)[:80]!r}: give x and y in metres, or {{"lat": ..., "lon": ...}}'
        ) from None
    if on_map(frame, x, y) or frame.crs is None or not (math.isfinite(x) and math.isfinite(y)):
        return WorldPoint(x, y)
    if abs(x) <= 90.0 and abs(y) <= 180.0 and on_map(frame, *(here := _projected(frame.crs, x, y))):
        words = f"{name} {x:g},{y:g} was read as latitude,longitude: x {here[0]:.2f}, y {here[1]:.2f} m on the map"
        return WorldPoint(*here, words)
    if abs(y) <= 90.0 and abs(x) <= 180.0 and on_map(frame, *_projected(frame.crs, y, x)):
        raise PointError(
            f"{name} ({x:g}, {y:g}) lies outside the map; as longitude,latitude it would lie inside: write latitude "
            f"first, {y:g},{x:g}",
            x=x,
            y=y,
        )
    west, south, east, north = frame.bounds
    far = west > 180.0 or east < -180.0 or south > 180.0 or north < -180.0  # else small numbers are metres
    if abs(x) <= 90.0 and abs(y) <= 180.0 and far:
        raise PointError(
            f"{name} ({x:g}, {y:g}) lies outside the map, also as latitude,longitude: the map spans {_span(frame)}, or "
            f"x {west:.2f}..{east:.2f}, y {south:.2f}..{north:.2f}",
            x=x,
            y=y,
            bounds=[west, south, east, north],
        )
    return WorldPoint(x, y)


def degrees(place: Mapping[str, Any], name: str) -> tuple[float, float]:
    """Return latitude and longitude of an object. Result: latitude, longitude [degrees]."""
    try:
        keys = {str(key).lower(): value for key, value in place.items()}
        known = [next((key for key in names if key in keys), None) for names in (_LATITUDE, _LONGITUDE)]
        if None in known or len(keys) != 2:
            raise ValueError
        lat, lon = (float(keys[key]) for key in known if key is not None)
    except (AttributeError, TypeError, ValueError):
        raise InputError(
            f'{name} is {str(place)[:80]}: an object has `lat` and `lon` in degrees, like {{"lat": 36.72, '
            '"lon": -4.49}'
        ) from None
    if not (abs(lat) <= 90.0 and abs(lon) <= 180.0):
        raise PointError(
            f"{name} is latitude {lat:g}, longitude {lon:g}: a latitude lies within -90..90 degrees and a longitude "
            "within -180..180",
            lat=str(lat),
            lon=str(lon),
        )
    return lat, lon


def _of_object(frame: GridFrame, place: Mapping[str, Any], name: str) -> WorldPoint:
    lat, lon = degrees(place, name)
    x, y = _projected(known_crs(frame.crs), lat, lon)
    if not on_map(frame, x, y):
        raise PointError(
            f"{name} (latitude {lat:g}, longitude {lon:g}) lies outside the map, which spans {_span(frame)}",
            lat=lat,
            lon=lon,
        )
    return WorldPoint(x, y)


def _span(frame: GridFrame) -> str:
    """Where a map lies, in degrees."""
    west, south, east, north = frame.bounds
    lon, lat = to_wgs84(frame.crs, [(west, south), (east, south), (west, north), (east, north)]).T
    return f"latitude {lat.min():.5f}..{lat.max():.5f}, longitude {lon.min():.5f}..{lon.max():.5f}"


def on_map(frame: GridFrame, x: float, y: float) -> bool:
    """Return whether a point lies on a map. `x`, `y`: world coordinates [m]. Result: False for NaN."""
    west, south, east, north = frame.bounds
    return west <= x <= east and south <= y <= north


def _projected(crs: str, lat: float, lon: float) -> tuple[float, float]:
    x, y = from_wgs84(crs, [(lon, lat)])[0]
    return float(x), float(y)


def _short(crs: str | None) -> str:
    return str(crs) if crs is None or '"' not in crs else crs.split('"')[1]


def _transformer(crs: str, towards_wgs84: bool) -> Transformer:
    return _transformer_of(crs, towards_wgs84, threading.get_ident())  # PROJ's objects belong to one thread


@lru_cache(maxsize=64)
def _transformer_of(crs: str, towards_wgs84: bool, _thread: int) -> Transformer:
    from pyproj.exceptions import ProjError  # commands that need no degrees do not wait for it

    from joulemap.model.terrain.crs_text import proj_crs, transformer

    try:
        own, earth = proj_crs(crs).to_2d(), "EPSG:4326"
        return transformer(own, earth) if towards_wgs84 else transformer(earth, own)
    except (HeightmapError, ProjError) as error:
        raise InputError(
            f"the map's coordinate system {_short(crs)} has no known place on Earth: {str(error)[:200]}"
        ) from error
