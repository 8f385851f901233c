"""Large bodies of JSON are parsed and checked on a thread, in slices: no call holds the event loop up for long."""

from __future__ import annotations

import json
import re
import secrets
from collections.abc import Callable, Coroutine
from typing import Any

from anyio.to_thread import run_sync
from fastapi import HTTPException, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from pydantic_core import from_json

_LARGE_BYTES = 100_000
_SLICE_BYTES = 150_000  # 2 ms; the parser lets no other thread run meanwhile
_NUMBERS = b"0123456789+-.eE,[] \t\r\n"
_PLACE = re.compile(r"(.*) at line (\d+) column (\d+)")
_MOST_ERRORS = 100

Check = Callable[..., tuple[Any, list[Any]]]


class QuickJsonRoute(APIRoute):
    """A route that takes large bodies of JSON."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return what answers a request.

        Result: FastAPI's own, to which a large body comes as the model that it is to be, which it does not check again.
        """
        handler = super().get_route_handler()
        check: Check | None = self.body_field.validate if self.body_field is not None else None

        async def _handle(request: Request) -> Response:
            try:
                return await handler(_QuickRequest(request.scope, request.receive, check))
            except _Refused as refused:
                raise RequestValidationError(refused.errors) from None

        return _handle


class _Refused(HTTPException):  # the only kind of error that FastAPI lets pass here
    """What is wrong with a large body."""

    def __init__(self, errors: list[Any]) -> None:
        super().__init__(422)
        self.errors = errors


class _QuickRequest(Request):
    def __init__(self, scope: Any, receive: Any, check: Check | None) -> None:
        super().__init__(scope, receive)
        self._check = check

    async def json(self) -> Any:
        body = await self.body()
        if len(body) <= _LARGE_BYTES:
            return _told_if_wrong(body)
        return await run_sync(_understood, body, self._check)


def _told_if_wrong(body: bytes) -> Any:
    try:
        return parsed(body)
    except ValueError as error:
        raise _told(str(error), body) from None


def _understood(body: bytes, check: Check | None) -> Any:
    value = _told_if_wrong(body)
    if check is None:
        return value
    model, errors = check(value, loc=("body",))
    if errors:
        raise _Refused(errors[:_MOST_ERRORS])
    return model


def parsed(body: bytes) -> Any:
    """Return what a body of JSON says. Result: dictionaries, lists, texts and numbers."""
    if len(body) <= _LARGE_BYTES:
        return from_json(body)
    begin, end = body.find(b"[["), body.find(b"]]")
    inner = body[begin + 1 : end + 1]
    if not 0 <= begin < end or len(inner) < 2 * _SLICE_BYTES or inner.translate(None, _NUMBERS):
        return from_json(body)
    token = secrets.token_hex(16)
    try:
        rest = from_json(b'%b"%b"%b' % (body[:begin], token.encode(), body[end + 2 :]))
        name = next(name for name, value in rest.items() if value == token)
        rest[name] = _in_slices(inner)
    except (ValueError, AttributeError, StopIteration):  # the whole of it says what is wrong, and where
        return from_json(body)
    return rest


def _in_slices(inner: bytes) -> list[Any]:
    """The lists of numbers of a text: a slice that is JSON by itself begins and ends between two of them."""
    found: list[Any] = []
    at = 0
    while at < len(inner):
        cut = inner.find(b"],", at + _SLICE_BYTES) + 1 or len(inner)
        found += from_json(b"[%b]" % inner[at:cut])
        at = cut + 1
    return found


def _told(words: str, body: bytes) -> json.JSONDecodeError:
    """An error of the parser as one of Python's, with the character."""
    match = _PLACE.fullmatch(words)
    if match is None:
        return json.JSONDecodeError(words, "", 0)
    reason, line, column = match[1], int(match[2]), int(match[3])
    at = 0
    for _ in range(line - 1):
        at = body.index(b"\n", at) + 1
    place = at + column - (not reason.startswith("EOF"))
    return json.JSONDecodeError(reason, "", len(body[:place].decode(errors="replace")))
