"""SQLite's log goes into the database on a thread of its own, so that no request waits for the disk.

A commit adds to the log. The commit that finds it long writes it to the database, syncs both, and holds the lock of
writing meanwhile: 0.3 s in which every update of a drive waits. A passive checkpoint does the same work and blocks
nobody (https://www.sqlite.org/pragma.html#pragma_wal_checkpoint).
"""

from __future__ import annotations

import logging
import threading

from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

EVERY_S = 1.0
"""Setting: 100 drives that are followed write 4 MB in that time."""
_LOG = logging.getLogger("joulemap.service")


class Checkpoints:
    """Writes the log of an SQLite database to the database, again and again."""

    def __init__(self, engine: Engine) -> None:
        self._engine, self._over = engine, threading.Event()
        self._thread = threading.Thread(target=self._repeat, name="checkpoints", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End, once the one that runs is over."""
        self._over.set()
        self._thread.join()

    def _repeat(self) -> None:
        while not self._over.wait(EVERY_S):
            try:
                with self._engine.connect() as connection:
                    connection.exec_driver_sql("PRAGMA wal_checkpoint(PASSIVE)")
            except SQLAlchemyError as error:  # a full disk: commits do it as far as they can
                _LOG.warning("the database's log cannot be written to it now: %s", error)
