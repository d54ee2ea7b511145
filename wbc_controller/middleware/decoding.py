"""Decoders of users' messages."""

import difflib
import itertools
import math
import operator
import reprlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
import yaml

from wbc_controller.arguments import finite, number, shortened, unit_quaternion
from wbc_controller.errors import ConfigurationError, InputRefused, require_known
from wbc_controller.inverse_dynamics import tasks
from wbc_controller.inverse_dynamics.references import changes
from wbc_controller.inverse_dynamics.references.relative import own_frames
from wbc_controller.inverse_dynamics.references.trajectories import Knot
from wbc_controller.inverse_dynamics.tasks.form import ReferenceForm
from wbc_controller.middleware.codec import JOINT_FIELDS, nanoseconds
from wbc_controller.middleware.stamps import stamp_of
from wbc_controller.middleware.states import require_unique
from wbc_controller.records import Array, ChangeSettings
from wbc_controller.settings.files import read_yaml

WORLD_FRAMES = ("", "world", "odom", "map")  # of the world in headers
#: Kinds of task with references that may be given in a frame of the robot.
_WORLD_KINDS = ("com", "frame_position", "frame_orientation", "frame_pose", "axis_alignment", "gaze", "capture_point")
_MAX_POINTS = 5000  # of a trajectory
MAX_DISTANCE = 1.0e4  # largest coordinate of a pose on the ground, m
_MAX_FOOTSTEPS = 1000
_LARGEST_TILT = 0.1  # of a pose on the ground, as a component of a unit quaternion
_MAX_UPDATE = 4096  # length of an update, characters
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # in C if available
_UPDATE_FORM = (
    "an update is YAML such as {tasks: {com: {weight: 5.0, enabled: true, setpoint: [0, 0, 0.7]}}, "
    "contacts: {left_foot: {enabled: false}}}"
)
#: Keys of references and keys of settings, by section of an update.
_UPDATE_KEYS = {
    "tasks": (("enabled", "weight", "setpoint", "frame"), ("stiffness", "damping", "gain", "setpoint_duration")),
    "contacts": (("enabled",), ("ramp",)),
}
_UPDATE_SETTINGS = ("control", "limits", "safety")  # with settings only


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """Valid names and sizes in messages."""

    kinds: Mapping[str, str]  # kind by task, such as ``frame_pose``
    joints: Mapping[str, tuple[str, ...]]  # joints by posture or torque task
    contacts: tuple[str, ...]
    robot_frames: Collection[str] = ()  # frames of the robot for setpoints
    #: Reference frame by task; the world for all others.
    reference_frames: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))


#: Reference form by kind of task, except the kinds of `JOINT_FIELDS`, with joints by name.
_FORMS: Mapping[str, ReferenceForm] = {
    **dict.fromkeys(("com", "frame_position", "linear_momentum", "angular_momentum"), ReferenceForm()),
    "frame_orientation": tasks.FrameOrientationTask.form,
    "frame_pose": tasks.FramePoseTask.form,
    "relative_pose": tasks.RelativePoseTask.form,
    "axis_alignment": tasks.AxisAlignmentTask.form,
    "gaze": tasks.GazeTask.form,
    "capture_point": ReferenceForm(vector=2),
    "contact_wrench": ReferenceForm(vector=6),
}
_xyz, _xyzw = operator.attrgetter("x", "y", "z"), operator.attrgetter("x", "y", "z", "w")


def _require_world_frame(content: Any, what: str) -> None:
    frame = content.header.frame_id
    if frame not in WORLD_FRAMES:
        raise InputRefused(f"frame_id is {frame!r}; valid for {what}: {', '.join(WORLD_FRAMES[1:])}")


