"""HTTP connections within limits: how many, how large a header, and how long nothing of a request may arrive.

The server itself waits for the rest of a request for ever, and collects a header of any size. A client that opens a
thousand connections and stays silent on each would then take all open files, and one endless header the event loop.
"""

from __future__ import annotations

import asyncio
import json
import resource
from collections import OrderedDict
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
_FRAMING = 8  # bytes of chunked transfer coding for each byte of a body: pieces of one byte need five
_LOOK_S = 1.0
_FILES_FOR_OTHERS = 256  # maps, logs, the database, pipes of the workers
_FILES_EACH = 2  # the connection, and the file that is being sent over it


class Connections:
    """The connections of one server.

    Parameters
    ----------
    most : int
        At a time. One more closes that which has been silent longest in the middle of a request.
    silent_s : float, optional
        See `SILENT_S`.
    on_stop : callable, optional
        Called once when the server begins to stop.
    """

    def __init__(self, most: int, *, silent_s: float = SILENT_S, on_stop: Callable[[], object] | None = None) -> None:
        self.most, self.silent_s, self._on_stop = most, silent_s, on_stop
        self.waiting: OrderedDict[_Connection, float] = OrderedDict()
        """Those that owe the rest of a request, and since when; those that wait longest come first."""
        self._looking = False

    def protocol(self, *arguments: Any, **options: Any) -> asyncio.Protocol:
        """Return the protocol of a new connection, as uvicorn asks for it.

        Parameters
        ----------
        *arguments, **options : object
            Of uvicorn's own protocol.

        Returns
        -------
        Protocol
            For one connection.
        """
        return _Connection(self, *arguments, **options)

    def owes(self, connection: _Connection) -> None:
        """Note that bytes of a request are awaited from now on.

        Parameters
        ----------
        connection : Protocol
            On which it comes.
        """
        loop = asyncio.get_running_loop()
        self.waiting[connection] = loop.time()
        self.waiting.move_to_end(connection)
        if not self._looking:
            self._looking = True
            loop.call_later(_LOOK_S, self._look)

    def owes_nothing(self, connection: _Connection) -> None:
        """Note that a request is whole, or that its connection is closed.

        Parameters
        ----------
        connection : Protocol
            On which it comes.
        """
        self.waiting.pop(connection, None)

    def make_room(self, newest: _Connection) -> None:
        """Close the connection that has been silent longest, or the newest where all are being answered.

        Parameters
        ----------
        newest : Protocol
            The one too many.
        """
        closed = next(iter(self.waiting), newest)
        closed.give_up(503, "too_many_connections", f"more than {self.most} connections are open")

    def stopping(self) -> None:
        """Note that the server stops."""
        callback, self._on_stop = self._on_stop, None
        if callback is not None:
            callback()

    def _look(self) -> None:
        loop = asyncio.get_running_loop()
        for connection, since in list(self.waiting.items()):
            if loop.time() - since < self.silent_s:
                break
            if connection.is_held_up:
                self.owes(connection)
            else:
                words = f"the rest of the request did not arrive within {self.silent_s:g} s"
                connection.give_up(408, "request_timeout", words)
        self._looking = bool(self.waiting)
        if self._looking:
            loop.call_later(_LOOK_S, self._look)


class _Connection(HttpToolsProtocol):
    def __init__(self, all_of_them: Connections, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._all, self._bytes, self._body, self._noted = all_of_them, 0, 0, 0

    @property
    def is_held_up(self) -> bool:
        """Whether the service does not read what arrives, because it has not worked off what came before."""
        return bool(self.flow.read_paused)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        if len(self.connections) > self._all.most:
            self._all.make_room(self)
        if not transport.is_closing():
            self._all.owes(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._all.owes_nothing(self)
        super().connection_lost(exc)

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
        if self not in self._all.waiting:
            self._all.owes(self)
        super().on_message_begin()

    def on_body(self, body: bytes) -> None:
        self._body += len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        self._all.owes_nothing(self)
        super().on_message_complete()

    def shutdown(self) -> None:
        self._all.stopping()
        super().shutdown()

    def give_up(self, status: int, code: str, words: str) -> None:
        """Answer with a problem, where no answer has begun, and close the connection."""
        self._all.owes_nothing(self)
        answering = self.cycle is not None and self.cycle.response_started and not self.cycle.response_complete
        if not answering:
            body = json.dumps(problem(status, code, HTTPStatus(status).phrase, words, None)).encode()
            header = f"content-type: {MEDIA_TYPE}\r\ncontent-length: {len(body)}\r\nconnection: close\r\n\r\n"
            self.transport.write(STATUS_LINE[status] + header.encode() + body)
        self.transport.close()


def most_connections(wanted: int) -> int:
    """Return how many connections there may be, after letting this process open as many files as the system permits.

    Parameters
    ----------
    wanted : int
        As set.

    Returns
    -------
    int
        At most `wanted`, and at least 8.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = _FILES_FOR_OTHERS + _FILES_EACH * wanted
    if soft != resource.RLIM_INFINITY and soft < needed:
        soft = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    return wanted if soft == resource.RLIM_INFINITY else max(8, min(wanted, (soft - _FILES_FOR_OTHERS) // _FILES_EACH))
