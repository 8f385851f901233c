"""PX4 logs (ULog): the battery, the receiver, the estimated position and attitude."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter

import numpy as np

from joulemap.model.errors import RunsError, TooLargeError
from joulemap.model.recordings.places import on_disk
from joulemap.model.runs.formats.contract import Log, Stream, mentioned
from joulemap.model.runs.formats.finite import FiniteStream, fill_at, filled
from joulemap.model.runs.formats.messages import cut_off, fields_by_kind, log_of, reading, wanted_of
from joulemap.model.runs.table import TableLimits
from joulemap.model.source_file import SourceFile

_MAGIC = b"ULog\x01\x12\x35"
_HEADER_BYTES, _MESSAGE_HEAD = 16, struct.Struct("<Hc")
_LEAST_BYTES = {b"A": 3, b"B": 40, b"C": 11, b"D": 10, b"L": 9, b"S": 8} | dict.fromkeys(
    [bytes([k]) for k in b"FIMOPQR"], 2
)
"""What a message of each kind holds at least: its number, its time and what else has no variable length
(https://docs.px4.io/main/en/dev_log/ulog_file_format)."""
_MANY, _LEAST_MEAN = 1_000_000, 8
"""After so many messages of fewer bytes in the mean it is no log: one with a time and a value has 17 [bytes]."""
_MOST_STEPS = 1_000_000
"""Bytes of no message in which the library may look for the next one [bytes]: it takes a second for so many."""
_WANTED = wanted_of(
    {
        "voltage": "battery_status.voltage_v:V battery_status.voltage_filtered_v:V",
        "current": "battery_status.current_a:A battery_status.current_filtered_a:A",
        "lat": "vehicle_global_position.lat:deg vehicle_gps_position.latitude_deg:deg vehicle_gps_position.lat:degE7 "
        "sensor_gps.latitude_deg:deg sensor_gps.lat:degE7",
        "lon": "vehicle_global_position.lon:deg vehicle_gps_position.longitude_deg:deg vehicle_gps_position.lon:degE7 "
        "sensor_gps.longitude_deg:deg sensor_gps.lon:degE7",
        "x": "vehicle_local_position.y:m",
        "y": "vehicle_local_position.x:m",
        "z": "vehicle_global_position.alt:m vehicle_gps_position.altitude_msl_m:m vehicle_gps_position.alt:mm "
        "sensor_gps.altitude_msl_m:m sensor_gps.alt:mm",
        "heading": "vehicle_local_position.heading:rad",
    }
)
"""The local position has x north and y east."""
_FIELDS = fields_by_kind(_WANTED)


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark at the start of the file."""
    return head.startswith(_MAGIC)


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the messages that a run needs."""
    from pyulog import ULog

    if source.size_bytes / 8 > limits.cells:
        raise TooLargeError.of_run(
            source.name, f" has {source.size_bytes / 1e6:,.0f} MB, the limit is {8e-6 * limits.cells:,.0f} MB: split it"
        )
    named = {text.split(".")[0].lstrip("+-").split("[")[0] for text in mapping.values()}
    broken, notes, formats = _skimmed(source)
    _check_formats(formats, limits, source.name)
    with reading("ULog", source.name, lambda: f"at byte {broken:,}"), source.open() as stream:
        limited = FiniteStream(stream, end=broken, most_steps=_MOST_STEPS)
        log = ULog(limited, [*_FIELDS, *sorted(named - _FIELDS.keys())])
        if log.file_corruption or (broken < source.size_bytes and not notes):
            raise RunsError.of_run(
                source.name,
                f"the ULog is corrupt at byte {broken:,} of {source.size_bytes:,} or before: it was "
                f"read up to {max(log.last_timestamp, 0) * 1e-6:.3f} s, where something is no message",
                byte=broken,
            )
        streams = []
        for data in log.data_list:
            topic = f"{data.name}[{data.multi_id}]" if data.multi_id else data.name
            stamps = np.asarray(data.data["timestamp"], dtype=np.float64) * 1e-6
            limits.check(stamps.size, len(data.data), source.name)
            whole = mentioned(mapping, topic)
            numbers = {
                f"{topic}.{key}": np.asarray(values, dtype=np.float64)
                for key, values in data.data.items()
                if values.dtype.kind in "fiub" and (whole or key in _FIELDS.get(data.name, ()))
            }
            streams.append(Stream(topic, numbers, {}, stamps))
    if not streams:
        raise RunsError.of_run(
            source.name,
            f"the ULog has no battery_status and no position; its messages are "
            f"{', '.join(sorted(log.message_formats))[:300]}",
        )
    return log_of(streams, _WANTED, notes=notes)


def _skimmed(source: SourceFile) -> tuple[int, list[str], list[str]]:
    """Where the messages end [bytes], a note where the last one is not whole, and the formats that are declared."""
    size, at, count = source.size_bytes, _HEADER_BYTES, 0
    formats: list[str] = []
    with source.open() as stream:
        while at < size:
            stream.seek(at)
            head = stream.read(_MESSAGE_HEAD.size)
            if len(head) == _MESSAGE_HEAD.size:
                length, kind = _MESSAGE_HEAD.unpack(head)
                if length < _LEAST_BYTES.get(kind, math.inf):  # no message of that kind, or no such kind
                    with on_disk(source) as path:
                        return at, [filled("ULog", path, at)] if fill_at(path) <= at else [], formats
                if kind == b"F":
                    formats.append(stream.read(length).decode(errors="replace"))
            if len(head) < _MESSAGE_HEAD.size or at + _MESSAGE_HEAD.size + length > size:
                return at, [cut_off("ULog", at, size)], formats
            at += _MESSAGE_HEAD.size + length
            count += 1
            if count == _MANY and at < _LEAST_MEAN * count:
                raise RunsError.of_run(
                    source.name,
                    f"the first {count:,} messages of the ULog have {at / count:.1f} bytes in the "
                    f"mean, and those of a log at least {_LEAST_MEAN}",
                )
    return at, [], formats


def _check_formats(formats: list[str], limits: TableLimits, name: str) -> None:
    """Refuse messages that hold themselves, or more columns than the limit: the library writes out every field."""
    fields: dict[str, list[tuple[str, int]]] = {}
    for text in formats:  # like battery_status:uint64_t timestamp;float[4] cell_v
        kind, _, declared = text.partition(":")
        types = (field.split(" ")[0].rstrip("]").partition("[") for field in declared.split(";") if field)
        fields[kind] = [(inner, int(count[:9]) if count.isdecimal() else 1) for inner, _, count in types]
    columns: dict[str, int] = {}
    try:
        for kind in TopologicalSorter({kind: {inner for inner, _ in fields[kind]} for kind in fields}).static_order():
            held = sum(count * columns[inner] for inner, count in fields[kind]) if kind in fields else 1
            columns[kind] = min(held, 10**12)  # the message writes it out
            limits.check(0, columns[kind], f"{name}, ULog message {kind[:80]!r},")
    except CycleError as error:
        raise RunsError.of_run(name, f"the ULog's message {error.args[1][0][:80]!r} holds itself") from error
