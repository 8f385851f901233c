"""Logs in JSON: a line for each record, or a document with a list of records or of columns somewhere inside."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.runs.formats.columns import stream_of
from joulemap.model.runs.formats.contract import Log, content_of
from joulemap.model.runs.names import words_of
from joulemap.model.runs.table import LARGEST, LEAST_ROWS, LONGEST_NAME, TableLimits
from joulemap.model.source_file import SourceFile

DEEPEST = 12
"""Setting: how many objects and lists may lie in each other."""
_ORDERS = {"coordinates": ("lon", "lat", "alt"), **dict.fromkeys(("latlng", "latlon", "lat_lng"), ("lat", "lon"))}
_BEGINNING = re.compile(rb'(?:\xef\xbb\xbf)?\s*(?:\{|\[\s*[{\["]|(?:[^\s{}\[\]",;]+ ){1,3}\{ ?")')
_NAMES = ("path", "name", "target", "key", "type", "field", "signal")
_LONGEST_LIST = 16  # a longer list in a record is no reading


def recognise(head: bytes, name: str) -> bool:
    """Decide by the first two tokens: `[0.1] x=1` and `[INFO] [12.5]` begin lines of a text."""
    return _BEGINNING.match(head) is not None


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the records."""
    name = source.name
    content = content_of(source).removeprefix(b"\xef\xbb\xbf")
    try:
        lines = content.split(b"\n") if content.lstrip()[:1] != b"[" else []
        if len(lines) > 1 and _whole(lines[0]):
            table = columns_of(_lines(lines, repairs), name, limits)
            return Log((stream_of(table, name, limits, dict(_units(json.loads(lines[0][lines[0].find(b"{") :])))),))
        return log_of(json.loads(content), "JSON", name, limits)
    except (ValueError, RecursionError) as error:
        whole = content.rstrip()[-1:] in (b"}", b"]")
        why = str(error)[:200] if whole else f"it breaks off after {content.rstrip()[-20:].decode(errors='replace')!r}"
        raise RunsError.of_run(name, f"not a readable JSON text: {why}") from error


def columns_of(records: Iterable[Mapping[str, Any]], name: str, limits: TableLimits) -> Any:
    """Return records as a table.

    A field that a record lacks is unknown there; fields of fewer than `LEAST_ROWS` records are left out.
    """
    import pyarrow as pa

    columns: dict[str, tuple[list[int], list[Any]]] = {}
    rows = 0
    for record in records:
        for key, value in record.items():
            if key not in columns:
                limits.check(rows, len(columns) + 1, name)
            at, values = columns.setdefault(key, ([], []))
            at.append(rows)
            values.append(value)
        rows += 1
        if rows % 1000 == 0:
            limits.check(rows, 1, name)
    known = {
        key: found for key, found in columns.items() if len(found[0]) >= LEAST_ROWS
    }  # fewer say nothing of a drive
    limits.check(rows, len(known), name)
    return pa.table({key[:LONGEST_NAME]: _array(rows, *found) for key, found in known.items()})


def _array(rows: int, at: list[int], values: list[Any]) -> Any:
    import pyarrow as pa

    if all(value is None or (isinstance(value, int | float) and not isinstance(value, bool)) for value in values):
        numbers = np.full(rows, np.nan)
        numbers[at] = [np.nan if value is None else float(min(max(value, -LARGEST), LARGEST)) for value in values]
        return pa.array(numbers)
    words: list[str | None] = [None] * rows
    for row, value in zip(at, values, strict=True):
        words[row] = None if value is None else str(value)
    return pa.array(words, pa.string())


def log_of(document: Any, kind: str, name: str, limits: TableLimits) -> Log:
    """Return the longest list of records of a document."""
    best = max(_tables(document, 0), key=len, default=[])
    if len(best) < LEAST_ROWS:
        raise RunsError.of_run(name, f"the {kind} text holds no list of {LEAST_ROWS} records or more")
    return Log((stream_of(columns_of(map(flat, best), name, limits), name, limits, dict(_units(document))),))


def _whole(line: bytes) -> bool:
    try:
        return isinstance(json.loads(line[line.find(b"{") :]), dict)
    except ValueError:
        return False


