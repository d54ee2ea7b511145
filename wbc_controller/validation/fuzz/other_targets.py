"""Guard, base estimator, mock robot and wait for a URDF as targets."""

import threading
from typing import Any

import numpy as np

from wbc_controller.controller.build.guard import make_guard_damping
from wbc_controller.controller.build.robot_description import describe
from wbc_controller.errors import WbcError
from wbc_controller.estimation.absolute_pose import AGREEMENT_TIME
from wbc_controller.middleware import topics
from wbc_controller.middleware.codec import decode, message
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.estimator_service import EstimatorService
from wbc_controller.nodes.guard_service import GuardService
from wbc_controller.nodes.urdf import wait_for_urdf
from wbc_controller.records import Array
from wbc_controller.safety.guard import GuardMode
from wbc_controller.settings import NODE_NAME
from wbc_controller.settings.config import load
from wbc_controller.simulation.mock_robot import MockRobot
from wbc_controller.simulation.plant import Plant
from wbc_controller.simulation.sensors import STREAMS, Measurement
from wbc_controller.validation.fuzz.target import (
    CYCLE_LIMIT,
    READ_LIMIT,
    InvariantViolation,
    Target,
    check_torques,
    fuzzed_robot,
    time_limit,
    valid_message,
)

_MESSAGES_PER_SILENCE = 25  # messages
_SILENT_PERIODS = 40  # periods, above the guard's patience
_MESSAGES_PER_RESET = 100  # messages
_ALL_DIAGNOSTICS = {"control.diagnostics_rate": 1000.0}  # in every cycle
_SETTLING = 0.1  # of the estimator, s; short for short episodes
_POSE_PERIOD = 0.05  # time between two states during the first absolute poses, s; below IMU gaps


class GuardTarget(Target):
    """The guard beside a controller with silences."""

    def __init__(self, robot: str) -> None:
        settings, self._model = fuzzed_robot(robot)
        settings = load(settings).replace(_ALL_DIAGNOSTICS).settings
        description = describe(self._model.urdf, settings.robot)
        self._limits = description.effort_limits
        opened = topics.endpoints(topics.GUARD_TOPICS, topics.GUARD_NODE)
        super().__init__(opened, ("effort", "diagnostics"))
        damping = make_guard_damping(settings, self._model)
        self._guard = GuardService(settings, description, damping, opened, MemoryTransport(self.bus), self.clock)
        self._period = 1.0 / settings.control.rate
        self._step = settings.limits.torque_rate * self._period * self._limits
        self._count = 0
        self._command()
        self._cycle("the start")

    def example(self, topic: topics.Endpoint) -> Any:
        """See `Target`."""
        content = valid_message(topic.type, self._model.joints, "", round(1e9 * self.clock.time))
        if topic.key == "controller_state":
            content.data = "active"
        return content

    def deliver(self, topic: topics.Endpoint, payload: bytes) -> None:
        """Deliver a message between a joint state and the command after it."""
        guard, mode = self._guard.guard, self._guard.guard.mode
        self.clock.time += self._period
        self._send("joint_states")
        with time_limit(READ_LIMIT, f"reading {len(payload)} bytes on {topic.name}"):
            self.publish(topic, payload)
        self._command()
        self._cycle(f"a message on {topic.name}")
        refused = self.refused().get(topic.key)
        if refused and guard.mode is not mode:
            raise InvariantViolation(f"a refused message ({refused}) changed the guard's mode to {guard.mode.value}")
        self._count += 1
        if self._count % _MESSAGES_PER_SILENCE == 0:
            self.finish()

    def finish(self) -> None:
        """Let the controller fall silent, and return."""
        self.send("controller_state", message("std_msgs/msg/String", data="active"))
        self._command()
        self._cycle("commands")
        guard, takeovers = self._guard.guard, self._guard.guard.takeovers
        for _ in range(_SILENT_PERIODS):
            self.clock.time += self._period
            self._send("joint_states")
            self._cycle("silence")
        if guard.takeovers != takeovers + 1:
            periods = f"{_SILENT_PERIODS} periods after a command"
            raise InvariantViolation(f"guard {guard.mode.value} {periods}; required: takeover")
        self._command()
        self._cycle("the return")
        if guard.mode is not GuardMode.WATCHING:
            raise InvariantViolation(f"the guard is {guard.mode.value} after a new command: {guard.reason}")

    def _send(self, key: str) -> None:
        self.send(key, self.example(self.by_key[key]))

    def _command(self) -> None:
        self._send("joint_commands")
        self._tau: Array = np.zeros(self._model.na)

    def _cycle(self, why: str) -> None:
        self.clear_outputs()
        with time_limit(CYCLE_LIMIT, f"the guard's cycle after {why}"):
            self._guard.cycle()
        if self.outputs["effort"] and why.startswith("a message"):
            raise InvariantViolation(f"the guard sent torques despite commands, after {why}")
        for payload in self.outputs["effort"]:
            tau: Array = np.asarray(decode(payload, self.types["effort"]).data)
            check_torques(tau, self._tau, self._limits, self._step, "the guard")
            self._tau = tau


