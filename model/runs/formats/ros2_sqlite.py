"""ROS 2 bags in SQLite (.db3), read without their metadata.yaml: topics and messages are two tables.

The messages of such a bag have the types of ROS 2 itself; a bag with types of its own is recorded as MCAP.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from contextlib import closing

from joulemap.model.errors import RunsError
from joulemap.model.runs.formats.contract import Log, mentioned, on_disk
from joulemap.model.runs.formats.messages import Collector, reading
from joulemap.model.runs.formats.ros import collect, full_type, is_wanted, ros_log, types_of
from joulemap.model.runs.table import TableLimits
from joulemap.model.terrain.formats.contract import SourceFile

_MAGIC = b"SQLite format 3\0"
_LARGEST_MESSAGE = 1 << 26


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark of SQLite.

    Parameters
    ----------
    head : bytes
        First bytes of the file.
    name : str
        Not used.

    Returns
    -------
    bool
        True for a database of SQLite.
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
    collector = Collector(source.name, limits)
    store = types_of("", "", ros1=False)
    last = 0.0

    def _place() -> str:
        return f"after {collector.messages:,} messages" + (f", at {last:.3f} s" if last else "")

    with (
        on_disk(source) as path,
        reading("ROS 2 bag", source.name, _place),
        closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as bag,
    ):
        bag.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST_MESSAGE)
        bag.execute("PRAGMA trusted_schema = OFF")
        topics = {
            number: (topic, kind)
            for number, topic, kind, how in bag.execute("SELECT id, name, type, serialization_format FROM topics")
            if how == "cdr" and is_wanted(topic, kind, mapping)
        }
        if not topics:
            raise RunsError(
                f"run {source.name}: no topic is a BatteryState, NavSatFix, Odometry or pose in CDR; say which with a "
                "mapping, such as current=/topic.field:A",
                run=source.name,
            )
        marks = ",".join("?" * len(topics))
        rows = bag.execute(f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks})", list(topics))
        for number, nanoseconds, data in rows:
            last = nanoseconds * 1e-9
            topic, kind = topics[number]
            value = store.deserialize_cdr(data, full_type(kind))
            collect(collector, topic, kind, last, value, whole=mentioned(mapping, topic))
    return ros_log(collector.streams(), dict(topics.values()))
