"""ASGI middleware that completes the header `Allow` of 405: all methods of a path, not those of one of its routes."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from starlette.types import ASGIApp, Message, Receive, Scope, Send

_PARAMETER = re.compile(r"\\{\w+\\}")


class Allowed:
    """Says in 405 which methods a path has."""

    def __init__(self, app: ASGIApp, *, paths: Callable[[], Mapping[str, Mapping[str, Any]]]) -> None:
        self._app, self._paths = app, paths
        self._methods: list[tuple[re.Pattern[str], str]] | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def _completed(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] == 405:
                methods = self._of(scope["path"])
                if methods is not None:
                    kept = [header for header in message["headers"] if header[0].lower() != b"allow"]
                    message = {**message, "headers": [*kept, (b"allow", methods.encode())]}
            await send(message)

        await self._app(scope, receive, _completed)

    def _of(self, path: str) -> str | None:
        if self._methods is None:
            self._methods = [
                (re.compile(_PARAMETER.sub("[^/]+", re.escape(template))), ", ".join(sorted(map(str.upper, methods))))
                for template, methods in self._paths().items()
            ]
        return next((methods for pattern, methods in self._methods if pattern.fullmatch(path)), None)