class EstimatorTarget(Target):
    """Estimator of a standing robot with continuous sensors between the messages."""

    def __init__(self, robot: str) -> None:
        settings, self._model = fuzzed_robot(robot)
        changes = {**_ALL_DIAGNOSTICS, "estimation.settling": _SETTLING, "estimation.absolute_pose": True}
        settings = load(settings).replace(changes).settings
        opened = topics.endpoints(topics.ESTIMATOR_TOPICS, topics.ESTIMATOR_NODE, settings)
        super().__init__(opened, ("odom", "diagnostics"))
        self._node = EstimatorService(settings, self._model, opened, MemoryTransport(self.bus), self.clock)
        self._period = 1.0 / settings.control.rate
        self._standing = Measurement(self._model, Plant(self._model, settings), 0, self._node.estimator.imu_frame)
        for _ in range(round(2.0 * _SETTLING / self._period)):
            self._advance("the start")
        for _ in range(round(AGREEMENT_TIME / _POSE_PERIOD) + 2):
            self.clock.time += _POSE_PERIOD - self._period
            self.send("pose", self._sensed("pose"))
            self._advance("the start of poses")
        self.alive = self._node.estimator.base is not None
        if not self.alive:
            raise InvariantViolation(f"no estimate: {self._node.estimator.waits_for}")

    def example(self, topic: topics.Endpoint) -> Any:
        """See `Target`."""
        if topic.key in STREAMS:
            return self._sensed(topic.key)
        return valid_message(topic.type, self._model.joints, "", round(1e9 * self.clock.time))

    def deliver(self, topic: topics.Endpoint, payload: bytes) -> None:
        """Deliver a message between the sensors' messages."""
        what = f"a message on {topic.name}"
        self.clock.time += 0.5 * self._period
        self.publish(topic, payload)
        answers = self._cycle(what)
        refused = "; ".join(self.refused().values())
        if refused and answers:
            raise InvariantViolation(f"{what} was refused ({refused}), but an estimate was published")
        self._advance(f"the cycle after {what}")
        self.alive = self._node.estimator.odometry is not None

    def finish(self) -> None:
        """Execute one more period."""
        self._advance("the end")

    def _sensed(self, stream: str) -> Any:
        self._standing.stamps = dict.fromkeys(STREAMS, round(1e9 * self.clock.time))
        return self._standing.message(stream)

    def _advance(self, what: str) -> None:
        self.clock.time += self._period
        for stream in ("imu", "joint_states"):
            self.send(stream, self._sensed(stream))
        self._cycle(what)

    def _cycle(self, what: str) -> int:
        self.clear_outputs()
        with time_limit(CYCLE_LIMIT, what):
            self._node.cycle()
        for payload in self.outputs["odom"]:
            odom = decode(payload, self.types["odom"])
            pose, twist = odom.pose.pose, odom.twist.twist
            numbers = [getattr(part, axis) for part in (pose.position, twist.linear, twist.angular) for axis in "xyz"]
            turned = np.array([getattr(pose.orientation, axis) for axis in "xyzw"])
            if not (np.isfinite(numbers).all() and abs(float(turned @ turned) - 1.0) < 1e-6):
                raise InvariantViolation(f"{what}: invalid pose or twist of the estimate: {numbers}, {turned.tolist()}")
            for covariance in (odom.pose.covariance, odom.twist.covariance):
                variances = covariance.reshape(6, 6).diagonal()
                if not (np.isfinite(covariance).all() and (variances >= 0.0).all()):
                    raise InvariantViolation(
                        f"{what}: invalid covariance of the estimate: variances {variances.tolist()}"
                    )
        return len(self.outputs["odom"])


