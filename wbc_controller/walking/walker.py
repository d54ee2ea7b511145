"""Base class of walkers, and prediction of their falls."""

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.references.changes import Change, EnableTask, SetSetpoint
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array, Reference, freeze
from wbc_controller.walking.fall_kernels import PERSISTS
from wbc_controller.walking.footsteps import Goal, Velocity, velocity_to
from wbc_controller.walking.gait import Gait, Phase, QuadrupedGait
from wbc_controller.walking.plan import WalkingPlan
from wbc_controller.walking.references_kernels import body_references

_PREDICTION_PERIOD = 0.012  # time between predictions of a fall, s
STILL = freeze(np.zeros(3))  # acceleration of a reference without one


@dataclass(slots=True)
class Decision:
    """Changes of tasks and contacts, and references of tasks, requested by the walker in one cycle."""

    changes: list[Change]
    references: Mapping[str, Reference]  # valid until the next cycle


@dataclass(frozen=True, slots=True)
class TaskSets:
    """Names of the tasks commanded and switched by a walker."""

    com: str  # task on the horizontal position of the centre of mass
    height: str  # task on the height of the centre of mass
    own: tuple[str, ...]  # enabled while it walks
    orientations: tuple[str, ...]  # tasks on orientations, turned with the heading
    suspended: tuple[str, ...]  # tasks with references in the world, disabled while it walks


class FallPrediction:
    """Prediction of an unavoidable fall, latched after it has persisted; `sentence` describes it, or is empty."""

    STATE_FIELDS = ("sentence", "_watched", "_captured")

    def __init__(self) -> None:
        self.sentence = ""
        self._watched = -math.inf  # time of the last prediction, s
        self._captured = math.inf  # last time at which no fall was predicted, s

    def is_due(self, time: float) -> bool:
        """Return whether a prediction is due at the time of a state, s; if so, the next one is due later."""
        if 0.0 <= time - self._watched < _PREDICTION_PERIOD:
            return False
        self._watched = time
        return True

    def clear(self, time: float) -> None:
        """Note that no fall is predicted at a time, s."""
        self._captured = time

    def compare(self, time: float, distance: float, most: float, support: str) -> None:
        """Predict a fall if a distance of the DCM from a support exceeds the largest one, m, for some time."""
        if not distance > most or time < self._captured:
            self.clear(time)
        elif time - self._captured > PERSISTS:
            self.sentence = (
                f"a fall is unavoidable: the capture point is {distance:.2f} m away from {support} (limit {most:.2f} m)"
            )


