"""Logs as lines of `name=value` or `name: value`: serial output, decoded CAN messages, points of series."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from joulemap.model.runs.formats import mavlink_text, series
from joulemap.model.runs.formats.columns import stream_of
from joulemap.model.runs.formats.contract import Log, content_of
from joulemap.model.runs.formats.json_records import columns_of
from joulemap.model.runs.table import TableLimits, add_count
from joulemap.model.source_file import SourceFile

_PAIR = re.compile(
    r"(?<![^\s,;(])([A-Za-z_][\w.\[\]/-]{0,100})(?:\s?[=:]\s?|,\"?)([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    r"(?:\s|\",)?([A-Za-z%/]*)(?=[\s,;)]|$)"
)
_STAMP = re.compile(
    r"^\s*(?:\[[A-Za-z]+\]\s*)?[(\[]?\s*(\d[\d.:TZ+ -]{5,40}?)\s*[)\],; ]|(?<=\s)(\d{9,19})\s*$|"
    r"=\"?(\d{4}-\d\d-\d\d[T ]\d\d[\d:.,]+(?:Z|[+-]\d\d:?\d\d)?)"
)
_SAMPLE_LINES = 100
_REMARKS = 5  # lines before the first with pairs, as a board says that it starts


def recognise(head: bytes, name: str) -> bool:
    """Decide by the first lines after remarks: messages, points, two pairs with a mark in each, or cells in pairs."""
    lines = [line for line in head.decode("utf-8", "replace").split("\n")[:-1] if line.strip()]
    if series.are_points(lines) or mavlink_text.are_messages(lines):
        return True
    remarks = next((k for k, line in enumerate(lines[:_REMARKS]) if len(_PAIR.findall(line)) > 1), 0)
    lines = lines[remarks:][:5]
    pairs = [[pair[0] for pair in _PAIR.finditer(line)] for line in lines]
    marked = [sum("=" in pair or ":" in pair for pair in found) for found in pairs]
    cells = [len(re.findall("[^,]+", line)) for line in lines]
    columns = len(lines) > 1 and all(4 * len(found) > max(n, 12) for found, n in zip(pairs[1:], cells[1:], strict=True))
    return bool(lines) and (min(marked) > 1 or columns)


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the pairs."""
    lines = content_of(source).decode("utf-8", "replace").splitlines()
    if mavlink_text.are_messages(lines[:_SAMPLE_LINES]):
        return mavlink_text.log_of_lines(lines, source.name, mapping, limits)
    points = series.are_points(lines[:_SAMPLE_LINES])
    table = columns_of(series.records(lines) if points else _records(lines, repairs), source.name, limits)
    return Log((stream_of(table, source.name, limits),))


def _records(lines: list[str], repairs: dict[str, int]) -> Iterator[dict[str, float | str]]:
    for line in lines:
        pairs = _PAIR.findall(line)
        if not pairs:
            add_count(repairs, "rows_without_pairs", bool(line.strip()))
            continue
        record: dict[str, float | str] = {
            f"{key} [{unit}]" if unit else key: float(value) for key, value, unit in pairs
        }
        stamp = _STAMP.search(line)
        if stamp is not None:
            record.setdefault("time", stamp[1] or stamp[2] or stamp[3])
        yield record
