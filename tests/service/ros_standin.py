"""Stand-ins of the seam of ROS 2: one in this process on the message definitions of rosbags, one on Cyclone DDS.

What is published is written as CDR by rosbags, so that a field of a wrong name or type fails.
"""

from __future__ import annotations

import array
from collections.abc import Callable
from dataclasses import is_dataclass
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

_GOAL = "geometry_msgs/PoseStamped {goal}\ngeometry_msgs/PoseStamped start\nstring planner_id\nbool use_start\n"
_RESULT = (
    "uint16 UNKNOWN={0}1\nuint16 TF_ERROR={0}3\nuint16 START_OUTSIDE_MAP={0}4\nuint16 GOAL_OUTSIDE_MAP={0}5\n"
    "uint16 START_OCCUPIED={0}6\nuint16 GOAL_OCCUPIED={0}7\nuint16 NO_VALID_PATH={0}9\n"
    "nav_msgs/Path path\nbuiltin_interfaces/Duration planning_time\nuint16 error_code\nstring error_msg\n"
)
"""Of nav2_msgs: https://github.com/ros-navigation/navigation2/tree/main/nav2_msgs/action"""


def types() -> Any:
    """The messages of ROS 2 Jazzy, and of the two actions."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, goal, codes in (("ComputePathToPose", "goal", 20), ("ComputePathThroughPoses", "goals", 30)):
        text = _GOAL.replace(" {goal}", "[] goals" if goal == "goals" else " goal")
        store.register(get_types_from_msg(text, f"nav2_msgs/msg/{name}_Goal"))
        store.register(get_types_from_msg(_RESULT.format(codes), f"nav2_msgs/msg/{name}_Result"))
    return store


class StandIn:
    """Keeps what is published, and calls who subscribed."""

    def __init__(self) -> None:
        self.types = types()
        self.published: dict[str, list[Any]] = {}
        self.taken: dict[str, Callable[[Any], None]] = {}
        self.actions: dict[str, tuple[str, Callable[[Any, Any], bool]]] = {}
        self.errors: list[str] = []
        self.seconds = 100.0

    def message(self, kind: str) -> Any:
        return self.types.types[kind](**{name: self._default(*one) for name, one in self.types.fielddefs[kind][1]})

    def _default(self, node: Any, detail: Any) -> Any:
        if node.name == "NAME":
            return self.message(detail)
        if node.name == "BASE":
            return {"string": "", "bool": False}.get(detail[0], 0.0 if detail[0].startswith("float") else 0)
        size = detail[1] if node.name == "ARRAY" else 0
        plain = detail[0][0].name == "BASE" and detail[0][1][0] != "string"
        return np.zeros(size, detail[0][1][0]) if plain else []

    def subscribe(self, topic: str, kind: str, take: Callable[[Any], None]) -> None:
        self.taken[topic] = take

    def publisher(self, topic: str, kind: str, *, latched: bool = False) -> Callable[[Any], None]:
        def _publish(message: Any) -> None:
            self.check(message, kind)
            self.published.setdefault(topic, []).append(message)

        return _publish

    def action(self, name: str, kind: str, answer: Callable[[Any, Any], bool]) -> None:
        self.actions[name] = kind.replace("/action/", "/msg/"), answer

    def ask(self, name: str, **values: Any) -> tuple[bool, Any]:
        """Send a goal; whether it succeeded, and its result."""
        kind, answer = self.actions[name]
        goal, result = self.message(f"{kind}_Goal"), self.message(f"{kind}_Result")
        for key, value in values.items():
            setattr(goal, key, value)
        self.check(goal, f"{kind}_Goal")
        done = answer(goal, result)
        self.check(result, f"{kind}_Result")
        return done, result

    def stamp(self) -> Any:
        self.seconds += 0.25
        now = self.message("builtin_interfaces/msg/Time")
        now.sec, now.nanosec = int(self.seconds), int(1e9 * (self.seconds % 1.0))
        return now

    def error(self, words: str) -> None:
        self.errors.append(words)

    def check(self, message: Any, kind: str) -> bytes:
        """Write a message as ROS does."""
        return bytes(self.types.serialize_cdr(self._plain(message), kind))

    def _plain(self, value: Any) -> Any:
        if isinstance(value, array.array):
            return np.frombuffer(value, np.int8)
        if isinstance(value, list):
            return [self._plain(one) for one in value]
        if not is_dataclass(value):
            return value[0] if isinstance(value, bytes) else value  # rclpy has a byte as bytes
        names = [name for name, _ in self.types.fielddefs[value.__msgtype__][1]]
        return type(value)(**{name: self._plain(getattr(value, name)) for name in names})


class OverDds(StandIn):
    """Topics over a participant of Cyclone DDS, with the names and types that ROS 2 gives them; actions stay here."""

    def __init__(self, domain: int) -> None:
        super().__init__()
        from cyclonedds.domain import DomainParticipant

        self.participant, self._made, self.readers = DomainParticipant(domain), {}, {}  # type: ignore[var-annotated]

    def idl(self, kind: str) -> Any:
        """The class of a message in Cyclone DDS."""
        from cyclonedds.idl import IdlStruct
        from cyclonedds.idl import types as idl

        if kind not in self._made:
            base = {"string": str, "bool": bool, "byte": idl.uint8, "float64": idl.float64, "float32": idl.float32}

            def _of(node: Any, detail: Any) -> Any:
                if node.name == "NAME":
                    return self.idl(detail)
                if node.name == "BASE":
                    return base.get(detail[0]) or getattr(idl, detail[0])
                inner = _of(*detail[0])
                return idl.array[inner, detail[1]] if node.name == "ARRAY" else idl.sequence[inner]

            members = {name: _of(*one) for name, one in self.types.fielddefs[kind][1]}
            package, _, name = kind.split("/")
            namespace = {"__annotations__": members, "__module__": __name__}
            from dataclasses import dataclass

            made = type(name, (IdlStruct,), namespace, typename=f"{package}.msg.dds_.{name}_")  # type: ignore[call-overload]
            self._made[kind] = dataclass(made)
        return self._made[kind]

    def _as_idl(self, message: Any, kind: str) -> Any:
        def _value(node: Any, detail: Any, value: Any) -> Any:
            if node.name == "NAME":
                return self._as_idl(value, detail)
            if node.name == "BASE":
                return value
            return [_value(*detail[0], one) for one in (value.tolist() if hasattr(value, "tolist") else value)]

        members = self.types.fielddefs[kind][1]
        return self.idl(kind)(**{name: _value(*one, getattr(message, name)) for name, one in members})

    def _topic(self, topic: str, kind: str) -> Any:
        from cyclonedds.topic import Topic

        return Topic(self.participant, f"rt/{topic}", self.idl(kind))

    def subscribe(self, topic: str, kind: str, take: Callable[[Any], None]) -> None:
        from cyclonedds.sub import DataReader

        self.readers[topic] = DataReader(self.participant, self._topic(topic, kind)), take

    def publisher(self, topic: str, kind: str, *, latched: bool = False) -> Callable[[Any], None]:
        from cyclonedds.core import Policy, Qos
        from cyclonedds.pub import DataWriter
        from cyclonedds.util import duration

        kept = [Policy.Durability.TransientLocal] if latched else []
        qos = Qos(Policy.Reliability.Reliable(duration(seconds=5)), Policy.History.KeepLast(1), *kept)
        writer = DataWriter(self.participant, self._topic(topic, kind), qos=qos)
        return lambda message: writer.write(self._as_idl(self._plain(message), kind))

    def spin_once(self) -> int:
        """Take in what came; how many messages that were."""
        found = 0
        for reader, take in self.readers.values():
            for message in reader.take(N=100):
                take(message)
                found += 1
        return found


def place(ros: StandIn, x: float, y: float, frame: str = "map", yaw: float = 0.0) -> Any:
    """A geometry_msgs/PoseStamped."""
    made = ros.message("geometry_msgs/msg/PoseStamped")
    made.header.frame_id = frame
    made.pose.position.x, made.pose.position.y = x, y
    made.pose.orientation.z, made.pose.orientation.w = float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
    return made


def moved(ros: StandIn, x: float, y: float, frame: str = "map") -> Any:
    """A nav_msgs/Odometry."""
    made = ros.message("nav_msgs/msg/Odometry")
    made.header.frame_id, made.pose.pose = frame, place(ros, x, y).pose
    return made


def battery(ros: StandIn, time_s: float, power_w: float, charge: float = float("nan")) -> Any:
    """A sensor_msgs/BatteryState of 24 V, which discharges."""
    made = ros.message("sensor_msgs/msg/BatteryState")
    made.header.stamp.sec, made.header.stamp.nanosec = int(time_s), round(1e9 * (time_s % 1.0))
    made.voltage, made.current, made.percentage = 24.0, -power_w / 24.0, charge
    return made
