"""The kinds of recordings that are one file each, recognised by their first bytes."""

from __future__ import annotations

from contextlib import AbstractContextManager

from joulemap.model.errors import InputError
from joulemap.model.recordings import mcap_file, ros1, ros2_sqlite
from joulemap.model.recordings.contract import Recording
from joulemap.model.source_file import SourceFile

_KINDS = (
    (mcap_file.recognise, mcap_file.open_mcap),
    (ros1.recognise, ros1.open_ros1),
    (ros2_sqlite.recognise, ros2_sqlite.open_sqlite),
)


def is_recording(head: bytes) -> bool:
    """Decide whether a file is a recording. Result: True for MCAP, ROS 1 bags and ROS 2 bags in SQLite."""
    return any(recognise(head, "") for recognise, _ in _KINDS)


def open_recording(source: SourceFile) -> AbstractContextManager[Recording]:
    """Open a recording of any kind."""
    for recognise, opener in _KINDS:
        if recognise(source.head, source.name):
            return opener(source)
    raise InputError(f"{source.name} is no MCAP recording and no ROS bag", name=source.name)
