"""Logs as text: CSV of any shape, read by pyarrow. What is found out here is where the table begins, and how it is cut.

Of lines before the header, comments and remarks are passed over. The separator is the one of which the lines have most:
the comma, the semicolon, the tab, the bar, or spaces. A second line of the header may hold units.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Mapping

from joulemap.model.errors import RunsError, TooLargeError
from joulemap.model.runs.formats.columns import named, stream_of
from joulemap.model.runs.formats.contract import Log, content_of
from joulemap.model.runs.table import TableLimits, add_count
from joulemap.model.source_file import SourceFile

_SEPARATORS = (",", ";", "\t", "|")
_BEFORE_HEADER = re.compile(rb"(?:(?:[#%][^\n]*+)?+\n++)*+")  # comments and empty lines, millions too
_OTHER_ENCODING = "cp1252"  # what spreadsheets write in Western Europe and America
_LONGEST_HEADER = 1_000_000  # bytes of the line with the names
_SAMPLE_LINES, _SAMPLE_BYTES = 40, 1 << 18
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")
_NUMBER = re.compile(r"^[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?$")
_BLOCK_BYTES = 1 << 22


def recognise(head: bytes, name: str) -> bool:
    """Take any file: what is no text is refused as it is read."""
    return True


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read a table from a text."""
    import pyarrow as pa
    from pyarrow import csv as arrow

    name = source.name
    content = _utf8(content_of(source), name)
    separator, header, units, line, start = _header(content, name, limits)
    if separator == " ":
        content, start, line, separator = (
            re.sub(rb"[ \t]+", b"\t", re.sub(rb"(?m)^[ \t]+", b"", content[start:])),
            0,
            b"",
            "\t",
        )
    limits.check(content.count(b"\n", start) + (not content.endswith(b"\n")), len(header), name)
    quoted = content.find(b'"', start) >= 0
    body = _without_headers(content, start, line)
    if quoted:
        body = _closed(bytes(body), name, repairs)
    columns = named(header)
    options = {
        # a small file needs no threads, and a process that has none may be forked
        "read_options": arrow.ReadOptions(
            column_names=columns, block_size=_BLOCK_BYTES, use_threads=len(body) > _BLOCK_BYTES
        ),
        "parse_options": arrow.ParseOptions(
            delimiter=separator, quote_char='"' if quoted else False, newlines_in_values=quoted
        ),
        "convert_options": arrow.ConvertOptions(null_values=["", "NA", "N/A", "n/a", "nan", "NaN", "null", "NULL"]),
    }
    try:
        table = _read(body, options) if len(body) and not bytes(body[:100]).isspace() else None
    except pa.ArrowInvalid as error:
        if "olumns, got" not in str(error):
            raise RunsError(f"run {name}: not a readable CSV file: {str(error)[:200]}", run=name) from error
        body = _even(bytes(body), separator, len(columns), quoted, name, repairs)
        try:
            table = _read(body, options)
        except pa.ArrowInvalid as again_error:
            raise RunsError(f"run {name}: not a readable CSV file: {str(again_error)[:200]}", run=name) from again_error
    if table is None:
        raise RunsError(f"run {name}: 0 rows are too few, at least 5 are needed", run=name)
    return Log((stream_of(table, name, limits, dict(zip(columns, units, strict=False))),))


def _without_headers(content: bytes, start: int, line: bytes) -> memoryview | bytes:
    """The rows without further lines with the names, as where two logs were joined."""
    if not line or content.find(b"\n" + line, start) < 0:
        return memoryview(content)[start:]
    return re.sub(rb"(?m)^" + re.escape(line) + rb" *\n", b"", content[start:])


def _read(body: memoryview | bytes, options: Mapping[str, object]) -> object:
    import pyarrow as pa
    from pyarrow import csv as arrow

    return arrow.read_csv(pa.BufferReader(pa.py_buffer(body)), **options)


