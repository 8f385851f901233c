"""A log of any format as one table in joulemap's columns and units: read, mapped, and aligned in time.

Of several streams the fastest one that power or position needs is the table's; the others are interpolated to its
stamps by straight lines, angles along the shorter way. Nothing is interpolated over a pause of a stream, and rows
outside the time in which power and position are both logged are left out.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.recordings.split import head_of
from joulemap.model.runs.formats import FORMATS
from joulemap.model.runs.formats.contract import HEAD_BYTES, Log, LogFormat, Stream
from joulemap.model.runs.instants import across_midnight, seconds_of
from joulemap.model.runs.mapping import Source, guessed, profile_of, source_of
from joulemap.model.runs.table import (
    LEAST_ROWS,
    LIMITS,
    FloatArray,
    TableLimits,
    TextArray,
    not_a_number,
    numbers_of,
    usable,
)
from joulemap.model.runs.units import conversion, own_unit, quantity_of, unit_in_name
from joulemap.model.source_file import SourceFile

_EPOCHS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"))
"""Stamps since 1970 in these units are larger than these numbers between 1973 and the year 5000."""

_PAUSE_PERIODS, _PAUSE_S = 5.0, 2.0  # no interpolation over more than five usual steps, and 2 s at least
_POWER = ("power", "current", "voltage")
_PLACE = ("x", "y", "lat", "lon", "speed_left", "speed_right")
_TURNING = ("heading", "wind_from")


@dataclass
class Table:
    """A log as a table.

    Attributes
    ----------
    numbers : dict of str to ndarray of float, (n,)
        Columns of numbers, NaN for blank, nan, inf and what is too large.
    texts : dict of str to ndarray of str, (n,)
        Columns of text.
    reading : dict of str to str
        By joulemap's column that was not there under its own name and in its own unit: what was taken.
    format : str
        Name of the file's format.
    notes : tuple of str
        What is to be known of the file: that it was cut off, for example.
    """

    numbers: dict[str, FloatArray]
    texts: dict[str, TextArray]
    reading: dict[str, str] = field(default_factory=dict)
    format: str = ""
    notes: tuple[str, ...] = ()


def read_log(
    content: str | bytes | Path,
    name: str,
    repairs: dict[str, int],
    *,
    limits: TableLimits = LIMITS,
    mapping: Mapping[str, str] | None = None,
) -> Table:
    """Read a log of any of the formats of the registry.

    Parameters
    ----------
    content : str, bytes or Path
        A text in CSV, the bytes of a file, or a file.
    name : str
        Of the run, for messages.
    repairs : dict
        Counts by rule, which are added to.
    limits : TableLimits, optional
        How large it may be.
    mapping : mapping of str to str, optional
        What is to be taken from where, as `read_mapping` returns it.

    Returns
    -------
    Table
        In joulemap's columns and units, where they could be found.

    Raises
    ------
    RunsError
        If the file is broken, is no log, or a column of the mapping is not in it.
    TooLargeError
        If it is larger than the limits.
    """
    mapping = mapping or {}
    source = _source(content, name)
    kind = _format_of(source)
    try:
        log = kind.code.decode(source, mapping=mapping, limits=limits, repairs=repairs)
    except ImportError as error:
        if not kind.extra or (error.name or "").startswith("joulemap"):
            raise
        raise kind.missing(name, error) from error
    if not log.streams:
        raise RunsError(f"run {name}: the {kind.name} holds nothing of a drive: no power, no position", run=name)
    table = _mapped(log, mapping, name, limits)
    table.format, table.notes = kind.name, log.notes
    rows = max((len(values) for values in (*table.numbers.values(), *table.texts.values())), default=0)
    if rows < LEAST_ROWS:
        raise RunsError(f"run {name}: {rows} rows are too few, at least {LEAST_ROWS} are needed", run=name)
    table.numbers = usable(table.numbers, name)
    return table


def format_of(file: Path, name: str) -> LogFormat:
    """Return the format of a log.

    Parameters
    ----------
    file : Path
        The log, or the folder of a split bag.
    name : str
        Of the run, for messages.

    Returns
    -------
    LogFormat
        CSV, where it is no other.

    Raises
    ------
    RunsError
        If it cannot be opened.
    """
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


def _mapped(log: Log, mapping: Mapping[str, str], name: str, limits: TableLimits) -> Table:
    """The log's columns by joulemap's names."""
    home = {column: stream for stream in log.streams for column in (*stream.numbers, *stream.texts)}
    chosen, kind = _chosen(log, mapping, home, name)
    if len(log.streams) == 1:
        stream = log.streams[0]
        t = None if stream.t is None or "t" in mapping else stream.t
        whole = True
    else:
        t, whole = _common_stamps(log, chosen, home, name), False
    used = {column for source in chosen.values() for column in source.columns}
    numbers: dict[str, FloatArray] = {}
    texts: dict[str, TextArray] = {}
    for target, source in list(chosen.items()):
        if target == "t" and t is None:
            numbers["t"], unit = _time(source, home, name)
            chosen["t"] = Source(source.parts, unit)
            continue
        words = home[source.columns[0]].texts.get(source.columns[0])
        if words is not None and len(source.parts) == 1 and quantity_of(target) is None:
            texts[target] = words
        else:
            numbers[target] = _value(target, source, home, t if not whole else None, name)
    if t is not None:
        numbers["t"] = t - np.floor(t[0]) if t.size else t
    if whole:
        for column, logged in log.streams[0].numbers.items():
            if column and column not in used and column not in numbers:
                numbers[column] = logged
        for column, words in log.streams[0].texts.items():
            if column and column not in used and column not in texts and column not in numbers:
                texts[column] = words
    _without_null_island(numbers)
    reading = {
        target: source.words(target)
        for target, source in chosen.items()
        if source.parts != ((1, target),) or source.unit not in ("", own_unit(target))
    }
    if t is not None and "t" not in reading:
        reading["t"] = "stamps of the messages [s]"
    for target, places in log.others.items():
        if target in reading and target not in mapping:
            reading[target] += f" (or {', '.join(places)})"
    if kind and reading:
        reading["as"] = kind
    limits.check(len(next(iter(numbers.values()), ())), len(numbers) + len(texts), name)
    return Table(numbers, texts, reading)


def _chosen(log: Log, mapping: Mapping[str, str], home: Collection[str], name: str) -> tuple[dict[str, Source], str]:
    """By joulemap's column its source: what the user says, what the types of messages say, a ready mapping, names."""
    chosen = {target: source_of(target, text, home, name) for target, text in mapping.items()}
    for target, text in log.usual.items():
        if not _replaced(target, mapping):
            chosen.setdefault(target, source_of(target, text, home, name))
    if log.usual or any(stream.t is not None for stream in log.streams):
        return chosen, ""
    profile = profile_of(home)
    if profile is not None:
        for target, text in profile[1].items():
            if not _replaced(target, mapping):
                chosen.setdefault(target, source_of(target, text, home, name))
    stream = log.streams[0]
    taken = {*chosen, *(("lat", "lon") if {"x", "y"} <= {*home, *chosen} else ())}
    candidates = [*stream.numbers, *(column for column in stream.texts if _is_time(stream.texts[column]))]
    for target, source in _currents_with_units(home).items():
        if not _replaced(target, mapping):
            chosen.setdefault(target, source)
    parts = [column for column in (*home, *chosen) if column.startswith("current_")]
    if parts or {"left_current", "right_current"} & {*home}:
        taken |= {"current"}
    used = {column for source in chosen.values() for column in source.columns}
    for target, source in guessed([c for c in candidates if c not in used], taken=taken, name=name).items():
        if target == "t" or source.parts[0][1] in stream.numbers:
            chosen[target] = source
    if "t" in home and "t" not in chosen:
        chosen["t"] = Source(((1, "t"),))
    return chosen, profile[0] if profile is not None else ""


