"""Parser of `wbc send`: words to one message on one topic."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from wbc_controller.apps.terminal import quantity_parser as quantity
from wbc_controller.errors import InputRefused, require_known
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
        value = quantity.number(word, "weight")
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
    if oriented and words and words[0] in quantity.ROTATIONS:
        rotation = quantity.turn(words[1:], quantity.ROTATIONS[words[0]], f"{task} {words[0]}")
        values = np.concatenate([np.zeros(0 if kind == "frame_orientation" else 3), quantity.quaternion(rotation)])
        return at(f"{words[0]}s {' '.join(words[1:])}", values, f"{task}/heading")
    if kind in ("frame_orientation", "axis_alignment", "contact_wrench"):
        forms = {"frame_orientation": "turn 10deg left, lean 5deg forward, or to X Y Z W"}.get(kind, "to NUMBERS")
        raise InputRefused(f"{task} is a {kind} task; valid forms: {forms}")
    moved, by_heading = quantity.displacement(words, task, quantity.PLAIN if "momentum" in kind else quantity.LENGTH)
    if kind == "relative_pose" and by_heading:
        raise InputRefused(f"{task} is relative to {spec.reference_frame}; valid directions: its axes x, y, z")  # type: ignore[union-attr]
    values = np.array([*moved, 0.0, 0.0, 0.0, 1.0]) if oriented else moved
    return at(f"moves {' '.join(words)}", values, f"{task}/{'heading' if by_heading else 'reference'}")


def _absolute(task: str, words: list[str], make: Callable[..., Any], oriented: bool, home: str) -> tuple[str, Make]:
    """Parse ``0 0 0.6 [in FRAME]``."""
    frame = home
    if len(words) > 1 and words[-2] == "in":
        frame, words = words[-1], words[:-2]
    values = np.array([quantity.number(word, task) for word in words])
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
    units = {"": 1.0, "N·m": 1.0, "Nm": 1.0} if field == "effort" else quantity.ANGLE
    names, values = words[::3], np.array([quantity.number(word, task, units) for word in words[2::3]])
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
    force, by_heading = quantity.displacement(words, "push", quantity.FORCE)
    push_time = settings.mock.push_duration
    requested_time = quantity.number(tail["for"], "push: the duration", quantity.TIME) if tail["for"] else push_time
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
