"""ROS 1 bags."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from joulemap.model.errors import RunsError, TooLargeError
from joulemap.model.runs.formats.contract import Log, mentioned, on_disk
from joulemap.model.runs.formats.messages import Collector, reading
from joulemap.model.runs.formats.ros import collect, is_wanted, ros_log, types_of
from joulemap.model.runs.table import TableLimits
from joulemap.model.terrain.formats.contract import SourceFile

_MAGIC = b"#ROSBAG V"


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
        True for a ROS 1 bag.
    """
    return head.startswith(_MAGIC)


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the topics that a run needs.

    Parameters
    ----------
    source : SourceFile
        The bag.
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
        If it is truncated or corrupt, or holds no topic that a run needs.
    TooLargeError
        If it is larger than the limits.
    """
    from rosbags.rosbag1 import Reader

    collector = Collector(source.name, limits)
    kinds: dict[str, str] = {}
    last = 0.0

    def _place() -> str:
        return f"after {collector.messages:,} messages" + (f", at {last:.3f} s" if last else "")

    with (
        on_disk(source, ".bag") as path,
        reading("ROS 1 bag", source.name, _place, repair="rosbag reindex BAG"),
        Reader(path) as bag,
    ):
        if bag.message_count > limits.cells:
            raise TooLargeError(
                f"run {source.name} has {bag.message_count:,} messages, the limit is {limits.cells:,}: split it",
                run=source.name,
            )
        wanted = [each for each in bag.connections if is_wanted(each.topic, each.msgtype, mapping)]
        if not wanted:
            there = ", ".join(sorted({each.topic for each in bag.connections}))[:300] or "none"
            raise RunsError(
                f"run {source.name}: no topic is a BatteryState, NavSatFix, Odometry or pose. Its topics are {there}; "
                "say which with a mapping, such as current=/topic.field:A",
                run=source.name,
            )
        stores: dict[int, Any] = {}
        for connection, nanoseconds, data in bag.messages(wanted):
            last = nanoseconds * 1e-9
            if connection.id not in stores:
                stores[connection.id] = types_of(connection.msgdef.data, connection.msgtype, ros1=True)
                kinds[connection.topic] = connection.msgtype
            value = stores[connection.id].deserialize_ros1(data, connection.msgtype)
            whole = mentioned(mapping, connection.topic)
            collect(collector, connection.topic, connection.msgtype, last, value, whole=whole)
    return ros_log(collector.streams(), kinds)
