"""Lines of one point each: InfluxDB's line protocol, OpenMetrics, and Graphite, whose last word is the stamp."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise

_INFLUX = re.compile(
    r"(?P<name>(?:[^\s,\\]|\\.)+)(?P<tags>(?:,(?:[^\s=,\\]|\\.)+=(?:[^\s,\\]|\\.)+)*) "
    r"(?P<fields>[^\s=]+=.*) (?P<t>\d{9,19})"
)
_METRIC = re.compile(
    r"(?P<name>[A-Za-z_:][\w:./-]*)?(?:\{(?P<tags>[^{}]*)\})?\s+(?P<value>[+-]?(?:\d|\.\d)\S*)\s+(?P<t>\d{9,19}(?:\.\d+)?)"
)
_FIELD = re.compile(r'(?:^|,)([^\s,="]+)=([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)[iu]?(?=,|$)')
_TAG = re.compile(r'([\w.-]+)="?((?:[^",\\]|\\.)*)"?')
_SELDOM = 0.1  # of the points: a mode of driving changes less often
_Point = tuple[str, dict[str, str], dict[str, float], str]  # measurement, tags, fields and stamp


def are_points(lines: Sequence[str]) -> bool:
    """Decide whether most of the first lines, but for comments, are points of series."""
    lines = [line for line in lines if line.strip() and not line.startswith("#")]
    points = sum(_point(line) is not None for line in lines)
    return points > 1 and 2 * points > len(lines)


def records(lines: Sequence[str]) -> list[dict[str, float | str]]:
    """Return a record of all points with the same stamp.

    A field that only one series has keeps its name; else the measurement, and the tags that differ, are before it. A
    tag that seldom changes from point to point is a state, and divides no series.
    """
    points = [point for line in lines if (point := _point(line)) is not None]
    names, said = defaultdict[str, set[str]](set), defaultdict[tuple[str, str], set[str]](set)
    for name, tags, fields, _ in points:
        for field in fields:
            names[field].add(name)
            for tag, value in tags.items():
                said[field, tag].add(value)
    dividing = {key for key, texts in said.items() if len(texts) > 1 and _divides(points, *key)}
    found = dict[str, dict[str, float | str]]()
    for name, tags, fields, stamp in points:
        record = found.setdefault(stamp, {"time": stamp})
        for field, number in fields.items():
            words = [name] if len(names[field]) > 1 or field == "value" else []
            words += [text for tag, text in tags.items() if (field, tag) in dividing]
            record[".".join([*words, *([] if field == "value" else [field])])] = number
    return list(found.values())


def _divides(points: Sequence[_Point], field: str, tag: str) -> bool:
    """Whether series of a field with several values of a tag are logged side by side."""
    known = sorted((float(t), tags[tag]) for _, tags, fields, t in points if field in fields and tag in tags)
    return sum(a[1] != b[1] for a, b in pairwise(known)) > _SELDOM * len(known)


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
