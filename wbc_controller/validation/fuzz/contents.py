"""Well-formed messages of every type that comes in: an ordinary one of each, and the same with hostile fields."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from wbc_controller.middleware.codec import TYPES, message
from wbc_controller.validation.fuzz.mutations import mutated_text, pick
from wbc_controller.validation.fuzz.values import FLOATS, INTEGERS, SCALARS, STRINGS, TEXTS, WORDS

#: Sizes of the integer types of messages, in bits; the unsigned ones begin with a u.
_BITS = {f"{sign}int{bits}": bits for sign in ("", "u") for bits in (8, 16, 32, 64)} | {"byte": 8, "octet": 8}
#: Elements of a hostile sequence: as many as there are, about, and now and then these.
_MANY = (0, 1, 2, 100, 6000)
#: Share of the messages that get a very long array or text.
_LARGE = 0.002
#: Length of those: characters of a text, values of an array.
_LARGEST = (20_000, 300_000)
#: Updates that are valid for a robot with these tasks, to be mutated.
_UPDATES = (
    "{tasks: {com: {weight: 5.0, enabled: true, setpoint: [0.0, 0.0, 0.3]}}}",
    "{tasks: {com: {stiffness: 90.0, damping: [19.0, 19.0, 19.0], setpoint_duration: 2.0}, posture: {weight: 0.01}}}",
    "{contacts: {front_left_foot: {enabled: false, ramp: 0.2}}, control: {weight_ramp: 0.4}}",
    "{limits: {acceleration: 200.0, position_margin: 0.02}, tasks: {base: {weight: 3}}}",
)


def ordinary(type_name: str, names: Sequence[str], frame: str, stamp: int) -> Any:
    """A message that is valid where its type is taken.

    Args:
        type_name: its type.
        names: joints, where it is about joints.
        frame: frame of its header, or child frame.
        stamp: time of its header, ns.
    """
    content = _blank(type_name)
    if hasattr(content, "header"):
        content.header.stamp.sec, content.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        content.header.frame_id = frame
    if type_name == "sensor_msgs/msg/JointState":
        content.name = list(names)
        content.position, content.velocity, content.effort = (np.zeros(len(names)) for _ in range(3))
    elif type_name == "std_msgs/msg/Float64MultiArray":
        content.data = np.zeros(len(names))
    elif type_name == "geometry_msgs/msg/Vector3Stamped":
        content.vector.z = 1.0
    elif type_name.startswith("trajectory_msgs/msg/"):
        joints = "MultiDOF" not in type_name
        content.joint_names = list(names) if joints else ["frame"]
        for second in range(1, 4):
            point = _blank(f"{type_name}Point")
            point.time_from_start.sec = second
            if joints:
                point.positions = np.zeros(len(names))
            else:
                point.transforms = [_blank("geometry_msgs/msg/Transform")]
                point.transforms[0].translation.z = 1.0
            content.points.append(point)
    return content


def hostile(rng: np.random.Generator, content: Any, names: Sequence[str]) -> Any:
    """A copy of a message with some fields replaced: numbers, texts, and sequences of other lengths and orders."""
    content = copy.deepcopy(content)
    for _ in range(int(rng.integers(1, 4))):
        owner, name, kind = pick(rng, _places(content))
        setattr(owner, name, _value(rng, getattr(owner, name), kind, names))
    return content


def hostile_text(rng: np.random.Generator, key: str) -> str:
    """A text for a topic of texts: a word, an update, or a URDF."""
    kind = int(rng.integers(4))
    if kind == 0:
        return pick(rng, STRINGS)
    if key == "update":
        return pick(rng, TEXTS) if kind == 1 else mutated_text(rng, pick(rng, _UPDATES), SCALARS)
    if key == "robot_description":
        return mutated_text(rng, "<robot name='r'>\n<link name='a'/>\n<link name='b'/>\n</robot>", STRINGS)
    word = pick(rng, WORDS)
    return word if kind == 1 else mutated_text(rng, word, STRINGS)


def _blank(type_name: str) -> Any:
    """A message with zeros, empty texts and sequences, and unit quaternions."""
    _, fields = TYPES.fielddefs[type_name]
    values = {name: _zero(kind) for name, kind in fields}
    if type_name == "geometry_msgs/msg/Quaternion":
        values["w"] = 1.0
    return message(type_name, **values)


def _zero(kind: Any) -> Any:
    node, detail = kind
    if node == Nodetype.NAME:
        return _blank(detail)
    if node == Nodetype.BASE:
        return "" if detail[0] == "string" else False if detail[0] == "bool" else 0.0 if "float" in detail[0] else 0
    element, size = detail
    numbers = element[0] == Nodetype.BASE and element[1][0] != "string"
    return np.zeros(size, dtype=element[1][0]) if numbers else [_zero(element) for _ in range(size)]


def _places(content: Any) -> list[tuple[Any, str, Any]]:
    """Every field that holds no message: its owner, its name and its kind. Of several elements, the ends."""
    found = []
    for name, kind in TYPES.fielddefs[content.__msgtype__][1]:
        node, detail = kind
        if node == Nodetype.NAME:
            found += _places(getattr(content, name))
            continue
        found.append((content, name, kind))
        if node in (Nodetype.SEQUENCE, Nodetype.ARRAY) and detail[0][0] == Nodetype.NAME:
            elements = getattr(content, name)
            for element in [*elements[:1], *elements[-1:]]:
                found += _places(element)
    return found


def _value(rng: np.random.Generator, value: Any, kind: Any, names: Sequence[str]) -> Any:
    node, detail = kind
    if node == Nodetype.BASE:
        return _scalar(rng, detail[0], names)
    element, size = detail
    many = rng.random() < _LARGE
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        return _numbers(rng, value, element[1][0], size, many)
    value = list(value)
    change = int(rng.integers(5))
    if element[0] == Nodetype.BASE and change == 0 and value:
        value[int(rng.integers(len(value)))] = _scalar(rng, "string", names)
    elif change <= 1 and value:
        value.append(copy.deepcopy(pick(rng, value)))
    elif change == 2 and value:
        del value[int(rng.integers(len(value)))]
    elif change == 3:
        value = [value[i] for i in rng.permutation(len(value))]
    elif value:
        value = [value[i % len(value)] for i in range(_MANY[-1] if many else pick(rng, _MANY[:-1]))]
    return value


def _numbers(rng: np.random.Generator, value: Any, type_name: str, size: int, many: bool) -> Any:
    """A hostile array: one value of it, all of them, or another length."""
    change = int(rng.integers(3))
    length = size or (pick(rng, _LARGEST) if many else len(value) if change else int(rng.integers(len(value) + 3)))
    result = np.resize(value if len(value) else np.zeros(1, dtype=type_name), length)
    if length and change == 1:
        result[int(rng.integers(length))] = _scalar(rng, type_name, ())
    elif change == 2:
        result = np.full(length, _scalar(rng, type_name, ()), dtype=type_name)
    return result


def _scalar(rng: np.random.Generator, type_name: str, names: Sequence[str]) -> Any:
    if type_name == "string":
        if rng.random() < _LARGE:
            return "x" * pick(rng, _LARGEST)
        return pick(rng, names) if names and rng.random() < 0.3 else pick(rng, STRINGS)
    if type_name == "bool":
        return bool(rng.integers(2))
    if "float" in type_name:
        return pick(rng, FLOATS)
    unsigned = type_name.startswith("u") or type_name in ("byte", "octet")
    bits = _BITS[type_name]
    value = pick(rng, INTEGERS) % (1 << bits)
    return value if unsigned or value < 1 << (bits - 1) else value - (1 << bits)
