"""What questions to a cost map share: the robot that is meant, warnings, the answer as it is, or a file of routes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from fastapi import Depends, Header, Query, Response
from fastapi.responses import StreamingResponse
from pydantic import BaseModel
from pydantic_core import to_json

from joulemap.model.errors import ConflictError, InputError
from joulemap.model.robot import Robot
from joulemap.service.exports.formats import WORDS, check_origin
from joulemap.service.exports.routes import ROUTE_FORMATS, RouteFile
from joulemap.service.exports.track import Track
from joulemap.service.problems import jsonable
from joulemap.service.schemas.base import robot_values
from joulemap.service.storage.tables import CostmapRow

_SLICE = 4000  # points or pieces: 2 ms


def answer_of(body: BaseModel | dict[str, Any]) -> Response:
    """Return an answer as it is: it is made of our own values, and FastAPI need not check them.

    Result: JSON; numbers that are not finite are null.
    """
    values = body.model_dump(mode="json") if isinstance(body, BaseModel) else body
    return Response(_written(values), media_type="application/json")


def _written(value: Any) -> bytes:
    """As JSON; long lists in slices, because the event loop waits while one call writes."""
    if not _is_long(value):
        return to_json(value, inf_nan_mode="null")
    if isinstance(value, dict):
        return b"{%b}" % b",".join(b"%b:%b" % (to_json(name), _written(one)) for name, one in value.items())
    slices = (value[at : at + _SLICE] for at in range(0, len(value), _SLICE))
    return b"[%b]" % b",".join(to_json(part, inf_nan_mode="null")[1:-1] for part in slices)


def _is_long(value: Any) -> bool:
    if isinstance(value, dict):
        return any(map(_is_long, value.values()))
    return isinstance(value, list) and len(value) > _SLICE


def attachment(content: bytes | Iterator[bytes], media_type: str, name: str) -> Response:
    """Return a file, whole or by and by, to be kept under a name."""
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    if isinstance(content, bytes):
        return Response(content, media_type=media_type, headers=headers)
    return StreamingResponse(content, media_type=media_type, headers=headers)


def warnings_of(row: CostmapRow) -> list[str]:
    """Return what the maker of a cost map warned of."""
    return list((row.summary or {}).get("provenance", {}).get("warnings", []))


def refuse_other_robot(row: CostmapRow, given: BaseModel | None) -> None:
    """Refuse a robot that is not that of a cost map. Raises ConflictError, which names the fields."""
    if given is None:
        return
    robot, values = Robot.from_mapping(row.robot), robot_values(given)
    Robot.from_mapping(values)
    differing = {
        key: (getattr(robot, key), value)
        for key, value in values.items()
        if value not in (getattr(robot, key), row.request["robot"][key])
    }
    if differing:
        words = ", ".join(f"{key} {there}, not {here}" for key, (there, here) in differing.items())
        raise ConflictError(
            f"cost map {row.id} was made for another robot ({words}): make a cost map for this robot",
            fields=sorted(differing),
            costmap_robot=jsonable({key: there for key, (there, _) in differing.items()}),
            given_robot=jsonable({key: here for key, (_, here) in differing.items()}),
        )


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
