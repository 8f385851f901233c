"""What each middleware has in common: it looks at requests of HTTP alone, and answers why it refuses one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType

from starlette.types import ASGIApp, Receive, Scope, Send

from joulemap.model.errors import JoulemapError, UnauthorizedError
from joulemap.service.http.problem_answers import response
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
