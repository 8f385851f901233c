"""Several tables that are one log: the topics of one recording, a file each, in a zip or in a folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from itertools import combinations

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.names import candidate
from joulemap.model.runs.table import TableLimits

_SAME_SPAN = 0.02
"""Powers of 1000: spans of topics of one recording are within 15 % of each other times the unit."""


def joined(parts: Mapping[str, Stream], name: str, limits: TableLimits) -> Stream:
    """Return one table with the rows of all: a column is blank in the rows of the others, but for the time.

    `parts`: by the name of a file, its table. Result: with a column's own name where no other table has it.
    """
    tables = {file: {**stream.numbers, **stream.texts} for file, stream in parts.items()}
    for (one, columns), (other, others) in combinations(tables.items(), 2):
        if columns.keys() == others.keys():
            raise RunsError.of_run(
                name, f" holds several logs: {one} and {other} have the same columns. Give them one by one"
            )
    first, *rest = parts.values()
    clocks = [
        column
        for column in first.numbers
        if all(column in stream.numbers and stream.units.get(column) == first.units.get(column) for stream in rest)
        and candidate("t", column) is not None
    ]
    if not clocks:
        raise RunsError.of_run(
            name,
            f" holds {', '.join(parts)[:200]}, which have no column of time in common: with one clock they "
            "are read as one log",
        )
    _check_clocks(parts, clocks[0], name)
    count = Counter(column for columns in tables.values() for column in columns)
    sizes = [next(iter(stream.numbers.values())).size for stream in parts.values()]
    limits.check(sum(sizes), len(clocks) + sum(map(len, tables.values())), name)
    numbers = {clock: np.concatenate([stream.numbers[clock] for stream in parts.values()]) for clock in clocks}
    texts, units, unread = {}, {clock: first.units[clock] for clock in clocks if clock in first.units}, {}
    ends = np.cumsum(sizes)
    for (file, stream), end, size in zip(parts.items(), ends.tolist(), sizes, strict=True):
        rows = slice(end - size, end)
        for column, values in tables[file].items():
            if column in clocks:
                continue
            called = column if count[column] == 1 else f"{file}.{column}"
            if column in stream.numbers:
                numbers[called] = np.full(ends[-1], np.nan)
                numbers[called][rows] = values
            else:
                texts[called] = np.zeros(ends[-1], dtype=values.dtype)
                texts[called][rows] = values
            if column in stream.units:
                units[called] = stream.units[column]
            if column in stream.unread:
                unread[called] = stream.unread[column]
    return Stream("", numbers, texts, None, units, unread)


def _check_clocks(parts: Mapping[str, Stream], clock: str, name: str) -> None:
    """Refuse tables of one recording whose clocks are not one: of another beginning, or in another unit."""
    spans = {file: stream.numbers[clock] for file, stream in parts.items()}
    ends = {file: (np.nanmin(values), np.nanmax(values)) for file, values in spans.items() if np.ptp(values) > 0.0}
    longest = max(ends, key=lambda file: ends[file][1] - ends[file][0], default="")
    for file, (begin, end) in ends.items():
        low, high = ends[longest]
        unit = np.log10((high - low) / (end - begin)) / 3.0  # of s, ms, us, ns
        apart = end < low or begin > high
        if apart or (unit > 0.5 and abs(unit - round(unit)) < _SAME_SPAN):
            raise RunsError.of_run(
                name,
                f" holds tables whose `{clock}` is not one clock: {begin:g} to {end:g} in {file}, "
                f"{low:g} to {high:g} in {longest}. Give all of them the same unit and beginning",
            )
