"""A log of any format as one table in joulemap's columns and units: read, mapped, and aligned in time.

Of several streams the fastest one that power or position needs is the table's; the others are interpolated to its
stamps by straight lines, angles along the shorter way. Nothing is interpolated over a pause of a stream, and rows
outside the time in which power and position are both logged are left out.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.recordings.split import head_of, is_split
from joulemap.model.runs.column_values import numbers_of
from joulemap.model.runs.common_rows import at_stamps
from joulemap.model.runs.formats import FORMATS
from joulemap.model.runs.formats.contract import HEAD_BYTES, Log, LogFormat, Stream
from joulemap.model.runs.joined import joined
from joulemap.model.runs.mapping import Source, replaced, source_of
from joulemap.model.runs.marks import without_marks
from joulemap.model.runs.rearranged import rearranged
from joulemap.model.runs.table import LEAST_ROWS, LIMITS, FloatArray, TableLimits, usable
from joulemap.model.runs.table_columns import Table, table_of
from joulemap.model.runs.units import conversion
from joulemap.model.runs.unpacking import MOST_TABLES, unpacked
from joulemap.model.source_file import SourceFile

_STAMPS = "stamps of the messages"
_POWER = ("power", "current", "voltage")
_PLACE = ("x", "y", "lat", "lon", "speed_left", "speed_right")
_WAY = ("speed", "distance")  # where there is no position
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
    if source.beside:
        kind, table = _of_several(source, name, limits, mapping, repairs)
        log = Log(())
    else:
        kind, log = _decoded(replace(source, name=name), _format_of(source), limits, mapping, repairs)
        table = _table(log, mapping, name, limits, repairs)
    table.format, table.notes = kind.name, (*log.notes, *table.notes)
    rows = max((len(values) for values in (*table.numbers.values(), *table.texts.values())), default=0)
    if rows < LEAST_ROWS:
        raise RunsError.of_run(name, f"{rows} rows are too few, at least {LEAST_ROWS} are needed")
    return table


def _decoded(
    source: SourceFile, kind: LogFormat, limits: TableLimits, mapping: Mapping[str, str], repairs: dict[str, int]
) -> tuple[LogFormat, Log]:
    try:
        log = kind.code.decode(source, mapping=mapping, limits=limits, repairs=repairs)
    except ImportError as error:
        if not kind.extra or (error.name or "").startswith("joulemap"):
            raise
        raise kind.missing(source.name, error) from error
    if not log.streams:
        raise RunsError.of_run(source.name, f"the {kind.name} holds nothing of a drive: no power, no position")
    return kind, log


def _of_several(
    source: SourceFile, name: str, limits: TableLimits, mapping: Mapping[str, str], repairs: dict[str, int]
) -> tuple[LogFormat, Table]:
    """One table of the files that lay in one zip or folder."""
    parts = dict[str, Stream]()
    for part in (source, *(SourceFile(each, file, each[:HEAD_BYTES]) for file, each in source.beside)):
        kind = _format_of(part)
        log = _decoded(part, kind, limits, mapping, repairs)[1] if kind.text else Log(())
        if len(log.streams) != 1 or log.streams[0].t is not None or not log.streams[0].numbers:
            raise RunsError.of_run(name, f"{part.name} is no table: give one log, or its tables alone")
        parts[part.name.rpartition(".")[0] or part.name] = rearranged(log.streams[0], name, limits)
    return kind, table_of(joined(parts, name, limits), mapping, name, repairs)


def format_of(file: Path, name: str) -> LogFormat:
    """Return the format of a log."""
    return _format_of(_source(file, name))


def _format_of(source: SourceFile) -> LogFormat:
    return next(each for each in FORMATS if each.code.recognise(source.head, source.name))  # any file may be a text


def _source(content: str | bytes | Path, name: str) -> SourceFile:
    if isinstance(content, Path):
        try:
            if content.is_dir() and not is_split(content):
                return _of_folder(content, name)
            head = head_of(content)
        except OSError as error:
            raise RunsError(f"run {content}: {error}", path=str(content)) from error
        return SourceFile(content, name, head)
    data = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    return SourceFile(data, name, data[:HEAD_BYTES])


def _of_folder(folder: Path, name: str) -> SourceFile:
    """The files of a folder, as a zip of it would hold them."""
    files = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    if not 0 < len(files) <= MOST_TABLES:
        raise RunsError.of_run(name, f"the folder {folder} holds {len(files)} files: one log has 1 to {MOST_TABLES}")
    first, *rest = files
    beside = tuple((path.name, path.read_bytes()) for path in rest)
    return SourceFile(first, first.name, head_of(first), beside=beside)


def _table(log: Log, mapping: Mapping[str, str], name: str, limits: TableLimits, repairs: dict[str, int]) -> Table:
    """The log's columns by joulemap's names."""
    stream = log.streams[0]
    if not log.usual and len(log.streams) == 1 and stream.t is None:
        return table_of(rearranged(stream, name, limits), mapping, name, repairs)
    usual = {target: text for target, text in log.usual.items() if not replaced(target, mapping)}
    packs = () if {"power", "current", "voltage"} & mapping.keys() else log.packs
    if packs:
        usual = {target: text for target, text in usual.items() if target not in ("voltage", "current")}
    stream = replace(_as_one(log, usual | dict(mapping), packs, name, repairs), packs=packs)
    limits.check(len(stream.numbers[_STAMPS]), len(stream.numbers), name)
    table = table_of(stream, {"t": f"{_STAMPS}:s"} | usual | dict(mapping), name, repairs)
    table.confidence |= dict.fromkeys(table.confidence.keys() - mapping.keys(), 0.99)
    for target, places in log.others.items():
        if target in table.reading and target not in mapping:
            table.reading[target] += f" (or {', '.join(places)})"
    return table


def _as_one(
    log: Log, chosen: Mapping[str, str], packs: Collection[tuple[str, str]], name: str, repairs: dict[str, int]
) -> Stream:
    """What was chosen of all streams, at the stamps of one of them; of a single stream all."""
    home = {column: stream for stream in log.streams for column in (*stream.numbers, *stream.texts)}
    sources = {target: source_of(target, text, home, name) for target, text in chosen.items()}
    single = len(log.streams) == 1
    drawn = {f"current_{k}": Source(((1, amp),)) for k, (_, amp) in enumerate(packs)}
    t = log.streams[0].t if single else _common_stamps(log, sources | drawn, home, name)
    assert t is not None
    numbers = {_STAMPS: t - np.floor(t[0]) if t.size else t}
    if single:
        numbers |= log.streams[0].numbers
    used = [(target, column, source.unit) for target, source in sources.items() for column in source.columns]
    used += [(target, pack[k], "") for pack in packs for k, target in enumerate(("voltage", "current"))]
    for target, column, unit in used:
        stream = home[column]
        values = without_marks(numbers_of(stream, column, name), target, column, name, repairs)
        if not single and stream.t is not None:
            factor = conversion(target, unit)[0] if unit else 1.0
            values = at_stamps(t, stream.t, values * factor, turning=target in _TURNING) / factor
        numbers[column] = values
    return Stream("", {key: usable(each) for key, each in numbers.items()})


def _common_stamps(log: Log, chosen: Mapping[str, Source], home: Mapping[str, Stream], name: str) -> FloatArray:
    """The stamps of the fastest stream of power and position, while both are logged."""

    def _streams(targets: tuple[str, ...]) -> list[Stream]:
        columns = [
            column
            for target, source in chosen.items()
            if target in targets or (targets is _POWER and target.startswith("current_"))
            for column in source.columns
        ]
        named = {home[column].name: home[column] for column in columns}
        return [stream for stream in named.values() if stream.t is not None and stream.t.size]

    power, place = _streams(_POWER), _streams(_PLACE) or _streams(_WAY)
    there = ", ".join(stream.name for stream in log.streams)[:300]
    for column, what, streams, option in (
        ("current", "a current or a power", power, "current=/battery.current:A"),
        ("x", "a position", place, "lat=/fix.latitude,lon=/fix.longitude"),
    ):
        if not streams:
            words = f"no message with {what} was found (in {there}); say which with a mapping, such as {option}"
            raise RunsError.of_run(name, words, column=column)
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
        raise RunsError.of_run(
            name, f"power and position were not logged at the same time ({spans[:300]}): have they one clock?"
        )
    return t


def _period(stream: Stream) -> float:
    assert stream.t is not None
    steps = np.diff(stream.t)
    steps = steps[steps > 0]
    return float(np.median(steps)) if steps.size else np.inf
