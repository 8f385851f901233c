"""Adds to the tables of an older version the columns and indexes that they do not have yet."""

from __future__ import annotations

from sqlalchemy import Connection, inspect
from sqlalchemy.schema import CreateColumn

from joulemap.service.storage.tables import Base


def add_missing_columns(connection: Connection) -> None:
    """Add every column and index that a table of the database lacks; new columns may be empty."""
    found = inspect(connection)
    quoted = connection.dialect.identifier_preparer
    for table in Base.metadata.sorted_tables:
        there = {column["name"] for column in found.get_columns(table.name)}
        for column in table.columns:
            if column.name not in there:
                new = CreateColumn(column).compile(dialect=connection.dialect)
                connection.exec_driver_sql(f"ALTER TABLE {quoted.format_table(table)} ADD COLUMN {new}")
        for index in table.indexes:
            index.create(connection, checkfirst=True)
