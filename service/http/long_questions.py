"""A question that may take long: it ends when nobody waits for the answer any more, and says how far it is."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from typing import Any, TypeVar

from fastapi import Request, Response
from sse_starlette import ServerSentEvent
from starlette.requests import ClientDisconnect

from joulemap.model.errors import JoulemapError
from joulemap.service import problems

EVENTS = "text/event-stream"
_LOOK_S = 0.25
_CLOSED = 499  # as nginx logs a request whose client closed the connection; nobody reads it

Result = TypeVar("Result")
Report = Callable[[float], None]
"""Is told the share that is done, 0..1."""


async def while_connected(request: Request, answer: Coroutine[Any, Any, Response]) -> Response:
    """Return an answer, or cancel it when the connection is closed before it is there."""
    try:
        return await unless_gone(request, answer)
    except ClientDisconnect:
        return Response(status_code=_CLOSED)


async def unless_gone(request: Request, work: Coroutine[Any, Any, Result]) -> Result:
    """Return the result of some work, or cancel it when the connection is closed before it is there."""
    task, gone = asyncio.create_task(work), asyncio.create_task(_gone(request))
    try:
        await asyncio.wait({task, gone}, return_when=asyncio.FIRST_COMPLETED)
        if not task.done():
            raise ClientDisconnect
        return task.result()
    finally:
        gone.cancel()
        task.cancel()
        await asyncio.wait({task})


async def _gone(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


async def events(work: Callable[[Report], Awaitable[Response]]) -> AsyncIterator[ServerSentEvent]:
    """Yield server-sent events: `progress` with the share that is done, then `answer`, or `problem` as of RFC 9457."""
    share = 0.0

    def _report(done: float) -> None:
        nonlocal share
        share = done

    task = asyncio.ensure_future(work(_report))
    try:
        while not task.done():
            yield ServerSentEvent(json.dumps(round(share, 3)), event="progress")
            await asyncio.wait([task], timeout=_LOOK_S)
        try:
            name, body = "answer", bytes(task.result().body).decode()
        except JoulemapError as error:
            name, body = "problem", json.dumps(problems.problem_of(error))
        yield ServerSentEvent(body, event=name)
    finally:
        task.cancel()
