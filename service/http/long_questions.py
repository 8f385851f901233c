"""A question that may take long: it ends when nobody waits for the answer any more, and says how far it is."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import AsyncIterator, Callable

import anyio.to_thread
from fastapi import Request, Response

from joulemap.model.errors import JoulemapError
from joulemap.service import problems

EVENTS = "text/event-stream"
_LOOK_S = 0.25
_CLOSED = 499  # as nginx logs a request whose client closed the connection; nobody reads it

Work = Callable[[Callable[[float], None]], Response]
"""Answers, and calls its argument with the share that is done, 0..1."""


class _Gone(Exception):
    """The connection was closed."""


async def until_gone(request: Request, work: Work) -> Response:
    """Return the answer of some work on another thread, which ends early when the connection is closed.

    Parameters
    ----------
    request : Request
        Whose connection counts.
    work : callable
        The work.

    Returns
    -------
    Response
        Its answer.
    """
    gone = threading.Event()

    async def _watch() -> None:
        while not await request.is_disconnected():
            await asyncio.sleep(_LOOK_S)
        gone.set()

    def _report(_share: float) -> None:
        if gone.is_set():
            raise _Gone

    watcher = asyncio.create_task(_watch())
    try:
        return await anyio.to_thread.run_sync(work, _report)
    except _Gone:
        return Response(status_code=_CLOSED)
    finally:
        watcher.cancel()


async def events(work: Work) -> AsyncIterator[str]:
    """Yield server-sent events: `progress` with the share that is done, then `answer`, or `problem` as of RFC 9457.

    Parameters
    ----------
    work : callable
        The work; it ends when the generator is closed.

    Yields
    ------
    str
        An event.
    """
    gone, share = threading.Event(), 0.0

    def _report(done: float) -> None:
        nonlocal share
        share = done
        if gone.is_set():
            raise _Gone

    task = asyncio.create_task(anyio.to_thread.run_sync(work, _report))
    try:
        while not task.done():
            yield f"event: progress\ndata: {json.dumps(round(share, 3))}\n\n"
            await asyncio.wait([task], timeout=_LOOK_S)
        try:
            name, body = "answer", bytes(task.result().body).decode()
        except JoulemapError as error:
            name, body = "problem", json.dumps(problems.problem_of(error))
        yield f"event: {name}\ndata: {body}\n\n"
    finally:
        gone.set()
