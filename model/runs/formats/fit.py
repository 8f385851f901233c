"""FIT files (bicycle computers, watches, power meters): the messages `record`, mostly one each second."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from typing import Any

from joulemap.model.errors import RunsError
from joulemap.model.runs.formats.contract import Log, mentioned
from joulemap.model.runs.formats.messages import Collector, cut_off, fields_by_kind, log_of, reading, wanted_of
from joulemap.model.runs.table import TableLimits
from joulemap.model.source_file import SourceFile

_WANTED = wanted_of(
    {
        "power": "record.power:W",
        "lat": "record.position_lat:semicircles",
        "lon": "record.position_long:semicircles",
        "z": "record.enhanced_altitude:m record.altitude:m",
        "speed": "record.enhanced_speed:m/s record.speed:m/s",
        "gps_error": "record.gps_accuracy:m",
        "temperature": "record.temperature:degC",
    }
)
_FIELDS = fields_by_kind(_WANTED)["record"]


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark in the header."""
    return head[8:12] == b".FIT" and head[0] in (12, 14)


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the records."""
    import fitdecode

    collector = Collector(source.name, limits)

    def _place() -> str:
        return f"after {collector.messages:,} records"

    notes: list[str] = []
    with (
        reading("FIT file", source.name, _place),
        source.open() as stream,
        fitdecode.FitReader(
            stream, check_crc=fitdecode.CrcCheck.RAISE, error_handling=fitdecode.ErrorHandling.RAISE
        ) as frames,
    ):
        try:
            for frame in frames:
                if isinstance(frame, fitdecode.FitDataMessage) and frame.name == "record":
                    _take(frame, collector, whole=mentioned(mapping, "record"))
        except fitdecode.FitEOFError as error:
            if not collector.messages:
                raise
            notes = [cut_off("FIT file", error.offset, source.size_bytes)]
    if not collector.messages:
        raise RunsError.of_run(source.name, "the FIT file has no records")
    return log_of(collector.streams(), _WANTED, notes=notes)


def _take(frame: Any, collector: Collector, *, whole: bool) -> None:
    values: dict[str, float] = {}
    when = None
    for field in frame.fields:
        if field.name == "timestamp":
            when = field.value
        elif (whole or field.name in _FIELDS) and isinstance(field.value, (int, float)):
            values[field.name] = float(field.value)
    if isinstance(when, dt.datetime):
        collector.add("record", when.timestamp(), values)
    elif isinstance(when, (int, float)):
        collector.add("record", float(when), values)