class Walker(ABC):
    """Command and phase of a walking robot.

    Call `update` in every cycle with the dynamics at the present state, before the references are sampled.

    Attributes:
        command: commanded velocity within the largest speeds; None to stand.
        goal: pose to walk to, or None; it commands the velocity.
        leaving: True if the controller is deactivated as soon as the robot has stopped; commands are refused.
        velocity: present velocity, on the way to the command.
        steps: number of steps since the start.
        fall_prediction: prediction of a fall.
    """

    gait: Gait | QuadrupedGait
    footsteps_left = 0  # planned footsteps without a touchdown

    def __init__(self, gait: Gait | QuadrupedGait, tasks: TaskSets) -> None:
        """Make a standing walker."""
        self.gait, self.tasks = gait, tasks
        self._com_height = gait.height - gait.lowering  # above the ground while walking, m
        self.reset()

    def reset(self) -> None:
        """Stand, without a command."""
        self.phase = Phase.STAND
        self.command: Velocity | None = None
        self.goal: Goal | None = None
        self.leaving = False
        self._until = math.inf  # time at which the command ends, s
        self.velocity = Velocity()
        self.steps = 0
        self.fall_prediction = FallPrediction()
        self._lifted: tuple[str, ...] = ()  # swing feet whose contact sensor has shown the lift-off
        self._since = self._last = 0.0  # start of the phase, and last cycle, s
        self._height = self._heading = 0.0  # references of its height in the world, m, and of the heading, rad
        self._begun = 0.0  # heading at the start, rad
        #: Quaternions (x, y, z, w) of the tasks on orientations at the start, (n, 4).
        self._orientations = np.zeros((len(self.tasks.orientations), 4))
        self._references: dict[str, Reference] = {}  # of the last cycle, by task

    def ask(self, command: Velocity | None, until: float = math.inf) -> None:
        """Walk at a velocity until a time in s; None to stand.

        Raises:
            InputRefused: if the robot stops because the controller is deactivated.
        """
        if self.leaving and command is not None:
            raise InputRefused("the command to walk is refused: the robot stops walking before it is deactivated")
        self.command, self._until, self.goal = self._limited(command), until, None

    def go(self, goal: Goal) -> None:
        """Walk to a pose, and stop there; raises `InputRefused` as `ask`."""
        self.ask(Velocity())
        self.goal = goal

    def follow(self, poses: Array, dynamics: Dynamics) -> None:
        """Step on poses of the soles, x, y in m and heading in rad, (n, 3), then stop.

        Raises:
            InputRefused: if it does not take footsteps, as `ask`, or if a step is out of reach.
        """
        raise InputRefused("footsteps are refused: only bipeds take them; send a velocity or a goal")

    def leave(self) -> None:
        """Stop walking; the controller is deactivated when the robot has stopped."""
        self.ask(None)
        self.leaving = True

    @property
    def moves(self) -> bool:
        """True while the robot walks or is about to."""
        return self.phase is not Phase.STAND or self.command is not None

    @property
    @abstractmethod
    def contact_sets(self) -> tuple[tuple[str, ...], ...]:
        """Sets of active contacts of the gait, first that of all feet."""

    @abstractmethod
    def plan(self) -> WalkingPlan | None:
        """Return the plan of the last cycle, or None while standing."""

    @abstractmethod
    def update(
        self, time: float, dynamics: Dynamics, orientations: Mapping[str, Array], touching: Mapping[str, bool]
    ) -> Decision:
        """Decide on contacts and references of one cycle.

        Args:
            time: of the state, s.
            orientations: present references of the tasks on orientations, as quaternions (x, y, z, w), by name.
            touching: states of the contact sensors, by contact; without one, the foot's motion indicates touchdown.
        """

    def watch_standing(self, time: float, dynamics: Dynamics, active: Collection[str]) -> None:  # noqa: B027
        """Predict a fall of a robot that is supported by its active contacts, at the time of a state, s."""

    def _approach(self, goal: Goal, place: complex, heading: float) -> None:
        """Command the velocity to a goal from the robot's place and heading; at the goal, drop it."""
        self.command = self._limited(velocity_to(goal, place, heading, self.gait, self.gait.step_time))
        if self.command is None:
            self.goal = None

    def _limited(self, command: Velocity | None) -> Velocity | None:
        return None if command is None else command.clipped(self.gait)

    def _sensor(self, contact: str, touching: Mapping[str, bool]) -> bool | None:
        """Return the state of the contact sensor of a swing foot; None before it has shown the lift-off."""
        sensor = touching.get(contact)
        if sensor is False and contact not in self._lifted:
            self._lifted = (*self._lifted, contact)
        return sensor if contact in self._lifted else None

    def _command_body(
        self, place: complex, velocity: complex, acceleration: complex, ground: float, turning: float, dt: float
    ) -> None:
        """Set the references of the body; its height follows that of the ground, m.

        The tasks on orientations turn with the heading, which changes at the rate `turning` in rad/s.
        """
        names, turn = self.tasks, self._heading - self._begun
        out = np.empty(12 + self._orientations.size)
        self._height = body_references(
            place, velocity, acceleration, self._height, ground + self._com_height, turn, turning, dt,
            self._orientations, out,
        )  # fmt: skip
        self._references[names.com] = self._references[names.height] = Reference(out[:3], out[3:6], out[6:9])
        rates = out[9:12]
        for i, name in enumerate(names.orientations):
            self._references[name] = Reference(out[12 + 4 * i : 16 + 4 * i], rates, STILL)

    def _begin_tasks(self, orientations: Mapping[str, Array], decision: Decision) -> None:
        """Enable the tasks of the walker; tasks on orientations continue from their present references."""
        self._begun = self._heading
        self._orientations[:] = [orientations[name] for name in self.tasks.orientations]
        decision.changes += [EnableTask(name, False) for name in self.tasks.suspended]
        decision.changes += [EnableTask(name, True) for name in self.tasks.own]

    def _stand(self, decision: Decision) -> None:
        """End walking: the tasks stay at their last references until they are off."""
        self.phase = Phase.STAND
        decision.changes += [SetSetpoint(name, each.position, 0.0) for name, each in self._references.items()]
        decision.changes += [EnableTask(name, False) for name in self.tasks.own]
        decision.changes += [EnableTask(name, True) for name in self.tasks.suspended]
