"""A PostgreSQL that stops answering without closing its connections: every wait for it ends.

A server that was stopped, whose host is frozen or whose disk hangs keeps its connections: its system acknowledges what
is sent, so that no limit of libpq or TCP, and no limit that the server keeps itself, ends the wait.
"""

from __future__ import annotations

import time
from collections.abc import Generator
from typing import Any, TypeVar

import psycopg
from sqlalchemy import Engine, event

Result = TypeVar("Result")

ANSWER_S = 10.0
"""Longest time until the server answers one statement [s]."""
PATIENCE = {"connect_timeout": 5, "tcp_user_timeout": 15_000}
"""Of libpq, for a connection and for a network that is lost [s, ms]; its own are minutes."""
POOL_S = 10.0
"""Longest time until a connection is free [s]."""


class LimitedConnection(psycopg.Connection[Any]):
    """A connection that is closed when the server does not answer in time, with an OperationalError."""

    def wait(self, gen: Generator[Any, Any, Result], *arguments: Any, **how: Any) -> Result:
        """Wait for the server."""
        return super().wait(self._limited(gen), *arguments, **how)

    def _limited(self, gen: Generator[Any, Any, Result]) -> Generator[Any, Any, Result]:
        deadline = time.monotonic() + ANSWER_S
        try:
            asked = next(gen)
            while True:
                ready = yield asked
                if not ready and time.monotonic() > deadline:
                    self.pgconn.finish()  # nobody knows what is in it; what asks next connects anew
                    raise psycopg.OperationalError(f"nothing within {ANSWER_S:g} s")
                asked = gen.send(ready)
        except StopIteration as end:
            result: Result = end.value
            return result


def limit(engine: Engine) -> None:
    """Have an engine connect with limits of time, where its driver is psycopg."""
    if engine.dialect.driver == "psycopg":
        event.listen(engine, "do_connect", _connect)


def _connect(_dialect: Any, _record: Any, arguments: Any, how: Any) -> LimitedConnection:
    return LimitedConnection.connect(*arguments, **how)
