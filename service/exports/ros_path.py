"""ROS nav_msgs/Path: what is driven, a pose each metre, as a message in JSON."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.frames import heading_of
from joulemap.service.exports.track import Line, Track

FRAME = "map"
"""Name of the frame of the poses: x east, y north [m], the coordinates of the map."""

Poses = NDArray[np.float64]
"""(n, 5) x, y, z [m], yaw [rad, counter-clockwise from east], time since the start [s]."""


def poses_of(track: Track) -> Poses:
    """Return what is driven as poses.

    Result (n, 5): x, y, z [m] (z 0 where unknown), yaw [rad, counter-clockwise from east], time since the start [s].
    """
    parts, began = list[Poses](), 0.0
    for line in track.driven:
        part = _poses(line, track.speed_mps)
        part[:, 4] += began
        began = float(part[-1, 4])
        if parts and np.allclose(part[0, :2], parts[-1][-1, :2], rtol=0.0, atol=1e-6):
            part = part[1:]
        parts.append(part)
    return np.vstack(parts)


def _poses(line: Line, speed_mps: float) -> Poses:
    if line.profile is None:
        xyz = line.points
        step = np.diff(xyz[:, :2], axis=0)
        heading, along = heading_of(step[:, 0], step[:, 1]), line.along_m
    else:
        p = line.profile
        xyz = np.vstack([line.points[:1], np.column_stack([p.x, p.y, p.z])])
        heading, along = p.heading_rad, np.append(0.0, p.distance_m)
    ahead = np.append(heading, heading[-1:]) if heading.size else np.zeros(len(xyz))  # at the end as on the way there
    return np.column_stack([np.nan_to_num(xyz, nan=0.0), np.mod(0.5 * np.pi - ahead, 2.0 * np.pi), along / speed_mps])


def stamp_of(seconds: float) -> tuple[int, int]:
    """Return a time as whole seconds and nanoseconds."""
    nanoseconds = round(seconds * 1e9)
    return nanoseconds // 1_000_000_000, nanoseconds % 1_000_000_000


def write(track: Track) -> bytes:
    """Return what is driven as a nav_msgs/Path in JSON, with the names of the message.

    Result: stamps count from the start of the drive.
    """

    def _header(seconds: float) -> dict[str, Any]:
        second, nanosecond = stamp_of(seconds)
        return {"stamp": {"sec": second, "nanosec": nanosecond}, "frame_id": FRAME}

    poses = [
        {
            "header": _header(time),
            "pose": {
                "position": {"x": x, "y": y, "z": z},
                "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(0.5 * yaw), "w": math.cos(0.5 * yaw)},
            },
        }
        for x, y, z, yaw, time in poses_of(track).tolist()
    ]
    return (json.dumps({"header": _header(0.0), "poses": poses}, allow_nan=False) + "\n").encode()
