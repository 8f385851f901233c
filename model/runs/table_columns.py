"""From the columns of a table to joulemap's: recognised, in its units, and of one rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from joulemap.model.errors import RunsError
from joulemap.model.runs import agreement
from joulemap.model.runs.counters import rate_of, summed, total_of
from joulemap.model.runs.formats.columns import CLOCK, DATE
from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.instants import across_midnight
from joulemap.model.runs.mapping import CAPACITY, Source
from joulemap.model.runs.marks import without_marks
from joulemap.model.runs.recognition import Recognised, disagreement, recognised
from joulemap.model.runs.table import FloatArray, TextArray, add_count
from joulemap.model.runs.units import UNITS, conversion, own_unit

_PAUSE_PERIODS, _PAUSE_S = 5.0, 2.0  # no interpolation over more than five usual steps, and 2 s at least
_SPARSE = 0.5  # a column that is known in fewer rows is a series of its own
_AGREE, _ANOTHER = 0.2, 0.5  # a power differs from voltage times current by less, and one of another part by more
_FAST_KMPH = 70.0  # a speed that is above this number is no m/s of a vehicle on the ground


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
    confidence : dict of str to float
        By joulemap's column, how sure it is that this is it, 0 to 1.
    """

    numbers: dict[str, FloatArray]
    texts: dict[str, TextArray]
    reading: dict[str, str] = field(default_factory=dict)
    format: str = ""
    notes: tuple[str, ...] = ()
    confidence: dict[str, float] = field(default_factory=dict)


def table_of(stream: Stream, mapping: Mapping[str, str], name: str, repairs: dict[str, int]) -> Table:
    """Return a table in joulemap's columns and units, as far as they can be recognised."""
    found = recognised(stream, mapping, name)
    chosen = found.chosen
    for target, question in found.questions.items():
        if target in stream.numbers and target in ("t", "x", "y", "lat", "lon"):  # it is there twice
            raise RunsError(f"run {name}: {question}", run=name, column=target)
    used = {column for source in chosen.values() for column in source.columns}
    used |= {column for pack in found.packs for source in pack for column in source.columns}
    numbers: dict[str, FloatArray] = {}
    texts: dict[str, TextArray] = {}
    words: dict[str, str] = {}  # of units that are found out here
    for target, source in chosen.items():
        if target == CAPACITY and not source.parts:
            continue
        if target not in ("t", "speed", "heading"):
            only = source.columns[0] if len(source.parts) == 1 else ""
            if only in stream.texts and own_unit(target) == "":
                texts[target] = stream.texts[only]
            else:
                numbers[target], words[target] = _read(target, source, stream, name, repairs)
    path_m = agreement.path_of(numbers)
    if path_m is None and "distance" in numbers:
        path_m = float(np.nanmax(total_of(numbers["distance"]), initial=0.0))
    if "t" in chosen:
        numbers["t"], words["t"] = _time(chosen["t"], stream, path_m, name, found)
    if "speed" in chosen:
        _take_speed(chosen["speed"], stream, numbers, path_m, name, repairs, found, words)
    volts, amps = (
        [_read(key, pack[k], stream, name, repairs)[0] for pack in found.packs]
        for k, key in enumerate(("voltage", "current"))
    )
    if found.packs:
        add_packs(numbers, volts, amps)
    rest = {column: values for column, values in stream.numbers.items() if column not in used | numbers.keys()}
    if "t" in numbers:
        numbers, rest, stream_texts = _aligned(numbers, rest, dict(stream.texts))
    else:
        stream_texts = dict(stream.texts)
    reading = {
        target: _words(target, source, words.get(target, ""))
        for target, source in chosen.items()
        if source.parts != ((1, target),) or source.unit not in ("", own_unit(target)) or words.get(target)
    }
    if found.packs:
        reading["power"] = " + ".join(f"{v.words('voltage')} x {i.words('current')}" for v, i in found.packs)
    _take_heading(chosen, stream, numbers, rest, reading)
    _check_power(numbers, chosen, mapping, reading, found)
    _take_counters(numbers, reading, found, mapping, name)
    if CAPACITY in chosen and not chosen[CAPACITY].parts and "t" in numbers:
        numbers[CAPACITY] = np.full(numbers["t"].size, float(chosen[CAPACITY].unit))
    _take_distance(numbers, reading, found, name)
    numbers |= {column: values for column, values in rest.items() if column not in numbers}
    for key in ("power", "current"):
        if key in stream.texts and not {"power", "current", "soc"} & numbers.keys():
            numbers_of(stream, key, name)  # says what stands there
    texts |= {key: v for key, v in stream_texts.items() if key not in used | texts.keys() | numbers.keys()}
    without_null_island(numbers)
    for target, source in chosen.items():
        if target in numbers:
            for column in source.columns:
                add_count(repairs, f"unreadable_{target}", stream.unread.get(column, 0))
    kept = {key: share for key, share in found.confidence.items() if key in numbers}
    return Table(numbers, texts, {k: v for k, v in reading.items() if k in numbers}, "", tuple(found.notes), kept)


