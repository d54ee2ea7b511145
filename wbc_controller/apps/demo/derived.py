"""The scenario of a robot without its own: motions and shoves scaled to its legs or arms, its support and its mass."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from wbc_controller.apps.demo.scenario import Reach, Scenario, shoves, squat, sway
from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.check.preflight import stance, support_margin
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts import UnilateralContact
from wbc_controller.inverse_dynamics.robot.model import RobotModel
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
#: Of an arm: way of the hand, as a share of its distance from the base, and at most, m; speed of a shove, m/s.
_ARM_REACH, _LONGEST_ARM_REACH, _ARM_SHOVE = 0.15, 0.1, 0.3
#: Height up to which a corner of a contact stands on the floor, m.
_LEVEL = 0.01


def derived_scenario(settings: Settings, model: RobotModel) -> Scenario:
    """Make a scenario for a robot on legs, or for arms on a fixed base.

    On legs the robot sways and squats as far as its support and the height of its centre of mass allow, reaches with
    the first hand that has a task which is off, and is shoved by a share of m ω d: the impulse that takes the capture
    point to the edge of its support, with ω² = g/h for the height h of the centre of mass, and its distance d from the
    edge.

    On a fixed base each hand that has a task which is off reaches to where it can move best, and the first one is
    shoved by what makes it `_ARM_SHOVE` faster, if nothing held it back; the posture has to bring it back.

    Raises:
        ConfigurationError: if there is no task of the centre of mass or no support to stand on; on a fixed base, if
            no hand has a task, or no posture is kept.
    """
    hands = {
        name: task.frame
        for name, task in settings.tasks.items()
        if isinstance(task, FramePoseTask) and not task.enabled
    }
    durations = {name: 2.0 + settings.tasks[name].setpoint_duration for name in hands}
    if not model.floating_base:
        return _of_arms(settings, model, hands, durations)
    tasks = [name for name, task in settings.tasks.items() if task.type == "com" and task.enabled]
    if not tasks:
        raise ConfigurationError(
            "the demo needs a task of type com that is enabled; without it, see docs/bring-up.md: wbc mock, wbc run, "
            "wbc send"
        )
    height, margin = _stance(settings, model)
    if not (margin > 0.0):
        raise ConfigurationError(
            "the demo needs a robot that stands: in robot.posture the centre of mass is not above contacts on the floor"
        )
    impulse = model.mass * min(_SHOVE * math.sqrt(model.gravity / height) * margin, _LARGEST_SHOVE)
    impulse = float(f"{impulse:.2g}")
    way = _REACH * height
    return Scenario(
        com=tasks[0],
        moves=(sway(min(_SWAY * margin, _LARGEST_SWAY), 0.005), squat(_SQUAT * height, 0.008)),
        reaches=tuple(Reach(name, (way, 0.0, way), durations[name], 0.01) for name in list(hands)[:1]),
        shoves=shoves(impulse, impulse),
    )


def _of_arms(
    settings: Settings, model: RobotModel, hands: Mapping[str, str], durations: Mapping[str, float]
) -> Scenario:
    posture = any(task.type == "posture" and task.enabled for task in settings.tasks.values())
    lacking = "a task of type frame_pose that is off" if not hands else "" if posture else "a posture task"
    if lacking:
        raise ConfigurationError(
            f"the demo of a fixed base needs {lacking}; without it, see docs/bring-up.md: wbc mock, wbc run, wbc send"
        )
    q = model.configuration(model.posture)
    data = model.pinocchio.createData()
    pin.computeAllTerms(model.pinocchio, data, q, np.zeros(model.nv))
    pin.updateFramePlacements(model.pinocchio, data)
    M = np.triu(data.M) + np.triu(data.M, 1).T
    reaches, impulses = [], np.zeros(3)
    for name, frame in hands.items():
        number = model.frame_id(frame, f"tasks.{name}.frame")
        place = np.array(data.oMf[number].translation)
        J = pin.getFrameJacobian(model.pinocchio, data, number, pin.LOCAL_WORLD_ALIGNED)[:3]
        mobility = J @ np.linalg.solve(M, J.T)  # the acceleration of the hand by a force on it, 1/kg
        best = np.linalg.eigh(J @ J.T)[1][:, 2]
        best *= -1.0 if best @ place > 0.0 else 1.0  # towards the base, away from where the arm is stretched
        way = min(_ARM_REACH * float(np.linalg.norm(place)), _LONGEST_ARM_REACH)
        x, y, z = (way * best).tolist()
        reaches.append(Reach(name, (x, y, z), durations[name], 0.01))
        if not impulses.any():
            impulses = _ARM_SHOVE / np.maximum(np.diag(mobility), 1.0 / model.mass)
    along, sideways, _ = (float(f"{impulse:.2g}") for impulse in impulses)
    return Scenario(com="", reaches=tuple(reaches), shoves=shoves(sideways, along, next(iter(hands.values()))))


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
