"""Logs in Feather, the files of Arrow, as tools for tables in memory write them."""

from __future__ import annotations

from collections.abc import Mapping

from joulemap.model.errors import RunsError
from joulemap.model.runs.formats.columns import named, stream_of
from joulemap.model.runs.formats.contract import Log, content_of
from joulemap.model.runs.formats.parquet import is_plain, longest_text
from joulemap.model.runs.table import TableLimits
from joulemap.model.source_file import SourceFile


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark at the start of the file."""
    return head.startswith(b"ARROW1")


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the table, batch by batch."""
    import pyarrow as pa

    name, batches, rows = source.name, [], 0
    try:
        file = pa.ipc.open_file(pa.py_buffer(content_of(source)))
        plain = [k for k, field in enumerate(file.schema) if is_plain(field.type)]
        for number in range(file.num_record_batches):
            batch = file.get_batch(number)
            batch.validate(full=True)  # Arrow takes places in a dictionary as they are written
            rows += batch.num_rows
            limits.check(rows, len(plain), name)
            for k in plain:
                limits.check_texts(rows, longest_text(batch.column(k)), name, file.schema.names[k])
            batches.append(batch.select(plain))
        table = pa.Table.from_batches(batches) if batches else file.schema.empty_table().select(plain)
        return Log((stream_of(table.rename_columns(named(table.column_names)), name, limits),))
    except (pa.ArrowException, OSError, ValueError, OverflowError) as error:
        raise RunsError.of_run(name, f"not a readable Feather file: {str(error)[:300]}") from error
