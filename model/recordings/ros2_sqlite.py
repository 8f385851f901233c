"""ROS 2 bags in SQLite (.db3), read without their metadata.yaml: topics and messages are two tables.

The messages of such a bag have the types of ROS 2 itself; a bag with types of its own is recorded as MCAP.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

from joulemap.model.recordings.contract import Recording, Topic, Wanted
from joulemap.model.recordings.places import on_disk
from joulemap.model.recordings.types import full_type, types_of
from joulemap.model.source_file import SourceFile

_MAGIC = b"SQLite format 3\0"
_ZSTD = b"\x28\xb5\x2f\xfd"
_LARGEST_MESSAGE = 1 << 26


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark of SQLite."""
    return head.startswith(_MAGIC)


@contextmanager
def open_sqlite(source: SourceFile) -> Iterator[Recording]:
    """Open a bag."""
    _check_length(source)
    with (
        on_disk(source) as path,
        closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as bag,
    ):
        bag.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST_MESSAGE)
        bag.execute("PRAGMA trusted_schema = OFF")
        _check_tables(bag)
        yield _Bag(bag)


def _check_length(source: SourceFile) -> None:
    """Refuse a file that is shorter than its header says (sqlite.org/fileformat2.html, section 1.3)."""
    if len(source.head) < 100:
        raise ValueError(f"it has {len(source.head)} bytes, its header alone has 100")
    (page,), (pages,) = struct.unpack_from(">H", source.head, 16), struct.unpack_from(">I", source.head, 28)
    declared = (65_536 if page == 1 else page) * pages
    if declared > source.size_bytes:
        raise ValueError(f"it ends at byte {source.size_bytes:,} of {declared:,}")


def _check_tables(bag: sqlite3.Connection) -> None:
    """Refuse what is no bag, and tables that are computed, which may never end."""
    listed = bag.execute("SELECT name, type, sql FROM sqlite_master")
    found = {str(name): (str(kind), str(text)) for name, kind, text in listed}
    for table in ("topics", "messages"):
        kind, text = found.get(table, ("", ""))
        if kind != "table" or "virtual" in text.lower():
            raise ValueError(f"it has no table {table!r}: its tables are {', '.join(sorted(found))[:200] or 'none'}")


class _Bag:
    def __init__(self, bag: sqlite3.Connection) -> None:
        self.notes: list[str] = []
        self._numbers = {
            int(number): Topic(str(topic), str(kind), str(how), how == "cdr")
            for number, topic, kind, how in bag.execute("SELECT id, name, type, serialization_format FROM topics")
        }
        self.topics = {topic.name: topic for topic in self._numbers.values()}
        self._bag = bag

    def messages(self, wanted: Wanted) -> Iterator[tuple[Topic, float, Any]]:
        chosen = [number for number, topic in self._numbers.items() if topic.readable and wanted(topic)]
        store = types_of("", "", ros1=False)
        marks = ",".join("?" * len(chosen))
        rows = self._bag.execute(f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks})", chosen)
        for number, nanoseconds, data in rows:
            topic = self._numbers[number]
            if data[:4] == _ZSTD:
                raise ValueError(
                    "its messages are compressed: write it again with `ros2 bag convert`, without compression_mode"
                )
            yield topic, nanoseconds * 1e-9, store.deserialize_cdr(data, full_type(topic.kind))
