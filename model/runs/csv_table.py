"""Logs in CSV: read block by block, so that memory is taken for numbers and not for their texts.

The separator is the comma, the semicolon or the tab, whichever the header line has most of. Where it is not the comma,
a comma in a number is the decimal point. Lines before the header that begin with # or % are comments.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain

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

_SEPARATORS = (",", ";", "\t")
_BEFORE_HEADER = re.compile(rb"(?:(?:[#%][^\r\n]*+)?+[\r\n]++)*+")  # comments and empty lines, millions too
_OTHER_ENCODING = "cp1252"  # what spreadsheets write in Western Europe and America
_LONGEST_HEADER = 1_000_000  # bytes of the line with the names
_BLOCK_BYTES = 1 << 22
_BLOCK_CELLS = 500_000  # of a table with quotes
_END = "\0end"  # a last line, which becomes part of a cell where a quote is never closed
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")

Block = tuple[list[int], list[str]]
"""Cells of each row, and all cells of these rows one after the other."""


def recognise(head: bytes, name: str) -> bool:
    """Take any file: what is no text is refused as it is read.

    Parameters
    ----------
    head : bytes
        First bytes of the file.
    name : str
        Its name.

    Returns
    -------
    bool
        True.
    """
    return True


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read a table from a text in CSV.

    Parameters
    ----------
    source : SourceFile
        The text.
    mapping : mapping of str to str
        Not used: all columns are read.
    limits : TableLimits
        How large it may be.
    repairs : dict
        Counts by rule, which are added to.

    Returns
    -------
    Log
        Of one stream.

    Raises
    ------
    RunsError
        As `read_csv`.
    TooLargeError
        As `read_csv`.
    """
    numbers, texts, _ = read_csv(content_of(source), source.name, repairs, limits)
    return Log((Stream("", numbers, texts),))


def read_csv(
    content: bytes, name: str, repairs: dict[str, int], limits: TableLimits
) -> tuple[dict[str, FloatArray], dict[str, TextArray], int]:
    """Read a table from a text in CSV; empty lines do not count.

    Parameters
    ----------
    content : bytes
        Of the whole file, in UTF-8.
    name : str
        Of the run, for messages.
    repairs : dict
        Counts by rule, which are added to: a last line that breaks off is dropped and counted.
    limits : TableLimits
        How large it may be.

    Returns
    -------
    tuple of (dict, dict, int)
        Columns of numbers, (n,) of float, NaN for blank; columns of text; and the number of rows.

    Raises
    ------
    RunsError
        If it is no table, or a column that must hold numbers holds something else.
    TooLargeError
        If it is larger than the limits.
    """
    start = len(_BYTE_ORDER_MARK) if content.startswith(_BYTE_ORDER_MARK) else 0
    try:
        return _read(content, start, name, repairs, limits)
    except csv.Error as error:
        raise RunsError(f"run {name}: not a readable CSV file: {error}", run=name) from error
    except UnicodeDecodeError as error:
        text = _other_text(content)
        if text is not None:
            return read_csv(text, name, repairs, limits)
        from joulemap.model.runs.formats import formats_in_words

        raise RunsError(
            f"run {name} is neither a text in CSV (UTF-8) nor another log that is read ({formats_in_words()}): {error}",
            run=name,
        ) from error


def _other_text(content: bytes) -> bytes | None:
    """A text of another encoding as UTF-8; None where the content is no text."""
    try:
        if content.startswith((b"\xff\xfe", b"\xfe\xff")):
            return content.decode("utf-16").encode()
        if _CONTROL.search(content):
            return None
        return content.decode(_OTHER_ENCODING).encode()
    except UnicodeError:
        return None


def _read(
    content: bytes, start: int, name: str, repairs: dict[str, int], limits: TableLimits
) -> tuple[dict[str, FloatArray], dict[str, TextArray], int]:
    start = _BEFORE_HEADER.match(content, start).end()  # type: ignore[union-attr]
    end = _line_end(content, start)
    first = content[start:end]
    separator = max(_SEPARATORS, key=lambda mark: first.count(mark.encode()))
    columns = first.count(separator.encode()) + 1
    last = content.endswith((b"\n", b"\r"))
    lines = content.count(b"\n", end) + content.count(b"\r", end) - content.count(b"\r\n", end) - last
    limits.check(0, columns, name)
    if len(first) > _LONGEST_HEADER:
        raise TooLargeError(
            f"run {name}: its first line has {len(first):,} bytes, the limit is {_LONGEST_HEADER:,}",
            run=name,
            found=len(first),
            limit=_LONGEST_HEADER,
        )
    quoted = b'"' in content
    header = _header(content, start, end, quoted, separator)
    if not header:
        raise RunsError(f"run {name}: the file is empty", run=name)
    if any("\0" in column for column in header):
        raise RunsError(
            f"run {name}: its first line has NUL characters, so it is no text in UTF-8: save it in that encoding",
            run=name,
        )
    named = [column for column in header if column]
    if len(named) < len(header) - 1:
        raise RunsError(f"run {name}: {len(header) - len(named)} of its {len(header)} columns have no name", run=name)
    if len(named) > 2 and all(map(_is_a_number, named)):
        raise RunsError(
            f"run {name}: its first line is {', '.join(named)[:80]!r}: write a line with the names of the columns "
            "above it",
            run=name,
        )
    check_names(header, name)
    limits.check(lines, len(header), name)

    def _blocks() -> Iterator[Block]:
        width = len(header)
        if quoted:
            blocks = _quoted_blocks(content, start, width, name, separator)
        else:
            blocks = _plain_blocks(content, end, width, name, separator)
        return _whole_rows(blocks, width, name, repairs)

    parts: dict[str, list[FloatArray]] = {column: [] for column in header}
    rows = 0
    for widths, cells in _blocks():
        for k, column in enumerate(header):
            if column not in parts:
                continue
            entries = cells[k :: len(header)]
            try:
                parts[column].append(_numbers(entries, separator))
            except ValueError:
                if must_be_number(column) and column != "t":  # a time may be a text
                    raise not_a_number(name, column, entries, rows) from None
                del parts[column]  # a column of text, which is read again below
        rows += len(widths)
    numbers = {column: np.concatenate(found or [np.empty(0)]) for column, found in parts.items()}
    words = {column: k for k, column in enumerate(header) if column not in parts}
    texts = _texts(_blocks(), words, len(header), rows, name, limits) if words else {}
    return numbers, texts, rows


