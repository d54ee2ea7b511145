"""ROS 2 message types as DDS types."""

import functools
from typing import Any

from cyclonedds.idl import annotations as idl_annotations
from cyclonedds.idl import make_idl_struct, types
from rosbags.interfaces import Nodetype

from wbc_controller.errors import TransportError, require_known
from wbc_controller.middleware.codec import TYPES

#: ROS 2's mapping of primitive types to IDL; ``char`` is an unsigned byte.
_PRIMITIVES: dict[str, Any] = {
    **{f"{kind}{bits}": getattr(types, f"{kind}{bits}") for kind in ("int", "uint") for bits in (8, 16, 32, 64)},
    **{name: getattr(types, name) for name in ("byte", "float32", "float64")},
    **{"bool": bool, "char": types.uint8, "octet": types.byte},
}


def dds_type_name(type_name: str) -> str:
    """Translate ``sensor_msgs/msg/JointState`` to ``sensor_msgs::msg::dds_::JointState_``."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def type_hash(type_name: str) -> str:
    """Return ROS 2's hash of a type, such as ``RIHS01_a13ee3…``."""
    return str(TYPES.hash_rihs01(type_name))


@functools.cache
def idl_type(type_name: str) -> Any:
    """Generate the topic class of a type, or raise `TransportError`; cached: cyclonedds compares classes slowly."""
    require_known(type_name, TYPES.fielddefs, "unknown message type", error=TransportError)
    _, fields = TYPES.fielddefs[type_name]
    generated = make_idl_struct(
        type_name.rsplit("/", 1)[-1],
        dds_type_name(type_name).replace("::", "."),
        {name: _field_type(description, f"{type_name}.{name}") for name, description in fields},
        dataclassify=False,  # a dataclass would refuse fields named like a Python keyword
    )
    return idl_annotations.final(generated)


def _field_type(description: Any, where: str) -> Any:
    kind, detail = description
    if kind == Nodetype.NAME:
        return idl_type(detail)
    if kind == Nodetype.ARRAY:
        element, length = detail
        return types.array[_field_type(element, where), length]
    if kind == Nodetype.SEQUENCE:
        element, bound = detail
        inner = _field_type(element, where)
        return types.sequence[inner, bound] if bound else types.sequence[inner]
    name, bound = detail
    if name == "string":
        return types.bounded_str[bound] if bound else str
    require_known(name, _PRIMITIVES, f"{where} has the unsupported type", error=TransportError)
    return _PRIMITIVES[name]
