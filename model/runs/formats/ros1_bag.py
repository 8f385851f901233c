"""ROS 1 bags."""

from __future__ import annotations

from joulemap.model.recordings.ros1 import open_ros1, recognise
from joulemap.model.runs.formats.recording import decoder

__all__ = ["decode", "recognise"]

decode = decoder("ROS 1 bag", open_ros1, repair="rosbag reindex BAG")
"""Reads the topics that a run needs: see `joulemap.model.runs.formats.recording.Decode`."""
