"""Errors as HTTP answers: every exception of the app becomes a problem body."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from sqlalchemy.exc import OperationalError
from sqlalchemy.exc import TimeoutError as SQLAlchemyTimeout
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import compile_path

from joulemap.model.errors import BusyError, DamagedError, JoulemapError, StorageFullError
from joulemap.service.problems import MEDIA_TYPE, findings, from_outside, problem, problem_of

_LOG = logging.getLogger("joulemap.service")
_CLOSED = 499  # as nginx logs a request whose client closed the connection; nobody reads it


class WhileReading(HTTPException):
    """An error of the tree, raised where FastAPI reads a body: it lets no other kind pass."""

    def __init__(self, error: JoulemapError) -> None:
        super().__init__(500)
        self.error = error


def response(body: Mapping[str, Any], headers: Mapping[str, str] | None = None) -> JSONResponse:
    """Return a problem as an HTTP response. Result: with ``Retry-After`` where the context has ``retry_after_s``."""
    extra = dict(headers or {})
    retry = body["context"].get("retry_after_s")
    if retry is not None:
        extra["Retry-After"] = str(max(1, math.ceil(retry)))
    if body["request_id"]:
        extra["X-Request-ID"] = body["request_id"]
    return JSONResponse(dict(body), status_code=body["status"], headers=extra, media_type=MEDIA_TYPE)


def request_id(request: Request) -> str | None:
    """Return the id that `joulemap.service.http.observed` gave the request.

    Result: None where the middleware is not installed.
    """
    return request.scope.get("state", {}).get("request_id")


def _allowed(paths: Mapping[str, Mapping[str, Any]], path: str) -> dict[str, str]:
    """The header `Allow` with all methods of a path; a route knows its own alone."""
    known = (methods for template, methods in paths.items() if compile_path(template)[0].match(path))
    methods = next(known, None)
    return {} if methods is None else {"Allow": ", ".join(sorted(map(str.upper, methods)))}


def install(app: FastAPI) -> None:
    """Answer every error of an app with a problem body."""

    @app.exception_handler(JoulemapError)
    async def _tree(request: Request, error: JoulemapError) -> JSONResponse:
        body = problem_of(error, request_id(request))
        if isinstance(error, StorageFullError | DamagedError):
            _LOG.warning("request %s: %s", request_id(request), error)
        elif body["status"] >= 500 and not isinstance(error, BusyError):
            _LOG.error("request %s failed", request_id(request), exc_info=error)
        return response(body)

    @app.exception_handler(RequestValidationError)
    async def _invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        detail, found = findings(error.errors())
        return response(
            problem(422, "invalid_request", "The request is not valid", detail, request_id(request), {"errors": found})
        )

    @app.exception_handler(HTTPException)
    async def _http(request: Request, error: HTTPException) -> JSONResponse:
        if isinstance(error, WhileReading):
            return response(problem_of(error.error, request_id(request)))
        title = HTTPStatus(error.status_code).phrase
        code = re.sub(r"[^a-z]+", "_", title.lower())
        detail = f"{request.method} {request.url.path[:200]}: {error.detail}"
        headers = dict(error.headers or {})
        if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
            headers |= _allowed(app.openapi()["paths"], request.url.path)
        return response(problem(error.status_code, code, title, detail, request_id(request)), headers)

    @app.exception_handler(ClientDisconnect)
    async def _gone(request: Request, error: ClientDisconnect) -> Response:
        return Response(status_code=_CLOSED)

    @app.exception_handler(OperationalError)
    @app.exception_handler(SQLAlchemyTimeout)
    @app.exception_handler(OSError)
    async def _from_outside(request: Request, error: Exception) -> JSONResponse:
        ours = from_outside(error) is None
        _LOG.error("request %s failed: %s", request_id(request), error, exc_info=error if ours else None)
        return response(problem_of(error, request_id(request)))

    @app.exception_handler(Exception)
    async def _bug(request: Request, error: Exception) -> JSONResponse:
        _LOG.error("request %s failed", request_id(request), exc_info=error)
        return response(problem_of(error, request_id(request)))
