"""Codec of ROS 2 messages (`rosbags` dataclasses, little-endian CDR), their layouts, common messages, setpoints."""

import copy
import dataclasses
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from wbc_controller.errors import InputRefused
from wbc_controller.records import Array

TYPES = get_typestore(Stores.ROS2_JAZZY)
OK, WARN, ERROR = 0, 1, 2  # levels of a diagnostic status
_MESSAGE, _PRIMITIVE = Nodetype.NAME, Nodetype.BASE
_STAMP = struct.Struct("<iI")
START = 4  # bytes of the encapsulation header; CDR aligns the numbers after it to multiples of eight
_FILLINGS = (0x11, 0x22)  # two values for all bytes of numbers
#: Field of the JointState, by kind of task with references by joint name.
JOINT_FIELDS = {"posture": "position", "torque": "effort"}
#: Numeric fields of a geometry_msgs/WrenchStamped.
WRENCH = tuple(f"wrench.{part}.{axis}" for part in ("force", "torque") for axis in "xyz")


def message(type_name: str, **fields: Any) -> Any:
    """Make a message of a type; omitted fields are zero, also the coordinates at the end of a vector.

    A field with a message accepts the message, a mapping of its fields, or an array with its numbers.
    """
    for name, (node, detail) in TYPES.fielddefs[type_name][1]:
        if name not in fields:
            fields[name] = _zero(node, detail)
        elif node is _MESSAGE:
            kind, value = str(detail), fields[name]
            if isinstance(value, dict):
                fields[name] = message(kind, **value)
            elif isinstance(value, np.ndarray):
                omitted = len(TYPES.fielddefs[kind][1]) - len(value)
                fields[name] = TYPES.types[kind](*value.tolist(), *[0.0] * omitted)
    return TYPES.types[type_name](**fields)


def _zero(node: Nodetype, detail: Any) -> Any:
    if node is _MESSAGE:
        return message(detail, **({"w": 1.0} if detail == "geometry_msgs/msg/Quaternion" else {}))
    if node is _PRIMITIVE:
        kind = detail[0]
        return "" if kind == "string" else False if kind == "bool" else 0.0 if kind.startswith("float") else 0
    (element, kind), size = detail
    if element is _PRIMITIVE and kind[0] != "string":
        return np.zeros(size, dtype=kind[0])
    return [_zero(element, kind) for _ in range(size)]


def encode(content: Any) -> bytes:
    """Serialize a message."""
    return bytes(TYPES.serialize_cdr(content, content.__msgtype__))


def decode(payload: bytes, type_name: str) -> Any:
    """Deserialize a message; raises `InputRefused` if the bytes have another type."""
    try:
        return TYPES.deserialize_cdr(payload, type_name)
    except Exception as error:  # generated decoders raise any exception on malformed bytes
        raise InputRefused(f"{len(payload)} bytes are not a {type_name} ({type(error).__name__}: {error})") from error


def time_fields(nanoseconds: int) -> dict[str, int]:
    """Return the fields of a builtin_interfaces/Time or Duration."""
    return dict(zip(("sec", "nanosec"), divmod(nanoseconds, 1_000_000_000), strict=True))


def header(nanoseconds: int, frame: str = "") -> Any:
    """Make a std_msgs/Header."""
    return message("std_msgs/msg/Header", stamp=time_fields(nanoseconds), frame_id=frame)