def _currents_with_units(home: Collection[str]) -> dict[str, Source]:
    """The sources of columns such as `current_mA` and `current_left_mA`: what their names end with is no motor."""
    named = {column: unit_in_name("current", column) for column in home if column.startswith("current_")}
    found = {}
    for column, (stem, unit) in named.items():
        of_motor_a = unit == own_unit("current") and stem == "current" and len(named) > 1  # beside `current_b`
        if unit is not None and stem not in home and not of_motor_a:
            found[stem] = Source(((1, column),), unit)
    return found


def _replaced(target: str, chosen: Collection[str]) -> bool:
    """Whether the user has chosen another way to say the same: x, y for lat, lon, and a current for currents."""
    if target in ("lat", "lon"):
        return "x" in chosen and "y" in chosen
    if target in ("x", "y"):
        return "lat" in chosen and "lon" in chosen
    if target == "current" or target.startswith("current_"):
        return "power" in chosen or any(key == "current" or key.startswith("current_") for key in chosen)
    return False


def _is_time(words: TextArray) -> bool:
    first = next((word for word in words[:100].tolist() if word.strip()), "")
    try:
        seconds_of([first])
    except ValueError:
        return False
    return bool(first)


def _value(target: str, source: Source, home: Mapping[str, Stream], t: FloatArray | None, name: str) -> FloatArray:
    """The values of a column in joulemap's unit, at the stamps `t`, or as they are in a table."""
    factor, offset = conversion(target, source.unit) if source.unit else (1.0, 0.0)
    total: FloatArray | None = None
    for sign, column in source.parts:
        stream = home[column]
        logged = stream.numbers.get(column)
        if logged is None:
            words = stream.texts[column].tolist()  # a cell of NUL characters, which numpy drops, is blank here
            try:
                logged = numbers_of(words)
            except ValueError:
                raise not_a_number(name, column, words, 0) from None
        if t is not None and stream.t is not None:
            logged = _at(t, stream.t, logged * factor, turning=target in _TURNING) / factor
        total = sign * logged if total is None else total + sign * logged
    assert total is not None
    return total if (factor, offset) == (1.0, 0.0) else factor * total + offset


