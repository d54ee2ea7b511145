"""The demo of a robot that has none of its own: motions and shoves that fit its legs, its support and its mass."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.assembly.preflight import stance, support_margin
from wbc_controller.assembly.program import make_qp
from wbc_controller.core.contacts import UnilateralContact
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.demo.scenario import Reach, Scenario, shoves, squat, sway
from wbc_controller.errors import ConfigurationError
from wbc_controller.settings import FramePoseTask, Settings

#: Amplitude of the sway, as a share of the distance from the centre of mass to the edge of the support; at most, m.
_SWAY, _LARGEST_SWAY = 0.4, 0.04
#: Depth of the squat, as a share of the height of the centre of mass.
_SQUAT = 0.12
#: Impulse of a shove, as a share of what moves the capture point to the edge of the support, m ω d; and the largest
#: change of speed, m/s: a wide stance does not make the legs faster.
_SHOVE, _LARGEST_SHOVE = 0.5, 0.35
#: Way of a hand, as a share of the height of the centre of mass: forward and up.
_REACH = 0.1
#: Height up to which a corner of a contact stands on the floor, m.
_LEVEL = 0.01


def derived_scenario(settings: Settings, model: RobotModel) -> Scenario:
    """Make a scenario for a robot on legs.

    The robot sways and squats as far as its support and the height of its centre of mass allow, reaches with the first
    hand that has a task which is off, and is shoved by a share of m ω d: the impulse that takes the capture point to
    the edge of its support, with ω² = g/h for the height h of the centre of mass, and its distance d from the edge.

    Raises:
        ConfigurationError: if the base is fixed, or there is no task of the centre of mass or no support to stand on.
    """
    tasks = [name for name, task in settings.tasks.items() if task.type == "com" and task.enabled]
    lacking = (
        "a floating base" if not model.floating_base else "a task of type com that is enabled" if not tasks else ""
    )
    if lacking:
        raise ConfigurationError(
            f"the demo needs {lacking}; without it, see docs/bring-up.md: wbc mock, wbc run, wbc send"
        )
    height, margin = _stance(settings, model)
    if not (margin > 0.0):
        raise ConfigurationError(
            "the demo needs a robot that stands: in robot.posture the centre of mass is not above contacts on the floor"
        )
    impulse = model.mass * min(_SHOVE * math.sqrt(model.gravity / height) * margin, _LARGEST_SHOVE)
    impulse = float(f"{impulse:.2g}")
    way = _REACH * height
    hands = [name for name, task in settings.tasks.items() if isinstance(task, FramePoseTask) and not task.enabled]
    return Scenario(
        com=tasks[0],
        moves=(sway(min(_SWAY * margin, _LARGEST_SWAY), 0.005), squat(_SQUAT * height, 0.008)),
        reaches=tuple(
            Reach(name, (way, 0.0, way), 2.0 + settings.tasks[name].setpoint_duration, 0.01) for name in hands[:1]
        ),
        shoves=shoves(impulse, impulse),
    )


def _stance(settings: Settings, model: RobotModel) -> tuple[float, float]:
    """Height of the centre of mass above the floor, and its distance from the edge of the support, both in m."""
    qp = make_qp(settings, model)
    enabled = [name for name, contact in settings.contacts.items() if contact.enabled]
    qp.dynamics.update(stance(model, qp, enabled), np.zeros(model.nv))
    feet = [
        contact.points(qp.dynamics)
        for contact in (qp.contacts[name] for name in enabled)
        if isinstance(contact, UnilateralContact) and not contact.internal
    ]
    corners = np.vstack([np.zeros((0, 3)), *feet])
    floor = corners[corners[:, 2] <= _LEVEL]
    if len(floor) < 3:
        return float(qp.dynamics.com[2]), 0.0
    return float(qp.dynamics.com[2]), support_margin(floor[:, :2], qp.dynamics.com[:2])
