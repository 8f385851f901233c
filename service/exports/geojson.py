"""GeoJSON after RFC 7946: longitude and latitude, WGS 84. Or, if asked for, the map's own coordinates."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.service.exports.track import Line, Track, degrees_of

WGS84, MAP = "wgs84", "map"
COORDINATES = (WGS84, MAP)


def geojson_document(track: Track, *, coordinates: str = WGS84) -> dict[str, Any]:
    """Return a track as a GeoJSON document.

    `coordinates`: "wgs84" (longitude, latitude [degrees]) or "map" (x, y [m] in the map's CRS, named in the member
    `crs`). Heights [m] are those of the map; lines with unknown heights have none. A line over the antimeridian is cut
    there.

    Reference: RFC 7946; `crs` is that of its predecessor, GeoJSON 2008.
    """
    document: dict[str, Any] = {"type": "FeatureCollection", **track.extra}
    if coordinates == MAP:
        document |= {} if track.crs is None else {"crs": {"type": "name", "properties": {"name": track.crs}}}
        places = [line.points[:, :2] for line in track.lines]
    else:
        places = [degrees_of(track, line) for line in track.lines]
        document["map_crs"] = track.crs
    document["features"] = [
        {"type": "Feature", "geometry": _geometry(line, xy, coordinates), "properties": line.properties}
        for line, xy in zip(track.lines, places, strict=True)
    ]
    return document


def write(track: Track, *, coordinates: str = WGS84) -> bytes:
    """Return a track as a GeoJSON file."""
    return (json.dumps(geojson_document(track, coordinates=coordinates), allow_nan=False) + "\n").encode()


def _geometry(line: Line, xy: NDArray[np.float64], coordinates: str) -> dict[str, Any]:
    known = bool(np.isfinite(line.points[:, 2]).all())
    points = np.column_stack([xy, np.round(line.points[:, 2], 3)]) if known else xy
    if len(points) == 1:  # a line has two positions at least
        points = np.repeat(points, 2, axis=0)
    parts = [points] if coordinates == MAP else _cut_at_antimeridian(points)
    if len(parts) == 1:
        return {"type": "LineString", "coordinates": parts[0].tolist()}
    return {"type": "MultiLineString", "coordinates": [part.tolist() for part in parts]}


def _cut_at_antimeridian(points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """The parts of a line on either side of longitude 180."""
    parts, begin = [], [points[0]]
    for here, there in zip(points[:-1], points[1:], strict=True):
        if abs(there[0] - here[0]) > 180.0:
            side = 180.0 if here[0] > 0 else -180.0
            share = (side - here[0]) / (there[0] + 2.0 * side - here[0])
            edge = here + share * (there - here)
            parts.append(np.array([*begin, [side, *edge[1:]]]))
            begin = [np.array([-side, *edge[1:]])]
        begin.append(there)
    return [*parts, np.array(begin)]
