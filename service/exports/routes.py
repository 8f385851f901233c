"""The formats of routes: name, suffix and function of each. Adding one is a module with `write` and a line here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from joulemap.model.errors import InputError
from joulemap.service.exports.formats import Format, check_origin, track_from
from joulemap.service.exports.geojson import COORDINATES, MAP, WGS84
from joulemap.service.exports.track import Track
from joulemap.service.places.coordinates import known_crs

_PLAN, _ROS = "application/vnd.qgroundcontrol.plan+json", "application/vnd.ros.path+json"
_KML = "application/vnd.google-earth.kml+xml"
ROUTE_FORMATS: dict[str, Format] = {
    known.name: known
    for known in (
        Format(
            "geojson", ".geojson", "application/geo+json", "GeoJSON (RFC 7946): GIS, web maps", "geojson:write", True
        ),
        Format("gpx", ".gpx", "application/gpx+xml", "GPX 1.1: GPS devices, phones", "gpx:write", True),
        Format("kml", ".kml", _KML, "KML 2.2: Google Earth", "kml:write", True),
        Format("csv", ".csv", "text/csv", "CSV: the route metre by metre", "csv_table:write"),
        Format("qgc-plan", ".plan", _PLAN, "mission for QGroundControl", "qgroundcontrol:write", True),
        Format("waypoints", ".waypoints", "text/plain", "mission for ArduPilot (QGC WPL 110)", "ardupilot:write", True),
        Format("mcap", ".mcap", "application/octet-stream", "ROS 2 nav_msgs/Path in MCAP", "mcap:write"),
        Format("ros-path", ".path.json", _ROS, "ROS nav_msgs/Path as JSON", "ros_path:write"),
    )
}
"""Name -> format, in the order of documents."""


@dataclass(frozen=True)
class RouteFile:
    """How a route is written: in which format, and what that leaves open."""

    format: Format
    coordinates: str | None = None
    origin: str | Sequence[float] | None = None

    @property
    def query(self) -> dict[str, Any]:
        """What a service is asked for."""
        how = {"format": self.format.name, "coordinates": self.coordinates, "origin": self.origin}
        return {name: value for name, value in how.items() if value is not None}

    def check(self, crs: str | None) -> None:
        """Refuse what cannot be written on a map; asked before a search."""
        chosen, coordinates = self.format, self.coordinates
        check_origin(self.origin, chosen.name)
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
                    f"{chosen.name} is in degrees of latitude and longitude: {error.message}. Formats in metres of the "
                    f"map are {', '.join(own)}, and geojson with `coordinates` = map",
                    format=chosen.name,
                ) from error

    def written(self, track: Track) -> bytes:
        """Return a track as a file."""
        self.check(track.crs)
        if self.origin is not None:
            track = track_from(track, self.origin)
        how = {} if self.coordinates is None else {"coordinates": self.coordinates}
        content: bytes = self.format.write(track, **how)
        return content
