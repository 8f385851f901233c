"""Clients that send slowly, read slowly, or still send when they are refused, over raw sockets."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
import uvicorn
from fastapi import FastAPI, Request, Response
from starlette.types import Receive, Scope, Send

from joulemap.service.http.middleware import PROGRESS_BYTES, RequestLimits, SlowClients, most_connections
from joulemap.service.http.problem_answers import install

SILENT_S, STALLED_S, LIMIT = 1.0, 1.0, 1_000_000
POST = "POST /{path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {size}\r\n{more}\r\n"


ended: dict[str, float] = {}
"""When the latest request of a path ended."""


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    """A server that answers with the size of a body; /late reads it late, /long answers at length."""
    inner = FastAPI()
    install(inner)

    @inner.post("/{path}")
    async def _size(path: str, request: Request) -> Response:
        if path == "late":
            await asyncio.sleep(2.0 * SILENT_S)
        return Response(str(len(await request.body())))

    async def _app(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"] != "/long":
            await inner(scope, receive, send)
            return
        await send({"type": "http.response.start", "status": 200, "headers": []})
        while True:
            await send({"type": "http.response.body", "body": b"a" * 50_000, "more_body": True})

    limited: Any = RequestLimits(_app, upload_bytes=LIMIT, other_bytes=LIMIT, upload_paths=())

    async def _named(scope: Scope, receive: Receive, send: Send) -> None:
        scope.setdefault("state", {})["request_id"] = "1"
        await SlowClients(limited, stalled_s=STALLED_S, silent_s=SILENT_S)(scope, receive, send)
        ended[scope["path"]] = time.monotonic()

    listening = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(_named, lifespan="off", log_level="critical"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    yield listening.getsockname()[1]
    server.should_exit = True
    thread.join(20.0)


def asks(port: int, path: str, size: int, sent: int, more: str = "") -> socket.socket:
    client = socket.create_connection(("127.0.0.1", port), timeout=20.0)
    client.sendall(POST.format(path=path, size=size, more=more).encode() + b"a" * sent)
    return client


def answer(client: socket.socket) -> tuple[int, bytes]:
    """Status and body of all that comes until the connection is closed."""
    found = b"".join(iter(lambda: client.recv(65_536), b""))
    return int(found.split()[1]), found.partition(b"\r\n\r\n")[2]


@pytest.mark.parametrize("more", ["", "Connection: close\r\n"])
def test_who_is_refused_while_sending_reads_why(port: int, more: str) -> None:
    """A client that reads only when all is sent sees 413, and no reset."""
    size = 30_000_000
    with asks(port, "a", size, size, more) as client:
        assert client.recv(12) == b"HTTP/1.1 413"
        if more:
            assert b"too_large" in b"".join(iter(lambda: client.recv(65_536), b""))


def test_a_body_that_does_not_come_is_ended(port: int) -> None:
    began = time.monotonic()
    with asks(port, "a", 1_000, 10) as client:
        for _ in range(4):  # single bytes are no progress
            time.sleep(0.2)
            client.sendall(b"a")
        status, body = answer(client)
    assert (status, json.loads(body)["code"]) == (408, "request_timeout")
    assert time.monotonic() - began >= SILENT_S - 0.1


def test_a_slow_line_and_a_service_that_reads_late_are_no_reason(port: int) -> None:
    with asks(port, "a", 4 * PROGRESS_BYTES, 0, "Connection: close\r\n") as client:
        for _ in range(4):
            time.sleep(0.6 * SILENT_S)
            client.sendall(b"a" * PROGRESS_BYTES)
        assert answer(client) == (200, str(4 * PROGRESS_BYTES).encode())
    with asks(port, "late", 900_000, 900_000, "Connection: close\r\n") as client:
        assert answer(client) == (200, b"900000")


def test_an_answer_that_nobody_takes_is_ended(port: int) -> None:
    began = time.monotonic()
    with asks(port, "long", 0, 0):
        while "/long" not in ended:
            assert time.monotonic() - began < 20.0, "it goes on"
            time.sleep(0.1)
    assert ended["/long"] - began >= STALLED_S


@pytest.mark.parametrize(
    ("soft", "hard", "most", "opened"),
    [(1_024, 524_288, 1_000, 3_256), (1_024, 1_024, 256, 1_024), (256, 256, 8, 256), (-1, -1, 1_000, -1)],
)
def test_there_are_as_many_as_files_may_be_open(
    monkeypatch: pytest.MonkeyPatch, soft: int, hard: int, most: int, opened: int
) -> None:
    limits = [soft, hard]
    monkeypatch.setattr("resource.getrlimit", lambda _which: tuple(limits))
    monkeypatch.setattr("resource.setrlimit", lambda _which, wanted: limits.__setitem__(slice(None), wanted))
    assert most_connections(1_000) == most
    assert limits == [opened, hard]
