"""Maps of robots as messages: grid_map_msgs/GridMap by grid_map's conventions, and nav_msgs/OccupancyGrid."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

GRID_MAP, OCCUPANCY = "grid_map_msgs/msg/GridMap", "nav_msgs/msg/OccupancyGrid"
DEFINITION = """std_msgs/Header header
grid_map_msgs/GridMapInfo info
string[] layers
string[] basic_layers
std_msgs/Float32MultiArray[] data
uint16 outer_start_index
uint16 inner_start_index
================================================================================
MSG: grid_map_msgs/GridMapInfo
float64 resolution
float64 length_x
float64 length_y
geometry_msgs/Pose pose
"""
STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE.register({k: v for k, v in get_types_from_msg(DEFINITION, GRID_MAP).items() if k not in STORE.fielddefs})

Message = tuple[str, str, Any]  # topic, type, message


def _header(frame: str) -> Any:
    types = STORE.types
    return types["std_msgs/msg/Header"](stamp=types["builtin_interfaces/msg/Time"](sec=5, nanosec=0), frame_id=frame)


def _pose(x: float, y: float) -> Any:
    types = STORE.types
    place = types["geometry_msgs/msg/Point"](x, y, 0.0)
    return types["geometry_msgs/msg/Pose"](
        position=place, orientation=types["geometry_msgs/msg/Quaternion"](0, 0, 0, 1)
    )


def grid_map(
    heights: Any,
    centre: tuple[float, float],
    side: float,
    start: tuple[int, int] = (0, 0),
    layers: Sequence[str] = ("elevation",),
    frame: str = "map",
) -> Message:
    """heights(x, y) of grid_map: index (r, c) lies at centre + length / 2 - (index + 0.5) * side, rows along x."""
    types = STORE.types
    rows, cols = heights.shape
    matrix = np.roll(heights, start, (0, 1)).astype(np.float32)
    dim = types["std_msgs/msg/MultiArrayDimension"]
    layout = types["std_msgs/msg/MultiArrayLayout"](
        dim=[dim("column_index", cols, rows * cols), dim("row_index", rows, rows)], data_offset=0
    )
    array = types["std_msgs/msg/Float32MultiArray"](layout=layout, data=matrix.T.ravel())
    info = types["grid_map_msgs/msg/GridMapInfo"](side, rows * side, cols * side, _pose(*centre))
    message = types[GRID_MAP](_header(frame), info, list(layers), [], [array] * len(layers), *start)
    return "/elevation_map", GRID_MAP, message


def occupancy(values: Any, origin: tuple[float, float], side: float, frame: str = "map") -> Message:
    """values (rows from the south, columns from the west): -1 unknown, 0 free to 100 occupied."""
    types = STORE.types
    rows, cols = values.shape
    zero = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    info = types["nav_msgs/msg/MapMetaData"](zero, side, cols, rows, _pose(*origin))
    return "/map", OCCUPANCY, types[OCCUPANCY](_header(frame), info, np.asarray(values, dtype=np.int8).ravel())


def recording(messages: Sequence[Message]) -> bytes:
    """An MCAP recording of these messages, one after another."""
    out = io.BytesIO()
    writer = Writer(out)
    writer.start("ros2", "tests")
    for number, (topic, kind, message) in enumerate(messages):
        text = DEFINITION if kind == GRID_MAP else STORE.generate_msgdef(kind, ros_version=2)[0]
        channel = writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", text.encode()))
        writer.add_message(channel, number, bytes(STORE.serialize_cdr(message, kind)), number)
    writer.finish()
    return out.getvalue()
