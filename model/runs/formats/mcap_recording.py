"""MCAP recordings of ROS 1, ROS 2, JSON and Protobuf messages."""

from __future__ import annotations

from joulemap.model.recordings.mcap_file import open_mcap, recognise
from joulemap.model.runs.formats.recording import decoder

__all__ = ["decode", "recognise"]

decode = decoder("MCAP recording", open_mcap, repair="mcap recover IN -o OUT")
"""Reads the topics that a run needs: see `joulemap.model.runs.formats.recording.Decode`."""
