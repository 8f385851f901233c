"""What the OpenAPI document says beyond types: which fields go together, who is refused and how, and keys."""

from __future__ import annotations

from typing import Any

from joulemap.model.errors import (
    BusyError,
    ConflictError,
    ForbiddenError,
    JoulemapError,
    NotFoundError,
    RateError,
    StorageFullError,
    TooLargeError,
    UnauthorizedError,
)
from joulemap.service.problems import problem, problem_of

_ID = "3f9c1a7be2d04c55"
_NULL, _GIVEN = {"type": "null"}, {"not": {"type": "null"}}


def _status_is(status: str, **fields: dict[str, Any]) -> dict[str, Any]:
    return {"if": {"properties": {"status": {"const": status}}}, "then": {"properties": fields}}


def _states(*made: str) -> dict[str, Any]:
    """What is there of a job in each of its states; `made`: fields that are there when it is done."""
    states = (
        *(_status_is(status, finished_at=_NULL, problem=_NULL) for status in ("queued", "running")),
        _status_is("done", finished_at=_GIVEN, **dict.fromkeys(made, _GIVEN), problem=_NULL),
        _status_is("failed", finished_at=_GIVEN, problem=_GIVEN, **{made[0]: _NULL}),
        _status_is("cancelled", finished_at=_GIVEN, problem=_NULL),
    )
    return {"allOf": list(states)}


_BOTH_ENDS: dict[str, Any] = {"required": ["start", "goal"], "properties": {"start": _GIVEN, "goal": _GIVEN}}
_NO_END = {"properties": {"start": _NULL, "goal": _NULL}}

CONDITIONS: dict[str, dict[str, Any]] = {
    "FeasibilityRequest": {
        "oneOf": [
            {"required": ["path"], "properties": {"path": _GIVEN, "start": _NULL, "goal": _NULL}},
            {**_BOTH_ENDS, "properties": {**_BOTH_ENDS["properties"], "path": _NULL}},
        ]
    },
    "CalibrationRequest": {"oneOf": [_BOTH_ENDS, _NO_END]},
    "CostmapOut": _states("frame", "blocked", "provenance"),
    "CalibrationOut": _states("calibrated_model"),
}
"""By component: what its schema also asks for."""

TOGETHER: dict[tuple[str, str], tuple[str, ...]] = {
    ("get_field", "start_x"): ("start_y",),
    ("get_field", "start_y"): ("start_x",),
    ("get_field", "goal_x"): ("goal_y",),
    ("get_field", "goal_y"): ("goal_x",),
    ("get_field", "within"): ("start_x", "start_y", "goal_x", "goal_y"),
    ("send_runs", "terrain_from_name"): ("odometry_track_m",),
}
"""By operation and parameter of the query: the parameters without which it is refused."""

SECURITY_SCHEMES = {
    "bearer": {"type": "http", "scheme": "bearer", "description": "a key of `joulemap keys add`"},
    "key": {"type": "apiKey", "in": "header", "name": "X-API-Key", "description": "the same key"},
}
SECURITY: list[dict[str, list[str]]] = [{}, {"bearer": []}, {"key": []}]
"""A service without keys asks for none."""


def event_schema(*names: str) -> dict[str, Any]:
    """Return the schema of one server-sent event."""
    data = {"type": "string", "contentMediaType": "application/json"}
    event = {"type": "string", "enum": list(names)}
    return {"type": "object", "properties": {"event": event, "data": data}, "required": ["event", "data"]}


OPEN_PATHS = ("/healthz", "/readyz")
KEEPING = ("/v1/heightmaps", "/v1/costmaps", "/v1/runs", "/v1/calibrations", "/v1/costmaps/{costmap_id}/drives")
"""Paths to which what is kept is posted."""

RETRY_AFTER = {
    "Retry-After": {
        "description": "seconds until it is worth asking again",
        "schema": {"type": "integer", "minimum": 1},
    }
}


def statuses_of(method: str, path: str) -> set[int]:
    """Return the statuses that middleware can answer before an operation is reached, and those of what is kept."""
    if path in OPEN_PATHS:
        return {500}
    keeping = {507} if method == "post" and path in KEEPING else set()
    return {401, 403, 429, 500, 503} | keeping


def problem_example(status: int) -> dict[str, Any]:
    """Return a problem body that the service answers with a status."""
    if status in _ERRORS:
        return problem_of(_ERRORS[status], _ID)
    code, title, detail, context = _OTHERS[status]
    return problem(status, code, title, detail, _ID, context)


_ERRORS: dict[int, JoulemapError | Exception] = {
    401: UnauthorizedError("this key is not valid: it is wrong, or it was revoked", prefix="jm_4b8424a4"),
    403: ForbiddenError(
        "a web page of http://other.example may not call this service: add its origin to JOULEMAP_CORS_ORIGINS",
        origin="http://other.example",
        allowed=[],
    ),
    404: NotFoundError("there is no cost map 'cm-0d4b8f6a2c17'", costmap_id="cm-0d4b8f6a2c17"),
    409: ConflictError(
        "cost map cm-0d4b8f6a2c17 is running (40%): ask again when it is done",
        status="running",
        progress=0.4,
        retry_after_s=2,
    ),
    413: TooLargeError(
        "the request's body is larger than the limit of 8 MB", declared_bytes=9_000_000, limit_bytes=8_000_000
    ),
    429: RateError("key survey-team sends more than 300 requests per second", limit_per_s=300.0, retry_after_s=0.01),
    500: RuntimeError(),
    503: BusyError(
        "the queue is full: cost maps that wait or run: 32, limit: 32", waiting=32, limit=32, retry_after_s=10
    ),
    507: StorageFullError(
        "key survey-team keeps 99 GB, and this takes up to 2 GB more; the limit is 100 GB",
        kept_bytes=99_000_000_000,
        more_bytes=2_000_000_000,
        limit_bytes=100_000_000_000,
    ),
}
_OTHERS: dict[int, tuple[str, str, str, dict[str, Any]]] = {
    400: ("bad_request", "Bad Request", "POST /v1/heightmaps: There was an error parsing the body", {}),
    415: (
        "unsupported_media_type",
        "Unsupported Media Type",
        "POST /v1/costmaps: send application/json, or multipart/form-data with the heightmap as `file`",
        {},
    ),
    422: (
        "invalid_request",
        "The request is not valid",
        "spacing_m: Input should be greater than or equal to 0.01, got 0",
        {
            "errors": [
                {"field": "spacing_m", "message": "Input should be greater than or equal to 0.01, got 0", "value": 0}
            ]
        },
    ),
}