def _words(target: str, source: Source, unit: str) -> str:
    return Source(source.parts, unit or source.unit).words(target)


def _read(target: str, source: Source, stream: Stream, name: str, repairs: dict[str, int]) -> tuple[FloatArray, str]:
    """The values in joulemap's unit, and the unit where it was found out."""
    total: FloatArray | None = None
    for sign, column in source.parts:
        logged = without_marks(numbers_of(stream, column, name), target, column, name, repairs)
        total = sign * logged if total is None else total + sign * logged
    assert total is not None
    unit = "" if source.unit or target not in ("lat", "lon") else agreement.degrees_unit(target, total)
    if unit == "ddmm":
        return agreement.of_minutes(total), unit
    factor, offset = conversion(target, source.unit or unit) if source.unit or unit else (1.0, 0.0)
    return (total if (factor, offset) == (1.0, 0.0) else factor * total + offset), unit


def numbers_of(stream: Stream, column: str, name: str) -> FloatArray:
    """Return a column of numbers. Result (n,): NaN where blank."""
    if column in stream.numbers:
        return stream.numbers[column]
    cells = stream.texts[column]
    row = next((k for k, cell in enumerate(cells.tolist()) if cell.strip()), 0)
    raise RunsError(
        f"run {name}, column {column[:80]!r}, row {row + 2}: {str(cells[row])[:80]!r} is not a number, and most of its "
        "cells are none",
        run=name,
        column=column[:80],
        row=row + 2,
    )


def _time(source: Source, stream: Stream, path_m: float | None, name: str, found: Recognised) -> tuple[FloatArray, str]:
    """The stamps [s], and their unit where the name does not say it."""
    kinds = [stream.units.get(column, "") for column in source.columns]
    columns = [numbers_of(stream, column, name) for column in source.columns]
    total = np.sum([sign * values for (sign, _), values in zip(source.parts, columns, strict=True)], axis=0)
    if DATE in kinds:
        return total, DATE
    if CLOCK in kinds:
        return across_midnight(total), CLOCK
    unit, why = (source.unit, "") if source.unit in UNITS["time"] or source.unit else agreement.time_unit(total, path_m)
    if why:
        found.notes.append(f"`t` is taken for {unit}: {why}")
    factor = conversion("t", unit)[0] if unit else 1.0
    largest = float(np.nanmax(np.abs(total), initial=0.0))
    seconds = total if factor == 1.0 else total * factor
    return (across_midnight(seconds) if unit == "ms" and largest * factor <= 86_400.0 else seconds), unit


def _take_speed(
    source: Source,
    stream: Stream,
    numbers: dict[str, FloatArray],
    path_m: float | None,
    name: str,
    repairs: dict[str, int],
    found: Recognised,
    words: dict[str, str],
) -> None:
    """The speed [m/s]; one whose unit nothing says is left out, or asked for where it is needed."""
    logged, _ = _read("speed", Source(source.parts), stream, name, repairs)
    unit = source.unit
    if not unit and "t" in numbers:
        unit = agreement.speed_unit(numbers["t"], logged, numbers, path_m)
        if not unit and path_m is None:
            column = source.columns[0]
            if np.nanmax(np.abs(logged), initial=0.0) > _FAST_KMPH:
                unit = "km/h"
                found.notes.append(f"`speed` is taken for km/h, because {column[:60]} reaches more than {_FAST_KMPH:g}")
            else:
                found.questions["speed"] = (
                    f"is {column[:60]} in km/h or m/s? Say it with a mapping: speed={column[:60]}:km/h"
                )
                return
        if not unit and source.columns != ["speed"]:  # of which joulemap's own is in m/s
            return
    words["speed"] = unit if not source.unit else ""
    numbers["speed"] = logged * (UNITS["speed"].get(unit) or conversion("speed", unit or "m/s"))[0]


