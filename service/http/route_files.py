"""Routes as files over HTTP: which format a request wants, and the answer in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from fastapi import Query, Response

from joulemap.model.errors import InputError
from joulemap.model.frames import GridFrame
from joulemap.service.exports.routes import ROUTE_FORMATS, RouteFormat, check_route_format, route_file
from joulemap.service.exports.track import Track

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
_OBJECT, _BYTES = {"type": "object"}, {"type": "string", "format": "binary"}
FILES: dict[str, Any] = {
    known.media_type: {
        "schema": {**(_OBJECT if known.media_type.endswith("json") else _BYTES), "description": known.words}
    }
    for known in ROUTE_FORMATS.values()
}
"""The media types of these answers, for the document."""


@dataclass(frozen=True)
class WantedFile:
    """In which format a route is wanted.

    Attributes
    ----------
    chosen : RouteFormat or None
        None: the answer of the schema.
    coordinates : str or None
        "wgs84" or "map", of GeoJSON.
    """

    chosen: RouteFormat | None
    coordinates: str | None

    def check(self, frame: GridFrame) -> None:
        """Refuse what cannot be written on a map."""
        if self.chosen is not None:
            check_route_format(self.chosen, frame.crs, self.coordinates)

    def response(self, track: Track, name: str) -> Response:
        """Return the file."""
        assert self.chosen is not None
        content = route_file(track, self.chosen, coordinates=self.coordinates)
        headers = {"Content-Disposition": f'attachment; filename="{name}{self.chosen.suffix}"'}
        return Response(content, media_type=self.chosen.media_type, headers=headers)


def route_file_wanted(format: str | None, accept: str | None, coordinates: str | None) -> WantedFile:
    """Return in which format a route is wanted."""
    offered = {known.media_type: name for name, known in ROUTE_FORMATS.items()}
    asked = [part.split(";")[0].strip() for part in (accept or "").split(",")]
    own = ("text/plain", "application/octet-stream")  # too general to mean one of these
    name = format or next((offered[kind] for kind in asked if kind in offered and kind not in own), JSON)
    if name == JSON and coordinates is not None:
        raise InputError("`coordinates` is for format=geojson: leave it out", coordinates=coordinates)
    return WantedFile(ROUTE_FORMATS.get(name), coordinates)
