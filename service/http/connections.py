"""HTTP connections within limits: how many, how large a header, and how long a client may neither send nor read.

The server itself waits for ever for the rest of a request, and for a client that reads no answer, and it collects a
header of any size. A client that opens a thousand connections and stays silent on each would then take all open files,
and one endless header the event loop.
"""

from __future__ import annotations

import asyncio
import json
import resource
import socket
import struct
from collections import Counter, OrderedDict
from collections.abc import Callable
from http import HTTPStatus
from typing import Any

from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol

from joulemap.service.problems import MEDIA_TYPE, problem

HEADER_BYTES = 65_536
"""Most bytes of a request line with its headers, give or take one piece as it arrives; h11 has the same limit."""
SILENT_S = 20.0
"""Longest time until a header is whole, and from one `PROGRESS_BYTES` of a body to the next [s]."""
PROGRESS_BYTES = 16_384
_DISCARDED_BYTES = 1_000_000_000  # of a body whose request was answered before it came, so that the answer is read
_FRAMING = 8  # bytes of chunked transfer coding for each byte of a body: pieces of one byte need five
_LOOK_S = 1.0
_NO_LINGERING = struct.pack("ii", 1, 0)
_RETRY_S = 5
_FILES_FOR_OTHERS = 256  # maps, logs, the database, pipes of the workers
_FILES_EACH = 3  # the connection, the file that is being sent over it, and one more connection: see `_SPARE`
_SPARE = 2  # connections for each that may be answered, so that a probe or a clear refusal is always possible


class Connections:
    """The connections of one server."""

    def __init__(
        self,
        most: int,
        *,
        stalled_s: float,
        silent_s: float = SILENT_S,
        on_stop: Callable[[], object] | None = None,
    ) -> None:
        self.most, self.silent_s, self.stalled_s, self._on_stop = most, silent_s, stalled_s, on_stop
        self.open: set[_Connection] = set()
        self.waiting: OrderedDict[_Connection, float] = OrderedDict()
        """Those that owe a request or the rest of it, and since when; those that wait longest come first."""
        self.stalled: OrderedDict[_Connection, float] = OrderedDict()
        """Those whose client takes nothing of its answer, and since when; in the same order."""
        self._looking = False

    def protocol(self, *arguments: Any, **options: Any) -> asyncio.Protocol:
        """Return the protocol of a new connection, as uvicorn asks for it."""
        return _Connection(self, *arguments, **options)

    def owes(self, connection: _Connection) -> None:
        """Note that bytes of a request are awaited from now on."""
        self.waiting[connection] = asyncio.get_running_loop().time()
        self.waiting.move_to_end(connection)

    def owes_nothing(self, connection: _Connection) -> None:
        """Note that a request is whole."""
        self.waiting.pop(connection, None)

    def opened(self, newest: _Connection) -> None:
        """Note a new connection, and close another one where there are too many.

        That is the one that has waited longest for its client, of the address with the most that wait.
        """
        self.open.add(newest)
        self.owes(newest)
        if len(self.open) > _SPARE * self.most:
            crowded = Counter(one.address for one in self.waiting).most_common(1)[0][0]
            closed = next(one for one in self.waiting if one.address == crowded)
            words = f"{len(self.open)} connections are open, and at most {_SPARE * self.most} may be"
            closed.give_up(503, "too_many_connections", words)
        if not self._looking:
            self._looking = True
            asyncio.get_running_loop().call_later(_LOOK_S, self._look)

    def lost(self, connection: _Connection) -> None:
        """Note that a connection is closed."""
        self.open.discard(connection)
        self.waiting.pop(connection, None)
        self.stalled.pop(connection, None)

    def end_a_stalled_one(self) -> bool:
        """End the connection whose client has taken nothing of its answer for longest, for another one's sake."""
        for connection in self.stalled:
            connection.cut_off()
            del self.stalled[connection]
            return True
        return False

    def stopping(self) -> None:
        """Note that the server stops."""
        callback, self._on_stop = self._on_stop, None
        if callback is not None:
            callback()

    def _look(self) -> None:
        loop = asyncio.get_running_loop()
        now = loop.time()
        for connection, since in list(self.waiting.items()):
            if now - since < self.silent_s:
                break
            if connection.is_held_up:
                self.owes(connection)
            else:
                words = f"the rest of the request did not arrive within {self.silent_s:g} s"
                connection.give_up(408, "request_timeout", words)
        for connection in list(self.open):
            if connection.takes_its_answer():
                self.stalled.pop(connection, None)
            elif now - self.stalled.setdefault(connection, now) >= self.stalled_s:
                connection.cut_off()
        self._looking = bool(self.open)
        if self._looking:
            loop.call_later(_LOOK_S, self._look)


