"""Construction of the walker and its tasks."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin

from wbc_controller.controller.build.estimation import torque_filter
from wbc_controller.controller.build.gait_limits import BipedLeg, BipedLimits, feasible_defaults
from wbc_controller.controller.build.leg import Leg
from wbc_controller.controller.build.quadruped_walking import is_quadruped, make_quadruped_tasks, make_quadruped_walker
from wbc_controller.controller.build.walking_tasks import COM, HEIGHT, POSTURE, make_disabled, make_task_sets, value_or
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts.mount import placement_of
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics, support_matrix
from wbc_controller.inverse_dynamics.robot.instruction import placement_numbers, placement_on_link
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.orientation import about_z
from wbc_controller.inverse_dynamics.tasks import ComTask, FramePoseTask, PostureTask, Task
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.settings import Settings
from wbc_controller.settings.contacts import SurfaceContact
from wbc_controller.settings.walking import WalkingSettings
from wbc_controller.walking.biped import BipedWalker
from wbc_controller.walking.feet import Foot, swing_reaction
from wbc_controller.walking.gait import Gait
from wbc_controller.walking.walker import Walker

LEFT, RIGHT = "walking_left_foot", "walking_right_foot"  # names of the tasks on the feet
_HIGHEST_LIFT = 0.25  # highest lift of a sole in the search, as a share of the height of the centre of mass


def make_walking_tasks(settings: Settings, model: RobotModel) -> list[Task]:
    """Build the tasks of the walker, which are off without a gait; none without the section `walking`.

    `ConfigurationError` if the feet are not two surface contacts, or a task has the name of one of these.
    """
    if settings.walking is None:
        return []
    if is_quadruped(settings, settings.walking):
        return make_quadruped_tasks(settings, model)
    left, right = find_feet(settings, model)
    tasks: dict[str, tuple[float, Task]] = {
        # With a weight of 35, the centre of pressure is twice as far from its reference.
        COM: (350.0, ComTask(COM, [True, True, False], stiffness=0.0, damping=0.0)),
        HEIGHT: (100.0, ComTask(HEIGHT, [False, False, True], stiffness=100.0, damping=20.0)),
        POSTURE: (0.05, PostureTask(POSTURE, model, _without_legs(model, left, right), stiffness=50.0)),
        LEFT: (20.0, FramePoseTask(LEFT, model, settings.contacts[left.contact].frame, stiffness=400.0)),
        RIGHT: (20.0, FramePoseTask(RIGHT, model, settings.contacts[right.contact].frame, stiffness=400.0)),
    }
    return make_disabled(tasks, settings)


def make_walker(settings: Settings, qp: WholeBodyQP) -> Walker | None:
    """Build the walker with the tasks of `make_walking_tasks`, in the nominal posture; None without `walking`."""
    if settings.walking is None:
        return None
    if is_quadruped(settings, settings.walking):
        return make_quadruped_walker(settings, settings.walking, qp)
    left, right = find_feet(settings, qp.model)
    gait, tasks = make_gait(settings, left, right, qp).gait, make_task_sets(settings, qp, (LEFT, RIGHT))
    return BipedWalker(gait, left, right, tasks, qp.model.gravity, torque_filter(settings))


def find_feet(settings: Settings, model: RobotModel) -> tuple[Foot, Foot]:
    """Build the left and the right foot, or raise `ConfigurationError` if they are not two surface contacts."""
    walking, dynamics = settings.walking or WalkingSettings(), Dynamics(model)
    surfaces = {name: c for name, c in settings.contacts.items() if isinstance(c, SurfaceContact)}
    valid = ", ".join(surfaces) or "none"
    names = walking.left, walking.right
    for key, name in zip(("left", "right"), names, strict=True):
        if name is not None and name not in surfaces:
            raise ConfigurationError(f"walking.{key} = {name!r} is not a surface contact; valid: {valid}")
    if None in names or names[0] == names[1]:
        if names != (None, None) or len(surfaces) != 2:
            raise ConfigurationError(
                f"walking.left = {names[0]!r}, walking.right = {names[1]!r}: walking takes two surface contacts, the "
                f"left and the right foot, or four point contacts; surface contacts: {valid}"
            )
        feet = [_foot(name, LEFT, contact, dynamics) for name, contact in surfaces.items()]
        right, left = sorted(feet, key=lambda foot: foot.sole(dynamics).place.imag)
        names = left.contact, right.contact
    left, right = (
        _foot(str(name), task, surfaces[str(name)], dynamics) for name, task in zip(names, (LEFT, RIGHT), strict=True)
    )
    return left, right


def _foot(name: str, task: str, contact: SurfaceContact, dynamics: Dynamics) -> Foot:
    """Build one foot with the half sides of the largest rectangle about the contact's origin.

    The x axis of its sole is the axis of the contact, or its opposite, that points forward in the nominal posture.
    """
    frame = dynamics.model.frame_id(contact.frame, f"contacts.{name}.frame")
    placement = placement_of(contact.translation, contact.rpy)
    forward = (dynamics.placement(frame) * placement).rotation[0, :2]  # components of the x and y axes
    quarter = round(math.atan2(-forward[1], forward[0]) / (0.5 * math.pi))
    turn = about_z(-0.5 * math.pi * quarter)
    corners = np.array(contact.corners) @ turn[:2, :2]
    half = np.minimum(corners.max(axis=0), -corners.min(axis=0))
    placement *= pin.SE3(turn, np.zeros(3))
    link, on_link = placement_on_link(dynamics.model, frame, placement)
    return Foot(name, task, frame, placement, (float(half[0]), float(half[1])), link, placement_numbers(on_link))


def make_gait(settings: Settings, left: Foot, right: Foot, qp: WholeBodyQP) -> BipedLimits:
    """Make the gait with its limits; its defaults follow from the robot in its nominal posture.

    Lowering and clearances are smaller if the flat feet cannot be raised as far, and speeds if they are not feasible.
    """
    walking, limits = settings.walking or WalkingSettings(), settings.limits
    dynamics, model, gravity = qp.dynamics, qp.model, qp.model.gravity
    soles = [foot.sole(dynamics) for foot in (left, right)]
    z = float(dynamics.com[2]) - 0.5 * (soles[0].height + soles[1].height)
    apart = abs(soles[0].place - soles[1].place)
    legs = [
        BipedLeg(side, foot, Leg(model, foot.frame, [other.frame], limits.margin, foot.placement))
        for side, foot, other in ((1, left, right), (-1, right, left))
    ]
    lift = min(each.leg.lift(_HIGHEST_LIFT * z) for each in legs)
    pace = math.sqrt(gravity * z)
    lowering = value_or(walking.lowering, min(0.03 * z, 0.2 * lift))
    clearance = value_or(walking.clearance, min(0.07 * z, 0.6 * lift))
    gait = Gait(
        single=value_or(walking.single_support, 1.5 * math.sqrt(z / gravity)),
        double=value_or(walking.double_support, 0.05),
        shift=0.8,
        height=z,
        lowering=lowering,
        clearance=clearance,
        rough_clearance=max(clearance, min(2.0 * clearance, 0.9 * lift - lowering)),
        width=value_or(walking.width, 0.85 * apart),
        least_width=value_or(walking.least_width, max(0.4 * apart, left.half[1] + right.half[1] + 0.03)),
        length=value_or(walking.max_step_length, 0.65 * z),
        greatest_width=value_or(walking.max_step_width, 0.9 * z),
        sole_length=2.0 * max(left.half[0], right.half[0]),
        sole_width=2.0 * max(left.half[1], right.half[1]),
        reaction=swing_reaction(dynamics, left, right, z),
        braking=6.0,  # with 2, a stop from 0.8 m/s takes one more step
        speed=(0.12 * pace, 0.08 * pace, 0.5),
    )
    found = BipedLimits(model, qp.contacts, legs, gait, limits.velocity_scale * model.velocity_limits)
    found.gait = replace(gait, speed=feasible_defaults(found, walking))
    return found


def _without_legs(model: RobotModel, left: Foot, right: Foot) -> list[str]:
    moves, frames = support_matrix(model.pinocchio), model.pinocchio.frames
    one = moves[frames[left.frame].parentJoint] != moves[frames[right.frame].parentJoint]
    columns = model.joint_columns(model.driven_joints, "robot.joints")
    return [name for name, column in zip(model.driven_joints, columns, strict=True) if not one[model.v_index[column]]]
