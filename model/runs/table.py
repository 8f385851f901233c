"""The cells of a log in CSV or Parquet by column, as numbers or texts; what is no table is refused with its place.

A Parquet file is read as if it were CSV: nulls are blank, times are seconds, categories are texts.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import RunsError

FloatArray = NDArray[np.float64]
TextArray = NDArray[np.str_]

NUMERIC_COLUMNS = frozenset(
    {
        "t",
        "x",
        "y",
        "z",
        "lat",
        "lon",
        "voltage",
        "current",
        "speed",
        "heading",
        "roll",
        "pitch",
        "temperature",
        "wind_speed",
        "wind_from",
        "payload",
        "motor_temperature",
        "gps_error",
    }
)
"""Columns that must hold numbers; any other column is text as soon as one cell is not a number."""

LEAST_ROWS = 5
"""Fewer rows are no run."""

_LARGEST = 1e30  # no quantity of a robot is larger, and its square is still a number

_OTHER_SEPARATORS = {";": "semicolons", "\t": "tabs"}

PARQUET_MAGIC = b"PAR1"
"""How the bytes of every Parquet file begin."""


def add_count(counts: dict[str, int], key: str, count: int) -> None:
    """Add to a count by key; a key is there only if its count is not zero.

    Parameters
    ----------
    counts : dict
        Counts by key, which are added to.
    key : str
        Of a rule, or of a reason.
    count : int
        To add.
    """
    if count:
        counts[key] = counts.get(key, 0) + int(count)


def columns_there(numbers: Iterable[str]) -> str:
    """Return the end of a sentence about a missing column.

    Parameters
    ----------
    numbers : iterable of str
        Names of the columns of numbers that are there.

    Returns
    -------
    str
        That lists them.
    """
    return f"; its other columns of numbers are {', '.join(sorted(numbers)) or 'none'}"


def read_table(
    content: str | bytes, name: str, repairs: dict[str, int]
) -> tuple[dict[str, FloatArray], dict[str, TextArray]]:
    """Read a table from a text in CSV, or from the bytes of a file in CSV or Parquet.

    A last line of a CSV that breaks off is dropped and counted.

    Parameters
    ----------
    content : str or bytes
        Of the whole file.
    name : str
        Of the run, for messages.
    repairs : dict
        Counts by rule, which are added to.

    Returns
    -------
    tuple of dict
        Columns of numbers, (n,) of float, NaN for blank, nan, inf and what is too large; and columns of text.

    Raises
    ------
    RunsError
        If it is no table, or a column that must hold numbers holds something else.
    """
    if isinstance(content, bytes) and content.startswith(PARQUET_MAGIC):
        header, rows, columns = _parquet_columns(content, name)
    else:
        try:
            header, rows, columns = _csv_columns(_decoded(content, name), name, repairs)
        except csv.Error as error:
            raise RunsError(f"run {name}: not a readable CSV file: {error}", run=name) from error
    separator = next((mark for mark in _OTHER_SEPARATORS if len(header) == 1 and mark in header[0]), None)
    if separator is not None:
        raise RunsError(
            f"run {name}: its columns are separated by {_OTHER_SEPARATORS[separator]}; write commas, and a point in "
            "numbers",
            run=name,
        )
    twice = sorted({c for c in header if header.count(c) > 1})
    if twice:
        raise RunsError(f"run {name}: column {twice[0]!r} appears twice", run=name, column=twice[0])
    if rows < LEAST_ROWS:
        raise RunsError(f"run {name}: {rows} rows are too few, at least {LEAST_ROWS} are needed", run=name)
    numbers: dict[str, FloatArray] = {}
    texts: dict[str, TextArray] = {}
    for column, entries in zip(header, columns, strict=True):
        try:
            values = _numbers(entries)
        except ValueError:
            if _must_be_number(column):
                row = next(k for k, entry in enumerate(entries) if not _is_number(entry))
                raise _not_usable(name, column, row, entries[row], "is not a number") from None
            texts[column] = np.array(entries)
            continue
        too_large = np.isfinite(values) & (np.abs(values) > _LARGEST)
        if too_large.any() and _must_be_number(column):
            row = int(np.argmax(too_large))
            raise _not_usable(
                name, column, row, float(values[row]), f"is larger than {_LARGEST:g}: leave unknown cells blank"
            )
        numbers[column] = np.where(np.isfinite(values) & ~too_large, values, np.nan)
    return numbers, texts


def _must_be_number(column: str) -> bool:
    return column in NUMERIC_COLUMNS or column.startswith("current_")


def _not_usable(name: str, column: str, row: int, value: object, what: str) -> RunsError:
    line = row + 2  # counted from 1, after the header
    return RunsError(
        f"run {name}, column {column!r}, row {line}: {value!r} {what}",
        run=name,
        column=column,
        row=line,
        value=str(value),
    )


def _decoded(content: str | bytes, name: str) -> str:
    if isinstance(content, str):
        return content
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RunsError(f"run {name} is neither a text in CSV (UTF-8) nor a Parquet file: {error}", run=name) from error


def _csv_columns(text: str, name: str, repairs: dict[str, int]) -> tuple[list[str], int, Iterator[list[str]]]:
    """(header, number of rows, the cells of each column)."""
    header, widths, cells = _cells(text)
    if not header:
        raise RunsError(f"run {name}: the file is empty", run=name)
    if widths and widths[-1] < len(header):
        del cells[len(cells) - widths.pop() :]
        add_count(repairs, "truncated_rows", 1)
    for k, width in enumerate(widths):
        if width != len(header):
            raise RunsError(
                f"run {name}, row {k + 2}: {width} cells where the header has {len(header)} columns",
                run=name,
                row=k + 2,
            )
    return header, len(widths), (cells[k :: len(header)] for k in range(len(header)))


def _parquet_columns(content: bytes, name: str) -> tuple[list[str], int, Iterator[Sequence[str] | FloatArray]]:
    """(header, number of rows, each column as numbers with NaN for null, or as texts with "" for null)."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise RunsError(
            f"run {name}: reading Parquet needs pyarrow (pip install 'joulemap[parquet]'); CSV needs nothing", run=name
        ) from None
    try:
        table = pq.read_table(io.BytesIO(content))
    except (pa.ArrowInvalid, OSError) as error:
        raise RunsError(f"run {name}: not a readable Parquet file: {error}", run=name) from error

    def entries(column: Any) -> Sequence[str] | FloatArray:
        kind = column.type
        if pa.types.is_dictionary(kind):
            column = column.cast(kind.value_type)
            kind = column.type
        if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
            wide = pa.timestamp("ns", kind.tz) if pa.types.is_timestamp(kind) else pa.duration("ns")
            column = pa.compute.divide(column.cast(wide).cast(pa.int64()).cast(pa.float64(), safe=False), 1e9)
            kind = column.type
        if any(check(kind) for check in (pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean)):
            return np.asarray(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), dtype=np.float64)
        return ["" if value is None else str(value) for value in column.to_pylist()]

    return list(table.column_names), table.num_rows, (entries(column) for column in table.columns)


def _numbers(entries: Sequence[str] | FloatArray) -> FloatArray:
    """Numbers as they are, or of texts; ValueError for a text that is none."""
    if isinstance(entries, np.ndarray):
        return entries
    return np.array(list(map(float, entries)) if "" not in entries else _with_blanks(entries))


def _cells(text: str) -> tuple[list[str], list[int], list[str]]:
    """(header, cells per row, all cells of the body in one list); empty lines do not count."""
    if '"' in text:
        rows = [row for row in csv.reader(io.StringIO(text)) if row]
        flat = [cell for row in rows[1:] for cell in row]
        return [c.strip() for c in rows[0]], [len(row) for row in rows[1:]], flat
    lines = [line for line in text.replace("\r", "\n").split("\n") if line]  # a table without quotes needs no parser
    if not lines:
        return [], [], []
    body = lines[1:]
    return [c.strip() for c in lines[0].split(",")], [line.count(",") + 1 for line in body], ",".join(body).split(",")


def _with_blanks(entries: Sequence[str]) -> list[float]:
    return [float(entry) if entry else math.nan for entry in entries]


def _is_number(entry: str) -> bool:
    try:
        float(entry or "nan")
    except ValueError:
        return False
    return True