def _time(source: Source, home: Mapping[str, Stream], name: str) -> tuple[FloatArray, str]:
    """The stamps of a table [s], and the unit in which they were logged."""
    total: FloatArray | None = None
    texts = False
    for sign, column in source.parts:
        logged = home[column].numbers.get(column)
        if logged is None:
            logged, texts = _instants(home[column].texts[column].tolist(), column, name), True
        total = sign * logged if total is None else total + sign * logged
    assert total is not None
    if texts:
        return across_midnight(total), "date and time" if np.nanmax(total) > 86_400.0 else "time of day"
    unit = source.unit
    largest = float(np.nanmax(np.abs(total))) if np.isfinite(total).any() else 0.0
    if not unit:
        unit = next((word for least, word in _EPOCHS if largest > least), "")
    factor = conversion("t", unit)[0] if unit else 1.0
    seconds = total if factor == 1.0 else total * factor
    return (across_midnight(seconds) if unit == "ms" and largest * factor <= 86_400.0 else seconds), unit


def _instants(words: list[str], column: str, name: str) -> FloatArray:
    try:
        return seconds_of(words)
    except ValueError as error:
        first = int(error.args[0])
        others = (k for k in range(len(words)) if words[k] and not _is_number(words[k]))
        row = next(others, first) if _is_number(words[first]) else first  # a column of numbers with one word in it
        raise RunsError(
            f"run {name}, column {column!r}, row {row + 2}: {words[row][:80]!r} is not a number, and no time such as "
            "2024-05-01T12:00:00.25",
            run=name,
            column=column,
            row=row + 2,
        ) from None


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


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


def _at(t: FloatArray, stamps: FloatArray, values: FloatArray, *, turning: bool) -> FloatArray:
    """Values at other stamps, by straight lines; NaN in pauses and outside."""
    known = np.isfinite(stamps) & np.isfinite(values)
    order = np.argsort(stamps[known], kind="stable")
    stamps, values = stamps[known][order], values[known][order]
    first = np.concatenate([[True], np.diff(stamps) > 0]) if stamps.size else np.zeros(0, dtype=bool)
    stamps, values = stamps[first], values[first]
    if stamps.size < 2:
        return np.full(t.size, np.nan)
    if turning:
        values = np.degrees(np.unwrap(np.radians(values)))
    out = np.interp(t, stamps, values, left=np.nan, right=np.nan)
    steps = np.diff(stamps)
    pause = steps > max(_PAUSE_S, _PAUSE_PERIODS * float(np.median(steps)))
    after = np.clip(np.searchsorted(stamps, t, side="left"), 1, stamps.size - 1)
    out[pause[after - 1] & (t != stamps[after]) & (t != stamps[after - 1])] = np.nan
    return out % 360.0 if turning else out


def _without_null_island(numbers: dict[str, FloatArray]) -> None:
    """Receivers without a fix write latitude 0 and longitude 0."""
    lat, lon = numbers.get("lat"), numbers.get("lon")
    if lat is None or lon is None:
        return
    nowhere = (lat == 0) & (lon == 0)
    if nowhere.any() and not nowhere.all():
        numbers["lat"], numbers["lon"] = (np.where(nowhere, np.nan, values) for values in (lat, lon))