def nanoseconds(time: Any) -> int:
    """Return a builtin_interfaces/Time or Duration in ns."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def torques(tau: Any) -> Any:
    """Make the message of effort controllers from torques, (na,) in N·m."""
    dimension = message("std_msgs/msg/MultiArrayDimension", label="actuators", size=len(tau), stride=len(tau))
    return message("std_msgs/msg/Float64MultiArray", layout={"dim": [dimension]}, data=tau)


def diagnostics(wall: int, level: int, name: str, text: str, hardware: str, values: Mapping[str, str]) -> Any:
    """Make a DiagnosticArray with one status, named ``node: subject``, at the time `wall`, ns."""
    pairs = [TYPES.types["diagnostic_msgs/msg/KeyValue"](*pair) for pair in values.items()]
    status = message(
        "diagnostic_msgs/msg/DiagnosticStatus", level=level, name=name, message=text, hardware_id=hardware, values=pairs
    )
    return message("diagnostic_msgs/msg/DiagnosticArray", header=header(wall), status=[status])


def odometry(
    stamp: int, frame: str, base: str, pose: Array, twist: Array, covariances: tuple[Array, Array] | None = None
) -> Any:
    """Make a nav_msgs/Odometry from a stamp in ns, a pose, (7,), and a twist in the axes of the base link, (6,).

    The covariances are of position and rotations about the axes of `frame`, and of the twist, (6, 6); None for zeros.
    """
    of_pose, of_twist = covariances if covariances is not None else (np.zeros(36), np.zeros(36))
    return message(
        "nav_msgs/msg/Odometry",
        header=header(stamp, frame),
        child_frame_id=base,
        pose={"pose": _pose_fields(pose), "covariance": of_pose.ravel()},
        twist={"twist": {"linear": twist[:3], "angular": twist[3:]}, "covariance": of_twist.ravel()},
    )


def pose_with_covariance(stamp: int, frame: str, pose: Array, position: float, turn: float) -> Any:
    """Make a PoseWithCovarianceStamped from standard deviations of position, m, and rotation, rad."""
    covariance = np.diag([position**2] * 3 + [turn**2] * 3).ravel()
    fields = {"pose": _pose_fields(pose), "covariance": covariance}
    return message("geometry_msgs/msg/PoseWithCovarianceStamped", header=header(stamp, frame), pose=fields)


def transform(stamp: int, frame: str, base: str, pose: Array) -> Any:
    """Make a tf2_msgs/TFMessage from a frame to the base's pose, (7,)."""
    top, motion = header(stamp, frame), {"translation": pose[:3], "rotation": pose[3:]}
    content = message("geometry_msgs/msg/TransformStamped", header=top, child_frame_id=base, transform=motion)
    return message("tf2_msgs/msg/TFMessage", transforms=[content])


def _pose_fields(pose: Array) -> dict[str, Array]:
    return {"position": pose[:3], "orientation": pose[3:]}


class MessageLayout:
    """Positions of the numbers in serialized messages with equal text and array sizes.

    A message contains `count` doubles from the byte `START` on, some of them parts of text.
    """

    def __init__(self, content: Any) -> None:
        filled = copy.deepcopy(content)
        numbers = list(_numbers(filled))
        first, second = (np.frombuffer(_encode_filled(filled, numbers, byte), dtype=np.uint8) for byte in _FILLINGS)
        differs = first != second
        number_bytes = np.flatnonzero(differs)
        self._indices: dict[str, np.ndarray] = {}
        seen = 0
        for path, owner, name in numbers:
            count = np.size(getattr(owner, name))  # 1 for a timestamp
            if count:
                start = (int(number_bytes[seen]) - START) // 8
                self._indices[path] = np.arange(start, start + count)
                seen += 8 * count
        edges = np.flatnonzero(np.diff(np.concatenate([[True], differs, [True]]))).reshape(-1, 2).tolist()
        self._pieces = [slice(start, stop) for start, stop in edges]  # bytes outside the numbers
        self._constant = [first[piece].tobytes() for piece in self._pieces]
        self._size, self.count = len(first), (len(first) - START) // 8

    def fits(self, payload: bytes) -> bool:
        """Return True if a message has this layout."""
        return len(payload) == self._size and [payload[piece] for piece in self._pieces] == self._constant

    def index_of(self, *paths: str) -> np.ndarray:
        """Return the index of each number of fields such as ``pose.pose.position.x``, (k,).

        A timestamp counts as one number. A field without numbers raises `KeyError`.
        """
        return np.concatenate([self._indices[path] for path in paths])


class Template:
    """Serializer of messages with variable timestamp and numbers; `fields` are groups of consecutive paths."""

    def __init__(self, content: Any, *fields: Sequence[str]) -> None:
        layout = MessageLayout(content)
        self._payload = bytearray(encode(content))
        self._stamp = START + 8 * int(layout.index_of("header.stamp")[0]) if hasattr(content, "header") else None
        numbers = np.frombuffer(self._payload, np.float64, layout.count, START)
        self._fields = [numbers[_as_slice(layout.index_of(*paths))] for paths in fields]  # views

    def write(self, nanoseconds: int, *values: Array) -> bytes:
        """Serialize a timestamp (ignored without a header) and groups of numbers; wrong sizes raise `ValueError`."""
        if self._stamp is not None:
            _STAMP.pack_into(self._payload, self._stamp, *divmod(nanoseconds, 1_000_000_000))
        for field, numbers in zip(self._fields, values, strict=True):
            if len(numbers) != len(field):
                raise ValueError(f"{len(numbers)} numbers for a field of {len(field)}")
            field[:] = numbers
        return bytes(self._payload)


