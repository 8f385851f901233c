"""MCAP recordings of ROS 1, ROS 2 and JSON messages."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from joulemap.model.errors import RunsError, TooLargeError
from joulemap.model.runs.formats.contract import Log, mentioned
from joulemap.model.runs.formats.messages import Collector, reading
from joulemap.model.runs.formats.ros import collect, full_type, is_wanted, ros_log, types_of
from joulemap.model.runs.table import TableLimits
from joulemap.model.terrain.formats.contract import SourceFile

_MAGIC = b"\x89MCAP0\r\n"
_LARGEST_RECORD = 1 << 30
_READ = ("cdr", "ros1", "json")


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark at the start of the file.

    Parameters
    ----------
    head : bytes
        First bytes of the file.
    name : str
        Not used.

    Returns
    -------
    bool
        True for an MCAP recording.
    """
    return head.startswith(_MAGIC)


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the topics that a run needs.

    Parameters
    ----------
    source : SourceFile
        The recording.
    mapping : mapping of str to str
        Topics that it names are read too.
    limits : TableLimits
        How large it may be.
    repairs : dict
        Not used.

    Returns
    -------
    Log
        A stream for each topic.

    Raises
    ------
    RunsError
        If it is truncated or corrupt, or holds no message that can be read.
    TooLargeError
        If it is larger than the limits.
    """
    from mcap.reader import SeekingReader

    collector = Collector(source.name, limits)
    kinds: dict[str, str] = {}
    last = 0.0

    def _place() -> str:
        return f"after {collector.messages:,} messages" + (f", at {last:.3f} s" if last else "")

    repair = "mcap recover IN -o OUT"
    with reading("MCAP recording", source.name, _place, repair=repair), source.open() as stream:
        reader = SeekingReader(stream, validate_crcs=True, record_size_limit=_LARGEST_RECORD)
        topics: list[str] | None = None
        summary = reader.get_summary()
        if summary is not None and summary.channels:
            largest = max((chunk.uncompressed_size for chunk in summary.chunk_indexes), default=0)
            if largest > _LARGEST_RECORD:
                raise TooLargeError(
                    f"run {source.name}: a chunk of the MCAP recording unpacks to {largest:,} bytes, the limit is "
                    f"{_LARGEST_RECORD:,}",
                    run=source.name,
                )
            topics = [
                channel.topic
                for channel in summary.channels.values()
                if channel.message_encoding in _READ
                and is_wanted(channel.topic, _kind(summary.schemas.get(channel.schema_id)), mapping)
            ]
            if not topics:
                raise _nothing(source.name, [channel.topic for channel in summary.channels.values()])
        stores: dict[int, Any] = {}
        for schema, channel, message in reader.iter_messages(topics=topics, log_time_order=False):
            kind = _kind(schema)
            if channel.message_encoding not in _READ or not is_wanted(channel.topic, kind, mapping):
                continue
            last = message.log_time * 1e-9
            if channel.id not in stores:
                stores[channel.id] = _store(schema, channel.message_encoding)
                kinds[channel.topic] = kind
            value = _value(stores[channel.id], channel.message_encoding, kind, message.data)
            collect(collector, channel.topic, kind, last, value, whole=mentioned(mapping, channel.topic))
    return ros_log(collector.streams(), kinds)


def _kind(schema: Any) -> str:
    return schema.name if schema is not None else ""


def _store(schema: Any, encoding: str) -> Any:
    if encoding == "json":
        return None
    text = schema.data.decode("utf-8") if schema is not None and schema.encoding in ("ros1msg", "ros2msg") else ""
    return types_of(text, _kind(schema), ros1=encoding == "ros1")


def _value(store: Any, encoding: str, kind: str, data: bytes) -> Any:
    if encoding == "json":
        return json.loads(data)
    read = store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr
    return read(data, full_type(kind))


def _nothing(name: str, topics: list[str]) -> RunsError:
    there = ", ".join(sorted(topics))[:300] or "none"
    return RunsError(
        f"run {name}: no topic is a BatteryState, NavSatFix, Odometry or pose, in CDR, ROS 1 or JSON. Its topics are "
        f"{there}; say which with a mapping, such as current=/topic.field:A",
        run=name,
    )
