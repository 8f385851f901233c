"""Polygons of GeoJSON as others send them: checked, with every ring closed, and the CRS that they are in."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame

MOST_COORDINATE = 1e8
"""[m]: more than twice round the Earth."""
_MOST_CELLS = 1e9
"""From the map's corner: GDAL counts cells in 32 bits, and draws nothing of a polygon that reaches further."""
_LEAST_CORNERS = 3

Ring = list[tuple[float, ...]]
"""x and y of each corner, and where it is given its height."""


def polygons_of(document: Mapping[str, Any], source: str) -> list[tuple[dict[str, Any], Mapping[str, Any]]]:
    """Return the polygons of a GeoJSON document with the properties of each, every ring closed.

    Raises InputError, which names `source`, where something else is in it.
    """
    found = []
    for feature in _features(document, source):
        if not isinstance(feature, Mapping):
            raise InputError(f"{source} is no GeoJSON with polygons: a feature of it is {_short(feature)}")
        alone = feature.get("type") != "Feature"
        geometry, properties = (feature, {}) if alone else (feature.get("geometry"), feature.get("properties") or {})
        if not isinstance(geometry, Mapping):
            raise InputError(f"a feature of {source} has no geometry: leave it out, or give it a polygon")
        if not isinstance(properties, Mapping):
            raise InputError(f"the properties of a feature of {source} are {_short(properties)}: give names and values")
        kind, nested = geometry.get("type"), geometry.get("coordinates")
        if kind not in ("Polygon", "MultiPolygon"):
            raise InputError(f"{source} holds a {_short(kind)}: a layer is of polygons")
        polygons = _list([nested] if kind == "Polygon" else nested, source)
        rings = [[_ring(ring, source) for ring in _list(polygon, source)] for polygon in polygons]
        found.append(({"type": "MultiPolygon", "coordinates": rings}, properties))
    if not found:
        raise InputError(f"{source} holds no polygons")
    return found


def corners_of(geometry: Mapping[str, Any]) -> Iterator[tuple[float, float]]:
    """Return the corners of a polygon of `polygons_of`."""
    return ((x, y) for x, y, *_ in _whole_corners(geometry))


def corners_with_heights(geometry: Mapping[str, Any]) -> NDArray[np.float64] | None:
    """Return x, y and height [m] of the corners, (n, 3), each place once; None where one has no height."""
    corners = {corner[:2]: corner for corner in map(tuple, _whole_corners(geometry))}
    return np.array([*corners.values()]) if all(len(corner) > 2 for corner in corners.values()) else None


def _whole_corners(geometry: Mapping[str, Any]) -> Iterator[Sequence[float]]:
    return (corner for polygon in geometry["coordinates"] for ring in polygon for corner in ring)


def named_crs(
    document: Mapping[str, Any], polygons: Sequence[tuple[Mapping[str, Any], Any]], ground: GridFrame, source: str
) -> str | None:
    """The CRS of GeoJSON: what it names, or else degrees where it looks so and the map has another (RFC 7946)."""
    crs = document.get("crs")
    said = crs.get("properties") if isinstance(crs, Mapping) else None
    name = said.get("name", crs) if isinstance(said, Mapping) else crs  # a link to one is not followed
    if name is not None:
        if not isinstance(name, str):
            raise InputError(f"the crs of {source} is {_short(name)}: give its name, such as EPSG:32630")
        return name
    corners = [corner for geometry, _ in polygons for corner in corners_of(geometry)]
    west, south, east, north = ground.bounds
    degrees = all(abs(x) <= 180.0 and abs(y) <= 90.0 for x, y in corners)
    inside = any(west <= x <= east and south <= y <= north for x, y in corners)
    return "EPSG:4326" if degrees and not inside and ground.crs is not None else None


def check_reach(geometry: Mapping[str, Any], ground: GridFrame, source: str) -> None:
    """Refuse a polygon that lies where no map does, which GDAL would leave out. Raises InputError."""
    most = min(MOST_COORDINATE, _MOST_CELLS * ground.resolution_m)
    for x, y in corners_of(geometry):
        if not (abs(x - ground.west_m) <= most and abs(y - ground.north_m) <= most):
            raise InputError(
                f"a polygon of {source} has a corner at {x:g}, {y:g}, and the limit is {most:g} m from the map",
                value=[str(x), str(y)],
                limit=most,
            )


def _features(document: Mapping[str, Any], source: str) -> Sequence[Any]:
    if not isinstance(document, Mapping):
        raise InputError(f"{source} is no GeoJSON with polygons, but {_short(document)}")
    return _list(document.get("features"), source) if document.get("type") == "FeatureCollection" else [document]


def _list(nested: Any, source: str) -> Sequence[Any]:
    if not isinstance(nested, list | tuple):
        raise InputError(f"{source} is no GeoJSON with polygons: where a list belongs it has {_short(nested)}")
    if not nested:
        raise InputError(f"{source} has a polygon without corners, or no polygons")
    return nested


def _ring(ring: Any, source: str) -> Ring:
    try:
        corners = [(float(x), float(y), *map(float, z[:1])) for x, y, *z in _list(ring, source)]
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"a polygon of {source} has a corner that is not two numbers, x and y") from error
    if not all(math.isfinite(value) for corner in corners for value in corner):
        raise InputError(f"a polygon of {source} has a corner that is not finite")
    distinct = len({corner[:2] for corner in corners})
    if distinct < _LEAST_CORNERS:
        raise InputError(
            f"a ring of a polygon of {source} has {distinct} different corners: it needs {_LEAST_CORNERS}",
            corners=distinct,
        )
    return corners if corners[0] == corners[-1] else [*corners, corners[0]]


def _short(value: Any) -> str:
    return f"{value!r:.60}"
