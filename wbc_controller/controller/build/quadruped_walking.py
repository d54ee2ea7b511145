"""Construction of the quadruped walker and its tasks."""

import math
from dataclasses import replace

import numpy as np

from wbc_controller.controller.build.gait_limits import QuadrupedLimits, feasible_defaults
from wbc_controller.controller.build.leg import Leg
from wbc_controller.controller.build.walking_tasks import COM, HEIGHT, POSTURE, make_disabled, make_task_sets, value_or
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.instruction import placement_on_link
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import ComTask, FramePositionTask, PostureTask, Task
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.settings import Settings
from wbc_controller.settings.contacts import PointContact, SurfaceContact
from wbc_controller.settings.walking import WalkingSettings
from wbc_controller.walking.gait import QuadrupedGait
from wbc_controller.walking.quadruped import PointFoot, QuadrupedWalker
from wbc_controller.walking.terrain import Ground

#: Keys of the section `walking` that only bipeds have.
_BIPED_KEYS = ("left", "right", "width", "least_width", "max_step_width")


def is_quadruped(settings: Settings, walking: WalkingSettings) -> bool:
    """Return whether the contacts are four points; `ConfigurationError` if a key of `walking` is for other robots."""
    contacts = settings.contacts
    points = [name for name, contact in contacts.items() if isinstance(contact, PointContact)]
    quadruped = len(points) == 4 and not any(isinstance(contact, SurfaceContact) for contact in contacts.values())
    if not quadruped and walking.gait is not None:
        problem = f"walking.gait = {walking.gait!r} takes four point contacts and no surface contact"
        found = ", ".join(points) or "none"
        raise ConfigurationError(f"{problem}; point contacts: {found}; remove the key for a biped")
    for key in _BIPED_KEYS if quadruped else ():
        if getattr(walking, key) is not None:
            raise ConfigurationError(f"walking.{key}: a robot with four point contacts has no such key; remove it")
    return quadruped


def make_quadruped_tasks(settings: Settings, model: RobotModel) -> list[Task]:
    """Build the tasks of the walker, which are off without a gait."""
    tasks: dict[str, tuple[float, Task]] = {
        COM: (5.0, ComTask(COM, [True, True, False], stiffness=30.0, damping=11.0)),
        HEIGHT: (50.0, ComTask(HEIGHT, [False, False, True], stiffness=100.0, damping=20.0)),
        POSTURE: (0.01, PostureTask(POSTURE, model, [], stiffness=50.0)),
    }
    for foot in _feet(settings, model):
        frame = settings.contacts[foot.contact].frame
        tasks[foot.task] = 5.0, FramePositionTask(foot.task, model, frame, stiffness=400.0)
    return make_disabled(tasks, settings)


def make_quadruped_walker(settings: Settings, walking: WalkingSettings, qp: WholeBodyQP) -> QuadrupedWalker:
    """Build the walker with the tasks of `make_quadruped_tasks`, in the nominal posture."""
    feet = _feet(settings, qp.model)
    gait, tasks = make_quadruped_gait(settings, walking, qp).gait, make_task_sets(settings, qp, [f.task for f in feet])
    return QuadrupedWalker(gait, feet, tasks, qp.model.gravity, qp.model.mass)


def _feet(settings: Settings, model: RobotModel) -> list[PointFoot]:
    dynamics = Dynamics(model)
    places, frames = {}, {}
    for name, contact in settings.contacts.items():
        if isinstance(contact, PointContact):
            frames[name] = model.frame_id(contact.frame, f"contacts.{name}.frame")
            at = dynamics.placement(frames[name]).translation
            places[name] = complex(at[0], at[1])
    middle = sum(places.values()) / len(places)
    by_length = sorted(places, key=lambda name: -places[name].real)
    names = [
        name for pair in (by_length[:2], by_length[2:]) for name in sorted(pair, key=lambda name: -places[name].imag)
    ]
    feet = []
    for row, name in enumerate(names):
        link, on_link = placement_on_link(model, frames[name])
        offset = tuple(on_link.translation.tolist())
        feet.append(PointFoot(name, f"walking_{name}", frames[name], row, places[name] - middle, link, offset))
    return feet


def make_quadruped_gait(settings: Settings, walking: WalkingSettings, qp: WholeBodyQP) -> QuadrupedLimits:
    """Make the gait with its limits; its defaults follow from the robot in its nominal posture.

    The clearance and the speeds are smaller if the legs cannot swing as fast.
    """
    dynamics, gravity, feet = qp.dynamics, qp.model.gravity, _feet(settings, qp.model)
    points = np.array([dynamics.placement(foot.frame).translation for foot in feet])
    com = dynamics.com
    z = float(com[2]) - Ground.below(points).height_at(complex(com[0], com[1]))
    front_left, front_right, rear_left, rear_right = (foot.contact for foot in feet)
    double, speed = value_or(walking.double_support, 0.03), math.sqrt(gravity * z)
    groups: tuple[tuple[str, ...], ...]
    sways: tuple[float, ...]
    pause: tuple[float, ...]
    if walking.gait == "walk":
        sway = 0.2 * (feet[0].nominal - feet[1].nominal).imag
        groups = (rear_left,), (front_left,), (rear_right,), (front_right,)
        sways, pause = (-sway, -sway, sway, sway), (0.5, double, 0.5, double)
        swing, fastest, turning = 1.8, (0.06, 0.03), 0.2
    else:
        groups = (front_left, rear_right), (front_right, rear_left)
        sways, pause = (0.0, 0.0), (double, double)
        swing, fastest, turning = 1.25, (0.5, 0.25), 1.5
    gait = QuadrupedGait(
        groups=groups,
        sway=sways,
        swing=value_or(walking.single_support, swing * math.sqrt(z / gravity)),
        pause=pause,
        shift=0.6,
        height=z,
        lowering=value_or(walking.lowering, 0.0),
        clearance=value_or(walking.clearance, 0.18 * z),
        length=value_or(walking.max_step_length, 0.6 * z),
        speed=(fastest[0] * speed, fastest[1] * speed, turning),
        acceleration=(1.0, 1.0, 3.0),
    )
    limits, model = settings.limits, qp.model
    frames = [foot.frame for foot in feet]
    legs = {
        foot: Leg(model, foot.frame, [each for each in frames if each != foot.frame], limits.margin) for foot in feet
    }
    found = QuadrupedLimits(legs, gait, limits.velocity_scale * model.velocity_limits)
    if walking.clearance is None:
        found.gait = replace(gait, clearance=found.raised(gait.clearance))
    found.gait = replace(found.gait, speed=feasible_defaults(found, walking))
    return found