def _as_slice(index: np.ndarray) -> slice:
    start, stop = int(index[0]), int(index[-1]) + 1
    if not np.array_equal(index, np.arange(start, stop)):
        raise ValueError(f"the fields of a group must be consecutive; their indices are {index.tolist()}")
    return slice(start, stop)


def _is_stamp(value: Any) -> bool:
    return getattr(value, "__msgtype__", "") == "builtin_interfaces/msg/Time"


def _numbers(content: Any, path: str = "") -> Iterator[tuple[str, Any, str]]:
    """Yield path, message and field of each timestamp, float and array of floats, in the order of serialization."""
    for field in dataclasses.fields(content):
        value, here = getattr(content, field.name), f"{path}{field.name}"
        if isinstance(value, float) or _is_stamp(value) or getattr(value, "dtype", None) == np.float64:
            yield here, content, field.name
        elif dataclasses.is_dataclass(value):
            yield from _numbers(value, f"{here}.")
        elif isinstance(value, list):
            for i, item in enumerate(value):
                if dataclasses.is_dataclass(item):
                    yield from _numbers(item, f"{here}[{i}].")


def _encode_filled(content: Any, numbers: Sequence[tuple[str, Any, str]], byte: int) -> bytes:
    """Serialize a message after filling all bytes of its numbers."""
    whole, number = (np.frombuffer(bytes([byte]) * 8, dtype=kind)[0].item() for kind in ("<u4", "<f8"))
    for _, owner, name in numbers:
        value = getattr(owner, name)
        if _is_stamp(value):
            value.sec = value.nanosec = whole
        else:
            setattr(owner, name, np.full_like(value, number) if isinstance(value, np.ndarray) else number)
    return encode(content)


def setpoint_message(
    type_name: str, kind: str, position: Array, *, frame: str = "world", stamp: int = 0, joints: Sequence[str] = ()
) -> Any:
    """Make the message of a task's setpoint, of a type in `TASK_TYPES`.

    The position has the task's reference form; missing coordinates become 0. A joint task needs its joints.
    """
    values, top = np.asarray(position, dtype=np.float64), header(stamp, frame)
    if kind in JOINT_FIELDS:
        return message(type_name, header=top, name=list(joints), **{JOINT_FIELDS[kind]: values})
    if type_name == "geometry_msgs/msg/PoseStamped":
        return message(type_name, header=top, pose={"position": values[:-4], "orientation": values[-4:]})
    if type_name == "geometry_msgs/msg/WrenchStamped":
        return wrench_stamped(values, frame, stamp)
    return message(type_name, header=top, **{"point" if type_name.endswith("/PointStamped") else "vector": values})


def wrench_stamped(wrench: Array, frame: str, stamp: int = 0) -> Any:
    """Make a geometry_msgs/WrenchStamped from a wrench, (6,), or a force, (3,); N, N·m."""
    parts = {"force": wrench[:3], "torque": wrench[3:]}
    return message("geometry_msgs/msg/WrenchStamped", header=header(stamp, frame), wrench=parts)


def velocity_message(velocity: Sequence[float] | Array) -> Any:
    """Make a geometry_msgs/Twist, m/s and rad/s."""
    forward, left, turning = map(float, velocity)
    return message("geometry_msgs/msg/Twist", linear={"x": forward, "y": left}, angular={"z": turning})


def com_trajectory(times: Sequence[float], positions: Array, *, task: str = "com", stamp: int = 0) -> Any:
    """Make a trajectory of the centre of mass through points, (n, 3) in m; stamp of its start in ns, 0 for now."""
    points = [{"transforms": [message("geometry_msgs/msg/Transform", translation=position)]} for position in positions]
    return trajectory_message("MultiDOFJointTrajectory", [task], times, points, stamp)


def joint_trajectory(joints: Sequence[str], times: Sequence[float], positions: Array) -> Any:
    """Make an immediate joint trajectory, (n, k) in rad."""
    return trajectory_message("JointTrajectory", joints, times, [{"positions": position} for position in positions])


def trajectory_message(
    kind: str, names: Sequence[str], times: Sequence[float], points: Sequence[dict[str, Any]], stamp: int = 0
) -> Any:
    """Make a JointTrajectory or a MultiDOFJointTrajectory from the fields of its points."""
    made = [
        message(f"trajectory_msgs/msg/{kind}Point", **point, time_from_start=time_fields(round(1e9 * time)))
        for time, point in zip(times, points, strict=True)
    ]
    top = header(stamp, "world")
    return message(f"trajectory_msgs/msg/{kind}", header=top, joint_names=list(names), points=made)
