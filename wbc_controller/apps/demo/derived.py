"""The scenario of a robot without its own: motions and shoves scaled to its legs or arms, its support and its mass."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from wbc_controller.apps.demo.hand import Hand
from wbc_controller.apps.demo.scenario import Reach, Scenario, shoves, squat, sway
from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.check.preflight import stance, support_margin, unsupported_passive_joints
from wbc_controller.controller.check.reserves import com_distance
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.contacts import UnilateralContact
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
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
#: Share of a possible motion of the centre of mass that is safe while it moves, and smallest motion that is made, m.
_SAFE, _LEAST_WAY = 0.8, 0.005
#: Height up to which a corner of a contact stands on the floor, m.
_LEVEL = 0.01


def derived_scenario(settings: Settings, model: RobotModel) -> Scenario:
    """Make a scenario for a robot on legs, or for arms on a fixed base.

    On legs the robot sways and squats as far as its support, the height of its centre of mass and the pre-flight
    check (`com_distance`) allow, reaches with the first hand that has a disabled task, and is shoved by a share
    of m ω d: the impulse that takes the capture point to the edge of its support, with ω² = g/h for the height h of the
    centre of mass, and its distance d from the edge.

    On a fixed base each hand that has a disabled task reaches in its easiest direction, and the first one is shoved by
    an impulse that makes it `_ARM_SHOVE` faster, if nothing held it back; the posture has to bring it back. Motions
    that the robot cannot make are left out.

    Raises:
        ConfigurationError: if there is no task of the centre of mass or no support to stand on; on a fixed base, if
            no posture is kept.
    """
    hands = {
        name: task for name, task in settings.tasks.items() if isinstance(task, FramePoseTask) and not task.enabled
    }
    if not model.floating_base:
        return _of_arms(settings, model, hands)
    tasks = [name for name, task in settings.tasks.items() if task.type == "com" and task.enabled]
    if not tasks:
        raise ConfigurationError(
            "the demo needs a task of type com that is enabled; without it, see docs/bring-up.md: wbc mock, wbc run, "
            "wbc send"
        )
    legs = _Stance(settings, model)
    height, margin = legs.height, legs.margin
    if not (margin > 0.0):
        raise ConfigurationError(
            "the demo needs a robot that stands: in robot.posture the centre of mass is not above contacts on the floor"
        )
    impulse = model.mass * min(_SHOVE * math.sqrt(model.gravity / height) * margin, _LARGEST_SHOVE)
    impulse = float(f"{impulse:.2g}")
    way = np.array([_REACH, 0.0, _REACH]) * height
    side, down = np.eye(3)[1], -np.eye(3)[2]
    amplitude = min(legs.way(sign * side, min(_SWAY * margin, _LARGEST_SWAY)) for sign in (1.0, -1.0))
    moves = (sway(amplitude, 0.005), squat(legs.way(down, _SQUAT * height), 0.008))
    reaches = (_reach(settings, model, name, hand, way) for name, hand in list(hands.items())[:1])
    return Scenario(
        com=tasks[0],
        moves=tuple(move for move in moves if move.largest > _LEAST_WAY),
        reaches=tuple(reach for reach in reaches if reach is not None),
        shoves=shoves(impulse, impulse),
    )


def _of_arms(settings: Settings, model: RobotModel, hands: Mapping[str, FramePoseTask]) -> Scenario:
    if not any(task.type == "posture" and task.enabled for task in settings.tasks.values()):
        raise ConfigurationError(
            "the demo of a fixed base needs a posture task; without it, see docs/bring-up.md: wbc mock, wbc run, "
            "wbc send"
        )
    last = str(model.pinocchio.names[model.pinocchio.njoints - 1])
    shoved = next((hand.frame for hand in hands.values()), last)
    reaches = (_reach(settings, model, name, hand) for name, hand in hands.items())
    impulses = _ARM_SHOVE / np.maximum(np.diag(_mobility(model, shoved)), 1.0 / model.mass)
    along, sideways, _ = (float(f"{impulse:.2g}") for impulse in impulses)
    return Scenario(
        com="",
        reaches=tuple(reach for reach in reaches if reach is not None),
        shoves=shoves(sideways, along, shoved),
    )


def _mobility(model: RobotModel, frame: str) -> Array:
    """Return the acceleration of a frame by a force on it, in the nominal posture, (3, 3) in 1/kg."""
    q, data = model.configuration(model.posture), model.pinocchio.createData()
    pin.computeAllTerms(model.pinocchio, data, q, np.zeros(model.nv))
    M = np.triu(data.M) + np.triu(data.M, 1).T
    number = model.frame_id(frame, "frame")
    J = pin.getFrameJacobian(model.pinocchio, data, number, pin.LOCAL_WORLD_ALIGNED).reshape(6, model.nv)[:3]
    return np.asarray(J @ np.linalg.solve(M, J.T))


def _reach(
    settings: Settings, model: RobotModel, name: str, task: FramePoseTask, way: Array | None = None
) -> Reach | None:
    """Make the reach of a hand that is possible, (3,) in m, at most `way`; None if it cannot move.

    Without a way the hand moves where it can best, rather towards the base than away from it.
    """
    hand = Hand(model, task.frame, turns=not any(task.mask[3:]))
    margin = settings.limits.position_margin if settings.limits.position else 0.0
    if way is None:
        length = min(_ARM_REACH * float(np.linalg.norm(hand.position)), _LONGEST_ARM_REACH)
        ways = [hand.easiest * length, -hand.easiest * length]
        ways.sort(key=lambda one: float(one @ hand.position))
    else:
        ways = [way]
    offset = max((hand.possible(one, margin) for one in ways), key=lambda one: round(float(np.linalg.norm(one)), 3))
    if not (np.linalg.norm(offset) > _LEAST_WAY):
        return None
    x, y, z = offset.tolist()
    return Reach(name, (x, y, z), 2.0 + task.setpoint_duration, 0.01)


class _Stance:
    """The robot in its nominal posture on its feet."""

    def __init__(self, settings: Settings, model: RobotModel) -> None:
        self._settings, self._qp = settings, make_qp(settings, model)
        dynamics = self._qp.dynamics
        self._enabled = [name for name, contact in settings.contacts.items() if contact.enabled]
        self._q = stance(model, self._qp, self._enabled)
        dynamics.update(self._q, np.zeros(model.nv))
        feet = [
            contact.points(dynamics)
            for contact in (self._qp.contacts[name] for name in self._enabled)
            if isinstance(contact, UnilateralContact) and not contact.internal
        ]
        corners = np.vstack([np.zeros((0, 3)), *feet])
        floor = corners[corners[:, 2] <= _LEVEL]
        self.height = float(dynamics.com[2])  # of the centre of mass above the floor, m
        #: Distance of the centre of mass from the edge of the support, m.
        self.margin = 0.0 if len(floor) < 3 else support_margin(floor[:, :2], dynamics.com[:2])

    def way(self, direction: Array, most: float) -> float:
        """Return the way of the centre of mass in a direction, m: `most`, or the safe share of what is possible."""
        limits = self._settings.limits
        margin = limits.position_margin if limits.position else 0.0
        hanging = unsupported_passive_joints(self._qp, self._enabled)
        found = com_distance(self._qp, self._enabled, self._q, hanging, direction, most / _SAFE, margin)
        return most if found is None else _SAFE * found.distance