def _lines(lines: list[bytes], repairs: dict[str, int]) -> Iterator[dict[str, Any]]:
    """A record of each line, with the stamp and the topic that stand before it."""
    filled = [line for line in lines if line.strip()]
    for number, line in enumerate(filled):
        before, brace, rest = line.partition(b"{")
        try:
            record = flat(json.loads(brace + rest))
        except ValueError:
            if number < len(filled) - 1:
                raise
            repairs["truncated_rows"] = 1
            return
        for word in before.decode("utf-8", "replace").split():
            record.setdefault("time" if word[0].isdigit() else "topic", word)
        yield record


def _tables(value: Any, depth: int) -> Iterator[list[Any]]:
    """Lists of records: of objects, of objects in objects by number, or lists of equal length side by side."""
    if depth > DEEPEST:
        return
    if isinstance(value, list):
        series = [each for item in value if isinstance(item, dict) for each in _series(item)]
        if series:
            yield series
        columns = {_name_of(item): _only_list(item) for item in value[:LONGEST_NAME] if isinstance(item, dict)}
        if len(columns) > 1 and all(name and _is_long(each) for name, each in columns.items()):
            yield from _tables(columns, depth + 1)
        if len(value) >= LEAST_ROWS and all(isinstance(item, dict) for item in value):
            yield value
        elif len(value) >= LEAST_ROWS and all(isinstance(item, list) for item in value):
            header = value[0]
            if all(isinstance(word, str) for word in header):  # a table with its header
                yield [dict(zip(header, row, strict=False)) for row in value[1:]]
        for item in value[:LEAST_ROWS]:
            yield from _tables(item, depth + 1)
    elif isinstance(value, dict):
        named = _named(value)
        values = (item for item in value.values() if isinstance(item, list) and len(item) >= LEAST_ROWS)
        for item in values:  # of columns that are named beside them
            if isinstance(item[0], list) and len(item[0]) == len(named) and not _are_words(item[0]):
                rows = zip(_index(value, len(item)), item, strict=True)
                yield [first | dict(zip(named, row, strict=False)) for first, row in rows if isinstance(row, list)]
        inside = [item for item in value.values() if isinstance(item, dict)]
        yield from _by_column(value)
        lists = {key: each for item in inside for key, each in item.items() if _is_long(each)}
        if len(inside) > 1 and len(lists) > 1:  # coordinates, and beside them what was measured at each
            yield from _tables(lists, depth + 1)
        value = {key: _only_list(item) for key, item in value.items()}
        lists = {key: item for key, item in value.items() if isinstance(item, list) and len(item) >= LEAST_ROWS}
        lengths = {len(item) for item in lists.values()}
        plain = [key for key, item in lists.items() if not isinstance(item[0], dict) and not _is_long(item[0])]
        keys = {key: frozenset(item[0]) for key, item in lists.items() if isinstance(item[0], dict)}
        if len(keys) > 1 and len({*keys.values()}) == 1:
            yield [{"name": key} | row for key in keys for row in lists[key] if isinstance(row, dict)]
        if len(plain) > 1 and len(lengths) == 1:
            yield [dict(zip(plain, row, strict=True)) for row in zip(*(lists[key] for key in plain), strict=True)]
        elif len(value) >= LEAST_ROWS and all(isinstance(item, dict) and item for item in value.values()):
            yield [{"key": key} | item for key, item in value.items()]
        for item in value.values():
            yield from _tables(item, depth + 1)


def _named(value: Mapping[str, Any]) -> list[str]:
    """The names of columns: a list of words, of which none is a unit."""
    words = [item for key, item in value.items() if isinstance(item, list) and _are_words(item) and not _of_unit(key)]
    return words[0] if words else []


def _by_column(value: Mapping[str, Any]) -> Iterator[list[Any]]:
    """The records of a table of pandas whose columns are objects, with a field for each row."""
    columns = [item for item in value.values() if isinstance(item, dict)]
    if len(columns) < 2 or len(columns) < len(value) or len(columns[0]) < LEAST_ROWS:
        return
    rows = [*columns[0]]
    if all(item.keys() == columns[0].keys() for item in columns):
        index = _index({"index": [int(row) if row.isdecimal() else row for row in rows]}, len(rows))
        yield [first | {key: item[row] for key, item in value.items()} for first, row in zip(index, rows, strict=True)]


