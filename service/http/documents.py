"""What the OpenAPI document says beyond signatures: problems, bodies with files, which fields go together, and keys."""

from __future__ import annotations

import json
from collections.abc import Mapping
from http import HTTPStatus
from importlib import resources
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

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
from joulemap.model.terrain.formats import formats_in_words
from joulemap.service.problems import MEDIA_TYPE, problem, problem_of
from joulemap.service.questions.costmap import CostmapOptions, CostmapRequest
from joulemap.service.questions.reading import UploadOptions
from joulemap.service.schemas.base import Problem

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


_REF = "#/components/schemas/{model}"
BINARY = {"schema": {"type": "string", "format": "binary"}}
"""The content of an answer that is a file or a picture."""
_FILE = {"type": "string", "format": "binary", "contentMediaType": "application/octet-stream"}


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the `responses` of a route that can answer with problems."""
    content = {MEDIA_TYPE: {"schema": {"$ref": _REF.format(model="Problem")}}}
    return {
        status: {"description": HTTPStatus(status).phrase, "content": content}
        for status in sorted({*statuses, 400, 413, 422, 500})
    }


def upload_body() -> dict[str, Any]:
    """Return the `openapi_extra` of the heightmap upload: a form with a file, or the file itself."""
    return _form_or_file(_heightmap_fields(), {"application/octet-stream": _FILE, "image/tiff": _FILE})


def runs_body() -> dict[str, Any]:
    """Return the `openapi_extra` of the upload of runs: a form with a file for each, or one file itself."""
    run = {**_FILE, "description": "a measured run: CSV, Parquet, MCAP, ROS bag, flight log or FIT"}
    files = {"type": "array", "items": run, "minItems": 1}
    return _form_or_file({"file": files}, {"text/csv": {"type": "string"}, "application/octet-stream": _FILE})


def _heightmap_fields() -> dict[str, Any]:
    heightmap = {**_FILE, "description": f"the heightmap: {formats_in_words()}"}
    return {"file": heightmap, **UploadOptions.model_json_schema()["properties"]}


def _form_or_file(fields: dict[str, Any], raw: dict[str, Any]) -> dict[str, Any]:
    form = {"type": "object", "properties": fields, "required": ["file"], "additionalProperties": False}
    content = {"multipart/form-data": form, **raw}
    return {"requestBody": {"required": True, "content": {kind: {"schema": body} for kind, body in content.items()}}}


def costmap_body() -> dict[str, Any]:
    """Return the `openapi_extra` of the cost map request: JSON with a heightmap's id, or a form with the heightmap."""
    options = {"type": "string", "description": "CostmapOptions as JSON", "contentMediaType": "application/json"}
    body = {"application/json": {"$ref": _REF.format(model="CostmapRequest")}}
    return _form_or_file({"options": options, **_heightmap_fields()}, body)


def install(app: FastAPI) -> None:
    """Add to an app's document the schemas that only problems and hand-written bodies refer to."""

    def _openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
            schemas = document["components"]["schemas"]
            for model in (Problem, CostmapRequest, CostmapOptions):
                schema = model.model_json_schema(ref_template=_REF)
                schemas.update(schema.pop("$defs", {}))
                schemas[model.__name__] = schema
            document["components"]["schemas"] = dict(sorted(schemas.items()))
            document["paths"] = dict(sorted(document["paths"].items()))
            _complete(document)
            app.openapi_schema = document
        return app.openapi_schema

    app.openapi = _openapi  # type: ignore[method-assign]


def _complete(document: dict[str, Any]) -> None:
    """Add what is the same for all operations, which fields go together, and an example of everything."""
    document["components"]["securitySchemes"] = SECURITY_SCHEMES
    for name, condition in CONDITIONS.items():
        document["components"]["schemas"][name] |= condition
    examples = recorded_examples()
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            if path not in OPEN_PATHS:
                operation["security"] = SECURITY
            responses = operation["responses"]
            for status in statuses_of(method, path) - {int(known) for known in responses}:
                responses[str(status)] = problems(status)[status]
            operation["responses"] = {status: _answer(int(status), responses[status]) for status in sorted(responses)}
            for parameter in operation.get("parameters", []):
                _say_together(operation["operationId"], parameter)
            _add_examples(operation, examples.get(operation["operationId"], {}))


def _answer(status: int, response: dict[str, Any]) -> dict[str, Any]:
    """A response with the example of its problem, and when to ask again."""
    content = response.get("content", {})
    if MEDIA_TYPE not in content:
        return response
    found = {**response, "content": {MEDIA_TYPE: {**content[MEDIA_TYPE], "example": problem_example(status)}}}
    return {**found, "headers": RETRY_AFTER} if status in (429, 503) else found


def _say_together(operation_id: str, parameter: dict[str, Any]) -> None:
    needed = TOGETHER.get((operation_id, parameter["name"]))
    if needed is not None:
        parameter["description"] += "; goes with " + " and ".join(f"`{name}`" for name in needed)
        parameter["x-requires"] = list(needed)


def _add_examples(operation: dict[str, Any], example: Mapping[str, Any]) -> None:
    """Add what was asked and answered once, see `tests/service/record_examples.py`."""
    for parameter in operation.get("parameters", []):
        if parameter["name"] in example.get("parameters", {}):
            parameter["example"] = example["parameters"][parameter["name"]]
    body = operation.get("requestBody", {}).get("content", {}).get("application/json")
    if body is not None and "body" in example:
        body["example"] = example["body"]
    for status, answers in example.get("answers", {}).items():
        for kind, answer in answers.items():
            operation["responses"][status]["content"][kind]["example"] = answer


def recorded_examples() -> dict[str, Any]:
    """Return what was asked and answered once, by operation.

    Result: with ``parameters``, ``body`` and ``answers`` (by status and media type), as far as an operation has them.
    """
    text = resources.files("joulemap.service").joinpath("http", "examples.json").read_text(encoding="utf-8")
    found: dict[str, Any] = json.loads(text)
    return found
