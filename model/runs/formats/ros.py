"""Messages of robots: which types a run needs, and their fields as numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from joulemap.model.recordings.contract import Topic
from joulemap.model.recordings.types import fields_of, short_type
from joulemap.model.runs.formats.contract import Log, Stream, mentioned
from joulemap.model.runs.formats.messages import Collector, log_of

_KINDS = {
    "sensor_msgs/BatteryState": ("voltage", "current", "percentage"),
    "nav_msgs/Odometry": ("pose.pose", "twist.twist.linear"),
    "sensor_msgs/NavSatFix": ("latitude", "longitude", "altitude"),
    "sensor_msgs/Imu": ("orientation",),
    "geometry_msgs/PoseStamped": ("pose",),
    "geometry_msgs/PoseWithCovarianceStamped": ("pose.pose",),
    "sensor_msgs/JointState": ("velocity",),
    "foxglove.LocationFix": ("latitude", "longitude", "altitude"),
    "foxglove.PoseInFrame": ("pose",),
}
"""By type, the fields that a run may need; poses and orientations are taken apart into positions and angles."""

_MOST_ELEMENTS = 64  # of an array in a message
_DEEPEST = 8


def is_wanted(topic: Topic, mapping: Mapping[str, str]) -> bool:
    """Decide whether the messages of a topic are read.

    Result: True for the types that a run needs, and for topics that the mapping names.
    """
    return short_type(topic.kind) in _KINDS or mentioned(mapping, topic.name)


def collect(collector: Collector, topic: Topic, recorded_s: float, message: Any, *, whole: bool) -> None:
    """Take the numbers of a message."""
    values: dict[str, float] = {}
    kind = short_type(topic.kind)
    if whole:
        _leaves(message, "", values, 0)
    for field in _KINDS.get(kind, ()):
        _leaves(_inside(message, field), field, values, 0)
    _derived(message, kind, values)
    collector.add(topic.name, recorded_s, values, _sent(message))


def _sent(message: Any) -> float:
    """When the sender says that it was sent [s]: `header.stamp` of ROS, `timestamp` of Foxglove; NaN where unknown."""
    stamp = _inside(message, "header.stamp") or _inside(message, "timestamp")
    if stamp is None or isinstance(stamp, (int, float, str)):
        return math.nan
    seconds, parts = (
        next((found for name in names if (found := _inside(stamp, name))), 0)
        for names in (("sec", "secs", "seconds"), ("nanosec", "nsecs", "nsec", "nanos"))
    )
    return float(seconds) + 1e-9 * float(parts) if seconds else math.nan


def ros_log(streams: Sequence[Stream], kinds: Mapping[str, str], *, notes: Sequence[str] = ()) -> Log:
    """Return a log whose columns are found by the types of their topics.

    Result: positions in degrees come before those in metres, a pose before odometry.
    """
    most = sorted(streams, key=lambda stream: -(0 if stream.t is None else stream.t.size))

    def _of(kind: str, field: str, unit: str) -> list[str]:
        return [f"{s.name}.{field}:{unit}" for s in most if short_type(kinds.get(s.name, "")) == kind]

    poses = [
        ("geometry_msgs/PoseWithCovarianceStamped", "pose.pose"),
        ("geometry_msgs/PoseStamped", "pose"),
        ("foxglove.PoseInFrame", "pose"),
        ("nav_msgs/Odometry", "pose.pose"),
    ]
    fixes = ("sensor_msgs/NavSatFix", "foxglove.LocationFix")
    wanted = {
        "voltage": _of("sensor_msgs/BatteryState", "voltage", "V"),
        "current": _of("sensor_msgs/BatteryState", "current", "A"),
        "lat": [found for kind in fixes for found in _of(kind, "latitude", "deg")],
        "lon": [found for kind in fixes for found in _of(kind, "longitude", "deg")],
        "gps_error": _of("sensor_msgs/NavSatFix", "gps_error", "m"),
        "x": [found for kind, at in poses for found in _of(kind, f"{at}.position.x", "m")],
        "y": [found for kind, at in poses for found in _of(kind, f"{at}.position.y", "m")],
        "z": [found for kind in fixes for found in _of(kind, "altitude", "m")]
        + [found for kind, at in poses for found in _of(kind, f"{at}.position.z", "m")],
        "heading": [found for kind, _ in poses for found in _of(kind, "heading", "deg")],
        "roll": _of("sensor_msgs/Imu", "roll", "deg") + _of("nav_msgs/Odometry", "roll", "deg"),
        "pitch": _of("sensor_msgs/Imu", "pitch", "deg") + _of("nav_msgs/Odometry", "pitch", "deg"),
        "speed": _of("nav_msgs/Odometry", "twist.twist.linear.x", "m/s"),
    }
    return log_of(streams, wanted, notes=notes)


def _derived(message: Any, kind: str, values: dict[str, float]) -> None:
    """Angles in degrees of a quaternion, and the error of a fix; a fix without a satellite is none."""
    for at in ("orientation", "pose.orientation", "pose.pose.orientation"):
        q = _inside(message, at)
        if q is not None and kind in _KINDS:
            values |= _angles(*(float(_inside(q, axis) or 0.0) for axis in "xyzw"))
    if kind == "sensor_msgs/NavSatFix":
        covariance, known = _inside(message, "position_covariance"), _inside(message, "position_covariance_type")
        if covariance is not None and known and len(covariance) == 9:
            values["gps_error"] = math.sqrt(max(float(covariance[0]), float(covariance[4]), 0.0))
        status = _inside(message, "status.status")
        if status is not None and int(status) < 0:
            values |= {"latitude": math.nan, "longitude": math.nan, "altitude": math.nan}


def _angles(x: float, y: float, z: float, w: float) -> dict[str, float]:
    """Heading clockwise from north, roll to the right and pitch upwards [deg]; ROS counts otherwise.

    REP 103: x forward, y left, z up, so that a pitch is downwards; a yaw of zero points east.
    """
    norm = x * x + y * y + z * z + w * w
    if not 0.25 < norm < 4.0:  # an orientation of zeros is none
        return {"heading": math.nan, "roll": math.nan, "pitch": math.nan}
    yaw = math.atan2(2 * (w * z + x * y), norm - 2 * (y * y + z * z))
    roll = math.atan2(2 * (w * x + y * z), norm - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x) / norm)))
    return {"heading": (90.0 - math.degrees(yaw)) % 360.0, "roll": math.degrees(roll), "pitch": -math.degrees(pitch)}


def _inside(message: Any, path: str) -> Any:
    for name in path.split("."):
        message = message.get(name) if isinstance(message, dict) else getattr(message, name, None)
        if message is None:
            return None
    return message


def _leaves(value: Any, path: str, out: dict[str, float], depth: int) -> None:
    """All numbers in a value, by their paths; those of a list that has names beside it (JointState) by these names."""
    if value is None or depth > _DEEPEST or len(out) > 1_000:
        return
    if isinstance(value, (int, float)):
        out[path] = float(value)
        return
    if isinstance(value, str):
        return
    front = f"{path}." if path else ""
    fields = fields_of(value)
    if fields is not None:
        names = getattr(value, "name", None)
        for key, inner in fields:
            if isinstance(names, list) and key in ("position", "velocity", "effort") and len(inner) == len(names):
                for name, element in zip(names[:_MOST_ELEMENTS], inner, strict=False):
                    out[f"{front}{key}.{name}"] = float(element)
            else:
                _leaves(inner, f"{front}{key}", out, depth + 1)
    elif hasattr(value, "__len__") and not isinstance(value, bytes) and len(value) <= _MOST_ELEMENTS:
        for k, element in enumerate(value):
            _leaves(element.item() if hasattr(element, "item") else element, f"{path}[{k}]", out, depth + 1)
