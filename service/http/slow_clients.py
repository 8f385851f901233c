"""ASGI middleware for slow clients: how long a body may take, how long an answer may wait, how a refusal is read.

Connections that never become a request, and headers that come by the byte, are the matter of a proxy, such as that of
docker/nginx.conf.
"""

from __future__ import annotations

import resource
import time

import anyio
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from joulemap.service.http.middleware import Middleware

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
