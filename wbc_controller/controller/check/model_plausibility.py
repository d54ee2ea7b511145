"""Plausibility of the model."""

from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.robot_description import are_possible_moments, inertia_tensor
from wbc_controller.controller.check import Finding
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.urdf import UNLIMITED
from wbc_controller.inverse_dynamics.robot.urdf_structure import mass_of, vector_of
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.settings.contacts import FixedContact

_SMALLEST = 1.0e-15  # smallest mass, kg, and principal moment of inertia, kg·m², of a moving body
_ONE_PLACE = 1.0e-3  # largest distance between coincident joints, m
_NOTICED_MASS = 0.05  # reported mass of a link without inertia, kg
_LARGEST_LINK = 20.0  # largest plausible distance between joints, m
_STRONGEST = 10.0  # largest plausible effort limit, in weight times size; strong motors reach 1
_FASTEST = 300.0  # largest plausible velocity limit, rad/s or m/s; fast joints reach 40
_SLIPPERY = 0.1  # smallest plausible friction: wet ice
_REMEDY = "set the limits of the motors in robot.joint_limits"


@dataclass(frozen=True, slots=True)
class _Link:
    name: str
    mass: float
    moments: Array  # (3,) in kg·m², rising

    @property
    def smallest_moment(self) -> float:
        """Smallest moment in the simulator, kg·m²."""
        return float(self.moments[0] if are_possible_moments(self.moments) else self.moments.mean())


def _links(urdf: str) -> Iterator[_Link]:
    for link in ElementTree.fromstring(urdf).findall("link"):  # noqa: S314 - checked
        inertia = link.find("inertial/inertia")
        tensor = np.zeros((3, 3)) if inertia is None else inertia_tensor(inertia)
        moments = np.asarray(np.linalg.eigvalsh(tensor), dtype=np.float64)
        yield _Link(str(link.get("name")), mass_of(link), moments)


def require_inertia(model: RobotModel) -> None:
    """Raise `ConfigurationError` for bodies without mass or inertia, except `massless_links`, and distant joints."""
    links = {link.name: link for link in _links(model.urdf)}
    bodies: dict[int, list[_Link]] = {joint: [] for joint in range(1, model.pinocchio.njoints)}
    for frame in model.pinocchio.frames:
        if frame.type == pin.BODY and frame.parentJoint in bodies and frame.name in links:
            bodies[frame.parentJoint].append(links[frame.name])
    bare = massless_links(model)
    for joint, own in bodies.items():
        if not own or own[0].name in bare:
            continue
        if not any(link.mass >= _SMALLEST and link.smallest_moment >= _SMALLEST for link in own):
            heaviest, moved_by = max(own, key=lambda link: link.mass), f"joint {model.pinocchio.names[joint]!r}"
            if model.floating_base and joint == 1:
                moved_by = "the floating base"
            raise ConfigurationError(
                f"robot.urdf: link {heaviest.name!r}, moved by {moved_by}, has {heaviest.mass:g} kg "
                f"and moments of inertia {np.array2string(heaviest.moments, precision=3)} kg·m²; a moving body "
                "requires a mass and three positive moments"
            )
    for joint, placement in enumerate(model.pinocchio.jointPlacements):
        distance = float(np.linalg.norm(placement.translation))
        if not (distance <= _LARGEST_LINK):
            name, allowed = model.pinocchio.names[joint], f"allowed {_LARGEST_LINK:g} m"
            text = f"is {distance:.4g} m from its parent joint ({allowed}); lengths in URDFs are in metres"
            raise ConfigurationError(f"robot.urdf: joint {name!r} {text}")


def massless_links(model: RobotModel) -> list[str]:
    """Return massless links between two coincident joints, as in planar bases and ball joints."""
    pinocchio, names = model.pinocchio, []
    for joint in range(1, pinocchio.njoints):
        carried = [child for child in range(joint + 1, pinocchio.njoints) if pinocchio.parents[child] == joint]
        if pinocchio.inertias[joint].mass == 0.0 and len(carried) == 1:
            apart = float(np.linalg.norm(pinocchio.jointPlacements[carried[0]].translation))
            if apart <= _ONE_PLACE:
                frames = (frame for frame in pinocchio.frames if frame.parentJoint == joint)
                names.append(next(str(frame.name) for frame in frames if frame.type == pin.BODY))
    return names


