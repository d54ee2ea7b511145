"""Placeholders of missing or implausible joint limits."""

from collections.abc import Sequence
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from wbc_controller.apps.new.notes import Draft

_LIMITED = ("revolute", "continuous", "prismatic")
_GRAVITY = 9.81  # m/s²
#: Largest plausible effort and its placeholder, in units of the weight times the length of the longest limb.
_MOST_EFFORT, _EFFORT = 10.0, 0.5
_MOST_VELOCITY, _VELOCITY = 100.0, 8.0  # largest plausible speed and its placeholder, rad/s or m/s
_RANGE = round(np.pi, 4)  # placeholder of a missing range to either side, rad


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


def fill_limits(tree: ElementTree.Element) -> None:
    """Write 0 for missing efforts and speeds of a URDF's joints, in place."""
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
