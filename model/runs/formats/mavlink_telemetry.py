"""MAVLink telemetry logs (.tlog): each message after eight bytes of time in microseconds since 1970."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path

from joulemap.model.errors import RunsError
from joulemap.model.recordings.places import on_disk
from joulemap.model.runs.formats.contract import Log, mentioned
from joulemap.model.runs.formats.finite import FiniteStream, fill_at, filled
from joulemap.model.runs.formats.messages import Collector, cut_off, fields_by_kind, log_of, reading, wanted_of
from joulemap.model.runs.table import TableLimits
from joulemap.model.source_file import SourceFile

_MARKS = (0xFD, 0xFE)  # of MAVLink 2 and 1
_YEARS_US = (1e15, 4e15)  # 2001 to 2096
_LONGEST_BYTES = 8 + 280  # of a stamp and a message
_MOST_UNREADABLE = 1_000  # more than there are messages: the rest is not looked at
_MOST_STEPS = 1_000_000
"""Bytes of no message in which the library may look for the next one [bytes]: it takes a second for so many."""
WANTED = wanted_of(
    {
        "voltage": "BATTERY_STATUS.voltage:mV SYS_STATUS.voltage_battery:mV",
        "current": "BATTERY_STATUS.current_battery:cA SYS_STATUS.current_battery:cA",
        "lat": "GLOBAL_POSITION_INT.lat:degE7 GPS_RAW_INT.lat:degE7",
        "lon": "GLOBAL_POSITION_INT.lon:degE7 GPS_RAW_INT.lon:degE7",
        "x": "LOCAL_POSITION_NED.y:m",
        "y": "LOCAL_POSITION_NED.x:m",
        "z": "GLOBAL_POSITION_INT.alt:mm GPS_RAW_INT.alt:mm",
        "roll": "ATTITUDE.roll:rad",
        "pitch": "ATTITUDE.pitch:rad",
        "heading": "ATTITUDE.yaw:rad",
        "speed": "VFR_HUD.groundspeed:m/s",
    }
)
"""By joulemap's column, where it may be found."""
FIELDS = fields_by_kind(WANTED)
"""The fields that are wanted of each kind of message."""


def recognise(head: bytes, name: str) -> bool:
    """Decide by a time of this century before the mark of a message."""
    if len(head) < 12 or head[8] not in _MARKS:
        return False
    (stamp,) = struct.unpack(">Q", head[:8])
    return _YEARS_US[0] < stamp < _YEARS_US[1]


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the messages that a run needs."""
    from pymavlink import mavutil

    collector = Collector(source.name, limits)
    log = None
    unreadable = whole_messages = 0

    def _place() -> str:
        return f"after {collector.messages:,} messages" + (f", at {log.percent:.1f} % of it" if log is not None else "")

    with on_disk(source, ".tlog") as path, reading("MAVLink telemetry log", source.name, _place):
        try:
            begins = fill_at(path)
            mavutil.set_dialect("ardupilotmega")
            log = mavutil.mavlogfile(str(path))  # without the index of all messages, which nothing here asks for
            log.f = FiniteStream(log.f, end=begins + _LONGEST_BYTES, most_steps=_MOST_STEPS)
            while (message := log.recv_msg()) is not None:
                kind = message.get_type()
                if kind == "BAD_DATA":
                    unreadable += 1
                    if unreadable > _MOST_UNREADABLE + whole_messages:
                        break
                    continue
                whole_messages += 1
                keys = message.get_fieldnames() if mentioned(mapping, kind) else FIELDS.get(kind)
                if keys is None:
                    continue
                values = {key: float(v) for key in keys if isinstance(v := getattr(message, key, None), (int, float))}
                if kind == "GPS_RAW_INT" and message.fix_type < 2:
                    continue
                if kind == "BATTERY_STATUS":
                    cells = [mv for mv in message.voltages if mv != 65535]
                    if int(message.id) != 0 or not cells or values["current_battery"] == -1:
                        continue  # another battery, or an unknown current
                    values["voltage"] = float(sum(cells))
                collector.add(kind, float(message._timestamp), values)
        finally:
            if log is not None:
                log.close()
        broken, notes = _about_end(path, begins)
    if unreadable > whole_messages:
        raise RunsError.of_run(
            source.name,
            f"the MAVLink telemetry log is corrupt from byte {broken:,} on: {unreadable:,} pieces "
            f"of it are no messages, and {whole_messages:,} are",
            byte=broken,
        )
    return log_of(collector.streams(), WANTED, notes=notes)


def _about_end(path: Path, fill: int) -> tuple[int, list[str]]:
    """Where the messages end [bytes], and a note where the last one is not whole. fill : see `fill_at`."""
    data = path.read_bytes()
    if len(data) - fill > _LONGEST_BYTES:
        return fill, [filled("MAVLink telemetry log", path, fill)]
    at, size = 0, len(data)
    while at < size:
        left = size - at
        if left > 8 and data[at + 8] not in _MARKS:
            break
        length = 17 if left <= 10 else 16 + data[at + 9]  # a stamp, a header of 6, a checksum of 2, and the content
        if left > 10 and data[at + 8] == _MARKS[0]:
            length += 4 + 13 * (data[at + 10] & 1)  # a longer header; a signature
        if length > left:
            return at, [cut_off("MAVLink telemetry log", at, size)]
        at += length
    return at, []
