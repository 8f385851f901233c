"""ROS 1 bags."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from joulemap.model.recordings.contract import Recording, Topic, Wanted
from joulemap.model.recordings.places import on_disk
from joulemap.model.recordings.ros1_records import UnindexedBag, has_index, unpacked_chunk
from joulemap.model.recordings.types import types_of
from joulemap.model.source_file import SourceFile

_MAGIC = b"#ROSBAG V"


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark at the start of the file."""
    return head.startswith(_MAGIC)


@contextmanager
def open_ros1(source: SourceFile) -> Iterator[Recording]:
    """Open a bag. One without an index is read from start to end."""
    with source.open() as stream:
        if not has_index(stream, source.size_bytes):
            yield UnindexedBag(stream, source.size_bytes)
            return
    from rosbags.rosbag1 import Reader
    from rosbags.rosbag1.reader import decompressors

    names = {unpack: name for name, unpack in decompressors.items()}
    with on_disk(source, ".bag") as path, Reader(path) as bag:
        # a chunk of kilobytes may hold gigabytes: rosbags would unpack all of them
        bag.chunks = {
            at: chunk._replace(decompressor=partial(unpacked_chunk, names[chunk.decompressor]))
            for at, chunk in bag.chunks.items()
        }
        yield _Bag(bag)


class _Bag:
    def __init__(self, bag: Any) -> None:
        self.notes: list[str] = []
        self.topics = {each.topic: Topic(each.topic, each.msgtype, "ros1") for each in bag.connections}
        self._bag = bag

    def messages(self, wanted: Wanted) -> Iterator[tuple[Topic, float, Any]]:
        chosen = [each for each in self._bag.connections if wanted(self.topics[each.topic])]
        stores: dict[int, Any] = {}
        for connection, nanoseconds, data in self._bag.messages(chosen) if chosen else ():
            if connection.id not in stores:
                stores[connection.id] = types_of(connection.msgdef.data, connection.msgtype, ros1=True)
            value = stores[connection.id].deserialize_ros1(data, connection.msgtype)
            yield self.topics[connection.topic], nanoseconds * 1e-9, value
