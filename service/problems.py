"""The one table from errors to HTTP statuses and exit codes, and the RFC 9457 problem bodies."""

from __future__ import annotations

import errno
import logging
import math
import re
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from sqlalchemy.exc import OperationalError
from sqlalchemy.exc import TimeoutError as SQLAlchemyTimeout
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from joulemap.model.errors import (
    BusyError,
    ConflictError,
    ForbiddenError,
    InfeasibleError,
    InputError,
    JoulemapError,
    NotFoundError,
    RateError,
    StorageFullError,
    TooLargeError,
    UnauthorizedError,
)

MEDIA_TYPE = "application/problem+json"
INTERNAL_EXIT_CODE = 1
_LOG = logging.getLogger("joulemap.service")
_CLOSED = 499  # as nginx logs a request whose client closed the connection; nobody reads it
_MAX_TEXT = 500
_MAX_ERRORS = 20
_RETRY_S = 5.0  # a database that restarts
_MAX_ITEMS = 200
_BODY, _THE_BODY = "body", "the body "


class Row(NamedTuple):
    """How one branch of the error tree is answered.

    Attributes
    ----------
    status : int
        HTTP status.
    exit_code : int
        Of the command line.
    title : str
        Of the problem body.
    """

    status: int
    exit_code: int
    title: str


TABLE: dict[type[JoulemapError], Row] = {
    InputError: Row(422, 3, "The input cannot be used"),
    InfeasibleError: Row(422, 4, "The question has no answer"),
    NotFoundError: Row(404, 5, "There is no such thing"),
    ConflictError: Row(409, 6, "The request contradicts what is stored"),
    TooLargeError: Row(413, 7, "Too large"),
    BusyError: Row(503, 8, "Come back later"),
    UnauthorizedError: Row(401, 9, "A key is needed"),
    ForbiddenError: Row(403, 10, "Not allowed"),
    RateError: Row(429, 11, "Too many at once"),
    StorageFullError: Row(507, 12, "No room to keep more"),
}
"""By branch of the tree; a leaf is answered as its nearest branch. Exit code 2 means wrong usage of a command."""


def row_of(error: type[JoulemapError]) -> Row | None:
    """Return the row of an error class: that of its nearest ancestor in the table.

    Parameters
    ----------
    error : type
        Class of the error tree.

    Returns
    -------
    Row or None
        None where no ancestor is in the table.
    """
    return next((TABLE[cls] for cls in error.__mro__ if cls in TABLE), None)


def exit_code(error: BaseException) -> int:
    """Return the exit code of a command that ended with an error.

    Parameters
    ----------
    error : BaseException
        Any.

    Returns
    -------
    int
        The table's code; 1 for anything outside the error tree, which is our bug.
    """
    row = row_of(type(error)) if isinstance(error, JoulemapError) else None
    return row.exit_code if row is not None else INTERNAL_EXIT_CODE


def jsonable(value: Any, *, depth: int = 6) -> Any:
    """Return a value as plain JSON.

    Parameters
    ----------
    value : object
        Anything. Numbers that are not finite become text, NumPy values Python values; long texts and lists are cut;
        everything else becomes its ``repr``.
    depth : int, optional
        How many levels of nesting are kept.

    Returns
    -------
    object
        Of the types that ``json.dumps`` takes.
    """
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, str):
        text = value.encode("utf-8", "replace").decode("utf-8")
        return text if len(text) <= _MAX_TEXT else text[:_MAX_TEXT] + "..."
    if depth > 0 and isinstance(value, Mapping):
        first = islice(value.items(), _MAX_ITEMS)
        kept = {str(key)[:_MAX_TEXT]: jsonable(item, depth=depth - 1) for key, item in first}
        return kept | ({"...": f"{len(value)} in all"} if len(value) > _MAX_ITEMS else {})
    if depth > 0 and isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, (bytes, bytearray)):
        items = [jsonable(item, depth=depth - 1) for item in list(value)[:_MAX_ERRORS]]
        return [*items, f"... {len(value)} in all"] if len(value) > _MAX_ERRORS else items
    return repr(value)[:_MAX_TEXT]


