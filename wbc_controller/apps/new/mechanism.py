"""Movable joints of a URDF, placeholders of missing or implausible limits, and postures of its SRDF."""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from wbc_controller.apps.new.notes import Draft
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot import urdf
from wbc_controller.inverse_dynamics.robot.from_urdf import read_mechanism
from wbc_controller.inverse_dynamics.robot.mimic import read_mimics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.virtual_base import virtual_joints
from wbc_controller.records import Array
from wbc_controller.settings.resources import PACKAGE_SCHEME, locate, read_text, share_folder
from wbc_controller.settings.robot import JointLimitSettings

_FINGER_SHARE = 1.0 / 200.0  # smallest share of the mass, except fingers
_SEVERAL_TURNS = 4.1 * np.pi  # smallest range of a joint with several turns, rad
#: Words in the names of SRDF postures, in order of preference; every name contains the last one.
_POSTURES = ("half_sitting", "standing", "home", "homing", "default", "neutral", "")
_LIMITED = ("revolute", "continuous", "prismatic")
_GRAVITY = 9.81  # m/s²
#: Largest plausible effort and its placeholder, in units of the weight times the length of the longest limb.
_MOST_EFFORT, _EFFORT = 10.0, 0.5
_MOST_VELOCITY, _VELOCITY = 100.0, 8.0  # largest plausible speed and its placeholder, rad/s or m/s
_RANGE = round(np.pi, 4)  # placeholder of a missing range to either side, rad


class UrdfSource(NamedTuple):
    """A URDF with its location."""

    address: str  # ``package://`` address if possible, otherwise an absolute path
    path: Path
    text: str  # with planar joints split, and missing limits set to 0
    tree: ElementTree.Element  # the text as XML


def read_source(uri: str) -> UrdfSource:
    """Read a URDF by its path or ``package://`` address; raise `ConfigurationError` for a missing or invalid file."""
    path = locate(uri, "ROBOT.urdf")
    tree = urdf.parse_urdf(read_text(path, f"ROBOT.urdf = {uri!r}", urdf.LARGEST_URDF))
    urdf.split_planar_joints(tree)
    for joint in tree.findall("joint"):
        if joint.get("type") in _LIMITED:
            limit = joint.find("limit")
            limit = ElementTree.SubElement(joint, "limit") if limit is None else limit
            for key in ("effort", "velocity"):
                limit.set(key, limit.get(key, "0"))
    text = ElementTree.tostring(tree, encoding="unicode")
    return UrdfSource(uri if uri.startswith(PACKAGE_SCHEME) else _address(path.resolve()), path, text, tree)


def _address(path: Path) -> str:
    for folder in path.parents:
        with contextlib.suppress(ConfigurationError):  # package not installed
            if folder.parent.name == "share" and share_folder(folder.name).resolve() == folder:
                return f"{PACKAGE_SCHEME}{folder.name}/{path.relative_to(folder).as_posix()}"
    return str(path)


def ranges_of(source: UrdfSource, limits: Mapping[str, Mapping[str, float]]) -> dict[str, tuple[float, float]]:
    """Return the position limits of the movable joints after replacements."""
    replaced = {name: JointLimitSettings.model_construct(None, **entries) for name, entries in limits.items()}
    tree, _ = urdf.read_robot(source.text, replaced)
    found = {}
    for joint in tree.iterfind("joint"):
        limit = joint.find("limit")
        if joint.get("type") != "fixed":
            values = [0.0 if limit is None else float(limit.get(key, "0")) for key in ("lower", "upper")]
            found[str(joint.get("name"))] = values[0], values[1]
    return found


