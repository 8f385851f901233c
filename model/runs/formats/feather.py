"""Logs in Feather, the files of Arrow, as tools for tables in memory write them."""

from __future__ import annotations

from collections.abc import Mapping

from joulemap.model.errors import RunsError
from joulemap.model.runs.formats.columns import named, stream_of
from joulemap.model.runs.formats.contract import Log, content_of
from joulemap.model.runs.formats.parquet import flattened, longest_text
from joulemap.model.runs.table import TableLimits
from joulemap.model.source_file import SourceFile


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark at the start of the file."""
    return head.startswith(b"ARROW1")


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the table, batch by batch."""
    import pyarrow as pa

    name, parts, rows = source.name, [], 0
    try:
        file = pa.ipc.open_file(pa.py_buffer(content_of(source)))
        for number in range(file.num_record_batches):
            batch = file.get_batch(number)
            batch.validate(full=True)  # Arrow takes places in a dictionary as they are written
            rows += batch.num_rows
            part = flattened(pa.Table.from_batches([batch]))
            limits.check(rows, part.num_columns, name)
            for column, values in zip(part.column_names, part.columns, strict=True):
                limits.check_texts(rows, longest_text(values), name, column)
            parts.append(part)
        table = pa.concat_tables(parts) if parts else flattened(file.schema.empty_table())
        return Log((stream_of(table.rename_columns(named(table.column_names)), name, limits),))
    except (pa.ArrowException, OSError, ValueError, OverflowError) as error:
        raise RunsError.of_run(name, f"not a readable Feather file: {str(error)[:300]}") from error
