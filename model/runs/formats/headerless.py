"""Tables without a header: known by their cells, such as the messages of `ros2 topic echo --csv`, or by comments."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from joulemap.model.runs.names import is_unit

_POSE, _TWIST = "position.xyz orientation.xyzw", "linear.xyz angular.xyz"
_MESSAGES = [  # nav_msgs/Odometry, sensor_msgs/NavSatFix, geometry_msgs/PoseStamped and TwistStamped, BatteryState
    f"child_frame_id {_POSE} covariance*36 {_TWIST} covariance*36",
    "status service latitude longitude altitude covariance*9 covariance_type",
    _POSE,
    f"twist.{_TWIST}",
    "voltage temperature current charge capacity design_capacity percentage status health technology present",
]
"""Fields by type of message, behind its header; no two have as many. The last goes on with lists of any length."""


_COMMENT = re.compile(r"(?im)^[#% \t]*(?:col(?:umn)?\.?[ \t]*)?(\d{1,3})(?:[ \t]*[:.)=-][ \t]*|[ \t]+)(\S.*)$")


def is_numbered(mapping: Mapping[str, str]) -> bool:
    """Decide whether a mapping takes columns by their numbers: `t=column 1:ms`."""
    return any(re.search(r"\bcolumn \d", source) for source in mapping.values())


def described(comments: str, columns: int) -> tuple[list[str], list[str]]:
    """Return names and units of columns that comments describe by number: `# 2 mV battery voltage`, `# 3: Speed [m/s]`.

    Result: empty where they do not describe as many.
    """
    lines = [(int(found[1]), found[2].rstrip()) for found in _COMMENT.finditer(comments)][-columns:]
    if columns < 2 or [number for number, _ in lines] not in ([*range(columns)], [*range(1, columns + 1)]):
        return [], []
    words = [text.split(maxsplit=1) for _, text in lines]
    units = [each[0].strip("[](),:") if len(each) > 1 else "" for each in words]
    known = [unit if is_unit(unit) and not unit.isdigit() else "" for unit in units]
    return [each[1] if unit else text for (_, text), each, unit in zip(lines, words, known, strict=True)], known


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
