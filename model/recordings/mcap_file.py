"""MCAP recordings of ROS 1, ROS 2, JSON and Protobuf messages."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, BinaryIO

from joulemap.model.errors import TooLargeError
from joulemap.model.recordings.contract import Recording, Topic, Wanted
from joulemap.model.recordings.types import full_type, types_of
from joulemap.model.source_file import SourceFile

_MAGIC = b"\x89MCAP0\r\n"
_LARGEST_RECORD = 1 << 30
_READ = ("cdr", "ros1", "json", "protobuf")


def recognise(head: bytes, name: str) -> bool:
    """Decide by the mark at the start of the file."""
    return head.startswith(_MAGIC)


@contextmanager
def open_mcap(source: SourceFile) -> Iterator[Recording]:
    """Open a recording. One that was cut off is read to its last whole record."""
    with source.open() as stream:
        yield _Recording(stream, source)


class _Recording:
    """Read from start to end: nearly every chunk holds messages of all topics, so that an index would save nothing."""

    def __init__(self, stream: BinaryIO, source: SourceFile) -> None:
        self.notes: list[str] = []
        self.topics: dict[str, Topic] = {}
        self._stream, self._source = stream, source
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, Any] = {}

    def messages(self, wanted: Wanted) -> Iterator[tuple[Topic, float, Any]]:
        from mcap.records import Channel, Message, Schema

        readers: dict[int, Callable[[bytes], Any] | None] = {}
        for record in self._all():
            if isinstance(record, Schema):
                self._schemas[record.id] = record
            elif isinstance(record, Channel):
                self._channels[record.id] = record
                self._meet(record)
            elif isinstance(record, Message):
                channel = self._channels[record.channel_id]
                topic = self.topics[channel.topic]
                if channel.id not in readers:
                    schema = self._schemas.get(channel.schema_id)
                    readers[channel.id] = _reader_of(schema, topic) if topic.readable and wanted(topic) else None
                read = readers[channel.id]
                if read is not None:
                    yield topic, record.log_time * 1e-9, read(record.data)

    def _meet(self, channel: Any) -> None:
        schema, encoding = self._schemas.get(channel.schema_id), channel.message_encoding
        readable = encoding in _READ and (encoding != "protobuf" or schema is not None)
        kind = schema.name if schema is not None else ""
        self.topics.setdefault(channel.topic, Topic(channel.topic, kind, encoding or "no known encoding", readable))

    def _all(self) -> Iterator[Any]:
        """All records, to where the file ends."""
        from mcap.records import Chunk, DataEnd

        for record, at in self._whole_records():
            if isinstance(record, Chunk):
                yield from self._inside(record, at)
            else:
                yield record
            if isinstance(record, DataEnd):
                self._note_index()
                break

    def _note_index(self) -> None:
        self._stream.seek(max(self._source.size_bytes - len(_MAGIC), 0))
        if self._stream.read() != _MAGIC:
            self.notes.append("the MCAP recording was cut off in its index. All its messages are there")

    def _whole_records(self) -> Iterator[tuple[Any, int]]:
        from mcap.exceptions import EndOfFile
        from mcap.stream_reader import StreamReader

        self._stream.seek(0)
        reader = StreamReader(self._stream, emit_chunks=True, validate_crcs=True, record_size_limit=_LARGEST_RECORD)
        records = iter(reader.records)
        end = 0
        while True:
            try:
                record = next(records)
            except StopIteration:
                return
            except (EndOfFile, struct.error):
                break
            yield record, end
            end = self._stream.tell()
        if end == 0:
            raise EOFError("there is no whole record in it")
        self.notes.append(
            f"the MCAP recording was cut off: it ends in the middle of a record that begins at byte {end:,} of "
            f"{self._source.size_bytes:,}. What comes before is kept; `mcap recover IN -o OUT` may find more"
        )

    def _inside(self, chunk: Any, at: int) -> list[Any]:
        """The records of a chunk, which is unpacked to the size that it declares, and no further."""
        from mcap.stream_reader import breakup_chunk

        size = int(chunk.uncompressed_size)
        if size > _LARGEST_RECORD:
            raise TooLargeError(
                f"{self._source.name}: the chunk at byte {at:,} of the MCAP recording unpacks to {size:,} bytes, the "
                f"limit is {_LARGEST_RECORD:,}: split it into smaller chunks",
                name=self._source.name,
                bytes=size,
                limit=_LARGEST_RECORD,
            )
        if chunk.compression in ("zstd", "lz4"):
            unpacked = _unpacked(chunk.data, chunk.compression, size)
            if len(unpacked) != size:
                raise ValueError(f"the chunk at byte {at:,} declares {size:,} bytes, and holds more or less")
            chunk = replace(chunk, compression="", data=unpacked)
        return breakup_chunk(chunk, validate_crc=True)


def _unpacked(data: bytes, compression: str, size: int) -> bytes:
    """At most one byte more than a size."""
    import lz4.frame
    import zstandard

    if compression == "lz4":
        found: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
        return found
    return zstandard.ZstdDecompressor().stream_reader(data).read(size + 1)


def _reader_of(schema: Any, topic: Topic) -> Callable[[bytes], Any]:
    if topic.encoding == "json":
        return json.loads
    if topic.encoding == "protobuf":
        from mcap_protobuf.decoder import DecoderFactory

        decoder = DecoderFactory().decoder_for("protobuf", schema)
        if decoder is None:
            raise ValueError(f"topic {topic.name} has no definition of its Protobuf messages")
        return decoder
    text = schema.data.decode("utf-8") if schema is not None and schema.encoding in ("ros1msg", "ros2msg") else ""
    store, kind = types_of(text, topic.kind, ros1=topic.encoding == "ros1"), full_type(topic.kind)
    deserialize = store.deserialize_ros1 if topic.encoding == "ros1" else store.deserialize_cdr
    return lambda data: deserialize(data, kind)