class _Connection(HttpToolsProtocol):
    def __init__(self, all_of_them: Connections, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._all, self._bytes, self._body, self._noted = all_of_them, 0, 0, 0
        self._in_header, self._unsent, self._took = False, 0, False

    @property
    def is_held_up(self) -> bool:
        """Whether the service does not read what arrives, because it has not worked off what came before."""
        return bool(self.flow.read_paused)

    @property
    def address(self) -> str:
        """From where it comes."""
        return self.client[0] if self.client else ""

    def takes_its_answer(self) -> bool:
        """Whether nothing of an answer waits for the client, or some of it went out since this was asked last."""
        before, self._unsent = self._unsent, self.transport.get_write_buffer_size()
        took, self._took = self._took or self._unsent < before, False
        return took or not self._unsent

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._all.opened(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._all.lost(self)
        super().connection_lost(exc)

    def resume_writing(self) -> None:
        self._took = True
        super().resume_writing()

    def data_received(self, data: bytes) -> None:
        self._bytes += len(data)
        super().data_received(data)
        if self._bytes > HEADER_BYTES + (1 + _FRAMING) * self._body and not self.transport.is_closing():
            words = f"the request's headers have more than {HEADER_BYTES:,} bytes"
            self.give_up(431, "headers_too_large", words)
        elif self._body - self._noted >= PROGRESS_BYTES and self in self._all.waiting:
            self._noted = self._body
            self._all.owes(self)

    def on_message_begin(self) -> None:
        self._bytes = self._body = self._noted = 0
        self._in_header = True
        if self not in self._all.waiting:
            self._all.owes(self)
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        self._in_header = False
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        self._body += len(body)
        super().on_body(body)
        if self._body > _DISCARDED_BYTES and self.cycle.response_complete:
            self.transport.close()

    def on_message_complete(self) -> None:
        super().on_message_complete()
        if self.cycle.response_complete:  # it was refused before it was whole
            self._all.owes(self)
        else:
            self._all.owes_nothing(self)

    def on_response_complete(self) -> None:
        super().on_response_complete()
        if not self.transport.is_closing() and self.cycle.response_complete:
            self._all.owes(self)

    def shutdown(self) -> None:
        self._all.stopping()
        super().shutdown()

    def cut_off(self) -> None:
        """Close the connection at once, also what the system still has to send."""
        self.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NO_LINGERING)
        self.transport.abort()

    def give_up(self, status: int, code: str, words: str) -> None:
        """Answer with a problem, where a request is not answered yet, and close the connection."""
        self._all.owes_nothing(self)
        cycle = self.cycle
        if cycle is None or not cycle.response_started or (cycle.response_complete and self._in_header):
            body = json.dumps(problem(status, code, HTTPStatus(status).phrase, words, None)).encode()
            retry = f"retry-after: {_RETRY_S}\r\n" if status == 503 else ""
            header = f"content-type: {MEDIA_TYPE}\r\n{retry}content-length: {len(body)}\r\nconnection: close\r\n\r\n"
            self.transport.write(STATUS_LINE[status] + header.encode() + body)
        self.transport.close()


def most_connections(wanted: int) -> int:
    """Return how many connections there may be, after letting this process open as many files as the system permits."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = _FILES_FOR_OTHERS + _FILES_EACH * wanted
    if soft != resource.RLIM_INFINITY and soft < needed:
        soft = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    return wanted if soft == resource.RLIM_INFINITY else max(8, min(wanted, (soft - _FILES_FOR_OTHERS) // _FILES_EACH))
