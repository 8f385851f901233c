"""Routes as files over HTTP: which format a request wants, and the answer in it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import Depends, Header, Query, Response

from joulemap.model.errors import InputError
from joulemap.service.exports.origin import WORDS, check_origin
from joulemap.service.exports.routes import ROUTE_FORMATS, RouteFile
from joulemap.service.exports.track import Track
from joulemap.service.http.asked import attachment

JSON = "json"
_NAMES = (JSON, *ROUTE_FORMATS)
_WORDS = "; ".join(f"{known.name}: {known.words}" for known in ROUTE_FORMATS.values())

FileFormat = Annotated[
    Literal[_NAMES] | None,  # type: ignore[valid-type]
    Query(description=f"default: as the Accept header says, else json, the answer of this schema. {_WORDS}"),
]
Coordinates = Annotated[
    Literal["wgs84", "map"] | None,
    Query(description="of geojson: wgs84 (default), longitude and latitude; map, x and y in the map's CRS [m]"),
]
Origin = Annotated[str | None, Query(max_length=60, description=f"{WORDS}; start: that of the route")]
_OBJECT, _BYTES = {"type": "object"}, {"type": "string", "format": "binary"}
FILES: dict[str, Any] = {
    known.media_type: {
        "schema": {**(_OBJECT if known.media_type.endswith("json") else _BYTES), "description": known.words}
    }
    for known in ROUTE_FORMATS.values()
}
"""The media types of these answers, for the document."""


def file_response(file: RouteFile, track: Track, name: str) -> Response:
    """Return a track as a file."""
    return attachment(file.written(track), file.format.media_type, f"{name}{file.format.suffix}")


def route_file_wanted(
    format: str | None, accept: str | None, coordinates: str | None, origin: str | None = None
) -> RouteFile | None:
    """Return how a route is wanted as a file; None where the answer of the schema is wanted."""
    offered = {known.media_type: name for name, known in ROUTE_FORMATS.items()}
    asked = [part.split(";")[0].strip() for part in (accept or "").split(",")]
    own = ("text/plain", "application/octet-stream")  # too general to mean one of these
    name = format or next((offered[kind] for kind in asked if kind in offered and kind not in own), JSON)
    if name == JSON and coordinates is not None:
        raise InputError("`coordinates` is for format=geojson: leave it out", coordinates=coordinates)
    if name == JSON:
        if origin is not None:
            check_origin(origin, JSON)
        return None
    return RouteFile(ROUTE_FORMATS[name], coordinates, origin)


async def _route_file(
    format: FileFormat = None,
    coordinates: Coordinates = None,
    origin: Origin = None,
    accept: Annotated[str | None, Header(include_in_schema=False)] = None,
) -> RouteFile | None:
    return route_file_wanted(format, accept, coordinates, origin)


FileWanted = Annotated[RouteFile | None, Depends(_route_file)]
"""The same of a request, as a route takes it."""
