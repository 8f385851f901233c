"""Routes, cost maps and forecasts as messages of ROS 2, and what the node needs of it: rclpy is loaded only here.

The frame is x east, y north [m], less an origin. Poses are float64, but renderers and costmaps compute in float32,
which has only steps of 0.25 m at UTM coordinates: so the origin of the frame is a point near the map.
"""

from __future__ import annotations

import array
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from joulemap.model.errors import InputError
from joulemap.planner.lattice import CostLattice
from joulemap.planner.route import Route
from joulemap.service.driving.forecast import Forecast
from joulemap.service.exports.ros_path import poses_of
from joulemap.service.exports.track import DRIVE, Track, line_of

Message = Any


class Ros:
    """A node of ROS 2 on rclpy, which every installation of ROS 2 brings."""

    def __init__(self, name: str) -> None:
        try:
            import rclpy
        except ImportError as error:
            raise InputError(f"rclpy is missing ({error}): source /opt/ros/jazzy/setup.bash first") from error

        rclpy.init()
        self._rclpy, self._node = rclpy, rclpy.create_node(name)

    def message(self, kind: str) -> Message:
        """Return a new message of a type such as nav_msgs/msg/Path, with its default values."""
        from rosidl_runtime_py.utilities import get_message

        return get_message(kind)()

    def subscribe(self, topic: str, kind: str, take: Callable[[Message], None]) -> None:
        """Call `take` with every message of a topic. As sensors publish: best effort takes reliable publishers too."""
        from rclpy.qos import qos_profile_sensor_data

        self._node.create_subscription(type(self.message(kind)), topic, take, qos_profile_sensor_data)

    def publisher(self, topic: str, kind: str, *, latched: bool = False) -> Callable[[Message], None]:
        """Return what publishes a message, reliably; who comes later gets the last one of a latched topic."""
        from rclpy.qos import DurabilityPolicy, QoSProfile

        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        quality = QoSProfile(depth=1, durability=durability)
        publish: Callable[[Message], None] = self._node.create_publisher(
            type(self.message(kind)), topic, quality
        ).publish
        return publish

    def action(self, name: str, kind: str, answer: Callable[[Message, Message], bool]) -> None:
        """Answer an action: `answer` gets its goal and an empty result; False aborts it."""
        from rclpy.action import ActionServer
        from rosidl_runtime_py.utilities import get_action

        wanted = get_action(kind)

        def _execute(handle: Any) -> Message:
            result = wanted.Result()
            (handle.succeed if answer(handle.request, result) else handle.abort)()
            return result

        ActionServer(self._node, wanted, name, _execute)

    def stamp(self) -> Message:
        """Return the time now, a builtin_interfaces/msg/Time of the clock of ROS, which a simulator may set."""
        return self._node.get_clock().now().to_msg()

    def error(self, words: str) -> None:
        """Log an error."""
        self._node.get_logger().error(words)

    def spin(self) -> None:
        """Work until the node is stopped."""
        self._rclpy.spin(self._node)


_DEAREST = 99
"""Of an OccupancyGrid: 100 is blocked."""
_OK, _WARN, _ERROR = b"\x00", b"\x01", b"\x02"
_LEVELS = {"yes": _OK, "likely": _OK, "marginal": _WARN, "no": _ERROR}


class Frame:
    """The frame of the map: its name and the world x, y of its origin [m]."""

    def __init__(self, ros: Ros, name: str, origin: tuple[float, float]) -> None:
        self.ros, self.name, self.origin = ros, name, origin

    def header(self) -> Message:
        """Return a header of now."""
        header = self.ros.message("std_msgs/msg/Header")
        header.stamp, header.frame_id = self.ros.stamp(), self.name
        return header

    def world(self, frame: str, pose: Message) -> tuple[float, float]:
        """Return the world x, y of a pose. Raises ValueError if it is in another frame."""
        if frame.lstrip("/") != self.name:
            raise ValueError(f"a pose is in the frame {frame!r}; this node needs it in {self.name!r}")
        return pose.position.x + self.origin[0], pose.position.y + self.origin[1]

    def path(self, route: Route, speed_mps: float, last: Message) -> Message:
        """Return a route as a nav_msgs/Path: poses along the way, the last with the orientation of `last`."""
        track = Track("route", (line_of(route, DRIVE),), None, speed_mps)
        path = self.ros.message("nav_msgs/msg/Path")
        path.header, path.poses = self.header(), []
        for x, y, z, yaw, _ in poses_of(track).tolist():
            pose = self.ros.message("geometry_msgs/msg/PoseStamped")
            pose.header, place, turned = path.header, pose.pose.position, pose.pose.orientation
            place.x, place.y, place.z = x - self.origin[0], y - self.origin[1], z
            turned.x, turned.y, turned.z, turned.w = 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)
            path.poses.append(pose)
        path.poses[-1].pose.orientation = last.pose.orientation
        return path

    def grid(self, lattice: CostLattice) -> Message:
        """Return the mean energy per metre as a nav_msgs/OccupancyGrid, rows from the south."""
        grid, frame = self.ros.message("nav_msgs/msg/OccupancyGrid"), lattice.frame
        west, south, _, _ = frame.bounds
        grid.header, info = self.header(), grid.info
        info.map_load_time, info.resolution = grid.header.stamp, float(frame.resolution_m)
        info.width, info.height = frame.cols, frame.rows
        info.origin.position.x, info.origin.position.y = west - self.origin[0], south - self.origin[1]
        info.origin.orientation.w = 1.0
        grid.data = array.array("b", np.flipud(occupancy(lattice)).tobytes())
        return grid

    def forecast(self, now: Forecast) -> Message:
        """Return a forecast as a diagnostic_msgs/DiagnosticArray: its sentence, and every number by name."""
        status = self.ros.message("diagnostic_msgs/msg/DiagnosticStatus")
        status.level = max(_LEVELS[now.verdict], _WARN if now.alarms else _OK)
        status.name, status.hardware_id, status.message, status.values = "joulemap: drive", "battery", now.text, []
        numbers = {name: value for name, value in now.as_dict().items() if isinstance(value, float)}
        for key, value in {**numbers, "verdict": now.verdict, "cause": now.more.name, "more": now.more.share}.items():
            pair = self.ros.message("diagnostic_msgs/msg/KeyValue")
            pair.key, pair.value = key, value if isinstance(value, str) else f"{value:.6g}"
            status.values.append(pair)
        found = self.ros.message("diagnostic_msgs/msg/DiagnosticArray")
        found.header, found.status = self.header(), [status]
        return found


def occupancy(lattice: CostLattice) -> NDArray[np.int8]:
    """Return mean energies per metre as 0 (the least) to 99 (the 98 % quantile, or more), and 100 where every heading
    is blocked, (rows, cols) from the north.
    """
    mean = lattice.mean_energy_per_m()
    free = np.isfinite(mean)
    if not free.any():
        return np.full(mean.shape, 100, dtype=np.int8)
    low, high = np.quantile(mean[free], [0.0, 0.98])
    share = np.clip((np.where(free, mean, low) - low) / max(high - low, 1e-9), 0.0, 1.0)
    return np.where(free, np.rint(_DEAREST * share), 100).astype(np.int8)
