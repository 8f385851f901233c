"""From the columns of a table to joulemap's: recognised, in its units, and of one rate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from joulemap.model.runs import agreement
from joulemap.model.runs.column_values import numbers_of, read_column, stamps_of, words_of
from joulemap.model.runs.columns_of_motion import take_distance, take_movement, take_wheels
from joulemap.model.runs.columns_of_place import (
    check_latitude,
    take_degrees,
    with_heading,
    without_frozen_positions,
    without_null_island,
    without_standing_positions,
)
from joulemap.model.runs.columns_of_power import take_counters, take_drawn, take_share
from joulemap.model.runs.common_rows import aligned
from joulemap.model.runs.formats.columns import DATE
from joulemap.model.runs.formats.contract import Stream
from joulemap.model.runs.mapping import CAPACITY, CONSTANTS, RADIUS, ROW, SIGNS, Source, source_of
from joulemap.model.runs.names import DISCHARGE
from joulemap.model.runs.names import words_of as words_of_name
from joulemap.model.runs.recognition import recognised
from joulemap.model.runs.table import FloatArray, TextArray, add_count, known_values
from joulemap.model.runs.units import own_unit

SIGNED = ("power", "current")
_SHUFFLED = 0.2  # of the steps between rows go back in time


@dataclass
class Table:
    """A log as a table of columns (n,): NaN for what is blank, infinite or too large."""

    numbers: dict[str, FloatArray]
    texts: dict[str, TextArray]
    reading: dict[str, str] = field(default_factory=dict)  # what was taken for a column under another name or unit
    format: str = ""
    notes: tuple[str, ...] = ()
    confidence: dict[str, float] = field(default_factory=dict)  # 0 to 1
    counted: bool = False  # what is drawn is the rate of a counter
    signed: frozenset[str] = frozenset()  # of SIGNED, those that are said to be positive while the battery discharges


def table_of(stream: Stream, mapping: Mapping[str, str], name: str, repairs: dict[str, int]) -> Table:
    """Return a table in joulemap's columns and units, as far as they can be recognised."""
    if ROW in mapping:
        rows = len(next(iter((*stream.numbers.values(), *stream.texts.values())), ()))
        lasts = float(source_of(ROW, mapping[ROW], (), name).unit)
        units = {key: unit for key, unit in stream.units.items() if key != "t"}
        stream = replace(stream, numbers=stream.numbers | {"t": lasts * np.arange(rows, dtype=np.float64)}, units=units)
    found = recognised(stream, mapping, name)
    chosen = found.chosen
    said = {key: chosen.pop(key) for key in CONSTANTS if key in chosen and not chosen[key].parts}
    if "t" in chosen:
        stream = _in_order(stream, chosen["t"], name, repairs)
    found.refuse(name, [key for key in ("t", "x", "y", "lat", "lon") if key in stream.numbers])  # it is there twice
    used = {column for source in chosen.values() for column in source.columns}
    used |= {column for pack in found.packs for source in pack for column in source.columns}
    check_latitude(stream, chosen, name)
    numbers: dict[str, FloatArray] = {}
    texts: dict[str, str] = {}  # columns of texts
    words: dict[str, str] = {}  # of units that are found out here
    for target, source in chosen.items():
        if target not in ("t", "heading"):
            only = source.columns[0] if len(source.parts) == 1 else ""
            if only in stream.texts and own_unit(target) == "":
                texts[target] = only
            else:
                numbers[target], words[target] = read_column(target, source, stream, name, repairs)
    take_share(numbers, words, chosen)
    take_degrees(numbers, chosen, words, found)
    without_standing_positions(numbers, stream, chosen, found)
    take_movement(numbers, stream, words, found, name)
    volts, amps = (
        [read_column(key, pack[k], stream, name, repairs)[0] for pack in found.packs]
        for k, key in enumerate(("voltage", "current"))
    )
    if found.packs:
        with np.errstate(invalid="ignore"):
            numbers["power"] = np.sum([v * i for v, i in zip(volts, amps, strict=True)], axis=0)
        numbers["voltage"] = np.mean(volts, axis=0)
    rest = {
        column: values
        for column, values in stream.numbers.items()
        if column not in used | numbers.keys()
        and stream.units.get(column) != DATE  # dates beside the time are no effect
        and (column != "power" or np.isfinite(values).any())
    }
    without_standing_positions(rest, stream, chosen, found)  # zeros are not recognised as positions
    open_heading = with_heading(chosen, stream, rest)
    if "t" in numbers:
        numbers, rest, stream_texts = aligned(numbers, rest, dict(stream.texts))
    else:
        stream_texts = dict(stream.texts)
    take_drawn(numbers, words, mapping, found, name)
    reading = {
        target: words_of(target, source, words.get(target, ""))
        for target, source in chosen.items()
        if source.parts != ((1, target),) or source.unit not in ("", own_unit(target)) or words.get(target)
    }
    if found.packs:
        reading["power"] = " + ".join(f"{v.words('voltage')} x {i.words('current')}" for v, i in found.packs)
    if open_heading and "t" in numbers:
        agreeing = agreement.compass(numbers["t"], rest[open_heading], numbers)
        if agreeing is not None:
            numbers["heading"] = agreeing[0]
            reading["heading"] = f"{open_heading} [{agreeing[1]}]"
    take_counters(numbers, reading, found, mapping, name)
    if CAPACITY in said and "t" in numbers:
        numbers[CAPACITY] = np.full(numbers["t"].size, float(said[CAPACITY].unit))
    take_wheels(numbers, reading, said.get(RADIUS), found)
    without_frozen_positions(numbers, found)
    take_distance(numbers, reading, found, name)
    numbers |= {column: values for column, values in rest.items() if column not in numbers}
    for key in ("power", "current"):
        if key in stream.texts and not {"power", "current", "soc"} & numbers.keys():
            numbers_of(stream, key, name)  # says what stands there
    others = {key: v for key, v in stream_texts.items() if key not in used | numbers.keys() and (v != "").any()}
    others |= {target: stream_texts[column] for target, column in texts.items()}
    without_null_island(numbers)
    for target, source in chosen.items():
        if target in numbers:
            for column in source.columns:
                add_count(repairs, f"unreadable_{target}", stream.unread.get(column, 0))
    kept = {key: share for key, share in found.confidence.items() if key in numbers}
    reading = {key: words for key, words in reading.items() if key in numbers}
    return Table(numbers, others, reading, "", tuple(found.notes), kept, found.counted, _signed(chosen, mapping))


