"""The parts of the OpenAPI document that FastAPI cannot derive from a signature: problems and bodies with files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from http import HTTPStatus
from importlib import resources
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from joulemap.model.terrain.formats import formats_in_words
from joulemap.service.http.document_rules import (
    CONDITIONS,
    OPEN_PATHS,
    RETRY_AFTER,
    SECURITY,
    SECURITY_SCHEMES,
    TOGETHER,
    problem_example,
    statuses_of,
)
from joulemap.service.problems import MEDIA_TYPE
from joulemap.service.questions.costmap import CostmapOptions, CostmapRequest
from joulemap.service.questions.reading import UploadOptions
from joulemap.service.schemas.base import Problem

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
