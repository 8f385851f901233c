"""Lines of one point each: InfluxDB's line protocol, OpenMetrics, and Graphite, whose last word is the stamp."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence

_INFLUX = re.compile(
    r"(?P<name>(?:[^\s,\\]|\\.)+)(?P<tags>(?:,(?:[^\s=,\\]|\\.)+=(?:[^\s,\\]|\\.)+)*) "
    r"(?P<fields>[^\s=]+=.*) (?P<t>\d{9,19})"
)
_METRIC = re.compile(
    r"(?P<name>[A-Za-z_:][\w:./-]*)?(?:\{(?P<tags>[^{}]*)\})?\s+(?P<value>[+-]?(?:\d|\.\d)\S*)\s+(?P<t>\d{9,19}(?:\.\d+)?)"
)
_FIELD = re.compile(r'(?:^|,)([^\s,="]+)=([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)[iu]?(?=,|$)')
_TAG = re.compile(r'([\w.-]+)="?((?:[^",\\]|\\.)*)"?')
_Point = tuple[str, dict[str, str], dict[str, float], str]  # measurement, tags, fields and stamp


def are_points(lines: Sequence[str]) -> bool:
    """Decide whether most of the first lines, but for comments, are points of series."""
    lines = [line for line in lines if line.strip() and not line.startswith("#")]
    points = sum(_point(line) is not None for line in lines)
    return points > 1 and 2 * points > len(lines)


def records(lines: Sequence[str]) -> Iterator[dict[str, float | str]]:
    """Return a record of each point.

    A field that only one series has keeps its name; else the measurement, and the tags that differ, are before it.
    """
    points = [point for line in lines if (point := _point(line)) is not None]
    names, said = defaultdict[str, set[str]](set), defaultdict[tuple[str, str], set[str]](set)
    for name, tags, fields, _ in points:
        for field in fields:
            names[field].add(name)
            for tag, value in tags.items():
                said[field, tag].add(value)
    for name, tags, fields, stamp in points:
        record: dict[str, float | str] = {"time": stamp}
        for field, number in fields.items():
            words = [name] if len(names[field]) > 1 or field == "value" else []
            words += [text for tag, text in tags.items() if len(said[field, tag]) > 1]
            record[".".join([*words, *([] if field == "value" else [field])])] = number
        yield record


def _point(line: str) -> _Point | None:
    line = line.strip()
    if (found := _INFLUX.fullmatch(line)) is not None:
        fields = {key: float(value) for key, value in _FIELD.findall(found["fields"])}
        return found["name"], dict(_TAG.findall(found["tags"])), fields, found["t"]
    if (found := _METRIC.fullmatch(line)) is None:
        return None
    tags = dict(_TAG.findall(found["tags"] or ""))
    name = found["name"] or tags.pop("__name__", "")
    try:
        return name, tags, {"value": float(found["value"])}, found["t"]
    except ValueError:
        return None