def choose_joints(source: UrdfSource, draft: Draft, carrying: Sequence[str]) -> None:
    """Write ``robot.joints``, ``locked_joints`` and ``joint_limits`` in URDF order; `carrying` are links of feet.

    Raises `ConfigurationError` if the URDF is invalid or has no usable joint.
    """
    model = read_mechanism(source.tree, floating_base=True)
    mimics, mass = read_mimics(source.tree), pin.computeTotalMass(model)
    if not (mass > 0.0):
        raise ConfigurationError("robot.urdf: the mass of the robot is 0 kg; add <inertial> elements to its links")
    elements = [joint for joint in source.tree.iterfind("joint") if joint.get("type") != "fixed"]
    limits = replaced_limits(elements, mass, reach_of(model))
    ranges = ranges_of(source, limits.values)
    joints, light, stiff, other, virtual = [], [], [], [], virtual_joints(source.tree)
    kept = {i for link in carrying for i in model.supports[model.frames[model.getFrameId(link, pin.BODY)].parentJoint]}
    for name in (str(element.get("name")) for element in elements):
        joint = model.joints[model.getJointId(name)]
        moved_mass = sum(model.inertias[i].mass for i in model.subtrees[joint.id])
        if name in mimics or name in virtual:
            continue
        if joint.nv != 1:
            other.append(name)
        elif not (ranges[name][0] < ranges[name][1]):
            stiff.append(name)
        elif moved_mass < _FINGER_SHARE * mass and joint.id not in kept:
            light.append(name)
        else:
            joints.append(name)
    if not joints:
        raise ConfigurationError(
            "robot.urdf: no usable joint; required: a joint of one degree of freedom with a range and a moved mass"
        )
    text = "Joints in the order of the URDF. Torques are sent in this order; it must equal the order of `joints` in "
    draft.put("robot.joints", joints, f"{text}your effort controller.", "guess")
    for names, why in (
        (light, f"each moves less than {100.0 * _FINGER_SHARE:g} % of the robot's mass, as fingers do"),
        (stiff, "their range in the URDF is empty"),
        (other, "they have several degrees of freedom"),
        (virtual, "they represent a floating base"),
    ):
        if names:
            draft.note("robot.joints", f"Locked joints, not listed here: {', '.join(names)}; {why}.", "guess")
    locked = {
        name: float(np.clip(np.round(np.clip(0.0, *ranges[name]), 4), *ranges[name])) for name in (*light, *stiff)
    }
    locked = {name: position for name, position in locked.items() if position}
    if locked:
        draft.put("robot.locked_joints", locked, "The nearer limit, because zero is outside the range.", "guess")
    limits.put(draft, joints)


class Placeholders(NamedTuple):
    """Limits that replace limits of the URDF."""

    values: dict[str, dict[str, float]]  # as ``robot.joint_limits``
    reasons: dict[str, dict[str, str]]  # by joint and kind of limit
    without_effort: list[str]

    def put(self, draft: Draft, joints: Sequence[str]) -> None:
        """Write ``robot.joint_limits``, with a note for each kind of limit of the movable joints."""
        if not self.values:
            return
        draft.put("robot.joint_limits", self.values)
        units = {"effort": "largest torque in N·m", "velocity": "largest speed in rad/s", "range": "range in rad"}
        for kind, unit in units.items():
            reasons: dict[str, list[str]] = {}
            for name in joints:
                if kind in self.reasons.get(name, {}):
                    reasons.setdefault(self.reasons[name][kind], []).append(name)
            for reason, names in reasons.items():
                text = f"{unit} of {', '.join(names)}, from the data sheet: {reason}."
                draft.note("robot.joint_limits", text, "missing")
        without_effort = [name for name in joints if name in self.without_effort]
        if without_effort and len(without_effort) < len(joints):
            text = f"{', '.join(without_effort)} have no effort in the URDF, unlike other joints: joints with a spring "
            draft.note("robot.joint_limits", f"{text}or without a motor belong in `passive_joints`.", "missing")


def reach_of(model: pin.Model) -> float:
    """Return the length of the longest chain of joints, m."""
    lengths = np.zeros(model.njoints)
    for joint in range(2, model.njoints):
        step = np.linalg.norm(model.jointPlacements[joint].translation)
        lengths[joint] = lengths[model.parents[joint]] + (step if model.parents[joint] > 1 else 0.0)
    return float(lengths.max())