def _frame_of_setpoint(vocabulary: Vocabulary, task: str, frame: str, what: str = "frame_id") -> str:
    home = vocabulary.reference_frames.get(task)
    if frame == home or (home is None and frame in WORLD_FRAMES):
        return ""
    kind = vocabulary.kinds[task]
    own: tuple[str, ...] = own_frames(task)  # relative to the reference, and to the heading
    if kind == "axis_alignment":  # directions have no displacement
        own = own[1:]
    elif kind in ("relative_pose", "contact_wrench", *JOINT_FIELDS):  # without heading
        own = own[:1]
    placed = kind in _WORLD_KINDS
    if frame in own or (placed and frame in vocabulary.robot_frames):
        return frame
    where = f"its reference frame {home!r}" if home is not None else f"the world ({', '.join(WORLD_FRAMES[1:])})"
    at = [f"relative to its reference ({', '.join(own)})"] if own else []
    robot = ["a frame of the robot"] if placed else []
    valid = " or ".join([where, *at, *robot])
    close = difflib.get_close_matches(frame, [*own, *(vocabulary.robot_frames if placed else ())], n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    raise InputRefused(f"{what} is {reprlib.repr(frame)}; valid for setpoints of task {task!r}: {valid}{hint}")


def _read_setpoint(vocabulary: Vocabulary, task: str, content: Any) -> tuple[changes.Change, ...]:
    kind = vocabulary.kinds[task]
    if kind in JOINT_FIELDS:
        what, joints, frame = JOINT_FIELDS[kind], vocabulary.joints[task], content.header.frame_id
        # Drivers fill the frame of joints arbitrarily; only a frame of the task has a meaning.
        relative = frame.startswith(f"{task}/")
        frame = _frame_of_setpoint(vocabulary, task, frame) if relative else ""
        values = _joint_values(joints, content.name, getattr(content, what), what, partial=relative)
        return (changes.SetSetpoint(task, values, frame=frame),)
    frame = _frame_of_setpoint(vocabulary, task, content.header.frame_id)
    if kind == "contact_wrench":
        return (changes.SetSetpoint(task, _wrench(content), frame=frame),)
    form = _FORMS[kind]
    if form.oriented:
        position = _position(form, content.pose.position, content.pose.orientation, "the pose")
    else:
        what = "point" if hasattr(content, "point") else "vector"
        position = _position(form, getattr(content, what), None, f"the {what}")
    return (changes.SetSetpoint(task, position, frame=frame),)


def _position(form: ReferenceForm, vector: Any, quaternion: Any, what: str) -> Array:
    orientation = _xyzw(quaternion) if form.oriented else ()
    return form.position([*_xyz(vector)[: form.vector], *orientation], what)


def _joint_values(joints: Sequence[str], names: Sequence[str], values: Any, what: str, *, partial: bool) -> Array:
    """Return the values in the task's order of joints; `partial` permits missing ones, with 0."""
    if len(values) != len(names):
        raise InputRefused(f"{what} has {len(values)} values for {len(names)} names")
    _require_joints(joints, names, what, partial=partial)
    given = dict(zip(names, finite(values, what), strict=True))
    return np.array([given.get(name, 0.0) for name in joints])


def _require_joints(joints: Sequence[str], names: Sequence[str], what: str, *, partial: bool = False) -> None:
    require_known(names, joints, f"{what}:", " is not a joint of this task", InputRefused)
    require_unique(names)
    missing = [] if partial else [name for name in joints if name not in names]
    if missing:
        raise InputRefused(f"{what}: {len(missing)} joints are missing: {', '.join(missing)}")


def _read_trajectory(vocabulary: Vocabulary, task: str, content: Any) -> tuple[changes.Change, ...]:
    if not content.points:
        raise InputRefused("the trajectory has no points")
    if len(content.points) > _MAX_POINTS:
        raise InputRefused(f"the trajectory has {len(content.points)} points (limit {_MAX_POINTS})")
    kind = vocabulary.kinds[task]
    if kind == "posture":
        joints, names = vocabulary.joints[task], list(content.joint_names)
        _require_joints(joints, names, "positions")
        order = np.array([names.index(name) for name in joints], dtype=np.intp)
        knots = [_joint_knot(order, point) for point in content.points]
    else:
        wanted = vocabulary.reference_frames.get(task)
        if wanted is None:
            _require_world_frame(content, "a trajectory")
        elif content.header.frame_id != wanted:
            raise InputRefused(
                f"frame_id is {content.header.frame_id!r}; valid for a trajectory of task {task!r}: its reference "
                f"frame {wanted!r}"
            )
        if len(content.joint_names) > 1:
            raise InputRefused(f"the trajectory has {len(content.joint_names)} joint names; valid: at most one frame")
        knots = [_frame_knot(_FORMS[kind], point) for point in content.points]
    times = [knot.time for knot in knots]
    if any(not (a < b) for a, b in itertools.pairwise(times)) or times[0] < 0.0:
        raise InputRefused(f"time_from_start must increase from 0, got {shortened(np.array(times))} s")
    if knots[-1].velocity.any():
        raise InputRefused(f"the last point has the velocity {shortened(knots[-1].velocity)}; it must be 0")
    stamp = stamp_of(content)
    return (changes.SetTrajectory(task, stamp * 1.0e-9 if stamp else None, tuple(knots)),)


def _joint_knot(order: np.ndarray, point: Any) -> Knot:
    arrays = []
    for what in ("positions", "velocities", "accelerations"):
        values = getattr(point, what)
        if len(values) != len(order) and (len(values) or what == "positions"):
            raise InputRefused(f"{what} has {len(values)} values for {len(order)} names")
        arrays.append(finite(values, what)[order] if len(values) else np.zeros(len(order)))
    return Knot(nanoseconds(point.time_from_start) * 1.0e-9, *arrays)


def _frame_knot(form: ReferenceForm, point: Any) -> Knot:
    if len(point.transforms) != 1:
        raise InputRefused(f"a point has {len(point.transforms)} transforms; valid: 1")
    transform = point.transforms[0]
    position = _position(form, transform.translation, transform.rotation, "the transform")
    derivatives = []
    for what in ("velocities", "accelerations"):
        twists = getattr(point, what)
        if len(twists) > 1:
            raise InputRefused(f"a point has {len(twists)} {what}; valid: at most 1")
        six = [*_xyz(twists[0].linear), *_xyz(twists[0].angular)] if twists else np.zeros(6)
        derivatives.append(finite(six, what)[form.twist])
    return Knot(nanoseconds(point.time_from_start) * 1.0e-9, position, *derivatives)


def _read_external_wrench(vocabulary: Vocabulary, frame: str, content: Any) -> tuple[changes.Change, ...]:
    _require_world_frame(content, "an external wrench")
    return (changes.SetExternalWrench(frame, _wrench(content)),)


def _read_velocity(twist: Any) -> tuple[changes.Change, ...]:
    unused = twist.linear.z, twist.angular.x, twist.angular.y
    velocity = finite([twist.linear.x, twist.linear.y, twist.angular.z], "the velocity")
    if any(unused):
        raise InputRefused(
            f"linear.z, angular.x and angular.y are {list(unused)}; they must be 0: walking uses linear.x, linear.y "
            "and angular.z"
        )
    return (changes.Walk(velocity if velocity.any() else None, streamed=True),)


def _pose_on_ground(pose: Any, what: str) -> Array:
    """Return x, y in m and heading in rad of a pose, (3,)."""
    place = finite([pose.position.x, pose.position.y], what)
    if not (np.abs(place) <= MAX_DISTANCE).all():
        raise InputRefused(f"{what} is at {shortened(place)} m; valid: up to {MAX_DISTANCE:g} m from the origin")
    orientation = finite(_xyzw(pose.orientation), "the orientation")
    x, y, z, w = unit_quaternion(orientation, "the orientation ").tolist()
    if not (abs(x) <= _LARGEST_TILT and abs(y) <= _LARGEST_TILT):
        raise InputRefused(f"the orientation of {what} is tilted (x {x:g}, y {y:g}); it must be a rotation about z")
    return np.array([*place, math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))])


