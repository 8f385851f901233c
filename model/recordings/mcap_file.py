"""MCAP recordings of ROS 1, ROS 2, JSON and Protobuf messages."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO

from joulemap.model.errors import TooLargeError
from joulemap.model.recordings.contract import Recording, Topic, Wanted
from joulemap.model.recordings.types import full_type, types_of
from joulemap.model.source_file import SourceFile

_MAGIC = b"\x89MCAP0\r\n"
_LARGEST_RECORD = 1 << 30
_READ = ("cdr", "ros1", "json", "protobuf")


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


@contextmanager
def open_mcap(source: SourceFile) -> Iterator[Recording]:
    """Open a recording. One that was cut off is read to its last whole record.

    Parameters
    ----------
    source : SourceFile
        The file.

    Yields
    ------
    Recording
        With the topics of its summary.

    Raises
    ------
    TooLargeError
        If a chunk says that it unpacks to more than the limit.
    """
    with source.open() as stream:
        stream.seek(max(source.size_bytes - len(_MAGIC), 0))
        whole = stream.read() == _MAGIC and source.size_bytes > 2 * len(_MAGIC)
        stream.seek(0)
        yield _Whole(stream, source.name) if whole else _Cut(stream, source)


class _Whole:
    """Read with its summary, so that chunks without wanted topics are not unpacked."""

    def __init__(self, stream: BinaryIO, name: str) -> None:
        from mcap.reader import SeekingReader

        self.notes: list[str] = []
        self.topics: dict[str, Topic] = {}
        self._reader = SeekingReader(stream, validate_crcs=True, record_size_limit=_LARGEST_RECORD)
        summary = self._reader.get_summary()
        self._listed = summary is not None and bool(summary.channels)
        if summary is None:
            return
        for chunk in summary.chunk_indexes:
            _check_chunk(chunk.uncompressed_size, name)
        for channel in summary.channels.values():
            _meet(self.topics, channel, summary.schemas.get(channel.schema_id))

    def messages(self, wanted: Wanted) -> Iterator[tuple[Topic, float, Any]]:
        chosen = [topic.name for topic in self.topics.values() if topic.readable and wanted(topic)]
        if self._listed and not chosen:
            return
        found = self._reader.iter_messages(topics=chosen if self._listed else None, log_time_order=False)
        yield from _read(found, self.topics, wanted)


class _Cut:
    """Read from the start, to where the file ends."""

    def __init__(self, stream: BinaryIO, source: SourceFile) -> None:
        self.notes: list[str] = []
        self.topics: dict[str, Topic] = {}
        self._stream = stream
        self._source = source

    def messages(self, wanted: Wanted) -> Iterator[tuple[Topic, float, Any]]:
        yield from _read(self._records(), self.topics, wanted)

    def _records(self) -> Iterator[tuple[Any, Any, Any]]:
        from mcap.records import Channel, Chunk, DataEnd, Message, Schema
        from mcap.stream_reader import breakup_chunk

        schemas: dict[int, Any] = {}
        channels: dict[int, Any] = {}
        for record in self._whole_records():
            inside = [record]
            if isinstance(record, Chunk):
                _check_chunk(record.uncompressed_size, self._source.name)
                inside = breakup_chunk(record, validate_crc=True)
            for each in inside:
                if isinstance(each, Schema):
                    schemas[each.id] = each
                elif isinstance(each, Channel):
                    channels[each.id] = each
                elif isinstance(each, Message):
                    channel = channels[each.channel_id]
                    yield schemas.get(channel.schema_id), channel, each
            if isinstance(record, DataEnd):  # the summary, which is broken off, repeats what was read
                self.notes.append("the MCAP recording was cut off in its index. All its messages are there")
                break

    def _whole_records(self) -> Iterator[Any]:
        from mcap.exceptions import EndOfFile
        from mcap.stream_reader import StreamReader

        records = iter(StreamReader(self._stream, emit_chunks=True, record_size_limit=_LARGEST_RECORD).records)
        end = 0
        while True:
            try:
                record = next(records)
            except (EndOfFile, struct.error):
                break
            yield record
            end = self._stream.tell()
        if end == 0:
            raise EOFError("there is no whole record in it")
        self.notes.append(
            f"the MCAP recording was cut off: it ends in the middle of a record that begins at byte {end:,} of "
            f"{self._source.size_bytes:,}. What comes before is kept; `mcap recover IN -o OUT` may find more"
        )


def _check_chunk(size: int, name: str) -> None:
    if size > _LARGEST_RECORD:
        raise TooLargeError(
            f"{name}: a chunk of the MCAP recording unpacks to {size:,} bytes, the limit is {_LARGEST_RECORD:,}: split "
            "it into smaller chunks",
            name=name,
            bytes=size,
            limit=_LARGEST_RECORD,
        )


def _meet(topics: dict[str, Topic], channel: Any, schema: Any) -> Topic:
    kind, encoding = schema.name if schema is not None else "", channel.message_encoding
    readable = encoding in _READ and (encoding != "protobuf" or schema is not None)
    return topics.setdefault(channel.topic, Topic(channel.topic, kind, encoding or "no known encoding", readable))


def _read(
    found: Iterator[tuple[Any, Any, Any]], topics: dict[str, Topic], wanted: Wanted
) -> Iterator[tuple[Topic, float, Any]]:
    readers: dict[int, Callable[[bytes], Any] | None] = {}
    for schema, channel, message in found:
        if channel.id not in readers:
            topic = _meet(topics, channel, schema)
            readers[channel.id] = _reader_of(schema, topic) if topic.readable and wanted(topic) else None
        read = readers[channel.id]
        if read is not None:
            yield topics[channel.topic], message.log_time * 1e-9, read(message.data)


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
