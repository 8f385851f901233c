"""ASGI middleware that sees every request: its id, how long it took, a line in the log, and the metrics."""

from __future__ import annotations

import asyncio
import random
import re
import time

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from joulemap.model.errors import BusyError
from joulemap.service.http.logs import ACCESS, REQUEST_ID
from joulemap.service.http.metrics import Metrics
from joulemap.service.http.middleware import Middleware, refuse

_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_METHODS = {"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"}
_QUIET = {"/healthz", "/readyz", "/metrics"}
_BACK_S = 10.0  # until a service that was stopped answers again
_NO_ANSWER = 499  # as nginx logs a request whose client closed the connection


class Observed(Middleware):
    """Gives each request an id, that of its header X-Request-ID where it has a good one; counts it and logs it."""

    def __init__(self, app: ASGIApp, *, metrics: Metrics) -> None:
        super().__init__(app)
        self._metrics = metrics

    async def request(self, scope: Scope, receive: Receive, send: Send) -> None:
        given = dict(scope["headers"]).get(b"x-request-id", b"").decode("latin-1")
        request_id = given if _ID.fullmatch(given) else f"{random.getrandbits(64):016x}"
        scope.setdefault("state", {})["request_id"] = request_id
        began, status, size = time.perf_counter(), _NO_ANSWER, 0

        async def _counted(message: Message) -> None:
            nonlocal status, size
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)["X-Request-ID"] = request_id
            size += len(message.get("body", b""))
            await send(message)

        token = REQUEST_ID.set(request_id)
        try:
            await self._app(scope, receive, _counted)
        except asyncio.CancelledError:  # by the server, which stops
            if status == _NO_ANSWER:
                stops = BusyError("the service stops: ask again when it is back", retry_after_s=_BACK_S)
                await refuse(stops, scope, receive, _counted)
        finally:
            self._saw(scope, status, size, time.perf_counter() - began)
            REQUEST_ID.reset(token)

    def _saw(self, scope: Scope, status: int, size: int, seconds: float) -> None:
        route = _template(scope)
        method = scope["method"] if scope["method"] in _METHODS else "other"
        self._metrics.saw_request(method, route, status, seconds)
        if route in _QUIET and status < 400:
            return
        fields = {
            "method": method,
            "path": scope["path"][:200],
            "route": route,
            "status": status,
            "seconds": round(seconds, 4),
            "bytes": size,
            "client": (scope.get("client") or ("-",))[0],
        }
        ACCESS.info("%s %s %d %.3f s", method, fields["path"], status, seconds, extra={"fields": fields})


def _template(scope: Scope) -> str:
    """The path of a route with the names of its parameters, so that there are few of them."""
    path = getattr(scope.get("route"), "path", None)
    if path is None:
        return "unmatched"
    inside, whole = path.split("/")[1:], scope["path"].split("/")
    return "/".join([*whole[: len(whole) - len(inside)], *inside])  # the router's own prefix may not be in the route
