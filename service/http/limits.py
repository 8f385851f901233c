"""ASGI middleware for every request: it answers with the request id, and refuses a body above the limit with 413."""

from __future__ import annotations

import json

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from joulemap.model.errors import TooLargeError
from joulemap.service.problems import MEDIA_TYPE, problem_of

_MOST = {  # the largest question is a path of 100,000 points of up to three numbers, or 500 samples of a drive
    b":": (4_100, "names of fields"),
    b"[": (110_000, "lists"),
    b"{": (1_100, "objects"),
    b",": (500_000, "values"),
}
"""Most of each mark in a body of JSON, and what it stands for. They are counted before the body is parsed, because
parsing holds the event loop up.
"""


class RequestLimits:
    """Limits for bodies, and the id that `Observed` gave a request in its answer.

    A declared Content-Length above the limit is refused before a byte of the body is read. A body of undeclared length
    is counted while it streams, and so are the lists, objects, names and values of a body of JSON.
    """

    def __init__(self, app: ASGIApp, *, upload_bytes: int, other_bytes: int, upload_paths: tuple[str, ...]) -> None:
        self._app = app
        self._upload_bytes = upload_bytes
        self._other_bytes = other_bytes
        self._upload_paths = upload_paths

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        request_id = scope["state"]["request_id"]
        limit = self._limit(scope, headers)
        declared = headers.get(b"content-length", b"")
        reply = _Reply(send, request_id)
        if declared.isdigit() and int(declared[:20]) > limit:
            await reply.refuse(TooLargeError(_words(limit), declared_bytes=int(declared[:20]), limit_bytes=limit))
            return
        received = 0
        marks = dict.fromkeys(_MOST, 0) if b"json" in headers.get(b"content-type", b"").lower() else {}

        async def counted() -> Message:
            nonlocal received
            message = await receive()
            if message["type"] == "http.request":
                body = message.get("body", b"")
                received += len(body)
                if received > limit:
                    reply.overrun = TooLargeError(_words(limit), received_bytes=received, limit_bytes=limit)
                    raise reply.overrun
                for mark in marks:
                    marks[mark] += body.count(mark)
                    if marks[mark] > _MOST[mark][0]:
                        most, what = _MOST[mark]
                        words = f"the request's body has more than {most:,} {what}"
                        reply.overrun = TooLargeError(words, found=marks[mark], limit=most)
                        raise reply.overrun
            return message

        await self._app(scope, counted, reply.send)

    def _limit(self, scope: Scope, headers: dict[bytes, bytes]) -> int:
        upload = scope["method"] == "POST" and scope["path"] in self._upload_paths
        is_json = headers.get(b"content-type", b"").split(b";")[0].strip().lower() == b"application/json"
        return self._upload_bytes if upload and not is_json else self._other_bytes


def _words(limit: int) -> str:
    return f"the request's body is larger than the limit of {limit / 1e6:g} MB"


class _Reply:
    """What goes out: adds the request id, and answers 413 to a body that is too large, whatever the app answers."""

    def __init__(self, send: Send, request_id: str) -> None:
        self._send = send
        self._request_id = request_id.encode("latin-1")
        self._replaced = False
        self.overrun: TooLargeError | None = None

    async def send(self, message: Message) -> None:
        if self._replaced:
            return
        if message["type"] == "http.response.start":
            if self.overrun is not None:
                await self.refuse(self.overrun)
                return
            headers = [h for h in message.get("headers", []) if h[0].lower() != b"x-request-id"]
            message = {**message, "headers": [*headers, (b"x-request-id", self._request_id)]}
        await self._send(message)

    async def refuse(self, error: TooLargeError) -> None:
        self._replaced = True
        body = json.dumps(problem_of(error, self._request_id.decode())).encode()
        headers = [
            (b"content-type", MEDIA_TYPE.encode()),
            (b"content-length", str(len(body)).encode()),
            (b"x-request-id", self._request_id),
        ]
        await self._send({"type": "http.response.start", "status": 413, "headers": headers})
        await self._send({"type": "http.response.body", "body": body})
