"""Scenario of any robot, scaled to its limbs, support and mass."""

import math
from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from scipy.linalg import null_space

from wbc_controller.apps.demo.scenario import Reach, Scenario, shoves, squat, sway
from wbc_controller.controller.build.leg import Leg
from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.check.preflight import floor_contacts, stance, support_margin, unsupported_passive_joints
from wbc_controller.controller.check.reserves import com_distance
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.dynamics import Mobility
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.settings.tasks import FramePoseTask

_SWAY, _LARGEST_SWAY = 0.4, 0.04  # amplitude of the sway: share of the distance to the support's edge, and maximum, m
_SQUAT = 0.12  # depth of the squat: share of the height of the centre of mass
#: Impulse of a push: share of m ω d, which moves the capture point to the support's edge; and maximum speed change,
#: m/s.
_SHOVE, _LARGEST_SHOVE = 0.5, 0.35
_REACH = 0.1  # forward and upward motion of a hand: share of the height of the centre of mass
#: Arms: motion of the hand as a share of its distance from the base, its maximum, m, and the speed of a push, m/s.
_ARM_REACH, _LONGEST_ARM_REACH, _ARM_SHOVE = 0.15, 0.1, 0.3
#: Safe share of the feasible motion of the centre of mass, and smallest executed motion, m.
_SAFE, _SMALLEST_MOTION = 0.8, 0.005
_STEPS = 10  # of a motion
_MAX_EFFORT = 0.8  # of an effort limit, for gravity


def derived_scenario(settings: Settings, model: RobotModel) -> Scenario:
    """Return a scenario for a legged robot, or for arms on a fixed base.

    Legs: sway and squat within `com_distance`, a reach with the first hand of a disabled task, and pushes by a share of
    m ω d, the impulse that moves the capture point to the support's edge: ω² = g/h, height h of the centre of mass,
    distance d from the edge. Arms: a reach with each such hand in its easiest direction, and pushes.
    Infeasible motions are omitted.

    Raises `ConfigurationError` without a centre of mass task or a support; on a fixed base without a posture task.
    """
    hands = {
        name: task for name, task in settings.tasks.items() if isinstance(task, FramePoseTask) and not task.enabled
    }
    if not model.floating_base:
        return _arm_scenario(settings, model, hands)
    tasks = [name for name, task in settings.tasks.items() if task.type == "com" and task.enabled]
    if not tasks:
        raise ConfigurationError(
            "the demo requires an enabled task of type com; for other robots use wbc mock, wbc run and wbc send "
            "(docs/bring-up.md)"
        )
    qp = make_qp(settings, model)
    enabled = [name for name, contact in settings.contacts.items() if contact.enabled]
    q = stance(model, qp, enabled)
    com = qp.dynamics.com
    height = float(com[2])
    corners = np.vstack([np.zeros((0, 3)), *floor_contacts(qp, enabled, np.eye(3)[2]).values()])
    margin = support_margin(corners[:, :2], com[:2]) if len(corners) else 0.0  # distance to the support's edge, m
    if not (margin > 0.0):
        raise ConfigurationError(
            "the demo requires a standing robot; in robot.posture the centre of mass is outside the support polygon of "
            "the contacts on the floor: correct robot.posture or the contacts"
        )
    impulse = model.mass * min(_SHOVE * math.sqrt(model.gravity / height) * margin, _LARGEST_SHOVE)
    impulse = float(f"{impulse:.2g}")
    hanging = unsupported_passive_joints(qp, enabled)

    def safe_distance(direction: Array, most: float) -> float:
        found = com_distance(qp, enabled, q, hanging, direction, most / _SAFE, settings.limits.margin)
        return most if found is None else _SAFE * found.most

    motion = np.array([_REACH, 0.0, _REACH]) * height
    side, down = np.eye(3)[1], -np.eye(3)[2]
    amplitude = min(safe_distance(sign * side, min(_SWAY * margin, _LARGEST_SWAY)) for sign in (1.0, -1.0))
    sizes = ((sway, amplitude, 0.005), (squat, safe_distance(down, _SQUAT * height), 0.008))
    moves = tuple(move(size, target) for move, size, target in sizes if size > _SMALLEST_MOTION)
    reaches = (_reach(settings, model, name, hand, motion) for name, hand in list(hands.items())[:1])
    return Scenario(com=tasks[0], moves=moves, reaches=tuple(filter(None, reaches)), shoves=shoves(impulse, impulse))


