"""MCAP with a ROS 2 nav_msgs/Path on the topic /plan, for `ros2 bag play`, Foxglove and RViz."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from joulemap.model.errors import InputError
from joulemap.service.exports.ros_path import FRAME, poses_of, stamp_of
from joulemap.service.exports.track import Track

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

TOPIC = "/plan"
"""As Nav2's planner server names it."""


def write(track: Track) -> bytes:
    """Return what is driven as an MCAP file. Needs the extra `logs` (rosbags).

    Result: one message, nav_msgs/msg/Path, at time 0; the stamps of its poses count from the start of the drive.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError("an MCAP file needs rosbags: pip install 'joulemap[logs]'") from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    message = _message(track, store)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "plan"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection(TOPIC, message.__msgtype__, typestore=store)
            writer.write(connection, 0, store.serialize_cdr(message, message.__msgtype__))
        (file,) = bag.glob("*.mcap")
        return file.read_bytes()


def _message(track: Track, store: Typestore) -> Any:
    types = store.types

    def _header(seconds: float) -> Any:
        stamp = types["builtin_interfaces/msg/Time"](*stamp_of(seconds))
        return types["std_msgs/msg/Header"](stamp, FRAME)

    def _pose(x: float, y: float, z: float, yaw: float, time: float) -> Any:
        position = types["geometry_msgs/msg/Point"](x, y, z)
        turned = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
        return types["geometry_msgs/msg/PoseStamped"](_header(time), types["geometry_msgs/msg/Pose"](position, turned))

    poses = np.asarray(poses_of(track)).tolist()
    return types["nav_msgs/msg/Path"](_header(0.0), [_pose(*pose) for pose in poses])
