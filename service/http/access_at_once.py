"""How many connections and event streams one client has at a time, and that a probe is always answered."""

from __future__ import annotations

import ipaddress
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from types import MappingProxyType

import anyio
from sse_starlette import EventSourceResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from joulemap.model.errors import BusyError, RateError
from joulemap.service.http.access_origin import HEALTH_PATHS
from joulemap.service.http.middleware import Middleware

PROBE_PATHS = (*HEALTH_PATHS, "/metrics")
"""They are answered at once and whole, so that they need no limit."""
_RETRY_S = 5.0
_LOOK_S = 2.0  # between looks whether the key of a stream was revoked


class AtOnce:
    """How many of something each client has now."""

    def __init__(self, what: str, most: int, setting: str) -> None:
        self._what, self._most, self._setting = what, most, setting
        self._now: Counter[str] = Counter()

    @contextmanager
    def one_of(self, client: str) -> Iterator[None]:
        """Count one more of a client meanwhile."""
        if self._now[client] >= self._most:
            raise RateError(
                f"{client} has {self._now[client]} {self._what} at a time, and may have {self._most} "
                f"({self._setting}): end one, or wait as long as Retry-After says",
                found=self._now[client],
                limit=self._most,
                retry_after_s=_RETRY_S,
            )
        self._now[client] += 1
        try:
            yield
        finally:
            self._now[client] -= 1
            if not self._now[client]:
                del self._now[client]


class Admission(Middleware):
    """Answers 429 where an address has too many connections that are being answered, and 503 where all have together.

    Probes are always let in.
    """

    refusal_headers = MappingProxyType({"Connection": "close"})

    def __init__(self, app: ASGIApp, *, most: int, each: AtOnce) -> None:
        super().__init__(app)
        self._most, self._each = most, each
        self._answered = 0

    async def request(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"] in PROBE_PATHS:
            await self._app(scope, receive, send)
            return
        with self._each.one_of(address_of(scope)):
            self._check_room()
            self._answered += 1
            try:
                await self._app(scope, receive, send)
            finally:
                self._answered -= 1

    def _check_room(self) -> None:
        if self._answered >= self._most:
            raise BusyError(
                f"{self._answered} connections are being answered, and at most {self._most} may be at a time "
                "(JOULEMAP_MAX_CONNECTIONS)",
                found=self._answered,
                limit=self._most,
                retry_after_s=_RETRY_S,
            )


class EventStream(EventSourceResponse):
    """Server-sent events, as long as the key is valid; 429 where the address or the key has too many such streams."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the events."""
        streams: AtOnce = scope["app"].state.service.streams
        with ExitStack() as stack:
            stack.enter_context(streams.one_of(address_of(scope)))
            if (name := scope["state"]["caller"].name) is not None:
                stack.enter_context(streams.one_of(f"key {name}"))
            async with anyio.create_task_group() as group:
                group.start_soon(_end_when_revoked, scope["state"].get("still_valid"), group.cancel_scope)
                await super().__call__(scope, receive, send)
                group.cancel_scope.cancel()


async def _end_when_revoked(still_valid: Callable[[], Awaitable[bool]] | None, stream: anyio.CancelScope) -> None:
    while still_valid is not None and await still_valid():
        await anyio.sleep(_LOOK_S)
    if still_valid is not None:
        stream.cancel()


def address_of(scope: Scope) -> str:
    """Return the address from which a request comes, in words; that before a proxy which is trusted.

    Result: of an IPv6 address the network of 64 bits, all of which one client usually has.
    """
    address = (scope.get("client") or ("unknown",))[0]
    if ":" in address:
        with suppress(ValueError):  # a trusted proxy may write anything
            address = str(ipaddress.IPv6Network((address, 64), strict=False))
    return f"address {address[:100]}"
