"""Outgoing messages: commands, contact wrenches, the mode, diagnostics, tasks' states and markers.

Diagnostics and markers take longer than the time between two states. They are composed piece by piece, one per cycle,
after the torques are sent. Contact wrenches, tasks' states and markers are made only if a subscription exists.
Diagnostics without a subscription are made once a second, for the recorder.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np

from wbc_controller.controller.report import CycleReport
from wbc_controller.controller.result import CycleResult
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import encode, header, message, torques
from wbc_controller.middleware.message_layout import Template
from wbc_controller.middleware.setpoints import WRENCH, wrench_stamped
from wbc_controller.middleware.topics import Direction, Endpoint
from wbc_controller.middleware.transports.transport import Publish, Transport
from wbc_controller.nodes.diagnostics.markers import MarkerScene
from wbc_controller.nodes.diagnostics.shortfall import Shortfall
from wbc_controller.nodes.diagnostics.status import StatusSummary
from wbc_controller.nodes.diagnostics.task_states import TaskStates
from wbc_controller.records import Fault, Mode, References, RobotState, Solution

#: Rows of the topic table whose messages depend on subscriptions; without one, diagnostics are made less often.
_ON_DEMAND = ("contact_wrench", "task_reference", "task_value", "markers", "diagnostics")
#: Shortest time between two diagnostics without a subscription, s.
_UNREAD = 1.0
#: Time between two queries of the subscriptions, s.
_LOOK = 0.1


class _Readers:
    """Subscriptions of the topics whose messages are made on demand.

    Attributes:
        subjects: names of the contacts or tasks whose topic has a subscription, by row of the topic table; the empty
            name for a topic without a subject.
    """

    def __init__(self, transport: Transport, endpoints: Iterable[Endpoint]) -> None:
        self._asked = [
            (endpoint.key, endpoint.subject, partial(transport.is_read, endpoint))
            for endpoint in endpoints
            if endpoint.key in _ON_DEMAND
        ]
        self._due = -np.inf
        self.subjects: dict[str, tuple[str, ...]] = dict.fromkeys(_ON_DEMAND, ())

    def look(self, now: float) -> None:
        """Query the subscriptions if they are due."""
        if now < self._due:
            return
        self._due = now + _LOOK
        read = [(key, subject) for key, subject, is_read in self._asked if is_read()]
        self.subjects = {key: tuple(subject for of, subject in read if of == key) for key in _ON_DEMAND}


class Outputs:
    """Publishes the results of a cycle.

    Args:
        contacts: contacts whose forces are published, by name.
        diagnostics_period: time between two diagnostics messages, and between two of a task, s.
        markers_period: time between two marker messages, s; inf for none.
        node: name of the node, with its namespace.
        scheduling: how the process is scheduled, for diagnostics.
        recorder: returns diagnostics of the recordings, by key.
    """

    def __init__(
        self,
        model: RobotModel,
        contacts: Mapping[str, Contact],
        endpoints: Iterable[Endpoint],
        transport: Transport,
        diagnostics_period: float,
        tasks: TaskStates,
        shortfall: Shortfall,
        scene: MarkerScene,
        markers_period: float,
        node: str,
        scheduling: str = "",
        recorder: Callable[[], Mapping[str, str]] = dict,
    ) -> None:
        self._actuation = model.actuation
        self._contacts = contacts
        outgoing = [endpoint for endpoint in endpoints if endpoint.direction is Direction.OUT]
        self._publish: dict[tuple[str, str], Publish] = {
            (endpoint.key, endpoint.subject): transport.advertise(endpoint) for endpoint in outgoing
        }
        self._readers = _Readers(transport, outgoing)
        no_torques, joints = self._actuation.command(np.zeros(model.na)), np.zeros(model.nj)
        self._zeros = encode(torques(no_torques))
        # The messages of every cycle are written in place.
        self._efforts = Template(torques(no_torques), ["data"])
        commands = message(
            "sensor_msgs/msg/JointState",
            header=header(0),
            name=list(model.joints),
            position=joints,
            velocity=joints,
            effort=joints,
        )
        self._joint_commands = Template(commands, ["position"], ["velocity"], ["effort"])
        self._wrenches = {
            name: Template(wrench_stamped(np.zeros(6), contact.wrench_frame), WRENCH)
            for name, contact in contacts.items()
        }
        self._mode_said: Mode | None = None
        self._fault_said: Fault | None = None
        self._summary = StatusSummary(node, model.name, scheduling, model, recorder)
        self._diagnostics_period = diagnostics_period
        self._diagnosed = -np.inf  # when the last diagnostics were begun, s
        self._contested_said: tuple[str, ...] = ()
        self._news = False  # whether the next diagnostics are due at once
        self._composed: dict[str, Generator[None, None, None]] = {}  # unfinished messages, by key
        self._tasks = tasks
        self._tasks_due = -np.inf
        self._shortfall = shortfall
        self._short: tuple[str, ...] = ()
        self._scene = scene
        self._markers_period = markers_period
        self._markers_due = -np.inf if markers_period < np.inf else np.inf

    def publish_command(self, result: CycleResult) -> None:
        """Send the torques and the contact forces of the solution: the time-critical messages of a cycle."""
        command, publish, wrenches = result.command, self._publish, self._readers.subjects["contact_wrench"]
        if command is not None:
            tau, actuation = command.tau, self._actuation
            publish["effort", ""](self._efforts.write(0, actuation.command(tau)))
            joints = actuation.at_joints(tau)
            payload = self._joint_commands.write(command.stamp, command.q_desired, command.v_desired, joints)
            publish["joint_commands", ""](payload)
        if wrenches and result.solution is not None and result.state is not None and result.mode is Mode.ACTIVE:
            stamp, forces = result.state.stamp, result.solution.forces
            for name in wrenches:
                force = forces.get(name)
                if force is not None:
                    payload = self._wrenches[name].write(stamp, self._contacts[name].basis @ force)
                    publish["contact_wrench", name](payload)

    def publish_zeros(self) -> None:
        """Send zero torques after a failure: the message was serialized at the start."""
        self._publish["effort", ""](self._zeros)

    def publish_status(self, report: CycleReport, now: float, wall: int) -> None:
        """Send the mode if it has changed, begin diagnostics if they are due, and query the subscriptions.

        Args:
            now: time on the clock of the loop, s.
            wall: time for the headers, ns.
        """
        mode, fault = report.mode, report.fault
        if mode is not self._mode_said or (fault is not self._fault_said and fault != self._fault_said):
            self._mode_said, self._fault_said = mode, fault
            text = report.mode.value
            if report.fault is not None:
                text += f" {report.fault.code}: {report.fault.sentence}"
            self._send("state", message("std_msgs/msg/String", data=text))
        self._summary.add(report)
        if report.refused or report.contested != self._contested_said:
            self._news, self._contested_said = True, report.contested
        period = self._diagnostics_period
        if period < _UNREAD and not self._readers.subjects["diagnostics"]:
            period = _UNREAD
        if now - self._diagnosed >= period or (self._news and "diagnostics" not in self._composed):
            self._news, self._diagnosed = False, now
            self._begin("diagnostics", self._summary.compose(wall, self._short))
        self._readers.look(now)

    def publish_tasks(
        self,
        now: float,
        state: RobotState | None,
        dynamics: Dynamics,
        references: References | None,
        solution: Solution | None,
    ) -> None:
        """Send the state and the reference of one task if due: all tasks with a subscription in turn, one per cycle.

        The next diagnostics name the tasks that stay short of their references.

        Args:
            now: time on the clock of the loop, s.
            state: latched state; None before the first one.
            references: references of the cycle; None if no program was solved.
        """
        if state is None or references is None or solution is None:
            self._short = ()
            return
        if now >= self._tasks_due:
            self._tasks_due = now + self._diagnostics_period
            subjects = self._readers.subjects
            self._tasks.begin({*subjects["task_reference"], *subjects["task_value"]})
            self._short = self._shortfall.sentences(now, dynamics, references, solution)
        made = self._tasks.next(state.stamp, dynamics, references)
        if made is not None:
            for key, content in made[1].items():
                self._publish[key, made[0]](content)

    def publish_markers(
        self, now: float, state: RobotState | None, references: References | None, solution: Solution | None
    ) -> None:
        """Begin the markers of the cycle if they are due and have a subscription."""
        if state is not None and now >= self._markers_due:
            self._markers_due = now + self._markers_period
            if self._readers.subjects["markers"]:
                self._begin("markers", self._scene.compose(state, references, solution))

    def compose(self) -> None:
        """Compose one piece of the oldest unfinished message."""
        for key, steps in self._composed.items():
            if next(steps, self) is self:
                del self._composed[key]
            return

    def finish(self) -> None:
        """Compose all pieces that are left."""
        while self._composed:
            self.compose()

    def _begin(self, key: str, content: Generator[None, None, Any]) -> None:
        """Begin a message; finish the last one at once, which is late."""
        for _ in self._composed.pop(key, ()):
            pass
        self._composed[key] = self._written(key, content)

    def _written(self, key: str, content: Generator[None, None, Any]) -> Generator[None, None, None]:
        composed = yield from content
        if composed is not None:
            yield
            self._send(key, composed)

    def _send(self, key: str, content: object) -> None:
        self._publish[key, ""](encode(content))
