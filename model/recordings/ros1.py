"""ROS 1 bags, read from start to end: also those without an index, because they were cut off or never closed.

Reference: ROS wiki, Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import io
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO

from joulemap.model.recordings.contract import Recording, Topic, Wanted
from joulemap.model.recordings.types import types_of
from joulemap.model.source_file import SourceFile

LARGEST_CHUNK = 1 << 28
"""Most bytes that a chunk is unpacked to."""

_MAGIC = b"#ROSBAG V"
_MESSAGE, _BAG, _CHUNK, _CONNECTION = 2, 3, 5, 7  # codes of records; the others are of the index

Fields = dict[str, bytes]


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark at the start of the file."""
    return head.startswith(_MAGIC)


@contextmanager
def open_ros1(source: SourceFile) -> Iterator[Recording]:
    """Open a bag. One that was cut off is read to its last whole record."""
    with source.open() as stream:
        yield _Bag(stream, source.size_bytes)


class _Bag:
    def __init__(self, stream: BinaryIO, size: int) -> None:
        self.topics: dict[str, Topic] = {}
        self.notes: list[str] = []
        self._stream, self._size, self._closed = stream, size, _has_index(stream, size)

    def messages(self, wanted: Wanted) -> Iterator[tuple[Topic, float, Any]]:
        read: dict[bytes, tuple[Topic, Callable[[bytes], Any] | None]] = {}
        for fields, data in self._all():
            code = _code(fields)
            if code == _CONNECTION and fields["conn"] not in read:
                topic, text = _connection(fields, data)
                self.topics.setdefault(topic.name, topic)
                read[fields["conn"]] = topic, _reader(topic, text) if wanted(topic) else None
            elif code == _MESSAGE:
                topic, deserialize = read[fields["conn"]]
                if deserialize is not None:
                    seconds, nanoseconds = struct.unpack("<LL", fields["time"])
                    yield topic, seconds + 1e-9 * nanoseconds, deserialize(data)

    def _all(self) -> Iterator[tuple[Fields, bytes]]:
        """All records, those of chunks in place of the chunks, to where the file ends."""
        self._stream.seek(0)
        self._stream.readline(100)
        while (at := self._stream.tell()) < self._size:
            head = _sized(self._stream, self._size)
            fields = {} if head is None else _fields(head)
            if fields and _code(fields) == _CHUNK and fields["compression"] == b"none":
                self._stream.read(4)  # its records follow as if there were no chunk, also those of one that is cut off
                continue
            data = None if head is None else _sized(self._stream, self._size)
            if data is None:
                self.notes.append(
                    f"the ROS 1 bag was cut off: it ends in the middle of a record that begins at byte {at:,} of "
                    f"{self._size:,}. What comes before is kept"
                )
                return
            if _code(fields) == _CHUNK:
                yield from _records_in(_unpacked(fields["compression"].decode("ascii"), data), at)
            elif _code(fields) != _BAG:
                yield fields, data
        if not self._closed:
            self.notes.append("the ROS 1 bag was not closed and has no index: it was read from start to end")


def _records_in(unpacked: bytes, at: int) -> Iterator[tuple[Fields, bytes]]:
    inside = io.BytesIO(unpacked)
    while inside.tell() < len(unpacked):
        found = _record(inside, len(unpacked))
        if found is None:
            raise ValueError(f"the chunk at byte {at:,} ends in the middle of a record")
        yield found


def _has_index(stream: BinaryIO, size: int) -> bool:
    """Whether a bag ends with the records of all connections and chunks: it was closed, and not cut off."""
    stream.seek(0)
    stream.readline(100)
    record = _record(stream, size)
    if record is None or not {"index_pos", "conn_count", "chunk_count"} <= record[0].keys():
        raise ValueError("its first record is no header of a bag")
    at = int.from_bytes(record[0]["index_pos"][:8], "little")
    count = sum(int.from_bytes(record[0][key][:4], "little") for key in ("conn_count", "chunk_count"))
    if not 0 < at <= size:
        return False
    stream.seek(at)
    return all(_record(stream, size) is not None for _ in range(count))


def _unpacked(compression: str, data: bytes) -> bytes:
    """The content of a chunk."""
    import lz4.frame

    if compression == "none":
        return data
    kinds = {"bz2": bz2.BZ2Decompressor, "lz4": lz4.frame.LZ4FrameDecompressor}
    if compression not in kinds:
        raise ValueError(f"its chunks are compressed by {compression[:20]!r}, which is not known")
    unpacker = kinds[compression]()
    found: bytes = unpacker.decompress(data, LARGEST_CHUNK)
    if not unpacker.eof:
        raise ValueError(f"a chunk of {len(data):,} bytes is cut off, or unpacks to more than {LARGEST_CHUNK:,}")
    return found


def _record(stream: BinaryIO, size: int) -> tuple[Fields, bytes] | None:
    """The next record; None where the file ends in it."""
    head = _sized(stream, size)
    data = _sized(stream, size) if head is not None else None
    return None if head is None or data is None else (_fields(head), data)


def _sized(stream: BinaryIO, size: int) -> bytes | None:
    count = stream.read(4)
    if len(count) < 4 or int.from_bytes(count, "little") > size - stream.tell():
        return None
    return stream.read(int.from_bytes(count, "little"))


def _fields(head: bytes) -> Fields:
    found, at = {}, 0
    while at < len(head):
        (length,) = struct.unpack_from("<L", head, at)
        name, mark, value = head[at + 4 : at + 4 + length].partition(b"=")
        if not mark or at + 4 + length > len(head):
            raise ValueError("a record has a header without names")
        found[name.decode("ascii")] = value
        at += 4 + length
    return found


def _code(fields: Fields) -> int:
    return fields["op"][0]


def _connection(fields: Fields, data: bytes) -> tuple[Topic, str]:
    about = _fields(data)
    kind = about["type"].decode("utf-8")
    package, _, name = kind.partition("/")
    topic = Topic(fields["topic"].decode("utf-8"), f"{package}/msg/{name}", "ros1")
    return topic, about["message_definition"].decode("utf-8")


def _reader(topic: Topic, text: str) -> Callable[[bytes], Any]:
    store = types_of(text, topic.kind, ros1=True)
    return lambda data: store.deserialize_ros1(data, topic.kind)
