"""The tables of an older version get what they lack; those of a newer one, and damaged ones, are refused."""

from __future__ import annotations

from sqlalchemy import Connection, Engine, delete, insert, inspect, select
from sqlalchemy.exc import DatabaseError, OperationalError
from sqlalchemy.schema import CreateColumn

from joulemap.model.errors import ConflictError, DamagedError
from joulemap.service.storage.tables import SCHEMA, SCHEMA_VERSION, Base


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
