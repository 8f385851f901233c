"""The database: its JSON, its log, and its tables. Those of an older version get what they lack; newer and damaged ones
are refused.
"""

from __future__ import annotations

import json
import logging
import math
import threading
import zlib
from collections.abc import Mapping
from typing import Any, NoReturn

from sqlalchemy import Connection, Engine, delete, insert, inspect, select
from sqlalchemy.exc import DatabaseError, OperationalError, SQLAlchemyError
from sqlalchemy.schema import CreateColumn

from joulemap.model.errors import ConflictError, DamagedError
from joulemap.service.storage.tables import SCHEMA, SCHEMA_VERSION, Base

_SUM = "crc32"
"""Last member of an object; a list has an object with it as its last item. Versions before 0.2 wrote none."""


def dumps(value: Any) -> str:
    """Return a value as JSON with a checksum, so that a damaged text harms its own row alone."""
    try:
        text = json.dumps(value, allow_nan=False)
    except ValueError:
        text = json.dumps(_finite(value), allow_nan=False)
    if not isinstance(value, Mapping | list | tuple):
        return text
    own = f'"{_SUM}": {_sum(text)}'
    return f"{text[:-1]}{', ' if value else ''}{own if isinstance(value, Mapping) else f'{{{own}}}'}{text[-1]}"


class Damaged(Mapping[str, Any]):
    """Stands for a text that is damaged: who looks into it gets the error, and who reads only other columns none."""

    def __init__(self, why: str) -> None:
        self._why = why

    def _fail(self, *_: object) -> NoReturn:
        raise DamagedError(f"what the database has of it is damaged: {self._why}", file="joulemap.db")

    __getitem__ = __iter__ = __len__ = _fail


def loads(text: str) -> Any:
    """Return what a text of the database says."""
    try:
        value = json.loads(text)
    except ValueError as error:
        return Damaged(f"it is no JSON: {error}")
    if isinstance(value, dict):
        kept = value.pop(_SUM, None)
    else:
        last = isinstance(value, list) and value and isinstance(value[-1], dict) and value[-1].keys() == {_SUM}
        kept = value.pop()[_SUM] if last else None
    return value if kept in (None, _sum(json.dumps(value))) else Damaged("it is not what was written")


def _sum(text: str) -> int:
    return zlib.crc32(text.encode())


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value


def check_schema(connection: Connection) -> None:
    """Refuse a database whose tables a newer joulemap has changed. None has a version before 0.2."""
    if not inspect(connection).has_table(SCHEMA_VERSION.name):
        return
    version = connection.execute(select(SCHEMA_VERSION.c.version)).scalar() or 0
    if version > SCHEMA:
        raise ConflictError(
            f"the database was written by a newer joulemap (its tables are version {version}, this joulemap knows "
            f"{SCHEMA}): install that one again, or restore a backup that this one made",
            found=version,
            limit=SCHEMA,
        )


def note_schema(connection: Connection) -> None:
    """Write down which version the tables have now."""
    SCHEMA_VERSION.create(connection, checkfirst=True)
    if connection.execute(select(SCHEMA_VERSION.c.version)).scalar() != SCHEMA:
        connection.execute(delete(SCHEMA_VERSION))
        connection.execute(insert(SCHEMA_VERSION).values(version=SCHEMA))


def check_pages(engine: Engine) -> None:
    """Refuse a SQLite file whose pages are damaged: what it would answer and keep from then on is not known."""
    try:
        with engine.connect() as connection:
            found = connection.exec_driver_sql("PRAGMA quick_check(1)").scalar()
    except OperationalError:  # it cannot be opened or is locked, which the next question says
        return
    except DatabaseError as error:
        found = str(error.orig)
    if found != "ok":
        raise damaged(engine, str(found))


def damaged(engine: Engine, why: str) -> DamagedError:
    """Return the error of a database that cannot be trusted, with what to do."""
    file = engine.url.database
    return DamagedError(
        f"the database {file} is damaged: {' '.join(why.split())[:200]}. `joulemap check` says what can be read of it; "
        "`joulemap restore` brings back a backup",
        file=file,
    )


def add_missing_columns(connection: Connection) -> None:
    """Add every column and index that a table of the database lacks; new columns may be empty."""
    found = inspect(connection)
    quoted = connection.dialect.identifier_preparer
    for table in Base.metadata.sorted_tables:
        there = {column["name"] for column in found.get_columns(table.name)}
        strange, lost = there - {*table.columns.keys()}, {*table.columns.keys()} - there
        if strange and lost and found.has_table(SCHEMA_VERSION.name):  # versions before 0.2 had other columns
            raise damaged(connection.engine, f"{table.name} has {min(strange)} and no {min(lost)}")
        for column in table.columns:
            if column.name not in there:
                new = CreateColumn(column).compile(dialect=connection.dialect)
                connection.exec_driver_sql(f"ALTER TABLE {quoted.format_table(table)} ADD COLUMN {new}")
        for index in table.indexes:
            index.create(connection, checkfirst=True)


EVERY_S = 1.0
"""Setting: 100 drives that are followed write 4 MB in that time."""
_LOG = logging.getLogger("joulemap.service")


class Checkpoints:
    """Writes the log of an SQLite database to the database, again and again, on a thread of its own.

    A commit adds to the log. The commit that finds it long writes it to the database, syncs both, and holds the lock of
    writing meanwhile: 0.3 s in which every update of a drive waits. A passive checkpoint does the same work and blocks
    nobody (https://www.sqlite.org/pragma.html#pragma_wal_checkpoint).
    """

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
