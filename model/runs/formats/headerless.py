"""Tables without a header that are known by their cells, such as the messages of `ros2 topic echo --csv`."""

from __future__ import annotations

import re
from collections.abc import Sequence

_POSE, _TWIST = "position.xyz orientation.xyzw", "linear.xyz angular.xyz"
_MESSAGES = [  # nav_msgs/Odometry, sensor_msgs/NavSatFix, geometry_msgs/PoseStamped and TwistStamped, BatteryState
    f"child_frame_id {_POSE} covariance*36 {_TWIST} covariance*36",
    "status service latitude longitude altitude covariance*9 covariance_type",
    _POSE,
    f"twist.{_TWIST}",
    "voltage temperature current charge capacity design_capacity percentage status health technology present",
]
"""Fields by type of message, behind its header; no two have as many. The last goes on with lists of any length."""


def _fields(message: str) -> list[str]:
    """`position.xyz` as three names, `covariance*36` as as many."""
    found = ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id"]
    for word in message.split():
        stem, axes, count = re.fullmatch(r"(.*?)(?:\.(xyzw?))?(?:\*(\d+))?", word).groups()  # type: ignore[union-attr]
        found += [f"{stem}.{each}" for each in axes or range(int(count or 0))] or [stem]
    return found


def fields_of_row(cells: Sequence[str], values: Sequence[bool]) -> list[str]:
    """Return the names of the columns by the first row, of which `values` says what is a value; none if unknown."""
    if [*values] == [True, False, True]:
        return ["time", "name", "value"]
    if len(cells) < 4 or not (cells[0].isdigit() and cells[1].isdigit()) or values[2]:
        return []
    *whole, battery = map(_fields, _MESSAGES)
    if cells[len(battery) - 1 : len(battery)] in (["True"], ["False"]):
        return battery + [""] * (len(cells) - len(battery))
    return next((names for names in whole if len(names) == len(cells)), [])
