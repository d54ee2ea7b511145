"""Codec of ROS 2 messages: `rosbags` dataclasses, little-endian CDR."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rosbags.typesys import Stores, get_typestore

from wbc_controller.errors import InputRefused

TYPES = get_typestore(Stores.ROS2_JAZZY)


def message(type_name: str, **fields: Any) -> Any:
    """Make a message of a type from all its fields."""
    return TYPES.types[type_name](**fields)


def encode(content: Any) -> bytes:
    """Serialize a message."""
    return bytes(TYPES.serialize_cdr(content, content.__msgtype__))


def decode(payload: bytes, type_name: str) -> Any:
    """Deserialize a message; raises `InputRefused` if the bytes have another type."""
    try:
        return TYPES.deserialize_cdr(payload, type_name)
    except Exception as error:  # generated decoders raise any exception on malformed bytes
        raise InputRefused(f"{len(payload)} bytes are not a {type_name} ({type(error).__name__}: {error})") from error


def stamp(nanoseconds: int) -> Any:
    """Make a builtin_interfaces/Time."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return message("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)


def header(nanoseconds: int, frame: str = "") -> Any:
    """Make a std_msgs/Header."""
    return message("std_msgs/msg/Header", stamp=stamp(nanoseconds), frame_id=frame)


def nanoseconds(time: Any) -> int:
    """Return a builtin_interfaces/Time or Duration in ns."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def torques(tau: Any) -> Any:
    """Make the message of effort controllers from torques, (na,) in N·m."""
    dimension = message("std_msgs/msg/MultiArrayDimension", label="actuators", size=len(tau), stride=len(tau))
    layout = message("std_msgs/msg/MultiArrayLayout", dim=[dimension], data_offset=0)
    return message("std_msgs/msg/Float64MultiArray", layout=layout, data=tau)


def diagnostics(wall: int, level: int, name: str, text: str, hardware: str, values: Mapping[str, str]) -> Any:
    """Make a DiagnosticArray with one status at the time `wall`, ns.

    Args:
        level: 0 (OK), 1 (WARN) or 2 (ERROR).
        name: ``node: subject``.
    """
    status = message(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level,
        name=name,
        message=text,
        hardware_id=hardware,
        values=[message("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()],
    )
    return message("diagnostic_msgs/msg/DiagnosticArray", header=header(wall), status=[status])