def _index(value: Mapping[str, Any], rows: int) -> list[dict[str, Any]]:
    """The index of a table of pandas, by row; nothing where it only counts the rows."""
    index = value.get("index")
    if not isinstance(index, list) or len(index) != rows or index == [*range(rows)]:
        return [{}] * rows
    return [{"index": each} for each in index]


def _of_unit(key: str) -> bool:
    return "unit" in key.lower() and bool({"unit", "units"} & {*words_of(key)})


def _units(value: Any, name: str = "", depth: int = 0) -> Iterator[tuple[str, str]]:
    """Units that stand beside the data, by the name of a column: an object `units`, a list of them beside that of the
    names, or one in what describes a column.
    """
    if depth > DEEPEST:
        return
    if isinstance(value, list):
        for item in value[:LONGEST_NAME]:
            yield from _units(item, _name_of(item), depth + 1)
    elif isinstance(value, dict):
        for key, item in value.items():
            if not _of_unit(key):
                yield from _units(item, key, depth + 1) if isinstance(item, dict | list) else ()
            elif isinstance(item, dict):
                yield from ((column, str(unit)) for column, unit in flat(item).items())
            elif isinstance(item, list) and len(item) == len(_named(value)):
                yield from zip(_named(value), map(str, item), strict=True)
            elif isinstance(item, str) and name:
                yield name, item


def _series(item: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The values of a series that is named beside them: `{"metric": {...}, "values": [[1709994611, "5.2"], ...]}`."""
    lists = [each for key, each in item.items() if _is_long(each) and key not in _ORDERS]
    pairs = [each for each in lists if all(isinstance(pair, list) and len(pair) == 2 for pair in each)]
    name = _name_of(item)
    if len(pairs) == 1 and name and name not in _ORDERS:
        yield from ({"time": time, "name": name, "value": value} for time, value in pairs[0])


def _name_of(item: Any) -> str:
    """What a record says that it is of; empty where it says nothing."""
    plain = {key: each for key, each in item.items() if not isinstance(each, list)} if isinstance(item, dict) else {}
    words = flat(plain)
    return next((str(words[key]) for key in words if key.rpartition(".")[2].strip("_") in _NAMES), "")


def _own_name(item: Any) -> str:
    """What a record in a list says that it is of, itself and not one of its parts."""
    words = [item[key] for key in _NAMES if isinstance(item.get(key), str)] if isinstance(item, dict) else []
    return words[0] if words else ""


def _only_list(item: Any) -> Any:
    """The list of a column with remarks, `{"data": [...], "type": "time"}`."""
    lists = [each for each in item.values() if _is_long(each)] if isinstance(item, dict) else []
    return lists[0] if len(lists) == 1 and not any(isinstance(each, dict) for each in item.values()) else item


def _is_long(item: Any) -> bool:
    return isinstance(item, list) and len(item) >= LEAST_ROWS


def _are_words(items: list[Any]) -> bool:
    return len(items) > 1 and all(isinstance(item, str) for item in items)


def flat(value: Any, front: str = "", depth: int = 0) -> dict[str, Any]:
    """Return numbers and texts by their path; coordinates are in the order of GeoJSON."""
    if isinstance(value, list):
        if len(value) > _LONGEST_LIST or depth > DEEPEST:
            return {}
        names = next((axes for word, axes in _ORDERS.items() if f".{front}".endswith(f".{word}")), ())
        items = [(names[k] if k < len(names) else _own_name(item) or str(k), item) for k, item in enumerate(value)]
    elif isinstance(value, dict):
        if depth > DEEPEST:
            return {}
        items = [(str(key), item) for key, item in value.items()]
    else:
        return {front: value}
    found: dict[str, Any] = {}
    for key, item in items:
        path = f"{front}.{key}" if front else key
        if isinstance(item, dict | list):
            found |= flat(item, path, depth + 1)
        else:
            found[path] = item
    return found
