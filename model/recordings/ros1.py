"""ROS 1 bags."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from joulemap.model.recordings.contract import Recording, Topic, Wanted
from joulemap.model.recordings.places import on_disk
from joulemap.model.recordings.types import types_of
from joulemap.model.source_file import SourceFile

_MAGIC = b"#ROSBAG V"
_LARGEST_CHUNK = 1 << 28


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


@contextmanager
def open_ros1(source: SourceFile) -> Iterator[Recording]:
    """Open a bag, which must have its index.

    Parameters
    ----------
    source : SourceFile
        The file.

    Yields
    ------
    Recording
        With its topics.
    """
    from rosbags.rosbag1 import Reader

    with on_disk(source, ".bag") as path, Reader(path) as bag:
        bag.chunks = {at: chunk._replace(decompressor=_bounded(chunk.decompressor)) for at, chunk in bag.chunks.items()}
        yield _Bag(bag)


def _bounded(unpack: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
    """The same, but of limited size: a chunk of kilobytes may hold gigabytes."""
    import lz4.frame
    from rosbags.rosbag1.reader import decompressors

    if unpack is decompressors["bz2"]:
        return lambda data: _unpacked(bz2.BZ2Decompressor(), data)
    if unpack is decompressors["lz4"]:
        return lambda data: _unpacked(lz4.frame.LZ4FrameDecompressor(), data)
    return unpack


def _unpacked(unpacker: Any, data: bytes) -> bytes:
    found: bytes = unpacker.decompress(data, _LARGEST_CHUNK)
    if not unpacker.eof:
        raise ValueError(f"a chunk of {len(data):,} bytes is cut off, or unpacks to more than {_LARGEST_CHUNK:,}")
    return found


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
