"""ASGI middleware for keys: on whose behalf a request is, how many a second; without a valid one it is refused."""

from __future__ import annotations

import ipaddress
import logging
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial

import anyio
from sqlalchemy.exc import SQLAlchemyError
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from joulemap.model.errors import BusyError, ForbiddenError, RateError, UnauthorizedError
from joulemap.service.hosting.settings import Settings
from joulemap.service.http.access_at_once import PROBE_PATHS, AtOnce
from joulemap.service.http.access_origin import HEALTH_PATHS
from joulemap.service.http.middleware import Middleware
from joulemap.service.problems import no_database
from joulemap.service.storage.keys import all_keys, fits, prefix_of
from joulemap.service.storage.owners import NOBODY, Caller
from joulemap.service.storage.store import Store
from joulemap.service.storage.tables import KeyRow

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