def _take_heading(
    chosen: dict[str, Source],
    stream: Stream,
    numbers: dict[str, FloatArray],
    rest: dict[str, FloatArray],
    reading: dict[str, str],
) -> None:
    """A heading in joulemap's sense, where one of its possible readings agrees with the way."""
    source = chosen.get("heading")
    if source is None:
        return
    column = source.columns[0]
    if column == "heading" or source.unit or len(source.parts) > 1:
        rest["heading"] = _read("heading", source, stream, "", {})[0]
        return
    rest[column] = stream.numbers[column]
    if "t" not in numbers or stream.numbers[column].size != numbers["t"].size:
        return
    found = agreement.compass(numbers["t"], stream.numbers[column], numbers)
    if found is not None:
        numbers["heading"] = found[0]
        reading["heading"] = f"{column} [{found[1]}]"


def add_packs(numbers: dict[str, FloatArray], volts: Sequence[FloatArray], amps: Sequence[FloatArray]) -> None:
    """Add the power of batteries in parallel, and their mean voltage.

    `numbers` (n,): columns, which are added to; `volts`, `amps` (n,): of each battery [V, A].
    """
    with np.errstate(invalid="ignore"):
        numbers["power"] = np.sum([v * i for v, i in zip(volts, amps, strict=True)], axis=0)
    numbers["voltage"] = np.mean(volts, axis=0)
    numbers.pop("current", None)