def _numbers(entries: list[str], separator: str) -> FloatArray:
    try:
        return numbers_of(entries)
    except ValueError:
        if separator == ",":
            raise
        return numbers_of([entry.replace(",", ".") for entry in entries])


def _is_a_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _texts(
    blocks: Iterator[Block], words: dict[str, int], width: int, rows: int, name: str, limits: TableLimits
) -> dict[str, TextArray]:
    longest = dict.fromkeys(words, 0)
    parts: dict[str, list[TextArray]] = {column: [] for column in words}
    for _, cells in blocks:
        for column, k in words.items():
            entries = cells[k::width]
            longest[column] = max(longest[column], max(map(len, entries), default=0))
            limits.check_texts(rows, sum(longest.values()), name, column)
            parts[column].append(np.array(entries, dtype=np.str_))
    return {column: np.concatenate(found) for column, found in parts.items()}


def _line_end(content: bytes, start: int) -> int:
    ends = [end for end in (content.find(b"\n", start), content.find(b"\r", start)) if end >= 0]
    return min(ends, default=len(content))


def _header(content: bytes, start: int, end: int, quoted: bool, separator: str) -> list[str]:
    line = content[start:end].decode("utf-8")
    if quoted:
        names = next((row for row in csv.reader(_text(content, start), delimiter=separator) if row), [])
    else:
        names = line.split(separator) if line else []
    return [name.strip() for name in names]


def _text(content: bytes, start: int) -> io.TextIOWrapper:
    stream = io.BytesIO(content)  # shares the bytes
    stream.seek(start)
    return io.TextIOWrapper(stream, encoding="utf-8", newline="")


def _plain_blocks(content: bytes, start: int, columns: int, name: str, separator: str) -> Iterator[Block]:
    """A table without quotes needs no parser."""
    rows = 0
    while start < len(content):
        end = start + _BLOCK_BYTES
        if end < len(content):
            cut = max(content.rfind(b"\n", start, end), content.rfind(b"\r", start, end))
            end = cut if cut > start else _line_end(content, end)
        text = content[start : end + 1].decode("utf-8").replace("\r", "\n")
        lines = [line for line in text.split("\n") if line]
        start = end + 1
        if not lines:
            continue
        widths = [line.count(separator) + 1 for line in lines]
        if max(widths) > columns:
            raise _wrong_width(widths, columns, rows, name)
        rows += len(widths)
        yield widths, separator.join(lines).split(separator)


def _quoted_blocks(content: bytes, start: int, columns: int, name: str, separator: str) -> Iterator[Block]:
    rows = (row for row in csv.reader(chain(_text(content, start), [_END]), delimiter=separator) if row)
    next(rows, None)  # the header
    widths: list[int] = []
    cells: list[str] = []
    before = 0
    try:
        for row in rows:
            if row == [_END]:
                break
            if row[-1].endswith(_END):
                row = _broken_off(row, before + len(widths) + 2, name)
            widths.append(len(row))
            if len(row) > columns:
                raise _wrong_width(widths, columns, before, name)
            cells += row
            if len(cells) >= _BLOCK_CELLS:
                yield widths, cells
                before += len(widths)
                widths, cells = [], []
    except csv.Error as error:
        row_number = before + len(widths) + 2
        raise RunsError(
            f"run {name}, row {row_number}: {error}: is a quote opened there and never closed?",
            run=name,
            row=row_number,
        ) from error
    if widths:
        yield widths, cells


def _broken_off(row: list[str], number: int, name: str) -> list[str]:
    """A last row whose quote is not closed, without that cell. Raises RunsError if further lines are in the quote."""
    lines = row[-1].removesuffix(_END).rstrip("\r\n").splitlines()
    if len(lines) > 1:
        raise RunsError(
            f"run {name}, row {number}: a quote is opened there and never closed: the {len(lines) - 1:,} lines after "
            "it cannot be read",
            run=name,
            row=number,
        )
    return row[:-1]


def _whole_rows(blocks: Iterator[Block], columns: int, name: str, repairs: dict[str, int]) -> Iterator[Block]:
    """The blocks without a last row that breaks off. Raises RunsError for any other row of another length."""
    rows, block = 0, next(blocks, None)
    while block is not None:
        following = next(blocks, None)
        widths, cells = block
        if following is None and widths[-1] < columns:
            del cells[len(cells) - widths.pop() :]
            repairs["truncated_rows"] = 1
        if any(width != columns for width in widths):
            raise _wrong_width(widths, columns, rows, name)
        rows += len(widths)
        yield widths, cells
        block = following


def _wrong_width(widths: Sequence[int], columns: int, rows: int, name: str) -> RunsError:
    k = next(k for k, width in enumerate(widths) if width != columns)
    line = rows + k + 2  # counted from 1, after the header
    return RunsError(
        f"run {name}, row {line}: {widths[k]} cells where the header has {columns} columns", run=name, row=line
    )
