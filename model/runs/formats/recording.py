"""Bags and recordings of messages as logs: the topics that a run needs, within limits, one file or several parts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial

from joulemap.model.errors import RunsError
from joulemap.model.recordings import mcap_file, ros1, ros2_sqlite
from joulemap.model.recordings.contract import Recording, Topic, topics_in_words
from joulemap.model.recordings.kinds import open_recording
from joulemap.model.recordings.split import parts_of, recognise
from joulemap.model.runs.formats.contract import Log, mentioned
from joulemap.model.runs.formats.messages import Collector, reading
from joulemap.model.runs.formats.ros import collect, is_wanted, ros_log
from joulemap.model.runs.table import TableLimits
from joulemap.model.source_file import SourceFile

__all__ = ["MCAP", "ROS1", "ROS2", "decode", "recognise"]

Part = Callable[[], AbstractContextManager[Recording]]
"""Opens a file of a recording."""


@dataclass(frozen=True)
class _OneFile:
    """A kind of recordings that are one file each; `repair`: the command that may repair one that is corrupt."""

    name: str
    recognise: Callable[[bytes, str], bool]
    opener: Callable[[SourceFile], AbstractContextManager[Recording]]
    repair: str

    def decode(
        self, source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]
    ) -> Log:
        """Read the topics that a run needs."""
        return _read_parts(self.name, source.name, [lambda: self.opener(source)], mapping, limits, repair=self.repair)


MCAP = _OneFile("MCAP recording", mcap_file.recognise, mcap_file.open_mcap, "mcap recover IN -o OUT")
ROS1 = _OneFile("ROS 1 bag", ros1.recognise, ros1.open_ros1, "rosbag reindex BAG")
ROS2 = _OneFile("ROS 2 bag", ros2_sqlite.recognise, ros2_sqlite.open_sqlite, "sqlite3 BAG .recover | sqlite3 OUT")


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the topics that a run needs from all files of a ROS 2 bag, in a folder or an archive."""
    with reading("archive", source.name, lambda: "in its list of files"), parts_of(source) as parts:
        return _read_parts("ROS 2 bag", source.name, [partial(open_recording, part) for part in parts], mapping, limits)


def _read_parts(
    kind: str, name: str, parts: Iterable[Part], mapping: Mapping[str, str], limits: TableLimits, *, repair: str = ""
) -> Log:
    collector = Collector(name, limits)
    topics: dict[str, Topic] = {}
    notes: list[str] = []
    last = 0.0

    def _place() -> str:
        return f"after {collector.messages:,} messages" + (f", at {last:.3f} s" if last else "")

    def _wanted(topic: Topic) -> bool:
        return is_wanted(topic, mapping)

    for part in parts:
        with reading(kind, name, _place, repair=repair), _opened(part, topics, notes) as recording:
            for topic, last, message in recording.messages(_wanted):
                collect(collector, topic, last, message, whole=mentioned(mapping, topic.name))
    if not collector.messages and not topics and notes:
        raise RunsError.of_run(name, f"{notes[0]}, and that is nothing")
    if not collector.messages:
        raise _nothing(name, topics, _wanted)
    return ros_log(collector.streams(), {topic.name: topic.kind for topic in topics.values()}, notes=notes)


@contextmanager
def _opened(part: Part, topics: dict[str, Topic], notes: list[str]) -> Iterator[Recording]:
    with part() as recording:
        yield recording
        topics |= recording.topics
        notes += recording.notes


def _nothing(name: str, topics: Mapping[str, Topic], wanted: Callable[[Topic], bool]) -> RunsError:
    there = topics_in_words(dict(topics))
    unreadable = sorted({topic.encoding for topic in topics.values() if wanted(topic) and not topic.readable})
    if unreadable:
        return RunsError.of_run(
            name,
            f"its messages are in {', '.join(unreadable)}, which is not read: record them in CDR, ROS 1, "
            f"JSON or Protobuf. Its topics are {there}",
            encodings=unreadable,
        )
    if any(wanted(topic) for topic in topics.values()):
        return RunsError.of_run(name, f"the topics that a run needs hold no message. Its topics are {there}")
    return RunsError.of_run(
        name,
        f"no topic is a BatteryState, NavSatFix, Odometry or pose. Its topics are {there}; say "
        "which with a mapping, such as current=/topic.field:A",
    )
