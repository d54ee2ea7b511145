"""Scenes of the comparison: robots, active feet, tasks, limits and states."""

import dataclasses
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from our_cycle import Cycle, make_model, parse_settings

from wbc_controller.controller.build.robot_description import read_urdf
from wbc_controller.controller.check.preflight import stance
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, Reference, References, frozen
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings

#: Gains of every task, 1/s² and 1/s.
STIFFNESS, DAMPING = 100.0, 20.0
#: Weights of the tasks, and of every contestant's regularization of the forces.
WEIGHTS = {"com": 1.0, "posture": 0.1, "waist": 1.0, "force": 1.0e-8}
#: Control period, s.
PERIOD = 0.001
#: Frequency of the sway, 1/s, and duration of its beginning, s.
FREQUENCY, BEGINNING = 0.5, 0.5
#: Duration of the motion of the centre of mass over the remaining feet, s.
SHIFT = 3.0
#: Weights during that motion, with a weak posture.
SHIFT_WEIGHTS = WEIGHTS | {"posture": 1.0e-3}
#: Radius of our point contacts, m: in all contestants the force acts at the origin of the foot's frame.
POINT = 1.0e-9
#: Talos with the joints of its grippers, without their couplings.
FULL_TALOS = "package://example-robot-data/robots/talos_data/robots/talos_full_v2.urdf"
#: Distance of joints from their limits if 0 is outside, rad.
INSIDE = 0.1


@dataclass(frozen=True)
class Case:
    """A robot on some of its feet."""

    name: str  # on the command line
    title: str  # in the table
    robot: str  # name of the supplied configuration
    feet: tuple[str, ...]  # active contacts
    waist: str  # frame with a controlled orientation
    sway: tuple[float, float, float]  # amplitude of the centre of mass, (3,) in m
    every_joint: bool = False  # True to use all joints of the URDF
    falls: bool = False  # True if the robot falls within a second on these feet; it is reset after `BEGINNING`


_FEET, _PAWS = ("left_foot", "right_foot"), ("front_left_foot", "front_right_foot", "rear_left_foot", "rear_right_foot")
CASES = {
    case.name: case
    for case in (
        Case("talos-double", "Talos, double support", "talos", _FEET, "base_link", (0.01, 0.03, 0.0)),
        Case("talos-single", "Talos, single support", "talos", _FEET[:1], "base_link", (0.01, 0.01, 0.0)),
        Case("g1-double", "G1, double support", "g1", _FEET, "pelvis", (0.01, 0.02, 0.0)),
        Case("g1-single", "G1, single support", "g1", _FEET[:1], "pelvis", (0.005, 0.005, 0.0)),
        Case("go2-four", "Go2, four feet", "go2", _PAWS, "base", (0.02, 0.02, 0.0)),
        Case("go2-two", "Go2, two feet", "go2", (_PAWS[0], _PAWS[3]), "base", (0.0, 0.0, 0.01), falls=True),
        Case("talos-full", "Talos, all joints", "talos", _FEET, "base_link", (0.01, 0.03, 0.0), every_joint=True),
    )
}
#: Robots with a timed whole cycle.
SERVICES = ("g1", "talos")
#: Amplitude of the centre of mass, m, with references at rest.
SERVICE_SWAY = (0.002, 0.005, 0.0)


def tasks(waist: str, weights: Mapping[str, float] = WEIGHTS) -> dict[str, Any]:
    """Return the three tasks of every contestant."""
    gains = {"stiffness": STIFFNESS, "damping": DAMPING, "setpoint_duration": 0.0}
    return {
        "com": {"type": "com", "weight": weights["com"], **gains},
        "posture": {"type": "posture", "weight": weights["posture"], **gains},
        "waist": {"type": "frame_orientation", "frame": waist, "weight": weights["waist"], **gains},
    }


