"""ASGI middleware: what all have in common, which answer why they refuse; limits of bodies, and of slow clients.

Connections that never become a request, and headers that come by the byte, are the matter of a proxy, such as that of
docker/nginx.conf.
"""

from __future__ import annotations

import resource
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType

import anyio
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from joulemap.model.errors import JoulemapError, TooLargeError, UnauthorizedError
from joulemap.service.http.problem_answers import WhileReading, response
from joulemap.service.problems import problem_of


class Middleware(ABC):
    """ASGI middleware for requests of HTTP; what else comes passes by."""

    refusal_headers: Mapping[str, str] = MappingProxyType({})

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            await self.request(scope, receive, send)
        except JoulemapError as error:  # of a middleware: the app itself answers its own
            await refuse(error, scope, receive, send, self.refusal_headers)

    @abstractmethod
    async def request(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the app answer a request. Raises JoulemapError where it is refused."""


async def refuse(
    error: JoulemapError, scope: Scope, receive: Receive, send: Send, headers: Mapping[str, str] = MappingProxyType({})
) -> None:
    """Answer a request with the problem of an error."""
    if isinstance(error, UnauthorizedError):
        headers = {**headers, "WWW-Authenticate": "Bearer"}
    await response(problem_of(error, scope.get("state", {}).get("request_id")), headers)(scope, receive, send)


_MOST = {  # the largest question is a path of 100,000 points of up to three numbers, or 5,000 polygons of layers
    b":": (60_000, "names of fields"),
    b"[": (110_000, "lists"),
    b"{": (20_000, "objects"),
    b",": (500_000, "values"),
}
"""Most of each mark in a body of JSON, and what it stands for. They are counted before the body is parsed, because
parsing holds the event loop up.
"""


class RequestLimits(Middleware):
    """Limits for bodies.

    A declared Content-Length above the limit is refused before a byte of the body is read. A body of undeclared length
    is counted while it streams, and so are the lists, objects, names and values of a body of JSON.
    """

    def __init__(self, app: ASGIApp, *, upload_bytes: int, other_bytes: int, upload_paths: tuple[str, ...]) -> None:
        super().__init__(app)
        self._upload_bytes = upload_bytes
        self._other_bytes = other_bytes
        self._upload_paths = upload_paths

    async def request(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = dict(scope["headers"])
        limit = self._limit(scope, headers)
        declared = headers.get(b"content-length", b"")
        if declared.isdigit() and int(declared[:20]) > limit:
            raise TooLargeError(_words(limit), declared_bytes=int(declared[:20]), limit_bytes=limit)
        received = 0
        marks = dict.fromkeys(_MOST, 0) if b"json" in headers.get(b"content-type", b"").lower() else {}

        async def counted() -> Message:
            nonlocal received
            message = await receive()
            if message["type"] == "http.request":
                body = message.get("body", b"")
                received += len(body)
                if received > limit:
                    raise WhileReading(TooLargeError(_words(limit), received_bytes=received, limit_bytes=limit))
                for mark in marks:
                    marks[mark] += body.count(mark)
                    if marks[mark] > _MOST[mark][0]:
                        most, what = _MOST[mark]
                        words = f"the request's body has more than {most:,} {what}"
                        raise WhileReading(TooLargeError(words, found=marks[mark], limit=most))
            return message

        await self._app(scope, counted, send)

    def _limit(self, scope: Scope, headers: dict[bytes, bytes]) -> int:
        upload = scope["method"] == "POST" and scope["path"] in self._upload_paths
        is_json = headers.get(b"content-type", b"").split(b";")[0].strip().lower() == b"application/json"
        return self._upload_bytes if upload and not is_json else self._other_bytes


def _words(limit: int) -> str:
    return f"the request's body is larger than the limit of {limit / 1e6:g} MB"


SILENT_S = 20.0
"""Longest time for each `PROGRESS_BYTES` of a body [s], without that which the service itself takes."""
PROGRESS_BYTES = 16_384
_DRAIN_S = 2.0
"""How long the rest of a body is read after an answer, before the connection is closed [s]. Bytes that nobody reads are
answered with a reset, and the client would lose the answer with it. Nginx has the same (`lingering_close`)."""
_FILES_FOR_OTHERS = 256  # maps, logs, the database, pipes of the workers
FILES_EACH = 3
"""Open files for each connection that is answered: it, the file that is sent over it, and one that waits."""


class SlowClients(Middleware):
    """Ends requests whose body does not come, and answers that nobody takes."""

    def __init__(self, app: ASGIApp, *, stalled_s: float, silent_s: float = SILENT_S) -> None:
        super().__init__(app)
        self._stalled_s, self._silent_s = stalled_s, silent_s

    async def request(self, scope: Scope, receive: Receive, send: Send) -> None:
        whole, waited_s, received = False, 0.0, 0
        closes = scope["http_version"] == "1.0" or (b"connection", b"close") in scope["headers"]

        async def _receive() -> Message:
            nonlocal whole, waited_s, received
            if whole:
                return await receive()
            began, most_s = time.monotonic(), self._silent_s * (1 + received // PROGRESS_BYTES)
            with anyio.move_on_after(most_s - waited_s) as waiting:
                message = await receive()
            if waiting.cancelled_caught:
                words = f"the rest of the request did not arrive within {self._silent_s:g} s"
                raise HTTPException(408, words, {"Connection": "close"})
            waited_s += time.monotonic() - began
            received += len(message.get("body", b""))
            whole = not message.get("more_body", False)
            return message

        async def _send(message: Message) -> None:
            nonlocal closes
            closes = closes or (b"connection", b"close") in message.get("headers", [])
            last = message["type"] == "http.response.body" and not message.get("more_body", False)
            drained = last and closes and not whole
            with anyio.move_on_after(self._stalled_s) as taking:
                await send({**message, "more_body": True} if drained else message)
            if taking.cancelled_caught:
                answering.cancel()
            if drained:
                with anyio.move_on_after(_DRAIN_S):
                    while (await receive()).get("more_body", False):
                        pass
                await send({"type": "http.response.body"})

        with anyio.CancelScope() as answering:
            await self._app(scope, _receive, _send)


def most_connections(wanted: int) -> int:
    """Return how many connections there may be, after letting this process open as many files as the system permits."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = _FILES_FOR_OTHERS + FILES_EACH * wanted
    if soft != resource.RLIM_INFINITY and soft < needed:
        soft = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    return wanted if soft == resource.RLIM_INFINITY else max(8, min(wanted, (soft - _FILES_FOR_OTHERS) // FILES_EACH))
