"""Contacts, tasks, gains and limits of a draft."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.apps.new.feet import Limb
from wbc_controller.apps.new.foot_shape import Foot, links_of
from wbc_controller.apps.new.notes import Draft
from wbc_controller.controller.build.footprint import simplify_polygon
from wbc_controller.controller.build.gait_limits import WAYS, BipedLimits, QuadrupedLimits
from wbc_controller.controller.build.quadruped_walking import make_quadruped_gait
from wbc_controller.controller.build.walking import find_feet, make_gait
from wbc_controller.controller.check.preflight import longest_ramp
from wbc_controller.inverse_dynamics.contacts.support import are_corners
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.settings.limits import LimitSettings
from wbc_controller.settings.walking import WalkingSettings

#: Stiffness of the centre of mass in units of the squared pendulum frequency g/h, and its range, 1/s².
_COM, _COM_RANGE = 7.0, (60.0, 250.0)
_MAX_LOAD = 3.0  # largest normal force, in weights
_FRICTION = {"surface": 0.7, "point": 0.6, "rolling": 0.6}  # assumed friction of soles, and of small feet and wheels
#: Joint damping in emergencies, as a share of m g h, N·m·s/rad, and its maximum, the value of G1.
_DAMPING, _MOST_DAMPING = 0.009, 2.0
#: Assumed rotor inertia per effort limit, s²: without load 10,000 rad/s²; G1's leg motors reach 5,500 to 8,700 rad/s².
_ARMATURE = 1.0e-4
_MARGIN = 0.05  # share of the smallest range: below the margins of postures
_MAX_SPEED = 8.0  # largest fully used joint speed, rad/s
#: Smallest number of joints of an arm with a hand task on a legged robot (heads have fewer) and a fixed base.
_ARM_JOINTS, _FIXED_ARM_JOINTS = 4, 3
_POSE_JOINTS = 6
#: Weight of an arm's posture: largest, m², and per squared lever of a hand (stationary error 2 %).
_POSTURE, _POSTURE_PER_AREA = 0.1, 0.2
_IMMOBILE = 1.0e-2  # largest singular value of an immobile direction, m or 1
_SLOWEST = 0.05  # least feasible speed of a robot that walks, m/s
_ROUNDING_ANGLE = 0.005  # rounding of a mesh, rad


def put_contacts(model: RobotModel, feet: Sequence[Foot], draft: Draft) -> None:
    """Write the contacts."""
    frames, weight = model.pinocchio.frames, model.mass * model.gravity
    force = float(f"{_MAX_LOAD * weight:.2g}")
    for number, foot in enumerate(feet):
        frame = frames[model.frame_id(foot.link, "contacts")]
        placement = frame.placement.actInv(foot.placement)
        key = f"contacts.{draft.free_name('contacts', foot.link)}"
        contact: dict[str, Any] = {"type": foot.kind, "frame": foot.link}
        translation = _rounded(placement.translation)
        if any(translation):
            contact["translation"] = translation
        if foot.kind == "surface":
            rpy = pin.rpy.matrixToRpy(placement.rotation)
            rpy = np.where(np.abs(rpy) < _ROUNDING_ANGLE, 0.0, rpy)
            if np.any(rpy):
                contact["rpy"] = _rounded(rpy)
            if foot.rectangle:
                half = np.abs(foot.corners).max(axis=0)
                contact |= {"half_length": _round_down(half[0]), "half_width": _round_down(half[1])}
            else:
                contact["vertices"] = [_rounded(corner) for corner in _rounded_polygon(foot.corners)]
        else:
            contact["radius"] = round(foot.radius, 4)
            if foot.kind == "rolling":
                contact["axis"] = _rounded(frame.placement.rotation.T @ foot.axis)
        contact |= {"friction": _FRICTION[foot.kind], "max_normal_force": force}
        draft.put(key, contact)
        if foot.measured_on:
            draft.note(key, f"Measured on {foot.measured_on}.", "found")
        else:
            draft.note(f"{key}.radius", f"radius of the foot, and its position on {foot.link!r} as `translation`: the "
                       "URDF has no measurable shape there.", "missing")  # fmt: skip
        if number == 0:
            draft.note("contacts", f"Friction of a dry floor; a largest force of {_MAX_LOAD:g} weights of the robot: "
                       "a URDF does not contain the limits of your floor and feet.", "guess")  # fmt: skip


def put_standing_tasks(
    model: RobotModel, arms: Sequence[Limb], feet: Sequence[Foot], height: float, draft: Draft
) -> None:
    """Write the tasks of a legged robot; `height` of the centre of mass above its feet, m."""
    stiffness = float(np.clip(float(f"{_COM * model.gravity / height:.2g}"), *_COM_RANGE))
    draft.note("tasks", "Weights of the supplied robots; stiffnesses scaled to a centre of mass "
               f"{height:.2f} m above the feet.", "guess")  # fmt: skip
    flat = any(foot.kind == "surface" for foot in feet)
    draft.put("tasks.com", {"type": "com", "weight": 50.0, "stiffness": stiffness})
    turn = {"type": "frame_orientation", "frame": model.base_link, "weight": 2.0 if flat else 5.0}
    draft.put("tasks.base", turn | {"stiffness": 1.0 * stiffness if flat else 1.5 * stiffness})
    trunk = _trunk(model, arms, feet)
    if trunk:
        draft.put("tasks.torso", {"type": "frame_orientation", "frame": trunk, "weight": 1.0, "stiffness": stiffness})
    _put_hands(model, arms, {foot.joint for foot in feet}, stiffness, _ARM_JOINTS, draft)
    heavy = 0.01 if model.mass > 60.0 else 0.002
    draft.put("tasks.posture", {"type": "posture", "weight": heavy, "stiffness": 0.5 * stiffness})


def put_arm_tasks(model: RobotModel, arms: Sequence[Limb], posture: Array, draft: Draft) -> None:
    """Write the tasks of a robot on a fixed base; `posture`: (nj,) in rad."""
    draft.note("tasks", "Weights and stiffnesses of the arm in examples/fixed_arm.py; the weight of the posture in "
               "proportion to the squared length of a shorter arm.", "guess")  # fmt: skip
    hands = _put_hands(model, arms, set(), 100.0, _FIXED_ARM_JOINTS, draft)
    shortest = min((_lever(model, hand, posture) for hand in hands), default=math.inf)
    weight = min(_POSTURE, _POSTURE_PER_AREA * shortest**2)
    draft.put("tasks.posture", {"type": "posture", "weight": float(f"{weight:.1g}"), "stiffness": 50.0})
    draft.put("safety.activation_ramp", 0.0, "Nothing else supports the arm.", "guess")


def _lever(model: RobotModel, link: str, posture: Array) -> float:
    q, frame, data = model.configuration(posture), model.frame_id(link, "tasks"), model.pinocchio.createData()
    J = pin.computeFrameJacobian(model.pinocchio, data, q, frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, model.nv)
    return float(np.linalg.norm(J[:3, model.v_index], 2))


def _put_hands(
    model: RobotModel, arms: Sequence[Limb], feet: set[int], stiffness: float, min_joints: int, draft: Draft
) -> list[str]:
    own, hands = set(model.v_index.tolist()), []
    for arm in arms:
        joints = [joint for joint in arm.joints if model.pinocchio.joints[joint].idx_v in own]  # without mimic joints
        if arm.end not in feet and len(joints) >= min_joints:
            link = str(links_of(model, arm.end)[0].name)
            task = {"type": "frame_pose", "frame": link, "weight": 5.0, "stiffness": stiffness, "enabled": False}
            text = "End of an arm: enable this task for a reach."
            if len(joints) < _POSE_JOINTS:
                task["mask"] = [True, True, True, False, False, False]
                text += f" {len(joints)} joints can control its position, but not its orientation."
            draft.put(f"tasks.{draft.free_name('tasks', link)}", task, text)
            hands.append(link)
    return hands


def _trunk(model: RobotModel, arms: Sequence[Limb], feet: Sequence[Foot]) -> str:
    ends = [arm.end for arm in arms if arm.end not in {foot.joint for foot in feet}]
    if len(ends) < 2:
        return ""
    joint = max(set.intersection(*(set(model.pinocchio.supports[end]) for end in ends)))
    return str(links_of(model, joint)[0].name) if joint > 1 else ""


def put_armature(model: RobotModel, legs: Sequence[Limb], draft: Draft) -> None:
    """Write a rotor inertia from the effort limits of the legs' joints; without one, light feet in the air spin."""
    columns = [model.pinocchio.joints[joint].idx_v for leg in legs for joint in leg.joints]
    weakest = min((_ARMATURE * effort for effort in model.effort_limits[np.isin(model.v_index, columns)]), default=0.0)
    armature = float(f"{weakest:.2g}")
    origin = f" {armature:g} corresponds to the effort limit of the weakest joint of the legs." if armature else ""
    draft.put("robot.armature", armature, "rotor inertia at the joints, N² times the inertia of the rotor with gear "
              f"ratio N, from the data sheet; a URDF has no such value.{origin}", "missing")  # fmt: skip


