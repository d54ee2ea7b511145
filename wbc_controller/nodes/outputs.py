"""Outgoing messages.

Diagnostics and markers are composed in pieces, after the torques were sent. Contact wrenches, task states and markers
require subscriptions; diagnostics without a subscription are composed once per second, for the recorder.
"""

from collections.abc import Callable, Generator, Iterable, Mapping
from typing import Any

import numpy as np

from wbc_controller.controller.controller import Controller
from wbc_controller.controller.report import CycleReport
from wbc_controller.controller.result import CycleResult
from wbc_controller.middleware.codec import WRENCH, Template, encode, message, torques, wrench_stamped
from wbc_controller.middleware.decoding import Vocabulary
from wbc_controller.middleware.topics import Direction, Endpoint
from wbc_controller.middleware.transports.transport import Publish, Transport
from wbc_controller.nodes.diagnostics.markers import MarkerScene
from wbc_controller.nodes.diagnostics.status import StatusSummary
from wbc_controller.nodes.diagnostics.task_reports import Shortfall, TaskStates
from wbc_controller.records import Fault, Mode, RobotState

#: Rows of the topic table with messages on demand.
_ON_DEMAND = ("contact_wrench", "task_reference", "task_value", "markers", "diagnostics")
_UNREAD_PERIOD = 1.0  # of diagnostics without a subscription, s
_QUERY_PERIOD = 0.1  # of the subscriptions, s


