"""Robot model from its URDF."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from types import MappingProxyType
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.inverse_dynamics.robot.actuation import Actuation
from wbc_controller.inverse_dynamics.robot.bare_mechanism import bare_mechanism
from wbc_controller.inverse_dynamics.robot.mimic import Followers, Mimic, read_mimics
from wbc_controller.inverse_dynamics.robot.model import PassiveForces, RobotModel
from wbc_controller.inverse_dynamics.robot.transmission import make_drive
from wbc_controller.inverse_dynamics.robot.urdf import read_robot
from wbc_controller.inverse_dynamics.robot.virtual_base import drop_virtual_joints, virtual_joints
from wbc_controller.records import Array, frozen
from wbc_controller.settings.robot import RobotSettings

_LEAST_MASS = 1.0e-6  # of a robot, kg; divisions by smaller masses overflow
_FREE_FLYER = "<floating base>"  # impossible in a URDF


def build_model(urdf: str, robot: RobotSettings) -> RobotModel:
    """Build the model of a robot from its URDF.

    Mimic joints follow their leader if it is in `robot.joints`; all other joints outside `robot.joints` are locked.
    Virtual joints of a floating base are removed. An invalid URDF or joint raises `ConfigurationError`.
    """
    joints, passive_joints, floating_base = robot.joints, robot.passive_joints, robot.base == "floating"
    tree, urdf = read_robot(urdf, robot.joint_limits)
    _refuse_virtual_motors(tree, joints)
    if floating_base and drop_virtual_joints(tree):
        urdf = ElementTree.tostring(tree, encoding="unicode")
    full = read_mechanism(tree, floating_base=floating_base)
    mimics = read_mimics(tree)
    _check_names(full, robot, mimics)
    following = {name: mimic for name, mimic in mimics.items() if mimic.leader in joints}
    for name in following:
        _require_one_coordinate(full, name, f"robot.urdf: {name!r}, which mimics {following[name].leader!r},")
    locked = dict(robot.locked_joints)
    for name, mimic in mimics.items():
        if name not in following and full.joints[full.getJointId(name)].nq == 1:
            locked[name] = mimic.ratio * locked.get(mimic.leader, 0.0) + mimic.offset
    locked = {name: position for name, position in locked.items() if position != 0.0}
    model = read_mechanism(tree, {*joints, *following}, locked, floating_base=floating_base)
    mass = pin.computeTotalMass(model)
    if not (mass >= _LEAST_MASS):
        raise ConfigurationError(
            f"robot.urdf: the mass of the moving links is {mass:g} kg; the minimum is {_LEAST_MASS:g} kg"
        )
    q_index, v_index = _indices_of(joints, model)
    leaders = _indices_of([mimic.leader for mimic in following.values()], model)
    followers = Followers(following, _indices_of(following, model), leaders) if following else None
    drive = make_drive(robot, np.array(model.upperEffortLimit)[v_index])
    coupling = followers.coupling(model.nv) if followers is not None else np.zeros((0, model.nv))
    actuation = Actuation(drive, v_index, coupling)
    own = [name in drive.names and name not in robot.transmission for name in joints]
    model.armature[v_index[own]] = robot.armature
    lower, upper, velocity_limits = _joint_limits(joints, following, model)
    result = RobotModel(
        pinocchio=model,
        urdf=urdf,
        joints=tuple(joints),
        floating_base=floating_base,
        q_index=q_index,
        v_index=v_index,
        velocity_limits=frozen(velocity_limits),
        position_lower=frozen(lower),
        position_upper=frozen(upper),
        posture=frozen(robot.posture),
        actuation=actuation,
        effort_limits=frozen(robot.effort_limit_scale * actuation.effort_limits),
        passive=PassiveForces(passive_joints, *_indices_of(passive_joints, model)) if passive_joints else None,
        followers=followers,
        locked=MappingProxyType(locked),
    )
    for name, value, low, high, unit in zip(
        joints, result.posture, result.position_lower, result.position_upper, result.units, strict=True
    ):
        if not (low <= value <= high):
            raise ConfigurationError(
                f"robot.posture: {value} {unit} for {name!r} is outside its limits [{low}, {high}] {unit}"
            )
    return result


def _indices_of(joints: Iterable[str], model: pin.Model) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of joints in q and in v, (k,) each."""
    ids = [model.getJointId(name) for name in joints]
    q_index, v_index = ([index[i] for i in ids] for index in (model.idx_qs, model.idx_vs))
    return np.array(q_index, dtype=np.intp), np.array(v_index, dtype=np.intp)


