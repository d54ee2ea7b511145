"""Parser of `wbc send`: words to one message on one topic."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from wbc_controller.errors import InputRefused, require_known, valid_choices
from wbc_controller.middleware.codec import JOINT_FIELDS, message, setpoint_message, wrench_stamped
from wbc_controller.middleware.topics import TASK_TYPES
from wbc_controller.records import REQUESTS, Array
from wbc_controller.settings import Settings

ReadMessage = Callable[[str, str, str], Any]  # waits for the newest message of a topic, given by node, key and subject
Make = Callable[[ReadMessage], Any]  # makes the message of a request; may read messages of the nodes
_HOIST = {"release": "the hoist releases the robot", "hold": "the hoist lifts the robot to its start pose"}
#: First words of other requests than setpoints, with their arguments.
FORMS = {
    **dict.fromkeys((*REQUESTS, *_HOIST), ""),
    "push": "FORCE DIRECTION [for SECONDS] [at FRAME]",
    "contact": "CONTACT on|off",
    "grip": "CONTACT on|off",
    "task": "TASK on|off",
    "weight": "TASK NUMBER",
    "update": "YAML",
    "record": "[NAME]",
    "fault": "YAML",
}
_Axes = Mapping[str, tuple[int, int, int]]
#: Directions along the axes of the robot's heading, and of the world.
HEADINGS: _Axes = {
    "forward": (1, 0, 0), "back": (-1, 0, 0),
    "left": (0, 1, 0), "right": (0, -1, 0),
    "up": (0, 0, 1), "down": (0, 0, -1),
}  # fmt: skip
AXES: _Axes = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
#: Rotation axes of a turn and a lean, in heading axes, by direction.
ROTATIONS: Mapping[str, _Axes] = {
    "turn": {"left": (0, 0, 1), "right": (0, 0, -1)},
    "lean": {"forward": (0, 1, 0), "back": (0, -1, 0), "left": (-1, 0, 0), "right": (1, 0, 0)},
}
#: Units that may follow a number without a space.
_LENGTH = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}
_ANGLE = {"": 1.0, "rad": 1.0, "deg": math.pi / 180.0}
_FORCE = {"": 1.0, "N": 1.0}
_TIME = {"": 1.0, "s": 1.0, "ms": 0.001}
_PLAIN = {"": 1.0}
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)([A-Za-z]*)")


class Request(NamedTuple):
    """One message."""

    node: str  # ``controller`` or ``mock``
    key: str  # of the topic
    subject: str  # task or contact, or empty
    summary: str  # effect in words, without a full stop
    make: Make
    frame: str = ""  # frame to be checked by the sender, as the mock robot only logs an error; or empty


def parse_request(words: Sequence[str], settings: Settings) -> Request:
    """Parse a request such as ``["com", "+0.02", "forward"]``; raise `InputRefused` with the valid forms."""
    first, rest = (words[0], list(words[1:])) if words else ("", [])
    if first in settings.tasks:
        return _setpoint(first, rest, settings)
    require_known(first, [*FORMS, *settings.tasks], "unknown command", error=InputRefused)
    form, text = FORMS[first], " ".join(rest)
    if not form and rest:
        raise InputRefused(f"{first!r} takes no arguments, got {text!r}")
    if first in REQUESTS:
        return Request("controller", "command", "", first, _constant("String", first))
    if first in _HOIST:
        return Request("mock", "hold", "", _HOIST[first], _constant("Bool", first == "hold"))
    if first == "push":
        return _push(rest, settings)
    if first in ("update", "fault"):
        if not rest:
            raise InputRefused(f"{first} requires YAML; see docs/{'topics' if first == 'update' else 'faults'}.md")
        node = "controller" if first == "update" else "mock"
        return Request(node, first, "", f"{first} {text}", _constant("String", text))
    if first == "record":
        summary = "the last seconds are written to a file"
        return Request("controller", "record", "", summary, _constant("String", "-".join(rest)))
    if len(rest) != 2:
        raise InputRefused(f"{first} requires {form}; got {text!r}")
    kind, known = ("task", settings.tasks) if first in ("task", "weight") else ("contact", settings.contacts)
    name, word = rest
    require_known(name, known, f"unknown {kind}", error=InputRefused)
    if first == "weight":
        value = _number(word, "weight")
        summary = f"the weight of {name} becomes {value:g} in {settings.control.weight_ramp:g} s"
        return Request("controller", "weight", name, summary, _constant("Float64", value))
    require_known(word, ("on", "off"), "unknown value", error=InputRefused)
    content = _constant("Bool", word == "on")
    if first == "grip":
        return Request("mock", "grip", name, f"{'grips' if word == 'on' else 'releases'} {name}", content)
    ramp = settings.control.weight_ramp if first == "task" else settings.contacts[name].ramp
    return Request("controller", f"{first}_enable", name, f"{first} {name} goes {word} in {ramp:g} s", content)


def _constant(type_name: str, value: str | bool | float) -> Make:
    return lambda wait_for_message: message(f"std_msgs/msg/{type_name}", data=value)


def _setpoint(task: str, words: list[str], settings: Settings) -> Request:
    """Parse a setpoint: ``TASK 0.02 forward``, ``TASK turn 10deg left`` or ``TASK to 0 0 0.6 in FRAME``."""
    spec = settings.tasks[task]
    kind, duration = spec.type, spec.setpoint_duration
    type_name = TASK_TYPES[kind]["setpoint"]
    oriented = type_name == "geometry_msgs/msg/PoseStamped"
    make = partial(setpoint_message, type_name, kind)

    def request(summary: str, content: Make) -> Request:
        when = f"in {duration:g} s" if duration > 0.0 else "at once"
        return Request("controller", "setpoint", task, f"{task} {summary}, {when}", content)

    def at(summary: str, position: Array, frame: str) -> Request:
        return request(summary, lambda wait_for_message: make(position, frame=frame))

    if kind in JOINT_FIELDS:
        return request(*_joints(task, words, make, JOINT_FIELDS[kind]))
    if words[:1] == ["to"]:
        return request(*_absolute(task, words[1:], make, oriented, getattr(spec, "reference_frame", "world")))
    if oriented and words and words[0] in ROTATIONS:
        rotation = _turn(words[1:], ROTATIONS[words[0]], f"{task} {words[0]}")
        values = np.concatenate([np.zeros(0 if kind == "frame_orientation" else 3), _quaternion(rotation)])
        return at(f"{words[0]}s {' '.join(words[1:])}", values, f"{task}/heading")
    if kind in ("frame_orientation", "axis_alignment", "contact_wrench"):
        forms = {"frame_orientation": "turn 10deg left, lean 5deg forward, or to X Y Z W"}.get(kind, "to NUMBERS")
        raise InputRefused(f"{task} is a {kind} task; valid forms: {forms}")
    moved, by_heading = _displacement(words, task, _PLAIN if "momentum" in kind else _LENGTH)
    if kind == "relative_pose" and by_heading:
        raise InputRefused(f"{task} is relative to {spec.reference_frame}; valid directions: its axes x, y, z")  # type: ignore[union-attr]
    values = np.array([*moved, 0.0, 0.0, 0.0, 1.0]) if oriented else moved
    return at(f"moves {' '.join(words)}", values, f"{task}/{'heading' if by_heading else 'reference'}")


def _absolute(task: str, words: list[str], make: Callable[..., Any], oriented: bool, home: str) -> tuple[str, Make]:
    """Parse ``0 0 0.6 [in FRAME]``."""
    frame = home
    if len(words) > 1 and words[-2] == "in":
        frame, words = words[-1], words[:-2]
    values = np.array([_number(word, task) for word in words])
    summary = f"goes to {' '.join(words)} in {frame}"
    if not oriented or len(values) in (4, 7):
        return summary, lambda wait_for_message: make(values, frame=frame)
    if len(values) != 3 or frame != home:
        raise InputRefused(
            f"{task} requires x y z in {home}, or x y z and a quaternion x y z w; got {' '.join(words)!r}"
        )

    def keep_orientation(wait_for_message: ReadMessage) -> Any:
        turned = wait_for_message("controller", "task_reference", task).pose.orientation
        return make(np.array([*values, turned.x, turned.y, turned.z, turned.w]), frame=frame)

    return summary, keep_orientation


def _joints(task: str, words: list[str], make: Callable[..., Any], field: str) -> tuple[str, Make]:
    """Parse ``JOINT by 0.1`` or ``JOINT to 0.7``, one or several."""
    keywords = set(words[1::3])
    if not words or len(words) % 3 or len(keywords) != 1 or not keywords <= {"by", "to"}:
        raise InputRefused(
            f"{task} requires JOINT by NUMBER or JOINT to NUMBER, one or several; got {' '.join(words)!r}"
        )
    units = {"": 1.0, "N·m": 1.0, "Nm": 1.0} if field == "effort" else _ANGLE
    names, values = words[::3], np.array([_number(word, task, units) for word in words[2::3]])
    if keywords == {"by"}:
        frame = f"{task}/reference"
        return f"moves {' '.join(words)}", lambda wait_for_message: make(values, frame=frame, joints=names)

    def keep_other_joints(wait_for_message: ReadMessage) -> Any:
        before = wait_for_message("controller", "task_reference", task)
        known = dict(zip(before.name, getattr(before, field), strict=True))
        require_known(names, known, "unknown joint", error=InputRefused)
        known |= dict(zip(names, values, strict=True))
        return make(np.array(list(known.values())), frame="", joints=list(known))

    return f"goes {' '.join(words)}", keep_other_joints


def _push(words: list[str], settings: Settings) -> Request:
    """Parse ``60 forward [for 0.1] [at FRAME]``."""
    tail = {"for": "", "at": ""}
    while len(words) > 2 and words[-2] in tail:
        tail[words[-2]] = words[-1]
        words = words[:-2]
    force, by_heading = _displacement(words, "push", _FORCE)
    push_time = settings.mock.push_duration
    requested_time = _number(tail["for"], "push: the duration", _TIME) if tail["for"] else push_time
    if not abs(requested_time - push_time) <= 1.0e-6:
        same = np.linalg.norm(force) * requested_time / push_time
        raise InputRefused(
            f"push: duration {requested_time:g} s; valid: {push_time:g} s (mock.push_duration). "
            f"{same:g} N for {push_time:g} s give the same impulse"
        )
    named = settings.tasks.get(tail["at"]) or settings.contacts.get(tail["at"])
    frame = getattr(named, "frame", tail["at"])
    turned = by_heading and settings.robot.base == "floating"

    def content(wait_for_message: ReadMessage) -> Any:
        axes = _heading(wait_for_message("mock", "odom", "")) if turned else np.eye(3)
        return wrench_stamped(axes @ force, frame)

    summary = f"a push of {' '.join(words)} (N) for {push_time:g} s at {frame or 'the base'}"
    return Request("mock", "push", "", summary, content, frame)


def _heading(odometry: Any) -> Array:
    # imported late, because shell completion must be fast
    from wbc_controller.middleware.codec import encode
    from wbc_controller.middleware.states import OdometryReader

    x, y, z, w = OdometryReader(odometry.child_frame_id).read(encode(odometry)).pose[3:]
    cosine, sine = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w)
    length = float(np.hypot(cosine, sine)) or 1.0
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, length]]) / length


def _number(text: str, subject: str, units: Mapping[str, float] = _PLAIN) -> float:
    """Return a number in SI units; raise `InputRefused` otherwise."""
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise InputRefused(f"{subject}: expected a number, got {text!r}")
    if match[2] not in units:
        raise InputRefused(f"{subject}: unknown unit in {text!r}; {valid_choices(match[2], [u for u in units if u])}")
    return float(match[1]) * units[match[2]]


def _displacement(words: Sequence[str], subject: str, units: Mapping[str, float]) -> tuple[Array, bool]:
    """Return the sum of pairs such as ``0.02 forward 0.01 down``, (3,), and whether it has the axes of the heading.

    The other axes are those of the world. Raises `InputRefused` for words of another form, or of both kinds of axes.
    """
    if not words or len(words) % 2:
        raise InputRefused(
            f"{subject} requires pairs of a number and a direction, such as 0.02 forward; got {' '.join(words)!r}"
        )
    known = {**HEADINGS, **AXES}
    total, directions = np.zeros(3), words[1::2]
    for amount, direction in zip(words[::2], directions, strict=True):
        require_known(direction, known, f"{subject}: unknown direction", error=InputRefused)
        total += _number(amount, subject, units) * np.array(known[direction])
    level = {"up", "down", "z"}  # the same in both
    by_heading, by_axes = (set(directions) & set(names) - level for names in (HEADINGS, AXES))
    if by_heading and by_axes:
        raise InputRefused(
            f"{subject}: {' '.join(words)!r} mixes directions of the robot with axes x, y, z of the world; use one kind"
        )
    return total, not by_axes


def _turn(words: Sequence[str], axes: _Axes, subject: str) -> Array:
    """Return ``_ANGLE DIRECTION`` as a rotation vector in heading axes, (3,) in rad; raise `InputRefused` otherwise."""
    if len(words) != 2:
        raise InputRefused(f"{subject} requires an angle and a direction, such as 10deg left; got {' '.join(words)!r}")
    require_known(words[1], axes, f"{subject}: unknown direction", error=InputRefused)
    return _number(words[0], subject, _ANGLE) * np.array(axes[words[1]])


def _quaternion(rotation: Array) -> Array:
    """Return the quaternion (x, y, z, w) of a rotation vector, (3,) in rad."""
    angle = float(np.linalg.norm(rotation))
    axis = rotation / angle if angle > 0.0 else np.zeros(3)
    return np.array([*(math.sin(0.5 * angle) * axis), math.cos(0.5 * angle)])
