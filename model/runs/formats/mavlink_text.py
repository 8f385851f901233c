"""MAVLink messages as text, as Mission Planner writes a telemetry log in CSV: a message a row, of names and values."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress

from joulemap.model.runs.formats.contract import Log, mentioned
from joulemap.model.runs.formats.mavlink_telemetry import FIELDS, WANTED
from joulemap.model.runs.formats.messages import Collector, log_of
from joulemap.model.runs.instants import seconds_of
from joulemap.model.runs.table import TableLimits

_MESSAGE = re.compile(r"^\s*(\d{4}-\d\d-\d\d[^,]*),.*?\bmavlink_(\w+)_t,")


def are_messages(lines: Sequence[str]) -> bool:
    """Decide whether the first lines are messages."""
    return any(map(_MESSAGE.match, lines))


def log_of_lines(lines: Sequence[str], name: str, mapping: Mapping[str, str], limits: TableLimits) -> Log:
    """Return what a run needs of messages, and what the mapping names."""
    found = [(match, line) for line in lines if (match := _MESSAGE.match(line)) is not None]
    stamps, _ = seconds_of([match[1] for match, _ in found], lenient=True)
    collector = Collector(name, limits)
    for (match, line), stamp in zip(found, stamps.tolist(), strict=True):
        kind, cells = match[2].upper(), line[match.end() :].split(",")
        fields = dict(zip(cells[::2], cells[1::2], strict=False))
        without_fix = kind == "GPS_RAW_INT" and fields.get("fix_type", "0") < "2"
        if kind == "BATTERY_STATUS" or without_fix:  # the voltages of its cells are no text
            continue
        wanted = fields if mentioned(mapping, kind) else FIELDS.get(kind, ())
        values = dict[str, float]()
        for key in wanted:
            with suppress(ValueError, KeyError):
                values[key] = float(fields[key])
        if values and stamp == stamp:
            collector.add(kind, stamp, values)
    return log_of(collector.streams(), WANTED)