class Outputs:
    """Publisher of the results of a controller's cycles; `values` returns other diagnostics."""

    def __init__(
        self,
        controller: Controller,
        vocabulary: Vocabulary,
        endpoints: Iterable[Endpoint],
        transport: Transport,
        node: str,  # name with namespace
        scheduling: str,
        values: Callable[[], Mapping[str, str]],
    ) -> None:
        settings, model, qp = controller.config.settings, controller.model, controller.qp
        self._actuation, self._walker, self._contacts = model.actuation, controller.walker, qp.contacts
        outgoing = [endpoint for endpoint in endpoints if endpoint.direction is Direction.OUT]
        self._publish: dict[tuple[str, str], Publish] = {
            (endpoint.key, endpoint.subject): transport.advertise(endpoint) for endpoint in outgoing
        }
        self._has_reader = transport.has_reader
        self._on_demand = [endpoint for endpoint in outgoing if endpoint.key in _ON_DEMAND]
        #: Subscribed contacts and tasks (or the empty subject) by row of the topic table.
        self._subscribed: dict[str, tuple[str, ...]] = dict.fromkeys(_ON_DEMAND, ())
        self._query_due = -np.inf
        no_torques, joints = self._actuation.command(np.zeros(model.na)), np.zeros(model.nj)
        self._zeros = encode(torques(no_torques))
        # Messages of every cycle are written in place.
        self._efforts = Template(torques(no_torques), ["data"])
        names = list(model.joints)
        commands = message("sensor_msgs/msg/JointState", name=names, position=joints, velocity=joints, effort=joints)
        self._joint_commands = Template(commands, ["position"], ["velocity"], ["effort"])
        self._wrenches = {
            name: Template(wrench_stamped(np.zeros(6), qp.contacts[name].wrench_frame), WRENCH)
            for name in vocabulary.contacts
        }
        self._published_mode: Mode | None = None
        self._published_footsteps: int | None = None
        self._published_fault: Fault | None = None
        self._summary = StatusSummary(node, model.name, scheduling, model, values)
        self._diagnostics_period = 1.0 / settings.control.diagnostics_rate  # s
        self._diagnostics_begun = -np.inf  # start of the last diagnostics, s
        self._published_contested: tuple[str, ...] = ()
        self._diagnostics_requested = False  # due at once
        self._composed: dict[str, Generator[None, None, None]] = {}  # unfinished messages, by key
        self._tasks = TaskStates(qp.tasks, vocabulary)
        self._tasks_due = -np.inf
        self._shortfall = Shortfall(qp.tasks)
        self._shortfalls: tuple[str, ...] = ()
        rate = settings.control.markers_rate
        self._markers_period, self._markers_due = (1.0 / rate, -np.inf) if rate > 0.0 else (np.inf, np.inf)  # s
        self._scene = MarkerScene(model, qp.tasks, qp.contacts, 3.0 * self._markers_period)

    def publish_command(self, result: CycleResult) -> None:
        """Send torques and contact wrenches."""
        command, publish, wrenches = result.command, self._publish, self._subscribed["contact_wrench"]
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
                    payload = self._wrenches[name].write(stamp, self._contacts[name].basis.dot(force))
                    publish["contact_wrench", name](payload)

    def publish_zeros(self) -> None:
        """Send zero torques after a failure, as serialized at the start."""
        self._publish["effort", ""](self._zeros)

    def publish_report(self, report: CycleReport, now: float, wall: int) -> None:
        """Send a changed mode, and compose due messages at the time `now`, s; `wall` is the time of headers, ns."""
        mode, fault, walker = report.mode, report.fault, self._walker
        if mode is not self._published_mode or (fault is not self._published_fault and fault != self._published_fault):
            self._published_mode, self._published_fault = mode, fault
            text = mode.value if fault is None else f"{mode.value} {fault.code}: {fault.sentence}"
            self._send("state", message("std_msgs/msg/String", data=text))
        if walker is not None and walker.footsteps_left != self._published_footsteps:
            self._published_footsteps = walker.footsteps_left
            self._send("walk_footsteps_left", message("std_msgs/msg/Int32", data=self._published_footsteps))
        self._summary.add(report)
        if report.refused or report.contested != self._published_contested:
            self._diagnostics_requested, self._published_contested = True, report.contested
        period = self._diagnostics_period
        if period < _UNREAD_PERIOD and not self._subscribed["diagnostics"]:
            period = _UNREAD_PERIOD
        requested = self._diagnostics_requested and "diagnostics" not in self._composed
        if requested or now - self._diagnostics_begun >= period:
            self._diagnostics_requested, self._diagnostics_begun = False, now
            self._begin("diagnostics", self._summary.compose(wall, self._shortfalls))
        if now >= self._query_due:
            self._query_due = now + _QUERY_PERIOD
            found = [(topic.key, topic.subject) for topic in self._on_demand if self._has_reader(topic)]
            self._subscribed = {key: tuple(subject for of, subject in found if of == key) for key in _ON_DEMAND}
        if report.result.state is not None:
            self._publish_tasks(now, report.result, report.result.state)
            if now >= self._markers_due:
                self._markers_due = now + self._markers_period
                if self._subscribed["markers"]:
                    plan = None if walker is None or report.solution is None else walker.plan()
                    drawing = self._scene.compose(report.result.state, report.result.references, report.solution, plan)
                    self._begin("markers", drawing)
        self.compose()

    def _publish_tasks(self, now: float, result: CycleResult, state: RobotState) -> None:
        """Send value and reference of the next task with a subscription, and update the shortfalls of all tasks."""
        references, solution, dynamics = result.references, result.solution, result.qp.dynamics
        if references is None or solution is None:
            self._shortfalls = ()
            return
        if now >= self._tasks_due:
            self._tasks_due = now + self._diagnostics_period
            self._tasks.begin({*self._subscribed["task_reference"], *self._subscribed["task_value"]})
            self._shortfalls = self._shortfall.sentences(now, dynamics, references, solution)
        states = self._tasks.next(state.stamp, dynamics, references)
        if states is not None:
            for key, content in states[1].items():
                self._publish[key, states[0]](content)

    def compose(self) -> None:
        """Compose one piece of the oldest unfinished message."""
        for key, steps in self._composed.items():
            if next(steps, self) is self:
                del self._composed[key]
            return

    def finish(self) -> None:
        """Compose all remaining pieces."""
        while self._composed:
            self.compose()

    def _begin(self, key: str, content: Generator[None, None, Any]) -> None:
        for _ in self._composed.pop(key, ()):
            pass
        self._composed[key] = self._compose_and_send(key, content)

    def _compose_and_send(self, key: str, content: Generator[None, None, Any]) -> Generator[None, None, None]:
        composed = yield from content
        if composed is not None:
            yield
            self._send(key, composed)

    def _send(self, key: str, content: object) -> None:
        self._publish[key, ""](encode(content))
