"""Tables without a header that are known by their cells, such as the messages of `ros2 topic echo --csv`."""

from __future__ import annotations

from collections.abc import Sequence


def _fields(words: str) -> list[str]:
    """`position.xyz` as three names, `covariance*36` as as many."""
    found = ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id"]
    for word in words.split():
        stem, star, count = word.partition("*")
        front, _, axes = stem.rpartition(".")
        if star:
            found += [f"{stem}.{k}" for k in range(int(count))]
        else:
            found += [f"{front}.{axis}" for axis in axes] if axes in ("xyz", "xyzw") else [stem]
    return found


_POSE, _TWIST = "pose.position.xyz pose.orientation.xyzw", "twist.linear.xyz twist.angular.xyz"
_ODOMETRY = (
    "child_frame_id pose.pose.position.xyz pose.pose.orientation.xyzw pose.covariance*36 "
    "twist.twist.linear.xyz twist.twist.angular.xyz twist.covariance*36"
)
_BATTERY = (
    "voltage temperature current charge capacity design_capacity percentage power_supply_status power_supply_health "
    "power_supply_technology present"
)
_WITH_HEADER = [
    _fields(_ODOMETRY),
    _fields("status.status status.service latitude longitude altitude position_covariance*9 position_covariance_type"),
    _fields(_POSE),
    _fields(_TWIST),
]
"""Fields of nav_msgs/Odometry, sensor_msgs/NavSatFix, geometry_msgs/PoseStamped and TwistStamped; no two have as many."""
_OF_BATTERY = _fields(_BATTERY)
"""Fields of sensor_msgs/BatteryState before its lists of cells, of any length."""


def fields_of_row(cells: Sequence[str], values: Sequence[bool]) -> list[str]:
    """Return the names of the columns, by the first row; none where it is not known.

    `values`: which cells are values.
    """
    if [*values] == [True, False, True]:
        return ["time", "name", "value"]
    if len(cells) < len(_fields("")) or not (cells[0].isdigit() and cells[1].isdigit()) or values[2]:
        return []
    last = len(_OF_BATTERY) - 1
    if len(cells) > last and cells[last] in ("True", "False"):
        return [*_OF_BATTERY, *[""] * (len(cells) - len(_OF_BATTERY))]
    return next((names for names in _WITH_HEADER if len(names) == len(cells)), [])