def _read_goal(content: Any) -> tuple[changes.Change, ...]:
    _require_world_frame(content, "a goal")
    return (changes.WalkTo(_pose_on_ground(content.pose, "the goal")),)


def _read_footsteps(content: Any) -> tuple[changes.Change, ...]:
    _require_world_frame(content, "footsteps")
    if not (1 <= len(content.poses) <= _MAX_FOOTSTEPS):
        raise InputRefused(f"the message has {len(content.poses)} footsteps; valid: 1 to {_MAX_FOOTSTEPS}")
    poses = [_pose_on_ground(pose, f"step {i}") for i, pose in enumerate(content.poses, 1)]
    return (changes.WalkFootsteps(np.array(poses)),)


def _wrench(content: Any) -> Array:
    return finite([*_xyz(content.wrench.force), *_xyz(content.wrench.torque)], "the wrench")


def _read_update(vocabulary: Vocabulary, subject: str, content: Any) -> tuple[changes.Change | ChangeSettings, ...]:
    if len(content.data) > _MAX_UPDATE:
        raise InputRefused(f"update has {len(content.data)} characters (limit {_MAX_UPDATE})")
    try:
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(content.data, Loader=_LOADER)):
            raise InputRefused(f"aliases (*name) are not supported; {_UPDATE_FORM}")
        update = read_yaml(content.data, "update", _LOADER)
    except (yaml.YAMLError, RecursionError) as error:  # RecursionError on deep nesting
        raise InputRefused(f"not valid YAML: {' '.join(str(error).split())}; {_UPDATE_FORM}") from error
    except ConfigurationError as error:
        raise InputRefused(f"{error}; {_UPDATE_FORM}") from error
    if not isinstance(update, dict) or not update:
        raise InputRefused(f"{reprlib.repr(content.data)} is not a mapping; {_UPDATE_FORM}")
    found: list[changes.Change] = []
    settings: dict[str, Any] = {}
    for section, entries in update.items():
        if section in _UPDATE_SETTINGS and isinstance(entries, dict):
            settings[section] = entries
            continue
        require_known((section,), (*_UPDATE_KEYS, *_UPDATE_SETTINGS), "unknown key", error=InputRefused)
        known = vocabulary.kinds if section == "tasks" else vocabulary.contacts
        if not isinstance(entries, dict):
            raise InputRefused(f"{section} is not a mapping; {_UPDATE_FORM}")
        for name, fields in entries.items():
            require_known((name,), known, f"unknown {section[:-1]}", error=InputRefused)
            if not isinstance(fields, dict):
                raise InputRefused(f"{section}.{name} is not a mapping; {_UPDATE_FORM}")
            if "frame" in fields and "setpoint" not in fields:
                raise InputRefused(f"{section}.{name}: 'frame' requires 'setpoint'")
            for key, value in fields.items():
                if key == "frame" and section == "tasks":
                    continue
                if key in _UPDATE_KEYS[section][1]:
                    settings.setdefault(section, {}).setdefault(name, {})[key] = value
                else:
                    found.append(_update_field(vocabulary, section, name, key, value, fields.get("frame", "")))
    if not found and not settings:
        raise InputRefused(f"{reprlib.repr(content.data)} changes nothing; {_UPDATE_FORM}")
    return (*found, *([ChangeSettings(settings)] if settings else []))


