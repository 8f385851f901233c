"""NMEA 0183: positions and speed of a receiver in RMC and GGA sentences, and readings in XDR and proprietary ones."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Iterator, Mapping
from functools import reduce
from operator import xor

from joulemap.model.runs.formats.columns import stream_of
from joulemap.model.runs.formats.contract import Log, content_of
from joulemap.model.runs.formats.json_records import columns_of
from joulemap.model.runs.names import is_unit
from joulemap.model.runs.table import TableLimits, add_count
from joulemap.model.source_file import SourceFile

_SENTENCE = re.compile(r"\$((?:[A-Z]{2}|P)[A-Z0-9]{3,8}),([^*$]*)\*([0-9A-Fa-f]{2})")
_TIME = re.compile(r"([01]\d|2[0-3])([0-5]\d)([0-5]\d(?:\.\d+)?)")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")
_DAY_S = 86_400.0


def recognise(head: bytes, name: str) -> bool:
    """Decide by a sentence with its checksum in most of the first lines."""
    lines = [line for line in head.decode("ascii", "replace").split("\n")[:-1] if line.strip()]
    return bool(lines) and 2 * sum(_SENTENCE.search(line) is not None for line in lines) > len(lines)


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the sentences, those of one time as one row."""
    text = content_of(source).decode("ascii", "replace")
    table = columns_of(_records(text, repairs), source.name, limits)
    return Log((stream_of(table, source.name, limits),))


def _records(text: str, repairs: dict[str, int]) -> Iterator[dict[str, float]]:
    day, clock, record = 0.0, -1.0, dict[str, float]()
    for name, content, checksum in _SENTENCE.findall(text):
        if reduce(xor, f"{name},{content}".encode("ascii", "replace")) != int(checksum, 16):
            add_count(repairs, "broken_sentences", 1)
            continue
        kind, cells = name if name.startswith("P") else name[2:], content.split(",")
        time = _TIME.fullmatch(cells[0])
        if time is not None:
            now = 3600.0 * int(time[1]) + 60.0 * int(time[2]) + float(time[3])
            if now != clock and record:
                yield record
                record = {}
            day += _DAY_S * (now < clock - _DAY_S / 2)
            clock = now
        if kind == "RMC" and day < _DAY_S and len(cells) > 8:
            day = _midnight(cells[8]) or day
        if clock >= 0.0:
            record |= {"time": day + clock} | _values(kind, cells)
    if record:
        yield record


def _midnight(ddmmyy: str) -> float:
    """When a day begins [s since 1970]; 0 where it is none."""
    try:
        return dt.datetime.strptime(ddmmyy, "%d%m%y").replace(tzinfo=dt.UTC).timestamp()
    except ValueError:
        return 0.0


def _values(kind: str, cells: list[str]) -> dict[str, float]:
    """What a sentence says, by names of columns."""
    found = dict[str, str]()
    if kind == "RMC" and cells[1:2] == ["A"] and len(cells) > 7:
        found = {"speed [kn]": cells[6], "course": cells[7]} | _position(cells[2:6])
    elif kind == "GGA" and len(cells) > 8 and cells[5] not in ("", "0"):
        found = {"altitude": cells[8]} | _position(cells[1:5])
    elif kind == "XDR":
        found = {f"{cells[k + 3]} [{cells[k + 2]}]": cells[k + 1] for k in range(0, len(cells) - 3, 4)}
    elif kind.startswith("P"):
        for k, cell in enumerate(cells[1:], start=1):
            unit = cells[k + 1] if k + 1 < len(cells) and not _NUMBER.fullmatch(cells[k + 1]) else ""
            found[f"{kind[1:]} {k}" + (f" [{unit}]" if is_unit(unit) else "")] = cell
    return {key: float(cell) for key, cell in found.items() if _NUMBER.fullmatch(cell)}


def _position(cells: list[str]) -> dict[str, str]:
    """Degrees of `4734.930775,N,00931.916705,E`."""
    found = dict[str, str]()
    for key, value, side in (("lat", *cells[:2]), ("lon", *cells[2:])):
        if _NUMBER.fullmatch(value) and side in ("N", "S", "E", "W"):
            degrees = float(value) // 100.0 + float(value) % 100.0 / 60.0
            found[key] = f"{-degrees if side in ('S', 'W') else degrees:.12f}"
    return found