class MockTarget(Target):
    """Two mock robots on the same topics: in real time with torques on ``effort``, and in lockstep."""

    def __init__(self, robot: str) -> None:
        self._settings, self._model = fuzzed_robot(robot)
        super().__init__(topics.endpoints(topics.MOCK_TOPICS, topics.MOCK_NODE, self._settings))
        self._robots = [
            MockRobot(self._model, self._settings, MemoryTransport(self.bus), lockstep=lockstep)
            for lockstep in (False, True)
        ]
        self._stop = threading.Event()
        self._stop.set()  # so that nothing waits for an answer
        self._start = self._robots[0].plant.state()
        self._count = 0

    def example(self, topic: topics.Endpoint) -> Any:
        """See `Target`."""
        frame = self._model.base_link if topic.key == "push" else ""
        return valid_message(topic.type, self._model.joints, frame, self._robots[1].stamp)

    def deliver(self, topic: topics.Endpoint, payload: bytes) -> None:
        """Deliver a message, and simulate a period."""
        with time_limit(READ_LIMIT, f"reading {len(payload)} bytes on {topic.name}"):
            self.publish(topic, payload)
            self._robots[1].wait_for_answer(self._stop)
        for robot in self._robots:
            try:
                robot.advance()
            except WbcError:  # valid pushes may diverge
                self.alive = False
                return
            q, v = robot.plant.state()
            if not (np.isfinite(q).all() and np.isfinite(v).all()):
                raise InvariantViolation(f"the mock robot's state is not finite after a message on {topic.name}")
            limits = robot.plant.effort_limits
            tau = robot.plant.applied_torques
            check_torques(tau, tau, limits, limits, f"the mock robot, after a message on {topic.name},")
        self._count += 1
        if self._count % _MESSAGES_PER_RESET == 0:
            for robot in self._robots:
                robot.plant.set_state(*self._start)

    def finish(self) -> None:
        """Publish the states."""
        for robot in self._robots:
            robot.publish()


class UrdfTarget(Target):
    """A node that waits for its URDF: every message is refused or returned unchanged."""

    def __init__(self, robot: str) -> None:
        row = [topic for topic in topics.CONTROLLER_TOPICS if topic.key == "robot_description"]
        super().__init__(())
        self.topics = {topic.name: topic for topic in topics.endpoints(row, NODE_NAME)}
        self._stop = threading.Event()
        self._stop.set()

    def example(self, topic: topics.Endpoint) -> Any:
        """Return a small URDF."""
        return message(topic.type, data="<robot name='r'><link name='a'/></robot>")

    def deliver(self, topic: topics.Endpoint, payload: bytes) -> None:
        """Publish a URDF, and wait for it."""
        bus = MemoryBus()
        MemoryTransport(bus).advertise(topics.counterpart(topic))(payload)
        with time_limit(READ_LIMIT, f"reading {len(payload)} bytes on {topic.name}"):
            text = wait_for_urdf(MemoryTransport(bus), self._stop, [topic])
        if text and text != decode(payload, topic.type).data:
            raise InvariantViolation("the node received another URDF than the published one")
