"""The formats of routes: name, suffix and module of each. Adding one is a module with `write` and a line here."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from joulemap.model.errors import InputError, nearest_name
from joulemap.service.coordinates import known_crs
from joulemap.service.exports.geojson import COORDINATES, MAP, WGS84
from joulemap.service.exports.track import Track


@dataclass(frozen=True)
class RouteFormat:
    """A format that routes are written in.

    Attributes
    ----------
    name : str
        Value of `format`.
    suffix : str
        How its files end.
    media_type : str
        For HTTP.
    words : str
        What it is for.
    module : str
        In this package; its `write` makes the file.
    degrees : bool
        Whether it needs longitude and latitude, WGS 84.
    """

    name: str
    suffix: str
    media_type: str
    words: str
    module: str
    degrees: bool = True


ROUTE_FORMATS: dict[str, RouteFormat] = {
    known.name: known
    for known in (
        RouteFormat("geojson", ".geojson", "application/geo+json", "GeoJSON (RFC 7946): GIS, web maps", "geojson"),
        RouteFormat("gpx", ".gpx", "application/gpx+xml", "GPX 1.1: GPS devices, phones", "gpx"),
        RouteFormat("kml", ".kml", "application/vnd.google-earth.kml+xml", "KML 2.2: Google Earth", "kml"),
        RouteFormat("csv", ".csv", "text/csv", "CSV: the route metre by metre", "csv_table", degrees=False),
        RouteFormat(
            "qgc-plan",
            ".plan",
            "application/vnd.qgroundcontrol.plan+json",
            "mission for QGroundControl",
            "qgroundcontrol",
        ),
        RouteFormat("waypoints", ".waypoints", "text/plain", "mission for ArduPilot (QGC WPL 110)", "ardupilot"),
        RouteFormat("mcap", ".mcap", "application/octet-stream", "ROS 2 nav_msgs/Path in MCAP", "mcap", degrees=False),
        RouteFormat(
            "ros-path",
            ".path.json",
            "application/vnd.ros.path+json",
            "ROS nav_msgs/Path as JSON",
            "ros_path",
            degrees=False,
        ),
    )
}
"""Name -> format, in the order of documents."""


def route_format(name: str) -> RouteFormat:
    """Return a format by its name."""
    if name not in ROUTE_FORMATS:
        near = nearest_name(name, ROUTE_FORMATS)
        hint = f"; did you mean {near}?" if near else ""
        raise InputError(f"there is no route format {name!r}{hint} Known are {', '.join(ROUTE_FORMATS)}", format=name)
    return ROUTE_FORMATS[name]


def route_format_of(file: str | Path, name: str | None = None) -> RouteFormat:
    """Return the format of a file that is to be written."""
    if name is not None:
        return route_format(name)
    found = [known for known in ROUTE_FORMATS.values() if str(file).lower().endswith(known.suffix)]
    if not found:
        suffixes = ", ".join(known.suffix for known in ROUTE_FORMATS.values())
        raise InputError(
            f"the name {Path(file).name!r} does not say what to write: let it end with one of {suffixes}, or give "
            "`format`",
            path=str(file),
        )
    return max(found, key=lambda known: len(known.suffix))


def check_route_format(chosen: RouteFormat, crs: str | None, coordinates: str | None = None) -> dict[str, Any]:
    """Refuse what cannot be written on a map; asked before a search.

    Result: keyword arguments for the module's `write`.
    """
    if coordinates is not None and coordinates not in COORDINATES:
        raise InputError(f"`coordinates` is {coordinates!r}: give {WGS84} or {MAP}", coordinates=coordinates)
    if coordinates is not None and chosen.name != "geojson":
        raise InputError(f"`coordinates` is for GeoJSON: leave it out for {chosen.name}", format=chosen.name)
    if chosen.degrees and coordinates != MAP:
        try:
            known_crs(crs)
        except InputError as error:
            own = [known.name for known in ROUTE_FORMATS.values() if not known.degrees]
            raise InputError(
                f"{chosen.name} is in degrees of latitude and longitude: {error.message}. Formats in metres of the map "
                f"are {', '.join(own)}, and geojson with `coordinates` = map",
                format=chosen.name,
            ) from error
    return {} if coordinates is None else {"coordinates": coordinates}


def route_file(track: Track, chosen: RouteFormat, *, coordinates: str | None = None) -> bytes:
    """Return a track as a file."""
    how = check_route_format(chosen, track.crs, coordinates)
    written: bytes = import_module(f"{__package__}.{chosen.module}").write(track, **how)
    return written
