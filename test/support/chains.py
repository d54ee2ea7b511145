"""Small robots written as text: chains and branches of links, for tests that need a robot of their own."""

from typing import Any

from wbc_controller.settings import Settings
from wbc_controller.settings.files import parse_settings

_LINK = (
    '<link name="{name}"><inertial><origin xyz="0.02 0.01 -0.15" rpy="0.1 0.2 0.3"/><mass value="{mass}"/>'
    '<inertia ixx="0.03" iyy="0.04" izz="0.02" ixy="0.001" ixz="0" iyz="0.002"/></inertial></link>'
)
_JOINT = (
    '<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/><parent link="{parent}"/>'
    '<child link="{child}"/><axis xyz="{axis}"/>'
    '<limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="{velocity}"/>{more}</joint>'
)


def link(name: str, mass: float = 1.0) -> str:
    return _LINK.format(name=name, mass=mass)


def joint(name: str, parent: str, child: str, axis: str = "0 1 0", **changes: Any) -> str:
    values = {
        "kind": "revolute", "xyz": "0.01 0.02 -0.3", "rpy": "0 0 0", "lower": -2.5, "upper": 2.5, "effort": 60,
        "velocity": 12, "more": "",
    }  # fmt: skip
    return _JOINT.format(name=name, parent=parent, child=child, axis=axis, **{**values, **changes})


def mimic(leader: str, multiplier: float, offset: float = 0.0) -> str:
    return f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/>'


def robot(*parts: str) -> str:
    return f'<robot name="small">{"".join(parts)}</robot>'


#: A base with two arms. Left: shoulder, elbow, and a wrist that mimics the elbow. Right: hip, knee, ankle. A rail that
#: slides, and a tail, turned in its mount, to be locked.
MENAGERIE = robot(
    link("base", 5.0),
    link("upper_arm"), joint("shoulder", "base", "upper_arm", "1 0 0", xyz="0 0.2 0"),
    link("forearm"), joint("elbow", "upper_arm", "forearm"),
    link("hand", 0.4), joint("wrist", "forearm", "hand", "0 0.6 0.8", more=mimic("elbow", -0.5, 0.2)),
    link("thigh"), joint("hip", "base", "thigh", "0 1 0", xyz="0 -0.2 0"),
    link("shank"), joint("knee", "thigh", "shank"),
    link("foot", 0.5), joint("ankle", "shank", "foot", "0.1 1 0"),
    link("carriage", 0.7), joint("rail", "base", "carriage", "1 0 0", kind="prismatic", lower=-0.5, upper=0.5),
    link("stump", 0.3), joint("tail", "carriage", "stump", "0 0.6 0.8", rpy="0.3 -0.4 0.5"),
    link("brush", 0.2), joint("slide", "stump", "brush", "0 0 2", kind="prismatic", lower=-0.5, upper=0.5),
)  # fmt: skip
MENAGERIE_JOINTS = ["hip", "shoulder", "elbow", "knee", "ankle", "rail"]


def menagerie(**changes: Any) -> Settings:
    """Settings of the menagerie: a passive ankle, hip and knee driven together, a wrist that follows; a fixed base."""
    own = {
        "base": "fixed",
        "joints": MENAGERIE_JOINTS,
        "posture": [0.2, 0.1, 0.4, -0.3, 0.1, 0.05],
        "actuators": ["rail", "both", "shoulder", "knee_motor", "elbow"],
        "transmission": {
            "both": {"ratios": {"hip": 2.0, "knee": 2.0}, "effort_limit": 70.0, "rotor_inertia": 0.1},
            "knee_motor": {"ratios": {"knee": -3.0}, "effort_limit": 50.0},
        },
        "passive_joints": {"ankle": {"stiffness": 15.0, "damping": 0.3, "rest": 0.25}},
        "locked_joints": {"tail": 0.7, "slide": -0.2},
    }
    return parse_settings({"robot": {**own, **changes}, "tasks": {"posture": {"type": "posture"}}}, "a test")


#: Changes of the menagerie: hip and knee are pulled by one tendon and returned by springs.
TENDON = {
    "actuators": ["rail", "tendon", "shoulder", "elbow"],
    "transmission": {
        "tendon": {"ratios": {"hip": 0.3, "knee": 0.2}, "effort_limit": 200.0, "rotor_inertia": 0.4},
    },
    "passive_joints": {
        "hip": {"stiffness": 60.0, "damping": 2.0}, "knee": {"stiffness": 40.0, "damping": 1.0}, "ankle": {},
    },
}  # fmt: skip