def _utf8(content: bytes, name: str) -> bytes:
    """The text in UTF-8 with line feeds only."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        try:
            content = content.decode("utf-16").encode()
        except UnicodeError as error:
            raise _no_text(name, error) from error
    try:
        if not content.isascii():
            content.decode("utf-8")  # as fast as copying, and says where
    except UnicodeDecodeError as error:
        if _CONTROL.search(content):
            raise _no_text(name, error) from error
        try:
            content = content.decode(_OTHER_ENCODING).encode()
        except UnicodeError:
            content = content.decode("latin-1").encode()
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return content.removeprefix(_BYTE_ORDER_MARK)


def _no_text(name: str, error: Exception) -> RunsError:
    from joulemap.model.runs.formats import formats_in_words

    return RunsError(
        f"run {name} is neither a text in CSV (UTF-8) nor another log that is read ({formats_in_words()}): {error}",
        run=name,
    )


def _header(content: bytes, name: str, limits: TableLimits) -> tuple[str, list[str], list[str], bytes, int]:
    """(separator, names, units, the line with the names, where the rows begin [bytes])."""
    start = _BEFORE_HEADER.match(content).end()  # type: ignore[union-attr]
    first = content[start : _line_end(content, start)]
    limits.check(0, max(first.count(mark.encode()) for mark in _SEPARATORS) + 1, name)
    if len(first) > _LONGEST_HEADER:
        raise TooLargeError(
            f"run {name}: its first line has {len(first):,} bytes, the limit is {_LONGEST_HEADER:,}",
            run=name,
            found=len(first),
            limit=_LONGEST_HEADER,
        )
    lines: list[tuple[str, int]] = []
    at = start
    while len(lines) < _SAMPLE_LINES and at < len(content) and at - start < _SAMPLE_BYTES + len(first):
        end = _line_end(content, at)
        lines.append((content[at:end].decode("utf-8", "replace"), end + 1))
        at = end + 1
    if not lines:
        raise RunsError(f"run {name}: the file is empty", run=name)
    if any("\0" in line for line, _ in lines[:1]):
        raise RunsError(
            f"run {name}: its first line has NUL characters, so it is no text in UTF-8: save it in that encoding",
            run=name,
        )
    separator, usual = _separator([line for line, _ in lines])
    rows = [(_cells(line, separator), after) for line, after in lines]
    number = next((k for k, (cells, _) in enumerate(rows) if 2 * len(cells) >= usual and any(cells)), 0)
    header, after = rows[number]
    numbers = [bool(_NUMBER.match(cell)) for cell in header]
    said = content[:start].decode("utf-8", "replace").splitlines()
    comment = _cells(said[-1].lstrip("#% "), separator) if said else []
    if 2 * sum(numbers) > len(header) > 2 and len(comment) == len(header) and not any(map(_NUMBER.match, comment)):
        return separator, comment, [], b"", start
    if len(header) > 2 and all(map(_NUMBER.match, filter(None, header))):
        raise RunsError(
            f"run {name}: its first line is {', '.join(header)[:80]!r}: write a line with the names of the columns "
            "above it",
            run=name,
        )
    units: list[str] = []
    if number + 2 < len(rows):
        second, third = rows[number + 1][0], rows[number + 2][0]
        numbers = [bool(_NUMBER.match(cell)) for cell in third]
        if sum(numbers) >= 2 and not any(_NUMBER.match(cell) for cell in second) and any(second):
            units, after = [cell.strip("[]() ") for cell in second], rows[number + 1][1]
    return separator, header, units, lines[number][0].encode().rstrip(), min(after, len(content))


def _line_end(content: bytes, start: int) -> int:
    end = content.find(b"\n", start)
    return end if end >= 0 else len(content)


def _separator(lines: list[str]) -> tuple[str, int]:
    """The mark between cells, and how many cells most lines have."""
    widths = {}
    for mark in _SEPARATORS:
        counts = Counter(line.count(mark) + 1 for line in lines if line)
        widths[mark] = max(counts.items(), key=lambda found: (found[1] * (found[0] > 1), found[0]))[0] if counts else 1
    best = max(_SEPARATORS, key=lambda mark: (lines[0].count(mark) > 0 or widths[mark] > 2, widths[mark]))
    if ";" in lines[0] and widths[";"] > 1 and best == ",":  # the commas are those of numbers
        best = ";" if widths[";"] >= lines[0].count(",") + 1 else best
    if widths[best] < 2 and len(lines[0].split()) > 2:
        return " ", len(lines[0].split())
    return best, widths[best]


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    try:
        cells = next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        cells = line.split(separator)
    return [cell.strip() for cell in cells]


def _closed(body: bytes, name: str, repairs: dict[str, int]) -> bytes:
    """The rows without a last one whose quote is not closed. Raises RunsError if further lines are in the quote."""
    if body.count(b'"') % 2 == 0:
        return body
    lines = body.rstrip(b"\n").split(b"\n")
    row = max(k for k, line in enumerate(lines) if line.count(b'"') % 2)
    if row < len(lines) - 1:
        raise RunsError(
            f"run {name}, row {row + 2}: a quote is opened there and never closed: the {len(lines) - 1 - row:,} lines "
            "after it cannot be read",
            run=name,
            row=row + 2,
        )
    add_count(repairs, "truncated_rows", 1)
    return b"\n".join(lines[:-1])


def _even(body: bytes, separator: str, width: int, quoted: bool, name: str, repairs: dict[str, int]) -> bytes:
    """Rows as long as the header: a last one that breaks off is dropped, others are cut or filled with blanks."""
    text = body.decode("utf-8")
    if quoted:
        try:
            rows = [row for row in csv.reader(io.StringIO(text, newline=""), delimiter=separator) if row]
        except csv.Error as error:
            raise RunsError(f"run {name}: a row cannot be divided into cells: {error}", run=name) from error
    else:
        rows = [line.split(separator) for line in text.split("\n") if line]
    if rows and len(rows[-1]) < width:
        rows.pop()
        add_count(repairs, "truncated_rows", 1)
    longer = sum(len(row) > width and any(row[width:]) for row in rows)
    if 2 * longer > len(rows):
        raise RunsError(
            f"run {name}, row 2: {len(rows[0])} cells where the header has {width} columns, as in most rows: if its "
            "commas are decimal marks, save it with semicolons between the cells",
            run=name,
            row=2,
        )
    add_count(repairs, "ragged_rows", sum(len(row) != width for row in rows))
    out = io.StringIO()
    csv.writer(out, delimiter=separator, lineterminator="\n").writerows(
        row[:width] + [""] * (width - len(row)) for row in rows
    )
    return out.getvalue().encode()