def inertias(model: RobotModel) -> list[Finding]:
    """Report links with impossible inertia, and links with a mass but no inertia."""
    links = list(_links(model.urdf))
    impossible = [link.name for link in links if not are_possible_moments(link.moments)]  # MuJoCo refuses them
    parts = [f"impossible: {', '.join(impossible)}"] if impossible else []
    bare = [link for link in links if link.mass >= _NOTICED_MASS and not link.moments.any()]
    points = [f"{link.name} ({link.mass:g} kg)" for link in bare]
    parts += [f"zero, treated as point mass: {', '.join(points)}"] if points else []
    return [Finding("inertias", "; ".join(parts))] if parts else []


def require_friction(settings: Settings) -> None:
    """Raise `ConfigurationError` for contacts with less friction than wet ice."""
    for name, contact in settings.contacts.items():
        if not isinstance(contact, FixedContact) and not (contact.friction >= _SLIPPERY):
            valid = f"must be at least {_SLIPPERY:g} (wet ice); rubber on a floor has 0.5 to 1"
            raise ConfigurationError(f"contacts.{name}.friction = {contact.friction:g}: {valid}")


def limits(settings: Settings, model: RobotModel, placements: Array) -> list[Finding]:
    """Report implausible, configured and missing limits; `placements` are positions of all frames, (n, 3) in m."""
    reach = model.mass * model.gravity * float(np.linalg.norm(np.ptp(placements, axis=0)))
    strong = [
        f"{name} {limit:g} N·m"
        for name, limit in zip(model.actuators, model.effort_limits, strict=True)
        if not (limit <= _STRONGEST * reach)
    ]
    fast = [
        f"{name} {limit:g} {unit}/s"
        for name, limit, unit in zip(model.joints, model.velocity_limits, model.units, strict=True)
        if not (limit <= _FASTEST)
    ]
    endless = [name for name, upper in zip(model.joints, model.position_upper, strict=True) if upper >= UNLIMITED]
    own = [
        f"{name} " + ", ".join(f"{key} {value:g}" for key, value in given.model_dump(exclude_none=True).items())
        for name, given in settings.robot.joint_limits.items()
    ]
    scale = f"weight times size of the robot is {reach:.3g} N·m"
    rows = [
        (strong, "implausible", f"effort limits of {_first_names(strong)}: {scale}; {_REMEDY}"),
        (fast, "implausible", f"velocity limits of {_first_names(fast)}: {_REMEDY}"),
        (endless, "no position limits", _first_names(endless)),
        (own, "joint limits", f"of the configuration: {'; '.join(own)}"),
    ]
    return [Finding(subject, text) for names, subject, text in rows if names]


def motors_without_effort(settings: Settings, urdf: str) -> list[Finding]:
    """Report motor joints with zero effort, as for springs, if others have an effort."""
    robot, joints = settings.robot, ElementTree.fromstring(urdf).findall("joint")  # noqa: S314 - checked
    efforts = {str(joint.get("name")): vector_of(joint.find("limit"), "effort", "0")[0] for joint in joints}
    driven = [name for name in robot.joints if name not in robot.passive_joints]
    idle = [name for name in driven if efforts.get(name) == 0.0]
    if not idle or (len(idle) == len(driven) and not robot.passive_joints):
        return []
    text = "effort 0 in the URDF, limit from robot.joint_limits; move joints without a motor to robot.passive_joints"
    return [Finding("no motor?", f"{_first_names(idle)}: {text}")]


def _first_names(names: list[str]) -> str:
    shown = ", ".join(names[:4])
    return shown if len(names) <= 4 else f"{shown} and {len(names) - 4} more"


def locked_joints(model: RobotModel) -> list[Finding]:
    """Report locked joints with their positions; a floating joint at the root of a floating base is not reported."""
    texts, zero = [], False
    for joint in ElementTree.fromstring(model.urdf).findall("joint"):  # noqa: S314 - checked
        name, parent = str(joint.get("name")), joint.find("parent")
        if joint.get("type") == "fixed" or name in model.moving_joints:
            continue
        if joint.get("type") == "floating":
            if not (model.floating_base and parent is not None and parent.get("link") == model.base_link):
                texts.append(f"{name} (floating in the URDF; only the root link can float)")
        elif name in model.locked:
            texts.append(f"{name} at {model.locked[name]:g}")
        else:
            texts.append(name)
            zero = True
    ending = " (at 0 by default)" if zero else ""
    return [Finding("locked joints", ", ".join(texts) + ending)] if texts else []
