"""Who may ask, and how often: hosts and web pages, connections and event streams at a time, keys. Probes always may."""

from __future__ import annotations

import ipaddress
import logging
import re
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from types import MappingProxyType

import anyio
from sqlalchemy.exc import SQLAlchemyError
from sse_starlette import EventSourceResponse
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from joulemap.model.errors import BusyError, ForbiddenError, RateError, UnauthorizedError
from joulemap.service.hosting.settings import Settings
from joulemap.service.http.middleware import Middleware
from joulemap.service.problems import no_database
from joulemap.service.storage.owners import NOBODY, Caller, all_keys, fits, prefix_of
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import KeyRow

HEALTH_PATHS = ("/healthz", "/readyz")
"""Probes call these by any address; they tell nothing about what is kept."""

_HOST = re.compile(r"(?:\[([0-9a-f:.]+)\]|([a-z0-9._-]+))(?::[0-9]{1,5})?", re.IGNORECASE)
_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_WILDCARDS = ("", "0.0.0.0", "::")
_SAME = ("same-origin", "none")  # `none`: the user typed the address


class TrustedPages(Middleware):
    """Answers 403 to a request whose `Host` is not allowed, and to one that a page of another origin sends.

    The check of `Host` stops DNS rebinding: a foreign page whose name suddenly leads to this machine. The check of
    `Origin` and `Sec-Fetch-Site` stops a foreign page that sends forms or loads pictures, which browsers allow.
    Programs send neither header.
    """

    def __init__(
        self, app: ASGIApp, *, host: str, allowed_hosts: Collection[str], cors_origins: Collection[str]
    ) -> None:
        super().__init__(app)
        listens = () if host in _WILDCARDS else (host.lower(),)
        self._hosts = {name.strip("[]") for name in (*_LOOPBACK, *listens, *allowed_hosts)}
        self._origins = set(cors_origins)

    async def request(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"] not in HEALTH_PATHS:
            self._check(scope, Headers(scope=scope))
        await self._app(scope, receive, send)

    def _check(self, scope: Scope, headers: Headers) -> None:
        host = ", ".join(headers.getlist("host"))
        name = _name_of(host)
        if "*" not in self._hosts and name not in self._hosts:
            known = ", ".join(sorted(self._hosts))
            raise ForbiddenError(
                f"this service is not called {(name or host)[:100]!r}: call it by one of {known}, or add the name to "
                "JOULEMAP_ALLOWED_HOSTS",
                host=host[:100],
                allowed=sorted(self._hosts),
            )
        origin = headers.get("origin")
        if origin is not None:
            foreign = origin.lower() not in self._origins and origin.lower().partition("://")[2] != host.lower()
        else:
            foreign = headers.get("sec-fetch-site", "none") not in _SAME and not _is_link(scope, headers)
        if foreign:
            raise ForbiddenError(
                f"a web page of {(origin or 'another origin')[:100]} may not call this service: add its origin to "
                "JOULEMAP_CORS_ORIGINS",
                origin=(origin or "")[:100],
                allowed=sorted(self._origins),
            )


def _name_of(host: str) -> str | None:
    """The name in a header `Host`, without port and brackets, in lower case; None where it is no host."""
    found = _HOST.fullmatch(host)
    return found and (found[1] or found[2]).lower()


def _is_link(scope: Scope, headers: Headers) -> bool:
    """Whether the user follows a link, which shows the answer as a page and tells the foreign page nothing."""
    return (
        scope["method"] in ("GET", "HEAD")
        and headers.get("sec-fetch-mode") == "navigate"
        and headers.get("sec-fetch-dest") == "document"
    )


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


BURST_S = 10.0
"""A caller that was quiet may send so many seconds' worth of requests at once."""


class Buckets:
    """Token buckets by name; one that is full again is forgotten when another one is made.

    `clock`: returns a time that only grows [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._buckets: dict[str, tuple[float, float]] = {}  # name -> tokens at a time

    def take(self, name: str, per_s: float) -> None:
        """Take one token, from the thread of the event loop."""
        now, most = self._clock(), max(1.0, per_s * BURST_S)
        tokens, since = self._buckets.get(name, (most, now))
        tokens = min(most, tokens + (now - since) * per_s)
        if tokens < 1.0:
            self._buckets[name] = tokens, now
            raise RateError(
                f"key {name} sends more than {per_s:g} requests per second: wait as long as Retry-After says",
                limit_per_s=per_s,
                retry_after_s=(1.0 - tokens) / per_s,
            )
        self._buckets[name] = tokens - 1.0, now


KNOWN_S = 2.0
"""So long a key that was revoked is still accepted [s]."""

_AGAIN_S = 0.2  # between looks at the database because of keys that are not known
_OPEN_PATHS = {"/", "/docs", "/openapi.json", *HEALTH_PATHS}  # the same for everybody
_OPEN_FOLDERS = ("/docs/static/", "/page/")
_OPERATOR_PATHS = {"/metrics"}
_LOG = logging.getLogger("joulemap.service")


class Keys:
    """The keys of a service, read from its database again and again. `clock`: returns a time that only grows [s]."""

    def __init__(self, store: Store, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        self._store, self._settings, self._clock = store, settings, clock
        self._rows: dict[str, KeyRow] = {}
        self._read_at = self._failed_at = -float("inf")
        self._thread = anyio.CapacityLimiter(1)  # of its own: a look waits for no upload and no plan
        self._lock = anyio.Lock()

    async def caller(self, headers: Headers) -> Caller:
        """Return on whose behalf a request is. NOBODY while the service has no keys."""
        await self._read(KNOWN_S)
        if not self._rows:
            return NOBODY
        key = _sent_key(headers)
        if key is None:
            raise UnauthorizedError(
                "this service wants a key: send the header `Authorization: Bearer KEY` or `X-API-Key: KEY`"
            )
        prefix = prefix_of(key)
        if prefix is not None and prefix not in self._rows:
            await self._read(_AGAIN_S)  # it may be new
        row = self._rows.get(prefix or "")
        if row is None or not fits(row, key):
            raise UnauthorizedError("this key is not valid: it is wrong, or it was revoked", prefix=prefix)
        return self._caller_of(row)

    async def still_valid(self, headers: Headers, caller: Caller) -> bool:
        """Return whether a request that was let in would be let in now; a database that is away changes nothing."""
        try:
            return await self.caller(headers) == caller
        except UnauthorizedError:
            return False
        except BusyError:
            return True

    async def _read(self, known_s: float) -> None:
        if self._clock() - self._read_at < known_s:
            return
        asked_at = self._clock()
        async with self._lock:
            if self._clock() - self._read_at < known_s:
                return
            if self._failed_at > asked_at:  # for another request meanwhile: each would wait as long, one after another
                raise no_database()
            try:
                rows = await anyio.to_thread.run_sync(all_keys, self._store.sessions, limiter=self._thread)
            except SQLAlchemyError as error:
                self._failed_at = self._clock()
                raise no_database() from error
            self._rows = {row.prefix: row for row in rows}
            self._read_at = self._clock()

    def _caller_of(self, row: KeyRow) -> Caller:
        settings = self._settings
        gb = row.gb if row.gb is not None else settings.key_gb
        return Caller(
            name=row.name,
            sees_all=row.operator,
            jobs=row.jobs if row.jobs is not None else settings.key_jobs,
            kept_bytes=int(gb * 1e9),
            requests_per_s=row.requests_per_s if row.requests_per_s is not None else settings.key_requests_per_s,
        )


class KeyCheck(Middleware):
    """Puts the caller into the request's state; answers 401, 403 or 429 where it may not ask, 503 without database."""

    def __init__(self, app: ASGIApp, *, keys: Keys, answered: AtOnce, away: Callable[[], bool] = lambda: False) -> None:
        super().__init__(app)
        self._keys, self._answered, self._away = keys, answered, away
        self._buckets = Buckets()

    async def request(self, scope: Scope, receive: Receive, send: Send) -> None:
        state = scope.setdefault("state", {})
        state["caller"] = NOBODY
        path = scope["path"]
        with ExitStack() as stack:
            if path not in _OPEN_PATHS and not path.startswith(_OPEN_FOLDERS):
                state["caller"] = await self._caller(scope, stack)
                state["still_valid"] = partial(self._keys.still_valid, Headers(scope=scope), state["caller"])
            await self._app(scope, receive, send)

    async def _caller(self, scope: Scope, stack: ExitStack) -> Caller:
        """On whose behalf a request is, which is counted until the stack is left."""
        path = scope["path"]
        if self._away():
            raise no_database()
        caller = await self._keys.caller(Headers(scope=scope))
        if path in _OPERATOR_PATHS and not caller.sees_all:
            raise ForbiddenError(f"{path} is for keys of an operator: `joulemap keys add NAME --operator`")
        if caller.name is not None and path not in PROBE_PATHS:
            if caller.requests_per_s is not None:
                self._buckets.take(caller.name, caller.requests_per_s)
            stack.enter_context(self._answered.one_of(f"key {caller.name}"))
        return caller


def warn_if_open(store: Store, host: str) -> None:
    """Write a warning where other machines can reach a service without keys."""
    if not _is_loopback(host) and not all_keys(store.sessions):
        _LOG.warning(
            "THIS SERVICE IS OPEN: it listens on %s and has no keys, so everybody who reaches it may read, change and "
            "delete everything. Add a key with `joulemap keys add NAME`, or listen on 127.0.0.1",
            host,
        )


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def _sent_key(headers: Headers) -> str | None:
    scheme, _, value = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        return value.strip()
    return headers.get("x-api-key")
