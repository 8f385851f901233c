"""Types of ROS messages: those that a file defines, or those of ROS itself."""

from __future__ import annotations

from typing import Any


def short_type(name: str) -> str:
    """Return a type as ROS 1 writes it."""
    return name.replace("/msg/", "/")


def full_type(kind: str) -> str:
    """Return a type as rosbags writes it. Result: such as `sensor_msgs/msg/Imu`."""
    parts = kind.split("/")
    return f"{parts[0]}/msg/{parts[-1]}" if len(parts) == 2 else kind


def types_of(text: str, kind: str, *, ros1: bool) -> Any:
    """Return a typestore for messages of a type.

    `text`: its definition as the file has it, empty where the file has none.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if text:
        found = get_types_from_msg(text, full_type(kind))
        store.register({key: fields for key, fields in found.items() if key not in store.fielddefs})
    return store


def fields_of(message: Any) -> list[tuple[str, Any]] | None:
    """Return the fields of a message. Result: names and values; None where it is a plain value or a list."""
    if isinstance(message, dict):
        return [(str(key), value) for key, value in message.items()]
    if hasattr(message, "__dataclass_fields__"):
        return [(key, getattr(message, key)) for key in message.__dataclass_fields__ if not key.startswith("__")]
    if hasattr(message, "ListFields"):  # messages inside that are not set have no end where a type contains itself
        return [
            (field.name, getattr(message, field.name))
            for field in message.DESCRIPTOR.fields
            if field.message_type is None or field.is_repeated or message.HasField(field.name)
        ]
    return None