def content_of(
    robot: str,
    its_tasks: Mapping[str, Any],
    sections: Mapping[str, Mapping[str, Any]],
    *,
    feet: tuple[str, ...] = (),
    contact_stiffness: float = 0.0,
) -> dict[str, Any]:
    """Return a supplied configuration at 1 kHz with other tasks and values by section, as plain values.

    Other values are defaults of the reading code. `feet` are the remaining contacts, empty for all; the stiffness of
    the contacts is in 1/s².
    """
    text = find_configuration(robot).read_text(encoding="utf-8")
    content: dict[str, Any] = yaml.safe_load(text)["wbc_controller"]["ros__parameters"]
    for section in ("estimation", "walking"):  # each state has its base, and older commits do not have these sections
        content.pop(section, None)
    content["control"]["rate"] = 1.0 / PERIOD
    content["mock"] = {"step": PERIOD}
    content["safety"] = {"activation_ramp": 0.0}
    content["tasks"] = dict(its_tasks)
    content["contacts"] = {
        name: contact | {"stiffness": contact_stiffness} | ({"radius": POINT} if contact["type"] == "point" else {})
        for name, contact in content["contacts"].items()
        if not feet or name in feet
    }
    for section, values in sections.items():
        content[section] = content.get(section, {}) | values
    return content


@dataclass(frozen=True)
class Scene:
    """A prepared case."""

    case: Case
    content: dict[str, Any]  # our settings as plain values
    settings: Settings
    model: RobotModel
    q: Array  # configuration of the references, (nq,)
    rows: Array  # states with their references, (n, nq + nv + 9)

    def message(self) -> dict[str, Any]:
        """Return the scene for a worker."""
        return message(self.content, self.settings, self.model, self.q, WEIGHTS, self.case.waist)


def make(case: Case, count: int, folder: Path) -> Scene:
    """Return a case with its states; a generated URDF is written to the folder."""
    # Limits of joint motion are off, because some rivals have none. Our regularization is as weak as theirs.
    sections: dict[str, dict[str, Any]] = {
        "limits": {"position": False, "velocity": False},
        "solver": {"regularization_force": WEIGHTS["force"]},
    }
    every = content_of(case.robot, tasks(case.waist, SHIFT_WEIGHTS), sections)
    content = content_of(case.robot, tasks(case.waist), sections, feet=case.feet)
    if case.every_joint:
        robot = every_joint(every["robot"], folder)
        every["robot"], content["robot"] = robot, robot
    settings = parse_settings(content, case.name)
    model = make_model(settings)
    q = _standing(parse_settings(every, case.name), model, case)
    once = round(BEGINNING / PERIOD) if case.falls else count
    once_through = swaying(Cycle(settings, model), q, case.sway, once)
    rows = np.resize(once_through, (count, once_through.shape[1]))
    return Scene(case, content, settings, model, q, rows)


def make_service(robot: str, count: int) -> tuple[dict[str, Any], Array]:
    """Return the scene of a supplied robot, and swaying states, (n, nq + nv + 9)."""
    settings = load_settings(find_configuration(robot))
    cycle = Cycle(settings, make_model(settings))
    model = cycle.controller.model
    q = stance(model, cycle.controller, list(cycle.controller.contacts))
    content = {"robot": robot, "nq": model.nq, "nv": model.nv, "q": q.tolist()}
    return content, swaying(cycle, q, SERVICE_SWAY, count, 1.0 / settings.control.rate)


def message(
    content: Mapping[str, Any],
    settings: Settings,
    model: RobotModel,
    q: Array,
    weights: Mapping[str, float],
    waist: str,
) -> dict[str, Any]:
    """Return the scene for a worker as plain values."""
    pinocchio = model.pinocchio
    contacts = [
        contact.model_dump() | {"name": name, "frame": f"contact_{name}", "type": contact.type, "link": contact.frame}
        for name, contact in settings.contacts.items()
    ]
    return {
        "settings": dict(content),
        "urdf": _plain_urdf(model, contacts),
        "joints": list(pinocchio.names)[2:],
        "nq": model.nq,
        "nv": model.nv,
        "armature": np.array(pinocchio.armature).tolist(),
        "q": q.tolist(),
        "effort_limits": np.array(pinocchio.upperEffortLimit)[6:].tolist(),
        "weights": dict(weights),
        "stiffness": STIFFNESS,
        "damping": DAMPING,
        "waist": waist,
        "contacts": contacts,
    }