def replaced_limits(joints: Sequence[ElementTree.Element], mass: float, reach: float) -> Placeholders:
    """Return placeholders for missing or implausible limits; `mass`, kg, and `reach`, m, scale the efforts."""
    weight = mass * _GRAVITY * max(reach, 0.05)
    found = Placeholders({}, {}, [])
    for joint in joints:
        if joint.get("type") not in _LIMITED:
            continue
        limit = joint.find("limit")
        attributes = {} if limit is None else limit.attrib
        number = {key: float(attributes[key]) for key in ("effort", "velocity", "lower", "upper") if key in attributes}
        values: dict[str, float] = {}
        reasons: dict[str, str] = {}
        effort, velocity = number.get("effort", 0.0), number.get("velocity", 0.0)
        if effort == 0.0:
            found.without_effort.append(str(joint.get("name")))
        if joint.get("type") != "prismatic" and not (0.0 < effort <= _MOST_EFFORT * weight):
            values["effort"] = float(f"{_EFFORT * weight:.2g}")
            given = f"{effort:g}, but {weight:.2g} would hold the whole robot at the end of its longest limb"
            reasons["effort"] = f"placeholder {values['effort']:g}; the URDF has {given if effort else 'none'}"
        elif not (effort > 0.0):
            values["effort"] = float(f"{mass * _GRAVITY:.2g}")
            reasons["effort"] = f"placeholder {values['effort']:g} N, the robot's weight; the URDF has none"
        if not (0.0 < velocity < _MOST_VELOCITY):
            values["velocity"] = _VELOCITY
            reasons["velocity"] = f"placeholder {_VELOCITY:g}; the URDF has {velocity:g}"
        # A joint with an effort and an empty range is meant to be fixed.
        empty = not number.get("lower") and not number.get("upper")
        if joint.get("type") == "revolute" and empty and (not effort or not {"lower", "upper"} & {*number}):
            values |= {"lower": -_RANGE, "upper": _RANGE}
            reasons["range"] = "placeholder of half a turn to either side; the URDF has none"
        if values:
            name = str(joint.get("name"))
            found.values[name], found.reasons[name] = values, reasons
    return found


def read_postures(srdf: str) -> dict[str, dict[str, float]]:
    """Read the postures of an SRDF by name, preferred first, in rad; raise `ConfigurationError` if it is invalid."""
    text = read_text(locate(srdf, "--srdf"), f"--srdf = {srdf!r}", urdf.LARGEST_URDF)
    tree = urdf.parse_xml(text, "--srdf", "SRDF")
    found: dict[str, dict[str, float]] = {}
    for state in tree.iterfind("group_state"):
        joints = found.setdefault(str(state.get("name")), {})
        for joint in state.iterfind("joint"):
            values = str(joint.get("value", "")).split()
            try:
                numbers = [float(value) for value in values]
            except ValueError:
                raise ConfigurationError(
                    f"--srdf: posture {state.get('name')!r}: invalid position of joint {joint.get('name')!r}: "
                    f"{joint.get('value')!r}; valid: a number, such as 0.5"
                ) from None
            if len(numbers) == 1:  # others belong to the floating base
                joints[str(joint.get("name"))] = numbers[0]
    ranks = {name: next(i for i, word in enumerate(_POSTURES) if word in name.lower()) for name in found}
    return dict(sorted(found.items(), key=lambda item: ranks[item[0]]))


def usable_ranges(model: RobotModel, share: float, largest: float) -> tuple[Array, Array]:
    """Return lower and upper position limits, (nj,) in rad, ±π for joints with several turns, with a margin.

    The margin is a share of the range, at most `largest`, rad.
    """
    several = model.position_upper - model.position_lower > _SEVERAL_TURNS
    lower, upper = np.where(several, [[-np.pi], [np.pi]], [model.position_lower, model.position_upper])
    margin = np.minimum(share * (upper - lower), largest)
    return lower + margin, upper - margin