def _refuse_virtual_motors(tree: ElementTree.Element, joints: Sequence[str]) -> None:
    listed = [name for name in virtual_joints(tree) if name in joints]
    if listed:
        raise ConfigurationError(
            f"robot.joints: {', '.join(listed)} are virtual joints of a floating base and have no motors; remove them "
            "and set robot.base: floating"
        )


def _check_names(full: pin.Model, robot: RobotSettings, mimics: Mapping[str, Mimic]) -> None:
    joints = robot.joints
    for name in joints:
        _require_own_coordinate(full, name, "robot.joints", mimics)
    require_known(robot.passive_joints, joints, "robot.passive_joints:", " is not one of robot.joints")
    for name, position in robot.locked_joints.items():
        _require_own_coordinate(full, name, "robot.locked_joints", mimics)
        if name in joints:
            raise ConfigurationError(f"robot.locked_joints: {name!r} is also in robot.joints; remove one entry")
        i = full.joints[full.getJointId(name)].idx_q
        low, high = full.lowerPositionLimit[i], full.upperPositionLimit[i]
        if not (low <= position <= high):
            raise ConfigurationError(
                f"robot.locked_joints: {position:g} rad for {name!r} is outside its limits [{low:g}, {high:g}] rad"
            )


def _require_own_coordinate(full: pin.Model, name: str, key: str, mimics: Mapping[str, Mimic]) -> None:
    own = [str(joint) for joint in full.names[1:] if joint != _FREE_FLYER]
    require_known(name, own, f"{key}:", " is not a joint of the URDF")
    if name in mimics:
        raise ConfigurationError(f"{key}: {name!r} mimics {mimics[name].leader!r}; name the leader only")
    _require_one_coordinate(full, name, f"{key}: {name!r}")


def _require_one_coordinate(full: pin.Model, name: str, subject: str) -> None:
    joint = full.joints[full.getJointId(name)]
    if joint.nv != 1 or joint.nq != 1:
        raise ConfigurationError(
            f"{subject} has {joint.nv} degrees of freedom in {joint.nq} coordinates; "
            "expected one revolute or prismatic joint with limits"
        )


def read_mechanism(
    tree: ElementTree.Element,
    moving: Collection[str] | None = None,
    locked: Mapping[str, float] = MappingProxyType({}),
    *,
    floating_base: bool,
) -> pin.Model:
    """Read the mechanism of a URDF with Pinocchio.

    Joints outside `moving` (None for all) are fixed at `locked` positions, 0 by default.
    """
    moving = [str(joint.get("name")) for joint in tree.findall("joint")] if moving is None else moving
    mechanism = ElementTree.tostring(bare_mechanism(tree, moving, locked), encoding="unicode")
    try:
        return pin.buildModelFromXML(mechanism, *([pin.JointModelFreeFlyer(), _FREE_FLYER] if floating_base else []))
    except (ValueError, RuntimeError) as error:
        raise ConfigurationError(f"robot.urdf: not a usable URDF: {error}") from error


def _joint_limits(
    joints: Sequence[str], following: Mapping[str, Mimic], model: pin.Model
) -> tuple[Array, Array, Array]:
    """Return smallest and largest positions, and speeds, (nj,) each, that the mimic joints also permit."""
    q_index, v_index = _indices_of(joints, model)
    lower, upper = np.array(model.lowerPositionLimit)[q_index], np.array(model.upperPositionLimit)[q_index]
    velocity = np.array(model.upperVelocityLimit)[v_index]
    for name, limit in zip(joints, velocity, strict=True):
        if not (0.0 < limit < np.inf):
            raise ConfigurationError(
                f"robot.urdf: joint {name!r} has the velocity limit {limit}; it must be positive, in the URDF or by "
                f"robot.joint_limits.{name}.velocity"
            )
    for name, mimic in following.items():
        if mimic.ratio == 0.0:
            continue
        joint, leader = model.joints[model.getJointId(name)], joints.index(mimic.leader)
        ends = [limits[joint.idx_q] - mimic.offset for limits in (model.lowerPositionLimit, model.upperPositionLimit)]
        low, high = sorted(end / mimic.ratio for end in ends)
        lower[leader], upper[leader] = max(lower[leader], low), min(upper[leader], high)
        velocity[leader] = min(velocity[leader], model.upperVelocityLimit[joint.idx_v] / abs(mimic.ratio))
        if not (lower[leader] <= upper[leader]):
            raise ConfigurationError(
                f"robot.urdf: the limits of joint {mimic.leader!r} and of {name!r}, which mimics it, have no position "
                "in common; correct the limits or the <mimic>"
            )
    return lower, upper, velocity