def _plain_urdf(model: RobotModel, contacts: list[dict[str, Any]]) -> str:
    """Return the URDF without shapes, with locked joints fixed, and a link at the origin of each contact."""
    root = ET.fromstring(model.urdf)  # noqa: S314 - URDF of a supplied robot
    moving = set(model.pinocchio.names)
    for link in root.findall("link"):
        for shape in link.findall("visual") + link.findall("collision"):
            link.remove(shape)
    for joint in root.findall("joint"):
        if joint.get("name") not in moving:
            joint.set("type", "fixed")
        for coupling in joint.findall("mimic"):
            joint.remove(coupling)
    for contact in contacts:
        ET.SubElement(root, "link", name=contact["frame"])
        joint = ET.SubElement(root, "joint", name=f"{contact['frame']}_mount", type="fixed")
        ET.SubElement(joint, "parent", link=contact["link"])
        ET.SubElement(joint, "child", link=contact["frame"])
        xyz, rpy = contact["translation"], contact.get("rpy", (0.0, 0.0, 0.0))
        ET.SubElement(joint, "origin", xyz=" ".join(map(str, xyz)), rpy=" ".join(map(str, rpy)))
    return ET.tostring(root, encoding="unicode")


def every_joint(robot: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the robot's section with all joints, at 0 or within their limits."""
    root = ET.fromstring(read_urdf(FULL_TALOS))  # noqa: S314 - URDF of a supplied robot
    for joint in root.findall("joint"):
        for coupling in joint.findall("mimic"):
            joint.remove(coupling)
    path = folder / "every_joint.urdf"
    path.write_text(ET.tostring(root, encoding="unicode"), encoding="utf-8")
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    posture = dict(zip(robot["joints"], robot["posture"], strict=True))
    names = list(model.names)[2:]
    for name in names:
        place = model.joints[model.getJointId(name)].idx_q
        low, high = model.lowerPositionLimit[place] + INSIDE, model.upperPositionLimit[place] - INSIDE
        posture.setdefault(name, float(min(max(0.0, low), high)))
    return {**robot, "urdf": str(path), "joints": names, "posture": [posture[name] for name in names]}


def _standing(settings: Settings, model: RobotModel, case: Case) -> Array:
    """Return a configuration at rest with the centre of mass over the feet of the case."""
    cycle = Cycle(settings, model)
    q = stance(model, cycle.controller, list(cycle.controller.contacts))
    if set(case.feet) == set(cycle.controller.contacts):
        return q
    rest = cycle.start(q)
    com = rest.tasks["com"].position
    contacts = [cycle.controller.contacts[name] for name in case.feet]
    over = np.mean([contact.points(cycle.controller.dynamics).mean(axis=0) for contact in contacts], axis=0)
    shift = np.array([*(over - com)[:2], 0.0])
    v = np.zeros(model.nv)
    for i in range(round((SHIFT + 1.0) / PERIOD)):  # and one second of rest
        s = min(1.0, PERIOD * i / SHIFT)
        smooth = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        rate, curvature = 30.0 * s**2 * (1.0 - s) ** 2, 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
        reference = Reference(
            frozen(com + smooth * shift), frozen(rate / SHIFT * shift), frozen(curvature / SHIFT**2 * shift)
        )
        q, v = _next(cycle, model, q, v, with_com(rest, reference))
    return q


def swaying(cycle: Cycle, q: Array, amplitude: tuple[float, float, float], count: int, period: float = PERIOD) -> Array:
    """Return states along the motion of our answers, without a simulator, and their references."""
    model = cycle.controller.model
    rest = cycle.start(q)
    com = rest.tasks["com"].position
    sway, v, rows = np.array(amplitude), np.zeros(model.nv), []
    for i in range(count):
        rate = 2.0 * math.pi * FREQUENCY
        phase, started = rate * period * i, min(1.0, period * i / BEGINNING)
        reference = Reference(
            frozen(com + started * math.sin(phase) * sway),
            frozen(started * rate * math.cos(phase) * sway),
            frozen(-started * rate**2 * math.sin(phase) * sway),
        )
        rows.append(np.concatenate([q, v, reference.position, reference.velocity, reference.acceleration]))
        q, v = _next(cycle, model, q, v, with_com(rest, reference), period)
    return np.array(rows)


def with_com(references: References, com: Reference) -> References:
    """Return references with another reference of the centre of mass."""
    return dataclasses.replace(references, tasks={**references.tasks, "com": com})


def _next(
    cycle: Cycle, model: RobotModel, q: Array, v: Array, references: References, period: float = PERIOD
) -> tuple[Array, Array]:
    """Return the state after one period, with the accelerations of our answer."""
    v_dot = cycle.controller.solve(cycle.state(q, v), references).v_dot
    return pin.integrate(model.pinocchio, q, period * v + 0.5 * period**2 * v_dot), v + period * v_dot
