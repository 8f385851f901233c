"""Logs as text: CSV of any shape, read by pyarrow. What is found out here is where the table begins, and how it is cut.

The separator is the one that divides the lines into most values. The header is the fullest line right above the first
row of values, whatever comments, remarks and headings come before it; a line of units may follow it.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from joulemap.model.errors import RunsError, TooLargeError
from joulemap.model.runs.formats.columns import named, stream_of
from joulemap.model.runs.formats.contract import Log, content_of
from joulemap.model.runs.formats.headerless import described, fields_of_row, is_numbered
from joulemap.model.runs.names import is_unit
from joulemap.model.runs.table import TableLimits, add_count
from joulemap.model.source_file import SourceFile

_SEPARATORS = (",", ";", "\t", "|")
_BEFORE_HEADER = re.compile(rb"(?:(?:[#%][^\n]*+)?+\n++)*+")  # comments and empty lines, millions too
_ENCODINGS = {  # of spreadsheets, with what tells each: four bytes in a row that no word of another has
    "cp932": re.compile(rb"(?:[\x81-\x98][\x40-\xfc]){2}"),
    "gb18030": re.compile(rb"(?:[\xb0-\xf7][\xa1-\xfe]){2}"),
    "cp1252": re.compile(b""),
}
_LONGEST_HEADER = 1_000_000  # bytes of the line with the names
_SAMPLE_LINES, _SAMPLE_BYTES = 100, 1 << 18
_COMMENT_LINES = 3  # before the table, which may be its header
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")
_NUMBER = re.compile(r"^[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?$")
_OF_VALUES = re.compile(r"[\d.:+/-]")
_SPACED = re.compile(r'(?:"[^"]*"|\S)+')  # a cell between spaces, which may be quoted
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
    separator, header, units, line, start = _header(content, name, limits, numbered=is_numbered(mapping))
    if separator == " ":
        content, start, line, separator = (
            _with_tabs(content[start:]),
            0,
            b"",
            "\t",
        )
    limits.check(content.count(b"\n", start) + (not content.endswith(b"\n")), len(header), name)
    quoted = content.find(b'"', start) >= 0
    body = _without_headers(content, start, line)
    if quoted:
        body = re.sub(
            re.escape(separator.encode()) + rb' +"', separator.encode() + b'"', _closed(bytes(body), name, repairs)
        )
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
            raise RunsError.of_run(name, f"not a readable CSV file: {str(error)[:200]}") from error
        body = _even(bytes(body), separator, len(columns), quoted, name, repairs)
        try:
            table = _read(body, options)
        except pa.ArrowInvalid as again_error:
            raise RunsError.of_run(name, f"not a readable CSV file: {str(again_error)[:200]}") from again_error
    if table is None:
        raise RunsError.of_run(name, "0 rows are too few, at least 5 are needed")
    return Log((stream_of(table, name, limits, dict(zip(columns, units, strict=False))),))


def _with_tabs(content: bytes) -> bytes:
    """Tabs in place of spaces between cells."""
    content = re.sub(rb"(?m)^[ \t]+", b"", content)
    if b'"' not in content:
        return re.sub(rb"[ \t]+", b"\t", content)
    return re.sub(rb'("[^"\n]*")|[ \t]+', lambda found: found[1] or b"\t", content)


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
        content = _decoded(content).encode()
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return content.removeprefix(_BYTE_ORDER_MARK)


def _decoded(content: bytes) -> str:
    """A text that is not in UTF-8: in Japanese, Chinese, or an encoding of Western Europe."""
    for encoding, telling in _ENCODINGS.items():
        with suppress(UnicodeDecodeError):
            if telling.search(content):
                return content.decode(encoding)
    return content.decode("latin-1")


def _no_text(name: str, error: Exception) -> RunsError:
    from joulemap.model.runs.formats import formats_in_words

    return RunsError.of_run(
        name, f" is neither a text in CSV (UTF-8) nor another log that is read ({formats_in_words()}): {error}"
    )


def _header(
    content: bytes, name: str, limits: TableLimits, *, numbered: bool = False
) -> tuple[str, list[str], list[str], bytes, int]:
    """(separator, names, units, the line with the names, where the rows begin [bytes])."""
    start = _BEFORE_HEADER.match(content).end()  # type: ignore[union-attr]
    line = content[start : _line_end(content, start)]
    limits.check(0, max(line.count(mark.encode()) for mark in _SEPARATORS) + 1, name)
    if len(line) > _LONGEST_HEADER:
        raise TooLargeError.of_run(
            name,
            f"its first line has {len(line):,} bytes, the limit is {_LONGEST_HEADER:,}",
            found=len(line),
            limit=_LONGEST_HEADER,
        )
    if start >= len(content):
        raise RunsError.of_run(name, "the file is empty")
    lines = _sample(content, start)
    if "\0" in lines[0].text:
        raise RunsError.of_run(
            name, "its first line has NUL characters, so it is no text in UTF-8: save it in that encoding"
        )
    comments = sum(line.after <= start for line in lines)
    separator = max((*_SEPARATORS, " "), key=lambda mark: _fit([line.text for line in lines[comments:]], mark))
    rows = [_cells(line.text, separator) for line in lines]
    values = [sum(map(_is_value, row)) for row in rows]
    usual = sorted(values)[len(values) * 3 // 4]
    first = _first_row(rows, values, usual)
    block = _block(rows, first)
    if not block:
        top = rows[first]
        if first <= comments and numbered:
            return separator, [""] * len(top), [], b"", start
        before = content[max(start - _SAMPLE_BYTES, 0) : start].decode("utf-8", "replace")
        names, units = described(before, len(top)) if first <= comments else ([], [])
        if names := names or fields_of_row(rows[0], [_is_value(cell) for cell in rows[0]]):
            return separator, names, units, b"", start
        if first <= comments and len(top) > 2 and all(map(_NUMBER.match, filter(None, top))):
            raise RunsError.of_run(
                name,
                f"its first line is {', '.join(top)[:80]!r}: write a line with the names of the columns above it, or "
                "say with a mapping which they are, such as t=column 1:ms,voltage=column 2:mV",
            )
        first = next((k for k, row in enumerate(rows) if any(row)), 0) + 1
        block = [first - 1]
    of_units = [k for k in block if k - 1 in block and _are_units(rows[k], len(rows[k]))]
    number = of_units[0] - 1 if of_units else max(block, key=lambda k: (len({*rows[k]} - {""}), -k))
    above = (row for row in rows[:number][::-1] if _are_units(row, len(rows[number])))
    units = rows[number + 1] if number + 1 in block else next(above, [])
    units = [cell.strip("[]() ") for cell in units]
    if any(line.raw == b"[column names]" for line in lines[:number]):  # of Racelogic: minutes, positive to the west
        units = [{"lat": "arcmin", "long": "arcmin west"}.get(column, "") for column in rows[number]]
    return separator, rows[number], units, lines[number].raw, lines[first - 1].after


@dataclass(frozen=True)
class _Line:
    """A line of the beginning: its text without the mark of a comment, its bytes, and where the next begins."""

    text: str
    raw: bytes
    after: int


def _sample(content: bytes, start: int) -> list[_Line]:
    """The last comments before `start`, where the others begin, and the lines after it."""
    at = start
    for _ in range(_COMMENT_LINES):
        at = content.rfind(b"\n", 0, max(at - 1, 0)) + 1
    lines = list[_Line]()
    while len(lines) < _SAMPLE_LINES and at < len(content) and at - start < _SAMPLE_BYTES + _LONGEST_HEADER:
        end = _line_end(content, at)
        text = content[at:end].decode("utf-8", "replace")
        lines.append(
            _Line(text.lstrip("#% ") if at < start else text, content[at:end].rstrip(), min(end + 1, len(content)))
        )
        at = end + 1
    return lines


def _are_units(row: Sequence[str], columns: int) -> bool:
    """Whether most cells are units, of most columns: the first may be a heading."""
    words = [cell.strip("[]() ") for cell in row[1:] if cell]
    units = sum(is_unit(word) and not _NUMBER.match(word) for word in words)
    return 2 * len(words) > columns - 1 and 2 * units > len(words)


def _first_row(rows: Sequence[Sequence[str]], values: Sequence[int], usual: int) -> int:
    """Where the largest block of values begins: lines of words, which are no row of one mark, divide blocks."""
    filled = [k for k, row in enumerate(rows) if any(row)]
    blocks, begin, headers = dict[int, int](), -1, list[Sequence[str]]()
    for k, after in zip(filled, [*filled[1:], filled[-1]], strict=True):
        if values[k] == 0 and len({*rows[k]} - {""}) > 1 and 2 * sum(map(bool, rows[k])) >= usual:
            begin = begin if rows[k] in headers else -1  # that of two logs joined is repeated
            headers.append(rows[k])
        full = values[k] > 0 and 2 * values[k] >= usual
        if full and begin < 0 and (after == k or 2 * values[after] >= usual):
            begin = k
        if full and begin >= 0:
            blocks[begin] = blocks.get(begin, 0) + 1
    return max(blocks, key=lambda each: blocks[each], default=0)


def _block(rows: Sequence[Sequence[str]], first: int) -> list[int]:
    """Which lines right above the first row of values may be its header, or tell of its columns."""
    wide, found = len(rows[first]), list[int]()
    for k in range(first - 1, -1, -1):
        filled = sum(map(bool, rows[k]))
        if filled > 1 and 2 * len(rows[k]) >= wide:
            found.insert(0, k)
        elif found or filled > 1:  # a remark
            break
    return found


def _is_value(cell: str) -> bool:
    """Whether a cell is a number, a date or degrees, and no name, which may begin with a digit, too."""
    marks = len(_OF_VALUES.findall(cell))
    return marks > 0 and 2 * marks >= len(cell)


def _fit(lines: Sequence[str], separator: str) -> tuple[int, int]:
    """Into how many numbers a separator divides lines, and, negative, how many other cells there are; without numbers,
    into how many cells, where spaces divide words and not cells.
    """
    cells = [cell for line in lines for cell in _cells(line, separator)]
    numbers = sum(bool(_NUMBER.match(cell)) for cell in cells)
    return numbers, numbers - sum(map(bool, cells)) if numbers else len(cells) * (separator != " ")


def _line_end(content: bytes, start: int) -> int:
    end = content.find(b"\n", start)
    return end if end >= 0 else len(content)


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return [cell.strip('"') for cell in _SPACED.findall(line)]
    try:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
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
        raise RunsError.of_run(
            name,
            f", row {row + 2}: a quote is opened there and never closed: the {len(lines) - 1 - row:,} lines "
            "after it cannot be read",
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
            raise RunsError.of_run(name, f"a row cannot be divided into cells: {error}") from error
    else:
        rows = [line.split(separator) for line in text.split("\n") if line]
    if rows and len(rows[-1]) < width:
        rows.pop()
        add_count(repairs, "truncated_rows", 1)
    longer = sum(len(row) > width and any(row[width:]) for row in rows)
    if 2 * longer > len(rows):
        raise RunsError.of_run(
            name,
            f", row 2: {len(rows[0])} cells where the header has {width} columns, as in most rows: if its "
            "commas are decimal marks, save it with semicolons between the cells",
            row=2,
        )
    add_count(repairs, "ragged_rows", sum(len(row) != width for row in rows))
    out = io.StringIO()
    csv.writer(out, delimiter=separator, lineterminator="\n").writerows(
        row[:width] + [""] * (width - len(row)) for row in rows
    )
    return out.getvalue().encode()