def put_limits(model: RobotModel, draft: Draft) -> None:
    """Write the limits of joint speeds and positions."""
    ranges = model.position_upper - model.position_lower
    smallest = int(np.argmin(ranges))
    margin = float(f"{_MARGIN * ranges[smallest]:.1g}")
    if 0.0 < margin < LimitSettings().position_margin:
        draft.put("limits.position_margin", margin, f"In proportion to the smallest range, {model.joints[smallest]}: "
                  f"{ranges[smallest]:.3g} {model.units[smallest]}.", "guess")  # fmt: skip
    fastest = float(model.velocity_limits.max())
    if fastest > _MAX_SPEED:
        share = float(np.clip(round(_MAX_SPEED / fastest, 2), 0.15, 1.0))
        draft.put("limits.velocity_scale", share, f"{fastest:g} rad/s in the URDF may be a motor speed: limbs at such "
                  "speeds cannot stop before their limits.", "guess")  # fmt: skip


def put_walking(settings: Settings, qp: WholeBodyQP, draft: Draft) -> None:
    """Write the section of walking for two soles or four points, or a note why the robot cannot walk."""
    kinds = [contact["type"] for contact in draft.values["contacts"].values()]
    if kinds not in (["surface"] * 2, ["point"] * 4):
        return
    values: dict[str, str] = {"gait": "trot"}  # ROS 2 refuses an empty section
    hindrance = "the joints of a leg cannot move its foot in all directions"
    if _feet_move_freely(qp) and len(kinds) == 4:
        hindrance = _hindrance_of_walking(make_quadruped_gait(settings, WalkingSettings(), qp))
    elif _feet_move_freely(qp):
        left, right = find_feet(settings, qp.model)
        values = {"left": left.contact, "right": right.contact}
        hindrance = _hindrance_of_walking(make_gait(settings, left, right, qp))
    if hindrance:
        draft.note("walking", f"Not written: {hindrance}.", "guess")
        return
    draft.put("walking", values, "All values follow from the robot; `wbc check` prints the feasible speeds.", "guess")