def problem(
    status: int, code: str, title: str, detail: str, request_id: str | None, context: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return an RFC 9457 problem body, with the extensions code, request_id and context.

    Parameters
    ----------
    status : int
        HTTP status.
    code : str
        Of the error class; the type is made from it.
    title : str
        The same for all errors of a branch.
    detail : str
        What is wrong this time, in words.
    request_id : str or None
        By which the log can be searched.
    context : mapping, optional
        The offending value and the limit.

    Returns
    -------
    dict
        JSON-able.
    """
    return {
        "type": f"urn:joulemap:problem:{code}",
        "title": title,
        "status": status,
        "detail": jsonable(detail),
        "code": code,
        "request_id": request_id,
        "context": jsonable(dict(context or {})),
    }


def problem_of(error: BaseException, request_id: str | None = None) -> dict[str, Any]:
    """Return the problem body of an exception.

    Parameters
    ----------
    error : BaseException
        Of the error tree, a full disk, or a database that does not answer. Anything else is our bug: the body then
        gives nothing but the request id.
    request_id : str, optional
        By which the log can be searched.

    Returns
    -------
    dict
        JSON-able.
    """
    error = _outside(error) or error
    row = row_of(type(error)) if isinstance(error, JoulemapError) else None
    if row is None or not isinstance(error, JoulemapError):
        detail = "something went wrong inside the service; its log has the details under this request id"
        return problem(500, "internal_error", "Internal error", detail, request_id)
    return problem(row.status, error.code, row.title, error.message, request_id, error.context)


def _outside(error: BaseException) -> JoulemapError | None:
    """What is neither the caller's fault nor ours: a full disk, a database that does not answer."""
    if isinstance(error, SQLAlchemyTimeout):
        return BusyError("the database has more questions than it can answer", retry_after_s=_RETRY_S)
    if isinstance(error, OperationalError):
        if "disk is full" in str(error.orig):
            return StorageFullError("the disk of the database is full: nothing more can be kept")
        return BusyError("the database does not answer", retry_after_s=_RETRY_S)
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return StorageFullError("the disk is full: nothing more can be kept")
    if isinstance(error, OSError) and error.errno == errno.EHOSTUNREACH:
        return BusyError(str(error.strerror), retry_after_s=_RETRY_S)
    return None


def response(body: Mapping[str, Any], headers: Mapping[str, str] | None = None) -> JSONResponse:
    """Return a problem as an HTTP response.

    Parameters
    ----------
    body : mapping
        As `problem` returns it.
    headers : mapping, optional
        Further headers.

    Returns
    -------
    JSONResponse
        With ``Retry-After`` where the context has ``retry_after_s``.
    """
    extra = dict(headers or {})
    retry = body["context"].get("retry_after_s")
    if retry is not None:
        extra["Retry-After"] = str(max(1, math.ceil(retry)))
    if body["request_id"]:
        extra["X-Request-ID"] = body["request_id"]
    return JSONResponse(dict(body), status_code=body["status"], headers=extra, media_type=MEDIA_TYPE)


def request_id(request: Request) -> str | None:
    """Return the id that `joulemap.service.http.limits` gave the request.

    Parameters
    ----------
    request : Request
        The request at hand.

    Returns
    -------
    str or None
        None where the middleware is not installed.
    """
    return request.scope.get("state", {}).get("request_id")


def install(app: FastAPI) -> None:
    """Answer every error of an app with a problem body.

    Parameters
    ----------
    app : FastAPI
        Gets the handlers.
    """

    @app.exception_handler(JoulemapError)
    async def _tree(request: Request, error: JoulemapError) -> JSONResponse:
        body = problem_of(error, request_id(request))
        if body["status"] >= 500 and not isinstance(error, BusyError):
            _LOG.error("request %s failed", request_id(request), exc_info=error)
        return response(body)

    @app.exception_handler(RequestValidationError)
    async def _invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        found = [_field_error(e) for e in error.errors()[:_MAX_ERRORS]]
        named = ("" if e["message"].startswith(_THE_BODY) else f"{e['field']}: " for e in found[:5])
        detail = "; ".join(f"{name}{e['message']}" for name, e in zip(named, found[:5], strict=True))
        return response(
            problem(422, "invalid_request", "The request is not valid", detail, request_id(request), {"errors": found})
        )

    @app.exception_handler(HTTPException)
    async def _http(request: Request, error: HTTPException) -> JSONResponse:
        title = HTTPStatus(error.status_code).phrase
        code = re.sub(r"[^a-z]+", "_", title.lower())
        detail = f"{request.method} {request.url.path[:200]}: {error.detail}"
        return response(problem(error.status_code, code, title, detail, request_id(request)), error.headers)

    @app.exception_handler(ClientDisconnect)
    async def _gone(request: Request, error: ClientDisconnect) -> Response:
        return Response(status_code=_CLOSED)

    @app.exception_handler(OperationalError)
    @app.exception_handler(SQLAlchemyTimeout)
    @app.exception_handler(OSError)
    async def _from_outside(request: Request, error: Exception) -> JSONResponse:
        _LOG.error("request %s failed: %s", request_id(request), error, exc_info=error if not _outside(error) else None)
        return response(problem_of(error, request_id(request)))

    @app.exception_handler(Exception)
    async def _bug(request: Request, error: Exception) -> JSONResponse:
        _LOG.error("request %s failed", request_id(request), exc_info=error)
        return response(problem_of(error, request_id(request)))


def _field_error(error: Mapping[str, Any]) -> dict[str, Any]:
    """One of pydantic's findings: which field, what is wrong with it, and the value that was sent."""
    place = [str(part) for part in error["loc"]] or ["body"]
    if error["type"] == "json_invalid":  # the second part of the place is the character
        reason = str(error.get("ctx", {}).get("error", error["msg"]))
        return {"field": _BODY, "message": f"{_THE_BODY}is no valid JSON: {reason} at character {place[-1]}"}
    if place == [_BODY] and error["type"] in ("model_attributes_type", "model_type", "dict_type"):
        return {"field": _BODY, "message": f"{_THE_BODY}must be a JSON object with Content-Type: application/json"}
    field = ".".join(place[1:] or place)  # the first says where: body, query, path, header, or a form field
    message = str(error["msg"]).removeprefix("Value error, ")
    found = {"field": jsonable(field), "message": jsonable(message)}
    if error["type"] != "missing" and "input" in error:
        found["value"] = jsonable(error["input"], depth=2)
        ours = error["type"] in ("value_error", "unknown_field")  # these words name the value where it matters
        if not ours and isinstance(error["input"], (int, float, str)) and not isinstance(error["input"], bool):
            found["message"] = f"{found['message']}, got {str(jsonable(error['input']))[:60]}"
    return found
