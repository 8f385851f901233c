"""Logs in Parquet, as if they were CSV: nulls are blank, times are seconds, categories are texts.

A few kilobytes of Parquet can stand for terabytes: a long text in a dictionary that every row refers to. So texts stay
in their dictionary until their size is known, and columns of lists or structures are refused.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from joulemap.model.errors import RunsError, TooLargeError
from joulemap.model.runs.formats.contract import Log, Stream, content_of
from joulemap.model.runs.table import (
    FloatArray,
    TableLimits,
    TextArray,
    check_names,
    must_be_number,
    not_a_number,
    numbers_of,
)
from joulemap.model.source_file import SourceFile

PARQUET_MAGIC = b"PAR1"
"""How the bytes of every Parquet file begin."""

_BATCH_CELLS = 1_000_000
_BATCH_TEXTS = 1_000  # where texts come in full, however long they are


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark at the start of the file.

    Parameters
    ----------
    head : bytes
        First bytes of the file.
    name : str
        Not used.

    Returns
    -------
    bool
        True for a Parquet file.
    """
    return head.startswith(PARQUET_MAGIC)


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the table of a Parquet file.

    Parameters
    ----------
    source : SourceFile
        The file.
    mapping : mapping of str to str
        Not used: all columns are read.
    limits : TableLimits
        How large it may be.
    repairs : dict
        Not used: nothing is repaired.

    Returns
    -------
    Log
        Of one stream.

    Raises
    ------
    RunsError
        As `read_parquet`.
    TooLargeError
        As `read_parquet`.
    """
    numbers, texts, _ = read_parquet(content_of(source), source.name, limits)
    return Log((Stream("", numbers, texts),))


def read_parquet(
    content: bytes, name: str, limits: TableLimits
) -> tuple[dict[str, FloatArray], dict[str, TextArray], int]:
    """Read a table from the bytes of a Parquet file.

    Parameters
    ----------
    content : bytes
        Of the whole file.
    name : str
        Of the run, for messages.
    limits : TableLimits
        How large it may be.

    Returns
    -------
    tuple of (dict, dict, int)
        Columns of numbers, (n,) of float, NaN for null; columns of text, "" for null; and the number of rows.

    Raises
    ------
    RunsError
        If it cannot be read, has a column of another kind, or a column that must hold numbers holds something else.
    TooLargeError
        If it is larger than the limits.
    """
    try:
        import pyarrow as pa
    except ImportError:
        raise RunsError(
            f"run {name}: reading Parquet needs pyarrow (pip install 'joulemap[parquet]'); CSV needs nothing", run=name
        ) from None
    try:
        return _read(content, name, limits)
    except (pa.ArrowException, OSError, ValueError, OverflowError) as error:
        raise RunsError(f"run {name}: not a readable Parquet file: {str(error)[:300]}", run=name) from error


def _read(content: bytes, name: str, limits: TableLimits) -> tuple[dict[str, FloatArray], dict[str, TextArray], int]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    about = pq.read_metadata(io.BytesIO(content))
    limits.check(about.num_rows, about.num_columns, name)
    schema = about.schema.to_arrow_schema()
    columns = list(schema.names)
    check_names(columns, name)
    for field in schema:
        _check_kind(field, name)
    _check_size(about, name, limits)
    words = {field.name for field in schema if pa.types.is_string(field.type) or pa.types.is_large_string(field.type)}
    in_full = _without_dictionary(about) & words
    file = pq.ParquetFile(io.BytesIO(content), read_dictionary=sorted(words - in_full), pre_buffer=False)
    parts: dict[str, list[Any]] = {column: [] for column in columns}
    letters = dict.fromkeys(columns, 0)
    rows = 0
    size = max(1, (_BATCH_TEXTS if in_full else _BATCH_CELLS) // max(1, len(columns)))
    for batch in file.iter_batches(batch_size=size, use_threads=False):
        batch.validate(full=True)  # Arrow takes places in a dictionary as they are written
        for column, values in zip(columns, batch.columns, strict=True):
            longest = _longest(values)
            letters[column] = max(letters[column], longest)
            limits.check_texts(about.num_rows, sum(letters.values()), name, column)
            limits.check_texts(len(getattr(values, "dictionary", ())), longest, name, column)
            parts[column].append(_values(values))
        rows += batch.num_rows
        limits.check(rows, len(columns), name)
    numbers: dict[str, FloatArray] = {}
    texts: dict[str, TextArray] = {}
    for column in columns:
        _sort(parts.pop(column), numbers, texts, name, column)
    return numbers, texts, rows


def _check_kind(field: Any, name: str) -> None:
    """Refuse what is neither a number, nor a time, nor a text."""
    import pyarrow as pa

    kind = field.type.value_type if pa.types.is_dictionary(field.type) else field.type
    if pa.types.is_nested(kind) or pa.types.is_binary(kind) or isinstance(kind, pa.BaseExtensionType):
        raise RunsError(
            f"run {name}, column {field.name[:80]!r}: it holds {str(field.type)[:80]}, and not numbers, times or "
            "texts: leave it out",
            run=name,
            column=field.name[:80],
        )


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
        raise TooLargeError(
            f"run {name} unpacks to {size / 1e6:,.0f} MB, the limit is {most / 1e6:,.0f} MB: split it, or leave "
            "columns out",
            run=name,
            bytes=size,
            limit=most,
        )


def _longest(column: Any) -> int:
    """Letters of the longest text of a column; 0 where it holds no texts."""
    import pyarrow as pa
    import pyarrow.compute as pc

    words = column.dictionary if pa.types.is_dictionary(column.type) else column
    if not (pa.types.is_string(words.type) or pa.types.is_large_string(words.type)):
        return 0
    return pc.max(pc.binary_length(words)).as_py() or 0  # bytes, of which a letter has at least one


def _values(column: Any) -> Any:
    """Part of a column: numbers with NaN for null, or texts with "" for null."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = column.type
    if pa.types.is_dictionary(kind):
        if pa.types.is_string(kind.value_type) or pa.types.is_large_string(kind.value_type):
            words = column.dictionary.to_pylist()
            array = np.array([*("" if word is None else word for word in words), ""])
            indices = column.indices.fill_null(len(words)).to_numpy(zero_copy_only=False)
            return array[indices]
        column = column.cast(kind.value_type)
        kind = column.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        wide = pa.timestamp("ns", kind.tz) if pa.types.is_timestamp(kind) else pa.duration("ns")
        column = pc.divide(column.cast(wide).cast(pa.int64()).cast(pa.float64(), safe=False), 1e9)
        kind = column.type
    if any(check(kind) for check in (pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean)):
        return np.asarray(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=np.float64)
    return np.array(["" if value is None else str(value) for value in column.to_pylist()], dtype=np.str_)


def _sort(
    parts: list[Any], numbers: dict[str, FloatArray], texts: dict[str, TextArray], name: str, column: str
) -> None:
    """Put a column among the numbers, if it can be, else among the texts."""
    if all(part.dtype.kind == "f" for part in parts):
        numbers[column] = np.concatenate(parts or [np.empty(0)])
        return
    array = np.concatenate(parts)
    entries = array.tolist()
    try:
        numbers[column] = numbers_of(entries)
    except ValueError:
        if must_be_number(column) and column != "t":  # a time may be a text
            raise not_a_number(name, column, entries, 0) from None
        texts[column] = array