def _update_field(vocabulary: Vocabulary, section: str, name: str, key: Any, value: Any, frame: Any) -> changes.Change:
    require_known((key,), sum(_UPDATE_KEYS[section], ()), f"{section}.{name}: unknown key", error=InputRefused)
    if key == "weight":
        return changes.SetWeight(name, number(value, f"tasks.{name}.weight", 0.0, 1.0e6))
    if key == "setpoint":
        if not isinstance(frame, str):
            raise InputRefused(f"tasks.{name}.frame is {reprlib.repr(frame)}; it must be the name of a frame")
        if frame:
            frame = _frame_of_setpoint(vocabulary, name, frame, f"tasks.{name}.frame")
        kind = vocabulary.kinds[name]
        form = ReferenceForm(vector=len(vocabulary.joints[name])) if kind in JOINT_FIELDS else _FORMS[kind]
        return changes.SetSetpoint(name, form.position(value, f"tasks.{name}.setpoint"), frame=frame)
    if not isinstance(value, bool):
        raise InputRefused(f"{section}.{name}.enabled is {reprlib.repr(value)}; valid: true or false")
    return changes.EnableTask(name, value) if section == "tasks" else changes.EnableContact(name, value)


#: Decoders by row of the topic table.
READERS: Mapping[str, Callable[[Vocabulary, str, Any], tuple[changes.Change | ChangeSettings, ...]]] = {
    "setpoint": _read_setpoint,
    "trajectory": _read_trajectory,
    "weight": lambda vocabulary, task, content: (changes.SetWeight(task, number(content.data, "weight", 0.0, 1.0e6)),),
    "task_enable": lambda vocabulary, task, content: (changes.EnableTask(task, bool(content.data)),),
    "contact_enable": lambda vocabulary, contact, content: (changes.EnableContact(contact, bool(content.data)),),
    "external_wrench": _read_external_wrench,
    "cmd_vel": lambda vocabulary, subject, content: _read_velocity(content),
    "cmd_vel_stamped": lambda vocabulary, subject, content: _read_velocity(content.twist),
    "walk_goal": lambda vocabulary, subject, content: _read_goal(content),
    "walk_footsteps": lambda vocabulary, subject, content: _read_footsteps(content),
    "update": _read_update,
}
