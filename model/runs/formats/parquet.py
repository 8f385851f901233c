"""Logs in Parquet, as if they were CSV: nulls are blank, times are seconds, categories are texts.

A few kilobytes of Parquet can stand for terabytes: a long text in a dictionary that every row refers to. So texts stay
in their dictionary until their size is known, and columns of lists are not read. Those of structures are read by field.
"""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from joulemap.model.errors import RunsError, TooLargeError
from joulemap.model.runs.formats.columns import named, stream_of
from joulemap.model.runs.formats.contract import Log, content_of
from joulemap.model.runs.table import TableLimits
from joulemap.model.source_file import SourceFile

_MAGIC = b"PAR1"
DEEPEST = 12
"""Setting: how many structures may lie in each other."""
_BATCH_CELLS = 1_000_000
_BATCH_TEXTS = 1_000  # where texts come in full, however long they are


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark at the start of the file."""
    return head.startswith(_MAGIC)


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the table of a Parquet file."""
    import pyarrow as pa

    name = source.name
    try:
        return Log((stream_of(_read(content_of(source), name, limits), name, limits),))
    except (pa.ArrowException, OSError, ValueError, OverflowError) as error:
        raise RunsError.of_run(name, f"not a readable Parquet file: {str(error)[:300]}") from error


def _read(content: bytes, name: str, limits: TableLimits) -> Any:
    import pyarrow as pa
    import pyarrow.parquet as pq

    about = pq.read_metadata(io.BytesIO(content))
    limits.check(about.num_rows, about.num_columns, name)
    schema = about.schema.to_arrow_schema()
    counts = Counter(field.name for field in schema)
    leaves = dict(leaf for field in schema if counts[field.name] == 1 for leaf in _leaves(field.name, field.type))
    columns = [path for path, kind in leaves.items() if is_plain(kind)]
    _check_size(about, name, limits)
    words = {path for path in columns if _is_text(leaves[path])}
    in_full = _without_dictionary(about) & words
    file = pq.ParquetFile(io.BytesIO(content), read_dictionary=sorted(words - in_full), pre_buffer=False)
    letters = dict.fromkeys(columns, 0)
    size = max(1, (_BATCH_TEXTS if in_full else _BATCH_CELLS) // max(1, len(columns)))
    parts, rows = [], 0
    for batch in file.iter_batches(batch_size=size, use_threads=False, columns=columns):
        batch.validate(full=True)  # Arrow takes places in a dictionary as they are written
        part = flattened(pa.Table.from_batches([batch]))
        for column, values in zip(part.column_names, part.columns, strict=True):
            longest = longest_text(values)
            letters[column] = max(letters.get(column, 0), longest)
            limits.check_texts(about.num_rows, sum(letters.values()), name, column)
            for chunk in values.chunks:
                limits.check_texts(len(getattr(chunk, "dictionary", ())), longest, name, column)
        parts.append(part)
        rows += batch.num_rows
        limits.check(rows, len(columns), name)
    table = pa.concat_tables(parts) if parts else flattened(schema.empty_table())
    return table.rename_columns(named(table.column_names))


def flattened(table: Any) -> Any:
    """Return a table whose structures are columns, `pose.position.x`, as far as they hold numbers, times and texts."""
    import pyarrow as pa

    for _ in range(DEEPEST):
        if any(pa.types.is_struct(kind) for kind in table.schema.types):
            table = table.flatten()
    return table.select([k for k, kind in enumerate(table.schema.types) if is_plain(kind)])


def _leaves(path: str, kind: Any, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """The fields of a column by their paths: itself, where it is no structure."""
    import pyarrow as pa

    if not pa.types.is_struct(kind):
        yield path, kind
    elif depth < DEEPEST:
        for field in kind:
            yield from _leaves(f"{path}.{field.name}", field.type, depth + 1)


def _is_text(kind: Any) -> bool:
    import pyarrow as pa

    return pa.types.is_string(kind) or pa.types.is_large_string(kind)


def is_plain(kind: Any) -> bool:
    """Decide whether a type is a number, a time or a text."""
    import pyarrow as pa

    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return not (pa.types.is_nested(kind) or pa.types.is_binary(kind) or isinstance(kind, pa.BaseExtensionType))


def _without_dictionary(about: Any) -> set[str]:
    """The columns whose texts are written as changes of the text before, which Arrow reads in full only."""
    chunks = (
        about.row_group(k).column(j) for k in range(min(about.num_row_groups, 1)) for j in range(about.num_columns)
    )
    return {chunk.path_in_schema for chunk in chunks if "DELTA_BYTE_ARRAY" in chunk.encodings}


def _check_size(about: Any, name: str, limits: TableLimits) -> None:
    """Refuse a file whose parts take more memory than numbers and texts of the limits could."""
    size = sum(about.row_group(k).total_byte_size for k in range(about.num_row_groups))
    most = 16 * limits.cells + int(limits.text_mb * 1e6)
    if size > most:
        raise TooLargeError.of_run(
            name,
            f" unpacks to {size / 1e6:,.0f} MB, the limit is {most / 1e6:,.0f} MB: split it, or leave columns out",
            bytes=size,
            limit=most,
        )


def longest_text(column: Any) -> int:
    """Return the letters of the longest text of a column; 0 where it holds no texts."""
    import pyarrow as pa
    import pyarrow.compute as pc

    chunks = column.chunks if isinstance(column, pa.ChunkedArray) else [column]
    words = [each.dictionary if pa.types.is_dictionary(each.type) else each for each in chunks]
    of_text = [each for each in words if pa.types.is_string(each.type) or pa.types.is_large_string(each.type)]
    return max(
        (pc.max(pc.binary_length(each)).as_py() or 0 for each in of_text), default=0
    )  # bytes, not fewer than letters