def _aligned(
    numbers: dict[str, FloatArray], rest: dict[str, FloatArray], texts: dict[str, TextArray]
) -> tuple[dict[str, FloatArray], dict[str, FloatArray], dict[str, TextArray]]:
    """The columns at the stamps of the one that is known most often, where columns are series of their own.

    They are where some of what a run needs is blank in most rows, as in an export of topics of different rates.
    """
    needed = [
        key
        for key in (
            "x",
            "y",
            "lat",
            "lon",
            "distance",
            "speed",
            "voltage",
            "current",
            "power",
            "energy",
            "charge",
            "soc",
        )
        if key in numbers and np.isfinite(numbers[key]).sum() > 1
    ] + [
        key
        for key in (*numbers, *rest)
        if key.startswith("current_") and np.isfinite({**rest, **numbers}[key]).sum() > 1
    ]
    every = {**rest, **numbers}
    known = {key: np.isfinite(every[key]) & np.isfinite(numbers["t"]) for key in needed}
    if not known or min(float(rows.mean()) for rows in known.values()) >= _SPARSE:
        return numbers, rest, texts
    rows = max(known.values(), key=np.sum)
    t, at = numbers["t"], numbers["t"][rows]

    def _at(columns: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        return {key: at_stamps(at, t, v, turning=key in ("heading", "yaw")) for key, v in columns.items()}

    placed = _at({key: values for key, values in numbers.items() if key != "t"})
    return {"t": at} | placed, _at(rest), {key: values[rows] for key, values in texts.items()}


def _check_power(
    numbers: dict[str, FloatArray],
    chosen: Mapping[str, Source],
    mapping: Mapping[str, str],
    reading: dict[str, str],
    found: Recognised,
) -> None:
    """A power that is not voltage times current is another one, or in another unit."""
    if "power" not in numbers or "power" in mapping or found.packs:
        return
    if not {"voltage", "current"} <= numbers.keys():
        unit = (
            ""
            if chosen["power"].unit or "speed" not in numbers
            else agreement.power_unit(numbers["power"], numbers["speed"])
        )
        if unit:
            numbers["power"] = UNITS["power"][unit][0] * numbers["power"]
            reading["power"] = _words("power", chosen["power"], unit)
            found.notes.append(f"`power` is taken for {unit}: in W it would be less than the air takes at that speed")
            found.confidence["power"] = min(found.confidence["power"], 0.8)
        return
    product = numbers["voltage"] * numbers["current"]
    units = {"": 1.0} if chosen["power"].unit else {unit: factor for unit, (factor, _) in UNITS["power"].items()}
    off = {unit: disagreement(factor * numbers["power"], product) for unit, factor in units.items()}
    best = min(off, key=lambda unit: off[unit])
    if not np.isfinite(off[best]):
        return
    if off[best] <= _AGREE:
        numbers["power"] = units[best] * numbers["power"]
        found.confidence["power"] = found.confidence["voltage"] = found.confidence["current"] = 0.99
        if best not in ("", "W"):
            reading["power"] = _words("power", chosen["power"], best)
        return
    column, kept = chosen["power"].columns[0], off[best] <= _ANOTHER
    found.notes.append(
        f"{column[:60]} is not voltage times current, they differ by {off[best]:.0%} in the median: it is "
        f"{'taken for the power of the battery' if kept else 'not used'}"
    )
    if kept:
        return
    other = numbers.pop("power")
    numbers[column if column != "power" else "power (not of the battery)"] = other
    reading.pop("power", None)


def _take_counters(
    numbers: dict[str, FloatArray], reading: dict[str, str], found: Recognised, mapping: Mapping[str, str], name: str
) -> None:
    """Power or current from a counter, where neither was logged."""
    flows = {"power", "current"} & numbers.keys() or any(
        key.startswith("current_") or key in ("left_current", "right_current") for key in numbers
    )
    for counter, target in (("energy", "power"), ("charge", "current")):
        if counter in numbers and "t" in numbers and not flows:
            rate = rate_of(numbers["t"], total_of(numbers[counter]))
            numbers[target] = rate
            reading[target] = f"the rate of {reading.pop(counter, counter)}"
            found.confidence[target] = found.confidence.get(counter, 1.0)
            flows = True
        if counter in numbers:
            numbers.pop(counter)
            reading.pop(counter, None)
    for key in ("current", "power", "voltage"):
        question = found.questions.get(key)
        missing = (
            not flows and "soc" not in numbers if key != "voltage" else "current" in numbers and "power" not in numbers
        )
        if question and missing:
            raise RunsError(f"run {name}: {question}", run=name, column=key)


def _take_distance(numbers: dict[str, FloatArray], reading: dict[str, str], found: Recognised, name: str) -> None:
    """The distance, counted or from the speed, where there is no position."""
    placed = {"x", "y"} <= numbers.keys() or {"lat", "lon"} <= numbers.keys()
    if placed or "t" not in numbers or {"speed_left", "speed_right"} <= numbers.keys():
        numbers.pop("distance", None)
        reading.pop("distance", None)
        return
    speed = numbers.get("speed")
    if "distance" in numbers:
        counted = total_of(numbers["distance"])
        steps = np.diff(counted[np.isfinite(counted)])
        resolution = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
        if speed is None or resolution <= 1.0:
            numbers["distance"] = counted
            return
    if speed is not None:
        numbers["distance"] = summed(numbers["t"], speed)
        reading["distance"] = f"the sum of {reading.get('speed', 'speed [m/s]')}"
    elif "distance" not in numbers:
        for key in ("lat", "lon", "x", "y", "distance", "speed"):
            if key in found.questions:
                raise RunsError(f"run {name}: {found.questions[key]}", run=name, column=key)


def at_stamps(t: FloatArray, stamps: FloatArray, values: FloatArray, *, turning: bool) -> FloatArray:
    """Return values at other stamps, by straight lines.

    `t` (n,): where they are wanted [s]; `stamps`, `values` (m,): where they are known [s], and what they are, NaN where
    they are not; `turning`: whether they are angles [deg]. Result (n,): NaN in pauses and outside.
    """
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


def without_null_island(numbers: dict[str, FloatArray]) -> None:
    """Make positions at latitude 0 and longitude 0 unknown, which receivers without a fix write.

    `numbers` (n,): columns, which are changed.
    """
    lat, lon = numbers.get("lat"), numbers.get("lon")
    if lat is None or lon is None:
        return
    nowhere = (lat == 0) & (lon == 0)
    if nowhere.any() and not nowhere.all():
        numbers["lat"], numbers["lon"] = (np.where(nowhere, np.nan, values) for values in (lat, lon))
