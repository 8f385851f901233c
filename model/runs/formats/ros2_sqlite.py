"""ROS 2 bags in SQLite (.db3)."""

from __future__ import annotations

from joulemap.model.recordings.ros2_sqlite import open_sqlite, recognise
from joulemap.model.runs.formats.recording import decoder

__all__ = ["decode", "recognise"]

decode = decoder("ROS 2 bag", open_sqlite, repair="sqlite3 BAG .recover | sqlite3 OUT")
"""Reads the topics that a run needs: see `joulemap.model.runs.formats.recording.Decode`."""
