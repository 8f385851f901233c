"""The parts of the OpenAPI document that FastAPI cannot derive from a signature: problems and bodies with files."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from joulemap.model.terrain.formats import formats_in_words
from joulemap.service.problems import MEDIA_TYPE
from joulemap.service.schemas.base import Problem
from joulemap.service.schemas.maps import CostmapOptions, CostmapRequest, UploadOptions

_REF = "#/components/schemas/{model}"
_FILE = {"type": "string", "format": "binary", "contentMediaType": "application/octet-stream"}
_HEIGHTMAP = f"the heightmap: {formats_in_words()}"


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the `responses` of a route that can answer with problems.

    Parameters
    ----------
    *statuses : int
        HTTP statuses of its own; 400, 413, 422 and 500 are always possible.

    Returns
    -------
    dict
        Problem schema by status.
    """
    content = {MEDIA_TYPE: {"schema": {"$ref": _REF.format(model="Problem")}}}
    return {
        status: {"description": HTTPStatus(status).phrase, "content": content}
        for status in sorted({*statuses, 400, 413, 422, 500})
    }


def upload_body() -> dict[str, Any]:
    """Return the `openapi_extra` of the heightmap upload: a form with a file, or the file itself."""
    heightmap = {**_FILE, "description": _HEIGHTMAP}
    fields = UploadOptions.model_json_schema()["properties"]
    return _form_or_file({"file": heightmap, **fields}, {"application/octet-stream": _FILE, "image/tiff": _FILE})


def runs_body() -> dict[str, Any]:
    """Return the `openapi_extra` of the upload of runs: a form with a file for each, or one file itself."""
    run = {**_FILE, "description": "a measured run: CSV or Parquet"}
    files = {"type": "array", "items": run, "minItems": 1}
    return _form_or_file({"file": files}, {"text/csv": {"type": "string"}, "application/octet-stream": _FILE})


def _form_or_file(fields: dict[str, Any], raw: dict[str, Any]) -> dict[str, Any]:
    form = {"type": "object", "properties": fields, "required": ["file"], "additionalProperties": False}
    content = {"multipart/form-data": form, **raw}
    return {"requestBody": {"required": True, "content": {kind: {"schema": body} for kind, body in content.items()}}}


def costmap_body() -> dict[str, Any]:
    """Return the `openapi_extra` of the cost map request: JSON with a heightmap's id, or a form with the heightmap."""
    fields = UploadOptions.model_json_schema()["properties"]
    options = {"type": "string", "description": "CostmapOptions as JSON", "contentMediaType": "application/json"}
    form = {
        "type": "object",
        "properties": {"file": {**_FILE, "description": _HEIGHTMAP}, "options": options, **fields},
        "required": ["file"],
        "additionalProperties": False,
    }
    return {
        "requestBody": {
            "required": True,
            "content": {
                "application/json": {"schema": {"$ref": _REF.format(model="CostmapRequest")}},
                "multipart/form-data": {"schema": form},
            },
        }
    }


def install(app: FastAPI) -> None:
    """Add to an app's document the schemas that only problems and hand-written bodies refer to.

    Parameters
    ----------
    app : FastAPI
        Its method `openapi` is replaced.
    """

    def _openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
            schemas = document["components"]["schemas"]
            for model in (Problem, CostmapRequest, CostmapOptions):
                schema = model.model_json_schema(ref_template=_REF)
                schemas.update(schema.pop("$defs", {}))
                schemas[model.__name__] = schema
            document["components"]["schemas"] = dict(sorted(schemas.items()))
            app.openapi_schema = document
        return app.openapi_schema

    app.openapi = _openapi  # type: ignore[method-assign]