def _hindrance_of_walking(limits: BipedLimits | QuadrupedLimits) -> str:
    if isinstance(limits, BipedLimits):
        load = max(limits.single_support().values(), key=lambda load: load.share)
        if load.share > 1.0:
            return f"one leg cannot bear the robot ({load.text})"
    forward = limits.feasible(WAYS[0], _SLOWEST)
    return f"{_SLOWEST:g} m/s forward is not feasible ({forward.quantity})" if forward.speed < _SLOWEST else ""


def put_activation_ramp(settings: Settings, qp: WholeBodyQP, draft: Draft) -> None:
    """Shorten the ramp of the torques if joints without support could not stop falling afterwards."""
    ramp = longest_ramp(settings, qp)[0]
    if ramp < settings.safety.activation_ramp:
        draft.put("safety.activation_ramp", ramp, "Joints without support fall meanwhile.", "guess")


def _feet_move_freely(qp: WholeBodyQP) -> bool:
    """Return whether each leg's own joints move its contact in all directions, in the nominal posture."""
    qp.dynamics.update(qp.model.configuration(qp.model.posture), np.zeros(qp.model.nv))
    jacobians = [contact.jacobian(qp.dynamics)[:, qp.model.v_index] for contact in qp.contacts.values()]
    moving = sum(J.any(axis=0).astype(int) for J in jacobians)
    ranks = [np.linalg.matrix_rank(J[:, moving == 1], tol=_IMMOBILE) for J in jacobians]
    return all(rank == len(J) for rank, J in zip(ranks, jacobians, strict=True))


def put_damping(model: RobotModel, height: float, draft: Draft) -> None:
    """Write the damping of a robot smaller than G1; `height` of the centre of mass, m."""
    damping = float(f"{_DAMPING * model.mass * model.gravity * height:.1g}")
    if damping < _MOST_DAMPING:
        draft.put("safety.damping", damping, "In proportion to mass and size; G1 has 2 N·m·s/rad.", "guess")
        draft.put("guard.damping", damping)
        draft.put("mock.damping", damping)


def _rounded_polygon(corners: Array) -> Array:
    corners = np.round(corners, 4)
    while len(corners) > 3 and not all(are_corners(corners)):
        corners = simplify_polygon(corners, len(corners) - 1)
    return corners


def _rounded(values: Array) -> list[float]:
    return [float(value) for value in np.round(values, 4) + 0.0]


def _round_down(value: float) -> float:
    return float(np.floor(value * 1.0e4 + 1.0e-6) / 1.0e4)
