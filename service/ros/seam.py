"""What the node needs of ROS 2, and no more: messages, topics, actions, a clock. rclpy is loaded only here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from joulemap.model.errors import InputError

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
