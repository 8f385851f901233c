"""Connections that send too much, too little or nothing, and more of them than there may be."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

import pytest
import uvicorn

from joulemap.service.http.connections import HEADER_BYTES, PROGRESS_BYTES, Connections, most_connections

SILENT_S = 1.5
STALLED_S = 1.0
PIECE, LONG = 50_000, 20_000_000
POST = b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: %d\r\n\r\n"
GET = b"GET / HTTP/1.1\r\nHost: localhost\r\n"


class Running(NamedTuple):
    port: int
    stopped: list[str]
    """Is given a word when the server begins to stop."""

    @contextmanager
    def connected(self, address: str = "127.0.0.1", *, receive_bytes: int | None = None) -> Iterator[socket.socket]:
        with socket.socket() as connection:
            connection.settimeout(20.0)
            if receive_bytes is not None:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
            connection.bind((address, 0))
            connection.connect(("127.0.0.1", self.port))
            yield connection


async def app(scope: Any, receive: Any, send: Any) -> None:
    """Answers with the number of bytes of the body; /slow reads it late, /long answers at length, /no without it."""
    size, more = 0, True
    if scope["path"] == "/long":
        headers = [(b"content-length", str(LONG).encode())]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        for _ in range(LONG // PIECE):
            await send({"type": "http.response.body", "body": b"a" * PIECE, "more_body": True})
        await send({"type": "http.response.body"})
        return
    if scope["path"] == "/no":
        await send({"type": "http.response.start", "status": 413, "headers": [(b"content-length", b"2")]})
        await send({"type": "http.response.body", "body": b"no"})
        return
    if scope["path"] == "/slow":
        await asyncio.sleep(3.0 * SILENT_S)
    while more:
        message = await receive()
        size, more = size + len(message.get("body", b"")), message.get("more_body", False)
    body = str(size).encode()
    headers = [(b"content-length", str(len(body)).encode())]
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    await send({"type": "http.response.body", "body": body})


@contextmanager
def running(most: int = 100, silent_s: float = SILENT_S) -> Iterator[Running]:
    stopped: list[str] = []
    connections = Connections(most, stalled_s=STALLED_S, silent_s=silent_s, on_stop=lambda: stopped.append("stopped"))
    listening = socket.create_server(("127.0.0.1", 0))
    config = uvicorn.Config(app, http=connections.protocol, lifespan="off", log_level="error")  # type: ignore[arg-type]
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    try:
        yield Running(listening.getsockname()[1], stopped)
    finally:
        server.should_exit = True
        thread.join(20.0)
        assert not thread.is_alive()


@pytest.fixture(scope="module")
def server() -> Iterator[Running]:
    with running() as server:
        yield server


@pytest.fixture(scope="module")
def patient() -> Iterator[Running]:
    """For what is sent at once, and arrives late all the same where the machine is busy."""
    with running(silent_s=20.0) as server:
        yield server


def answer(connection: socket.socket) -> tuple[int, bytes]:
    """Status and body of all that comes until the connection is closed, or until the body is whole."""
    found = b""
    while piece := connection.recv(65_536):
        found += piece
        head, end, body = found.partition(b"\r\n\r\n")
        length = next(
            (int(line[15:]) for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:")), 0
        )
        if end and len(body) >= length:
            break
    return int(found.split()[1]), body


def read_all(connection: socket.socket) -> None:
    while connection.recv(65_536):
        pass


def refusal(connection: socket.socket) -> tuple[int, str]:
    """Status and code of a problem, after which the connection is closed."""
    status, body = answer(connection)
    assert connection.recv(1) == b""
    problem = json.loads(body)
    assert problem["status"] == status
    return status, problem["code"]


@pytest.mark.parametrize("before", [GET + b"X-Long: ", GET + b"X-", b"GET /"])
def test_an_endless_header_is_refused(patient: Running, before: bytes) -> None:
    with patient.connected() as connection:
        connection.sendall(before)
        time.sleep(0.2)
        connection.sendall(b"a" * (HEADER_BYTES + 1))
        assert refusal(connection) == (431, "headers_too_large")


def test_many_headers_are_counted_together_and_each_request_alone(patient: Running) -> None:
    with patient.connected() as connection:
        for _ in range(3):
            connection.sendall(GET + b"X-Long: " + b"a" * (HEADER_BYTES // 2) + b"\r\n\r\n")
            assert answer(connection) == (200, b"0")
        connection.sendall(GET)
        time.sleep(0.2)
        for _ in range(HEADER_BYTES // 1_000 + 1):
            connection.sendall(b"X-Next: " + b"a" * 1_000 + b"\r\n")
        assert refusal(connection)[0] == 431


def test_headers_after_a_body_are_counted_too(server: Running) -> None:
    with server.connected() as connection:
        connection.sendall(POST.replace(b"Content-Length: %d", b"Transfer-Encoding: chunked") + b"1\r\nx\r\n0\r\n")
        time.sleep(0.2)
        connection.sendall((b"X-Last: " + b"a" * 1_000 + b"\r\n") * (HEADER_BYTES // 1_000 + 1))
        assert refusal(connection)[0] == 431


@pytest.mark.parametrize("begun", [b"", b"GET", GET, POST % 10, POST % 10 + b"12345"])
def test_a_request_that_stops_halfway_is_ended(server: Running, begun: bytes) -> None:
    with server.connected() as connection:
        connection.sendall(begun)
        began = time.monotonic()
        assert refusal(connection) == (408, "request_timeout")
        assert time.monotonic() - began >= SILENT_S - 0.1


def test_single_bytes_are_no_progress(server: Running) -> None:
    with server.connected() as connection:
        connection.sendall(POST % 1_000)
        for _ in range(1_000):
            try:
                connection.sendall(b"a")
            except OSError:
                return
            time.sleep(0.05)
    pytest.fail("it was read to its end")


def test_a_slow_line_is_no_reason(server: Running) -> None:
    with server.connected() as connection:
        connection.sendall(POST % (4 * PROGRESS_BYTES))
        for _ in range(4):
            time.sleep(0.6 * SILENT_S)
            connection.sendall(b"a" * PROGRESS_BYTES)
        assert answer(connection) == (200, str(4 * PROGRESS_BYTES).encode())


def test_a_service_that_reads_late_is_no_reason(server: Running) -> None:
    size = 8_000_000  # more than is read ahead and than the sockets hold
    with server.connected() as connection:
        connection.sendall((POST % size).replace(b"POST /", b"POST /slow") + b"a" * size)
        assert answer(connection) == (200, str(size).encode())


def test_a_body_in_chunks_of_a_byte_is_read(server: Running) -> None:
    size = 50_000
    with server.connected() as connection:
        connection.sendall(POST.replace(b"Content-Length: %d", b"Transfer-Encoding: chunked"))
        connection.sendall(b"1\r\na\r\n" * size + b"0\r\n\r\n")
        assert answer(connection) == (200, str(size).encode())


def test_silent_connections_make_room(server: Running) -> None:
    with running(most=4) as server, ExitStack() as stack:
        silent = [stack.enter_context(server.connected()) for _ in range(8)]
        silent[0].sendall(POST % 10)
        time.sleep(0.3)
        with server.connected() as connection:
            connection.sendall(GET + b"\r\n")
            assert answer(connection) == (200, b"0")
        assert refusal(silent[0]) == (503, "too_many_connections")
        silent[1].sendall(GET + b"\r\n")
        assert answer(silent[1]) == (200, b"0")


def test_idle_connections_make_room_without_a_word() -> None:
    with running(most=4) as server, ExitStack() as stack:
        idle = [stack.enter_context(server.connected()) for _ in range(8)]
        for connection in idle:
            connection.sendall(GET + b"\r\n")
            assert answer(connection) == (200, b"0")
        with server.connected() as connection:
            connection.sendall(GET + b"\r\n")
            assert answer(connection) == (200, b"0")
        assert idle[0].recv(1) == b""
        idle[1].sendall(GET + b"\r\n")
        assert answer(idle[1]) == (200, b"0")


def test_those_who_wait_at_the_most_crowded_address_make_room() -> None:
    with running(most=4) as server, ExitStack() as stack:
        alone = stack.enter_context(server.connected("127.0.0.2"))
        time.sleep(0.1)
        crowd = [stack.enter_context(server.connected()) for _ in range(8)]
        assert refusal(crowd[0]) == (503, "too_many_connections")
        alone.sendall(GET + b"\r\n")
        assert answer(alone) == (200, b"0")


def test_an_answer_that_nobody_reads_is_ended(server: Running) -> None:
    with server.connected(receive_bytes=4_096) as connection:
        connection.sendall(GET.replace(b"GET /", b"GET /long") + b"\r\n")
        time.sleep(STALLED_S + 2.5)  # it is looked at once a second
        with pytest.raises(ConnectionResetError):
            read_all(connection)


def test_an_answer_that_is_read_slowly_is_not_ended(server: Running) -> None:
    with server.connected(receive_bytes=100_000) as connection:
        connection.sendall(GET.replace(b"GET /", b"GET /long") + b"\r\n")
        began, size = time.monotonic(), 0
        while piece := connection.recv(200_000):
            size += len(piece)
            if size > LONG:
                break
            time.sleep(0.02)
        assert size > LONG
        assert time.monotonic() - began > 2.0 * STALLED_S


def test_who_is_refused_while_sending_reads_why(server: Running) -> None:
    size = 30_000_000
    with server.connected() as connection:
        connection.sendall((POST % size).replace(b"POST /", b"POST /no") + b"a" * size)
        assert answer(connection) == (413, b"no")
        connection.sendall(GET + b"\r\n")
        assert answer(connection) == (200, b"0")


def test_it_is_told_once_that_the_server_stops() -> None:
    with ExitStack() as stack, running() as server:
        for _ in range(3):
            stack.enter_context(server.connected())
        time.sleep(0.3)
        assert server.stopped == []
    assert server.stopped == ["stopped"]


@pytest.mark.parametrize(
    ("soft", "hard", "most", "opened"),
    [
        (1_024, 524_288, 1_000, 3_256),
        (1_024, 1_024, 256, 1_024),
        (256, 256, 8, 256),
        (4_096, 4_096, 1_000, 4_096),
        (1_024, -1, 1_000, 3_256),
        (-1, -1, 1_000, -1),
    ],
)
def test_there_are_as_many_as_files_may_be_open(
    monkeypatch: pytest.MonkeyPatch, soft: int, hard: int, most: int, opened: int
) -> None:
    limits = [soft, hard]
    monkeypatch.setattr("resource.getrlimit", lambda _which: tuple(limits))
    monkeypatch.setattr("resource.setrlimit", lambda _which, wanted: limits.__setitem__(slice(None), wanted))
    assert most_connections(1_000) == most
    assert limits == [opened, hard]
