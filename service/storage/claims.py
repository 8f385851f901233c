"""Which jobs are this service's: of two services on one database, one sends a job off.

A claim is a lock that ends with its process, however that ends: nobody has to find out who is alive. With PostgreSQL it
is an advisory lock of the database; with SQLite, which is for one machine, a byte of a file is locked. On Linux that
lock is of the open file, so that two services of one process do not share it.
"""

from __future__ import annotations

import fcntl
import os
import struct
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import IO

from sqlalchemy import Connection, Engine, text
from sqlalchemy.exc import SQLAlchemyError


class Claims:
    """The jobs that one service has claimed."""

    def __init__(self, engine: Engine, file: Path) -> None:
        self._engine, self._path = engine, file
        self._file: IO[bytes] | None = None
        self._connection: Connection | None = None  # whose locks are held as long as it is open
        self._held: set[str] = set()

    def keep(self, wanted: Iterable[str]) -> set[str]:
        """Claim all jobs that no other service has, and give back the others.

        Result: those that are claimed; what was claimed before is lost where the database was.
        """
        wanted = set(wanted)
        try:
            if self._engine.dialect.name != "postgresql":
                take, give = self._lock_byte, self._unlock_byte
            else:
                if self._connection is None:
                    self._connection = self._engine.connect().execution_options(isolation_level="AUTOCOMMIT")
                self._connection.execute(text("select 1"))
                take, give = self._lock_number, self._unlock_number
            for job_id in self._held - wanted:
                give(_number(job_id))
                self._held.discard(job_id)
            self._held |= {job_id for job_id in wanted - self._held if take(_number(job_id))}
        except SQLAlchemyError:
            self.close()
            raise
        return set(self._held)

    def close(self) -> None:
        """Give all jobs back."""
        self._held.clear()
        if self._file is not None:
            self._file.close()
            self._file = None
        if self._connection is not None:
            with suppress(SQLAlchemyError):
                self._connection.invalidate()  # not back to the pool, with its locks
                self._connection.close()
            self._connection = None

    def _lock_byte(self, number: int) -> bool:
        if self._file is None:
            self._file = self._path.open("wb")
        try:
            self._set_lock(fcntl.F_WRLCK, number)
        except (BlockingIOError, PermissionError):
            return False
        return True

    def _unlock_byte(self, number: int) -> None:
        self._set_lock(fcntl.F_UNLCK, number)

    def _set_lock(self, kind: int, number: int) -> None:
        assert self._file is not None
        if hasattr(fcntl, "F_OFD_SETLK"):
            wanted = struct.pack("hhqqi", kind, os.SEEK_SET, number, 1, 0)  # struct flock of 64 bits
            fcntl.fcntl(self._file, fcntl.F_OFD_SETLK, wanted)
        else:
            how = fcntl.LOCK_UN if kind == fcntl.F_UNLCK else fcntl.LOCK_EX | fcntl.LOCK_NB
            fcntl.lockf(self._file, how, 1, number)

    def _lock_number(self, number: int) -> bool:
        assert self._connection is not None
        return bool(self._connection.scalar(text("select pg_try_advisory_lock(:number)"), {"number": number}))

    def _unlock_number(self, number: int) -> None:
        assert self._connection is not None
        self._connection.execute(text("select pg_advisory_unlock(:number)"), {"number": number})


def _number(job_id: str) -> int:
    """The random number of an id, which has 48 bits."""
    return int(job_id.rpartition("-")[2], 16)
