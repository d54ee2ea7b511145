"""Builds the walker and its tasks from the settings."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.controller.build.quadruped_walking import (
    is_quadruped,
    make_quadruped_tasks,
    make_quadruped_walker,
)
from wbc_controller.controller.build.walking_tasks import HEIGHT, POSTURE, enabled_tasks, make_disabled, value_or
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts.mount import placement_of
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import CapturePointTask, ComTask, FramePoseTask, PostureTask, Task
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.settings import Settings, SurfaceContact, WalkingSettings
from wbc_controller.walking.feet import Foot
from wbc_controller.walking.gait import Gait
from wbc_controller.walking.quadruped import QuadrupedWalker
from wbc_controller.walking.walker import GAIN, Walker, WalkingTasks

#: Names of the walker's tasks.
DCM, LEFT, RIGHT = "walking_dcm", "walking_left_foot", "walking_right_foot"


def make_walking_tasks(settings: Settings, model: RobotModel) -> list[Task]:
    """Build the tasks of the walker, which are off while the robot stands; none without the section `walking`.

    Raises:
        ConfigurationError: if the feet are not two surface contacts, or a task has the name of one of these.
    """
    if settings.walking is None:
        return []
    if is_quadruped(settings, settings.walking):
        return make_quadruped_tasks(settings, model)
    left, right = _feet(settings, settings.walking, model)
    tasks: dict[str, tuple[float, Task]] = {
        DCM: (500.0, CapturePointTask(DCM, model.gravity, gain=GAIN)),
        HEIGHT: (50.0, ComTask(HEIGHT, [False, False, True], stiffness=100.0, damping=20.0)),
        POSTURE: (0.05, PostureTask(POSTURE, model, [], stiffness=50.0)),
        LEFT: (20.0, FramePoseTask(LEFT, model, settings.contacts[left.contact].frame, stiffness=400.0)),
        RIGHT: (20.0, FramePoseTask(RIGHT, model, settings.contacts[right.contact].frame, stiffness=400.0)),
    }
    return make_disabled(tasks, settings)


def make_walker(settings: Settings, qp: WholeBodyQP) -> Walker | QuadrupedWalker | None:
    """Build the walker; None without the section `walking`.

    Args:
        qp: the quadratic program, with the tasks of `make_walking_tasks` and the dynamics in the nominal posture.
    """
    if settings.walking is None:
        return None
    if is_quadruped(settings, settings.walking):
        return make_quadruped_walker(settings, settings.walking, qp)
    left, right = _feet(settings, settings.walking, qp.model)
    orientations, suspended = enabled_tasks(settings, qp)
    tasks = WalkingTasks(
        dcm=DCM,
        height=HEIGHT,
        posture=POSTURE,
        orientations=orientations,
        suspended=suspended,
    )
    return Walker(_gait(settings.walking, left, right, qp), left, right, tasks, qp.model.gravity)


def _feet(settings: Settings, walking: WalkingSettings, model: RobotModel) -> tuple[Foot, Foot]:
    """Build the left and the right foot.

    Raises:
        ConfigurationError: if they are not two surface contacts.
    """
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
        dynamics = Dynamics(model)
        feet = [_foot(name, LEFT, contact, model) for name, contact in surfaces.items()]
        right, left = sorted(feet, key=lambda foot: float(foot.sole(dynamics).centre[1]))
        names = left.contact, right.contact
    left, right = (
        _foot(str(name), task, surfaces[str(name)], model) for name, task in zip(names, (LEFT, RIGHT), strict=True)
    )
    return left, right


def _foot(name: str, task: str, contact: SurfaceContact, model: RobotModel) -> Foot:
    """Build one foot; its half length and width are those of the largest rectangle about the contact's origin."""
    corners = np.array(contact.corners)
    half = np.minimum(corners.max(axis=0), -corners.min(axis=0))
    return Foot(
        contact=name,
        task=task,
        frame=model.frame_id(contact.frame, f"contacts.{name}.frame"),
        placement=placement_of(contact.translation, contact.rpy),
        half=(float(half[0]), float(half[1])),
    )


def _gait(walking: WalkingSettings, left: Foot, right: Foot, qp: WholeBodyQP) -> Gait:
    """Collect the parameters of the gait, with the defaults of the robot in its nominal posture."""
    dynamics, gravity = qp.dynamics, qp.model.gravity
    soles = [foot.sole(dynamics).centre for foot in (left, right)]
    z = float(dynamics.com[2]) - 0.5 * float(soles[0][2] + soles[1][2])
    apart = float(np.linalg.norm((soles[0] - soles[1])[:2]))
    sole = left.half[1] + right.half[1]
    least = value_or(walking.least_width, max(0.6 * apart, sole + 0.03))
    return Gait(
        single=value_or(walking.single_support, 1.9 * math.sqrt(z / gravity)),
        double=value_or(walking.double_support, 0.1),
        shift=0.8,
        lowering=value_or(walking.lowering, 0.03 * z),
        clearance=value_or(walking.clearance, 0.07 * z),
        width=value_or(walking.width, 0.85 * apart),
        least_width=least,
        length=value_or(walking.max_step_length, 0.65 * z),
        greatest_width=value_or(walking.max_step_width, 0.8 * z),
        speed=(
            value_or(walking.max_speed, 0.12 * math.sqrt(gravity * z)),
            value_or(walking.max_side_speed, 0.08 * math.sqrt(gravity * z)),
            value_or(walking.max_turn_rate, 0.5),
        ),
    )
