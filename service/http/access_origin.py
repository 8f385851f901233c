"""ASGI middleware against web pages: refuses requests for other hosts, and requests that foreign pages send."""

from __future__ import annotations

import re
from collections.abc import Collection

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from joulemap.model.errors import ForbiddenError
from joulemap.service.http.middleware import Middleware

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
