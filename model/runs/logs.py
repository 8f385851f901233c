"""A log of any format as one table in joulemap's columns and units: read, mapped, and aligned in time.

Of several streams the fastest one that power or position needs is the table's; the others are interpolated to its
stamps by straight lines, angles along the shorter way. Nothing is interpolated over a pause of a stream, and rows
outside the time in which power and position are both logged are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.recordings.split import head_of
from joulemap.model.runs.formats import FORMATS
from joulemap.model.runs.formats.contract import HEAD_BYTES, Log, LogFormat, Stream
from joulemap.model.runs.mapping import Source, source_of
from joulemap.model.runs.marks import without_marks
from joulemap.model.runs.recognition import replaced
from joulemap.model.runs.table import LEAST_ROWS, LIMITS, FloatArray, TableLimits, usable
from joulemap.model.runs.table_columns import Table, add_packs, at_stamps, numbers_of, table_of, without_null_island
from joulemap.model.runs.units import conversion
from joulemap.model.runs.unpacking import unpacked
from joulemap.model.source_file import SourceFile

_POWER = ("power", "current", "voltage")
_PLACE = ("x", "y", "lat", "lon", "speed_left", "speed_right")
_TURNING = ("heading", "wind_from")


def read_log(
    content: str | bytes | Path,
    name: str,
    repairs: dict[str, int],
    *,
    limits: TableLimits = LIMITS,
    mapping: Mapping[str, str] | None = None,
) -> Table:
    """Read a log of any of the formats of the registry.

    The result is in joulemap's columns and units, where they could be found.
    """
    mapping = mapping or {}
    source = unpacked(_source(content, name))
    kind = _format_of(source)
    source = replace(source, name=name)
    try:
        log = kind.code.decode(source, mapping=mapping, limits=limits, repairs=repairs)
    except ImportError as error:
        if not kind.extra or (error.name or "").startswith("joulemap"):
            raise
        raise kind.missing(name, error) from error
    if not log.streams:
        raise RunsError(f"run {name}: the {kind.name} holds nothing of a drive: no power, no position", run=name)
    table = _mapped(log, mapping, name, limits, repairs)
    table.format, table.notes = kind.name, (*log.notes, *table.notes)
    rows = max((len(values) for values in (*table.numbers.values(), *table.texts.values())), default=0)
    if rows < LEAST_ROWS:
        raise RunsError(f"run {name}: {rows} rows are too few, at least {LEAST_ROWS} are needed", run=name)
    return table


def format_of(file: Path, name: str) -> LogFormat:
    """Return the format of a log."""
    return _format_of(_source(file, name))


def _format_of(source: SourceFile) -> LogFormat:
    return next(each for each in FORMATS if each.code.recognise(source.head, source.name))  # any file may be a text


def _source(content: str | bytes | Path, name: str) -> SourceFile:
    if isinstance(content, Path):
        try:
            head = head_of(content)
        except OSError as error:
            raise RunsError(f"run {content}: {error}", path=str(content)) from error
        return SourceFile(content, name, head)
    data = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    return SourceFile(data, name, data[:HEAD_BYTES])


def _mapped(log: Log, mapping: Mapping[str, str], name: str, limits: TableLimits, repairs: dict[str, int]) -> Table:
    """The log's columns by joulemap's names."""
    if not log.usual and len(log.streams) == 1 and log.streams[0].t is None:
        return table_of(log.streams[0], mapping, name, repairs)
    home = {column: stream for stream in log.streams for column in (*stream.numbers, *stream.texts)}
    chosen = {target: source_of(target, text, home, name) for target, text in mapping.items()}
    for target, text in log.usual.items():
        if not replaced(target, mapping):
            chosen.setdefault(target, source_of(target, text, home, name))
    single = len(log.streams) == 1
    t = log.streams[0].t if single else _common_stamps(log, chosen, home, name)
    assert t is not None
    numbers: dict[str, FloatArray] = {"t": t - np.floor(t[0]) if t.size else t}
    for target, source in chosen.items():
        if target == "t":
            numbers["t"] = _value(target, source, home, None, name, repairs)
        else:
            numbers[target] = _value(target, source, home, None if single else t, name, repairs)
    if single:
        used = {column for source in chosen.values() for column in source.columns}
        numbers |= {key: v for key, v in log.streams[0].numbers.items() if key not in used and key not in numbers}
    reading = {target: source.words(target) for target, source in chosen.items()}
    reading.setdefault("t", "stamps of the messages [s]")
    if log.packs and not {"power", "current", "voltage"} & mapping.keys():
        packs = [[Source(((1, column),)) for column in pack] for pack in log.packs]
        volts, amps = (
            [_value(key, pack[k], home, None if single else t, name, repairs) for pack in packs]
            for k, key in enumerate(("voltage", "current"))
        )
        add_packs(numbers, volts, amps)
        reading["power"] = " + ".join(f"{volt} x {amp}" for volt, amp in log.packs)
        for key in ("voltage", "current"):
            reading.pop(key, None)
    without_null_island(numbers)
    for target, places in log.others.items():
        if target in reading and target not in mapping:
            reading[target] += f" (or {', '.join(places)})"
    limits.check(len(t), len(numbers), name)
    return Table(usable(numbers), {}, reading, confidence=dict.fromkeys(reading, 0.99))


def _value(
    target: str,
    source: Source,
    home: Mapping[str, Stream],
    t: FloatArray | None,
    name: str,
    repairs: dict[str, int],
) -> FloatArray:
    """The values of a column in joulemap's unit, at the stamps `t`, or as they are in a table."""
    factor, offset = conversion(target, source.unit) if source.unit else (1.0, 0.0)
    total: FloatArray | None = None
    for sign, column in source.parts:
        stream = home[column]
        logged = without_marks(numbers_of(stream, column, name), target, column, name, repairs)
        if t is not None and stream.t is not None:
            logged = at_stamps(t, stream.t, logged * factor, turning=target in _TURNING) / factor
        total = sign * logged if total is None else total + sign * logged
    assert total is not None
    return total if (factor, offset) == (1.0, 0.0) else factor * total + offset


