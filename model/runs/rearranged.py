"""Tables that hold a quantity in another way than a column of its own: objects, rows by name, stamps in two columns."""

from __future__ import annotations

import json
import re
from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np

from joulemap.model.runs.formats.columns import stream_of
from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.formats.json_records import columns_of, flat
from joulemap.model.runs.names import candidate, words_of
from joulemap.model.runs.table import TableLimits
from joulemap.model.runs.units import known_unit, unit_in_name

_WORDS = "pid field name signal variable metric entity sensor parameter channel topic key tag diagnostic"
_NAMES = frozenset(_WORDS.split(" "))
_NAMED = ("voltage", "current", "power", "speed", "lat")
_VALUES = ("value", "state", "reading", "val", "data")
_UNITS = ("unit", "units")
_LETTERS = re.compile(r"[^\W\d]")
_MOST_NAMES = 500
_FIRST = 1000  # cells that tell what a column holds


def rearranged(stream: Stream, name: str, limits: TableLimits) -> Stream:
    """Return a table in which each quantity has a column, and stamps are one number."""
    return _with_whole_stamps(_with_units(_by_name(_opened(stream, name, limits), name, limits)))


def _opened(stream: Stream, name: str, limits: TableLimits) -> Stream:
    """Objects in the cells of a column, as services of logs export them, as columns: `message.battery.voltage`."""
    for column, cells in stream.texts.items():
        first = cells[cells != ""][:_FIRST]
        if first.size and 2 * np.sum(np.char.startswith(first, "{")) > first.size:
            table = columns_of((_object(cell, column) for cell in cells.tolist()), name, limits)
            limits.check(table.num_rows, table.num_columns + len(stream.numbers) + len(stream.texts), name)
            inside = stream_of(table, name, limits)
            stream = replace(
                stream,
                numbers=inside.numbers | stream.numbers,
                texts=inside.texts | {key: each for key, each in stream.texts.items() if key != column},
                units=inside.units | stream.units,
                unread=inside.unread | stream.unread,
            )
    return stream


def _object(cell: str, column: str) -> dict[str, Any]:
    try:
        found = json.loads(cell) if cell.startswith("{") else None
    except (ValueError, RecursionError):
        return {}
    return flat(found, column) if isinstance(found, dict) else {}


def _with_units(stream: Stream) -> Stream:
    """`speed.unit` beside `speed.value` or `speed`: a column of texts that says the unit of a column of numbers."""
    said = dict(stream.units)
    for column, texts in _called(stream, _UNITS).items():
        words = words_of(column)
        units = {*np.unique(texts).tolist()} - {""}
        for other in stream.numbers:
            if len(units) == 1 and words[-1] in _UNITS and words_of(other) in (words[:-1], [*words[:-1], "value"]):
                said.setdefault(other, *units)
    return replace(stream, units=said)


def _by_name(stream: Stream, name: str, limits: TableLimits) -> Stream:
    """Rows of a name and a value, as loggers of cars, InfluxDB and Home Assistant write them, with a column by name."""
    no_times = [column for column in stream.numbers if candidate("t", column, stream.units.get(column, "")) is None]
    values = [column for column in no_times if {*_VALUES} & {*words_of(column)}] or no_times
    if len(values) != 1:
        return stream
    kinds = {column: np.unique(texts, return_inverse=True) for column, texts in stream.texts.items()}
    called = _called(stream, _NAMES)
    several = {
        column: kind
        for column, kind in kinds.items()
        if 1 < kind[0].size <= _MOST_NAMES
        and (column in called or any(candidate(target, each) for each in kind[0].tolist() for target in _NAMED))
    }
    if not several:
        return stream
    column = max(several, key=lambda each: several[each][0].size)
    names, at = several[column]
    limits.check(at.size, names.size + len(stream.numbers), name)
    units = next(iter(_called(stream, _UNITS).values()), None)
    numbers, said = dict(stream.numbers), dict(stream.units)
    read = numbers.pop(values[0])
    for k, each in enumerate(names.tolist()):
        rows = at == k
        if _LETTERS.search(each) and np.isfinite(read[rows]).any():
            numbers[each] = np.where(rows, read, np.nan)
            if units is not None:
                said[each] = str(units[rows][0])
    texts = {key: each for key, each in stream.texts.items() if key != column}
    return replace(stream, numbers=numbers, texts=texts, units=said)


def _called(stream: Stream, words: Collection[str]) -> dict[str, np.ndarray]:
    return {column: texts for column, texts in stream.texts.items() if {*words_of(column)} & {*words}}


def _with_whole_stamps(stream: Stream) -> Stream:
    """`stamp.secs` and `stamp.nsecs`, as messages of ROS have them, as one column of seconds."""
    parts = {column: unit_in_name("t", column) for column in stream.numbers}
    numbers, units = dict(stream.numbers), dict(stream.units)
    for column, (stem, unit) in parts.items():
        whole = next((other for other, found in parts.items() if found == (stem, "s")), None)
        if unit == "ns" and whole is not None and known_unit("t", stream.units.get(column, "ns")) == "ns":
            numbers[stem] = numbers.pop(whole) + 1e-9 * numbers.pop(column)
            units[stem] = "s"
    return replace(stream, numbers=numbers, units=units)