def _signed(chosen: Mapping[str, Source], mapping: Mapping[str, str]) -> frozenset[str]:
    """Of power and current those whose sign is said: `power=-column`, or `discharge_power`."""
    said = {key for key in SIGNED if mapping.get(key, "")[:1] in SIGNS and mapping[key] not in chosen[key].columns}
    named = {key for key in SIGNED if key in chosen and DISCHARGE in words_of_name(chosen[key].columns[0])}
    return frozenset(said | named)


def _in_order(stream: Stream, source: Source, name: str, repairs: dict[str, int]) -> Stream:
    """Rows that are in no order of time, as parts of a table come together, are sorted; a clock set back is no such."""
    t = stamps_of(source, stream, name)
    known = known_values(t)
    falls = float(np.mean(np.diff(known) < 0)) if known.size > 1 else 0.0
    dated = stream.units.get(source.columns[0]) == DATE  # then the newest may come first; else it may count down
    if falls <= _SHUFFLED or (falls > 1 - _SHUFFLED and not dated):
        return stream
    add_count(repairs, "rows_sorted_by_time", known.size)
    rows = np.argsort(t, kind="stable")
    numbers = {key: each[rows] for key, each in stream.numbers.items()}
    return replace(stream, numbers=numbers, texts={key: each[rows] for key, each in stream.texts.items()})