def _arm_scenario(settings: Settings, model: RobotModel, hands: Mapping[str, FramePoseTask]) -> Scenario:
    if not any(task.type == "posture" and task.enabled for task in settings.tasks.values()):
        raise ConfigurationError(
            "the demo of a fixed base requires an enabled posture task; for other robots use wbc mock, wbc run and "
            "wbc send (docs/bring-up.md)"
        )
    shoved = next((hand.frame for hand in hands.values()), str(model.pinocchio.names[-1]))
    reaches = (_reach(settings, model, name, hand) for name, hand in hands.items())
    along, sideways, _ = (float(f"{impulse:.2g}") for impulse in _arm_impulses(model, shoved))
    return Scenario(com="", reaches=tuple(filter(None, reaches)), shoves=shoves(sideways, along, shoved))


def _arm_impulses(model: RobotModel, frame: str) -> Array:
    """Return the impulses of pushes at a frame along x, y and z, (3,) in N·s.

    Each moves the frame at 0.3 m/s; less if the joints cannot stop within their ranges: τ d ≥ ½ m v² with the free
    torque τ of the motors, the distance d to the nearest limit and the inertia m.
    """
    q, data = model.configuration(model.posture), model.pinocchio.createData()
    pin.framesForwardKinematics(model.pinocchio, data, q)
    pin.computeJointJacobians(model.pinocchio, data, q)
    number = model.frame_id(frame, "frame")
    J = pin.getFrameJacobian(model.pinocchio, data, number, pin.LOCAL_WORLD_ALIGNED).reshape(6, model.nv)[:3]
    mobility = Mobility(model)(q)
    speeds = mobility @ J.T  # per N·s
    joints, drive = model.v_index, model.actuation
    weight = drive.torques(pin.computeGeneralizedGravity(model.pinocchio, data, q))
    free = np.abs(drive.ratios).T @ np.maximum(model.effort_limits - np.abs(weight), 0.0)
    posture = np.array(model.posture)
    distance = np.minimum(posture - model.position_lower, model.position_upper - posture)
    inertia = np.diag(np.linalg.inv(mobility[np.ix_(joints, joints)]))  # of each joint while the others are still
    driven = np.abs(drive.ratios).any(axis=0)
    slowest = np.finfo(float).tiny
    fastest = np.maximum(np.sqrt(2.0 * free * np.maximum(distance, 0.0) / inertia), slowest)[driven]
    shares = np.max(np.abs(speeds[joints][driven]) / fastest[:, None], axis=0)
    whole = _ARM_SHOVE / np.maximum(np.diag(J @ speeds), 1.0 / model.mass)
    return np.asarray(np.minimum(whole, 1.0 / np.maximum(shares, slowest)))


def _reach(
    settings: Settings, model: RobotModel, name: str, task: FramePoseTask, motion: Array | None = None
) -> Reach | None:
    """Return the feasible reach of a hand, at most `motion`; by default in its easiest direction."""
    pose = pin.SE3.Identity() if any(task.mask[3:]) else None
    arm = Leg(model, model.frame_id(task.frame, "frame"), (), settings.limits.margin, pose)
    if motion is None:
        length = min(_ARM_REACH * float(np.linalg.norm(arm.place)), _LONGEST_ARM_REACH)
        way = length * _easiest_direction(arm, model)
        motions = sorted((way, -way), key=lambda one: float(one @ arm.place))
    else:
        motions = [motion]
    feasible = [_feasible_part(arm, model, one) for one in motions]
    offset = max(feasible, key=lambda one: round(float(np.linalg.norm(one)), 3))
    if not (np.linalg.norm(offset) > _SMALLEST_MOTION):
        return None
    x, y, z = offset.tolist()
    return Reach(name, (x, y, z), 2.0 + task.setpoint_duration, 0.01)


def _easiest_direction(arm: Leg, model: RobotModel) -> Array:
    """Return the unit vector of the largest hand motion per joint motion, (3,), at a constant orientation if held."""
    _, J = arm.kinematics(np.array(model.posture))
    ways = J if len(J) == 3 else J[:3] @ null_space(J[3:])
    return np.asarray(np.linalg.eigh(ways @ ways.T)[1][:, 2])


def _feasible_part(arm: Leg, model: RobotModel, motion: Array) -> Array:
    posture, reached = np.array(model.posture), 0.0
    most = max(_MAX_EFFORT, _effort(model, posture))
    for step in range(1, _STEPS + 1):
        posture, reason = arm.posture(np.append(step / _STEPS * motion, 0.0), posture)
        if reason or not (_effort(model, posture) <= most):
            break
        reached = step / _STEPS
    return reached * motion


def _effort(model: RobotModel, posture: Array) -> float:
    gravity = pin.computeGeneralizedGravity(model.pinocchio, model.pinocchio.createData(), model.configuration(posture))
    return float(np.max(np.abs(model.actuation.torques(gravity)) / model.effort_limits))
