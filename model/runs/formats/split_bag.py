"""ROS 2 bags of several files, as a folder or as an archive: one log."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from joulemap.model.recordings.kinds import open_recording
from joulemap.model.recordings.split import parts_of, recognise
from joulemap.model.runs.formats.contract import Log
from joulemap.model.runs.formats.messages import reading
from joulemap.model.runs.formats.recording import read_parts
from joulemap.model.runs.table import TableLimits
from joulemap.model.source_file import SourceFile

__all__ = ["decode", "recognise"]


def decode(source: SourceFile, *, mapping: Mapping[str, str], limits: TableLimits, repairs: dict[str, int]) -> Log:
    """Read the topics that a run needs from all files."""
    with reading("archive", source.name, lambda: "in its list of files"), parts_of(source) as parts:
        return read_parts("ROS 2 bag", source.name, [partial(open_recording, part) for part in parts], mapping, limits)