def _common_stamps(log: Log, chosen: Mapping[str, Source], home: Mapping[str, Stream], name: str) -> FloatArray:
    """The stamps of the fastest stream of power and position, while both are logged."""

    def _streams(targets: tuple[str, ...]) -> list[Stream]:
        columns = [
            column
            for target, source in chosen.items()
            if target in targets or target.startswith("current_")
            for column in source.columns
        ]
        named = {home[column].name: home[column] for column in columns}
        return [stream for stream in named.values() if stream.t is not None and stream.t.size]

    power, place = _streams(_POWER), _streams(_PLACE)
    there = ", ".join(stream.name for stream in log.streams)[:300]
    if not power:
        raise RunsError(
            f"run {name}: no message with a current or a power was found (in {there}); say which with a mapping, "
            "such as current=/battery.current:A",
            run=name,
            column="current",
        )
    if not place:
        raise RunsError(
            f"run {name}: no message with a position was found (in {there}); say which with a mapping, such as "
            "lat=/fix.latitude,lon=/fix.longitude",
            run=name,
            column="x",
        )
    base = min([*power, *place], key=_period)
    assert base.t is not None
    ends = [(float(np.min(stream.t)), float(np.max(stream.t))) for stream in (*power, *place) if stream.t is not None]
    begin, end = max(first for first, _ in ends), min(last for _, last in ends)
    t = np.unique(base.t[np.isfinite(base.t)])
    t = t[(t >= begin) & (t <= end)]
    if t.size < LEAST_ROWS:
        spans = "; ".join(
            f"{stream.name} {float(np.min(stream.t)):.1f}..{float(np.max(stream.t)):.1f} s"
            for stream in (*power, *place)
            if stream.t is not None
        )
        raise RunsError(
            f"run {name}: power and position were not logged at the same time ({spans[:300]}): have they one clock?",
            run=name,
        )
    return t


def _period(stream: Stream) -> float:
    assert stream.t is not None
    steps = np.diff(stream.t)
    steps = steps[steps > 0]
    return float(np.median(steps)) if steps.size else np.inf
