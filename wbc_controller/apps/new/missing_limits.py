"""Placeholders for joint limits that are missing in the URDF, or cannot be a motor's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from wbc_controller.apps.new.notes import Draft

#: Types of joints with limits.
_LIMITED = ("revolute", "continuous", "prismatic")
#: Gravity, m/s².
_GRAVITY = 9.81
#: Effort above which a limit cannot be a motor's, in weights of the robot at the end of its longest limb, and its
#: placeholder in the same unit.
_MOST_EFFORT, _EFFORT = 10.0, 0.5
#: Speed above which a limit cannot be a motor's, and its placeholder, rad/s or m/s.
_MOST_VELOCITY, _VELOCITY = 100.0, 8.0
#: Placeholder of a missing range to either side, rad.
_RANGE = round(np.pi, 4)


@dataclass(frozen=True, slots=True)
class Placeholders:
    """Limits in place of those of the URDF."""

    values: dict[str, dict[str, float]]  # by joint, as in ``robot.joint_limits``
    why: dict[str, dict[str, str]]  # by joint, the kinds of limit with what the URDF has instead
    idle: list[str]  # joints without an effort

    def put(self, draft: Draft, joints: Sequence[str]) -> None:
        """Write ``robot.joint_limits``, with a sentence for each kind of limit of joints that move."""
        if not self.values:
            return
        draft.put("robot.joint_limits", self.values)
        for kind, unit in (
            ("effort", "largest torque, N·m"),
            ("velocity", "largest speed, rad/s"),
            ("range", "range, rad"),
        ):
            reasons: dict[str, list[str]] = {}
            for name in joints:
                if kind in self.why.get(name, {}):
                    reasons.setdefault(self.why[name][kind], []).append(name)
            for reason, names in reasons.items():
                text = f"the {unit}, of {', '.join(names)}, from the data sheet: {reason}."
                draft.note("robot.joint_limits", text, "missing")
        idle = [name for name in joints if name in self.idle]
        if idle and len(idle) < len(joints):
            text = f"{', '.join(idle)} have no effort in the URDF, and other joints have: joints with a spring, or "
            draft.note("robot.joint_limits", f"{text}without a motor, belong in `passive_joints`.", "missing")


def fill_limits(tree: ElementTree.Element) -> None:
    """Write 0 for the missing efforts and speeds of a URDF's joints, in place."""
    for joint in tree.findall("joint"):
        if joint.get("type") in _LIMITED:
            limit = joint.find("limit")
            limit = ElementTree.SubElement(joint, "limit") if limit is None else limit
            for key in ("effort", "velocity"):
                limit.set(key, limit.get(key, "0"))


def reach_of(model: pin.Model) -> float:
    """Return the length of the longest chain of joints, m."""
    lengths = np.zeros(model.njoints)
    for joint in range(2, model.njoints):
        step = np.linalg.norm(model.jointPlacements[joint].translation)
        lengths[joint] = lengths[model.parents[joint]] + (step if model.parents[joint] > 1 else 0.0)
    return float(lengths.max())


def replaced_limits(joints: Sequence[ElementTree.Element], mass: float, reach: float) -> Placeholders:
    """Replace the limits of joints that are missing or cannot be true.

    The robot has the mass `mass`, kg, and its longest chain of joints the length `reach`, m.
    """
    weight = mass * _GRAVITY * max(reach, 0.05)
    found = Placeholders({}, {}, [])
    for joint in joints:
        if joint.get("type") not in _LIMITED:
            continue
        limit = joint.find("limit")
        given = {key: None if limit is None else limit.get(key) for key in ("effort", "velocity", "lower", "upper")}
        number = {key: float(value) for key, value in given.items() if value is not None}
        values: dict[str, float] = {}
        why: dict[str, str] = {}
        effort, velocity = number.get("effort", 0.0), number.get("velocity", 0.0)
        if effort == 0.0:
            found.idle.append(str(joint.get("name")))
        if joint.get("type") != "prismatic" and not (0.0 < effort <= _MOST_EFFORT * weight):
            values["effort"] = float(f"{_EFFORT * weight:.2g}")
            why["effort"] = f"{values['effort']:g} stands here, as the URDF has " + (
                f"{effort:g}, and {weight:.2g} hold the whole robot at the end of its longest limb"
                if effort
                else "none"
            )
        elif not (effort > 0.0):
            values["effort"] = float(f"{mass * _GRAVITY:.2g}")
            why["effort"] = f"the robot's weight, {values['effort']:g} N, stands here, as the URDF has none"
        if not (0.0 < velocity < _MOST_VELOCITY):
            values["velocity"] = _VELOCITY
            why["velocity"] = f"{_VELOCITY:g} stands here, as the URDF has {velocity:g}"
        # An empty range beside an effort is a joint that is meant not to move.
        empty = not number.get("lower") and not number.get("upper")
        nothing = empty and (not effort or not {"lower", "upper"} & {*number})
        if joint.get("type") == "revolute" and nothing:
            values |= {"lower": -_RANGE, "upper": _RANGE}
            why["range"] = "half a turn to either side stands here, as the URDF has none"
        if values:
            name = str(joint.get("name"))
            found.values[name], found.why[name] = values, why
    return found
