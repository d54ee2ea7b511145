"""The controller as a target of the fuzzer: the service's loop in lockstep with a mock robot on the hoist."""

import dataclasses
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from wbc_controller.controller.report import CycleReport, LatchedInputs, UserRequests
from wbc_controller.inverse_dynamics.references.changes import SetTrajectory
from wbc_controller.middleware.codec import decode, encode, message
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.nodes.inputs import Inputs
from wbc_controller.nodes.wiring import controller_endpoints, make_vocabulary
from wbc_controller.records import Array, Mode
from wbc_controller.validation.fuzz.examples import ordinary
from wbc_controller.validation.fuzz.target import (
    CYCLE_LIMIT,
    READ_LIMIT,
    Broken,
    Target,
    check_torques,
    fuzzed_robot,
    within,
)
from wbc_controller.validation.lockstep import Lockstep

#: Topics whose messages count in the cycle that they come in.
_STATES = ("joint_states", "odom", "clock")
#: Refused messages that one cycle gets.
_BATCH = 16
#: Cycles after the activation until the torques have settled.
_SETTLE = 8


class _Gate:
    """Inputs of a loop in which each message is read on arrival, and passes if and when the fuzzer says so."""

    def __init__(self, inputs: Inputs) -> None:
        self._inputs = inputs
        self.passed: list[LatchedInputs] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inputs, name)

    def read(self) -> LatchedInputs:
        """Read the messages since the last call."""
        return self._inputs.latch()

    def latch(self, holding: Collection[str], *, controlled: bool) -> LatchedInputs:
        """Return the newest state and the passed requests; as `Inputs.latch`."""
        passed, self.passed = [*self.passed, self._inputs.latch(holding, controlled=controlled)], []
        requests = [latched.requests for latched in passed]
        return dataclasses.replace(
            passed[-1],
            refused_states=tuple(sentence for latched in passed for sentence in latched.refused_states),
            requests=UserRequests(
                commands=tuple(word for taken in requests for word in taken.commands),
                changes=tuple(change for taken in requests for change in taken.changes),
                refused=tuple(sentence for taken in requests for sentence in taken.refused),
                total=requests[-1].total,
            ),
        )


class ControllerTarget(Target):
    """The controller's loop, active, with a user who sends any message.

    Each message is read by itself, as the reader of requests does. A cycle gets several refused messages together, and
    must not change any reference, setting or mode. It gets messages that it may refuse in the end one by one.
    """

    def __init__(self, robot: str) -> None:
        """Build the controller and its robot, and activate it."""
        fuzzed = fuzzed_robot(robot)
        super().__init__(controller_endpoints(fuzzed.settings, fuzzed.model), ("effort",))
        self._robot = Lockstep(fuzzed.settings, model=fuzzed.model, bus=self.bus, use_sim_time=True)
        self._settings, self._model = fuzzed.settings, fuzzed.model
        self._mock, self._controller, self._loop = self._robot.mock, self._robot.controller, self._robot.loop
        self._vocabulary = make_vocabulary(self._settings, self._model)
        self._gate = _Gate(self._loop._inputs)
        self._loop._inputs = self._gate  # type: ignore[assignment]  # it delegates all other attributes
        self._step = self._settings.limits.torque_rate * self._controller.period * self._model.effort_limits
        self._tau = np.zeros(self._model.na)
        self._refused: list[LatchedInputs] = []
        self._accepted: list[LatchedInputs] = []
        self._disturbed = False
        self._start()

    def _start(self) -> None:
        for _ in range(3):  # the odometry and the joint states have to come before an activation
            self._cycle("the start", publish=True)
        self.take(self.by_key["command"], encode(message("std_msgs/msg/String", data="activate")))
        self.finish()
        for _ in range(_SETTLE):
            self._cycle("the start", publish=True)
        if self._controller.mode is not Mode.ACTIVE:
            raise Broken(f"the robot cannot be activated: {self._controller.mode.value} {self._controller.fault}")
        self._disturbed = False

    def example(self, topic: Endpoint) -> Any:
        """An ordinary message of a topic, valid now."""
        names: Any = self._vocabulary.joints.get(topic.subject, self._model.joints)
        # Between two states of the robot, so that it is newer than the last one and older than the next.
        stamp = self._mock.stamp + round(0.5e9 * self._controller.period) if topic.key in _STATES else 0
        frame = self._vocabulary.reference_frames.get(topic.subject, "world")
        content = ordinary(topic.type, names, frame, stamp)
        if topic.key == "joint_states":
            content.position = np.array(self._mock.plant.state()[0][self._model.q_index])
        elif topic.key == "odom":
            content.child_frame_id = self._model.base_link
            q = self._mock.plant.state()[0]
            pose = content.pose.pose
            pose.position.x, pose.position.y, pose.position.z = q[:3].tolist()
        elif topic.key == "clock":
            content.clock.sec, content.clock.nanosec = divmod(stamp, 1_000_000_000)
        elif topic.key == "weight":
            content.data = 1.0
        return content

    def take(self, topic: Endpoint, payload: bytes) -> None:
        """Deliver a message; see `Target`."""
        state = topic.key in _STATES
        if state:
            self.finish()
            self._mock.publish()
            self._gate.passed.append(self._gate.read())
        limit = CYCLE_LIMIT if state else READ_LIMIT
        now = self._robot.clock.now()
        with within(limit, f"reading {len(payload)} bytes on {topic.name}"):
            self.publish(topic, payload)
            latched = self._gate.read()
        if self._robot.clock.now() != now:
            self._disturbed = True
        if latched.refused and (latched.requests.commands or latched.requests.changes):
            raise Broken(f"a message on {topic.name} was refused, and is used all the same: {latched.refused}")
        if latched.refused:
            self._refused.append(latched)
        elif state:
            self._disturbed = True
        else:
            self._accepted.append(latched)
        if state:
            self._see_refused(publish=False)
        elif len(self._refused) + len(self._accepted) >= _BATCH:
            self.finish()

    def finish(self) -> None:
        """Run the cycles of the messages that have been read; see `Target`."""
        if self._refused:
            self._see_refused(publish=True)
        alone = [each for each in self._accepted if each.requests.commands or _may_be_late(each)]
        together = [each for each in self._accepted if not (each.requests.commands or _may_be_late(each))]
        self._accepted = []
        for batch in [*([each] for each in alone), *([together] if together else [])]:
            self._gate.passed += batch
            before, mode = self._parts(), self._controller.mode
            report = self._cycle("messages that were read", publish=True)
            late = [
                sentence for sentence in report.refused if not sentence.startswith("/")
            ]  # others begin with a topic
            if len(late) == sum(len(each.requests.commands) + len(each.requests.changes) for each in batch):
                self._see_unchanged(before, mode, report)  # refused after all, by what they met
            else:
                self._disturbed = True

    def _see_refused(self, publish: bool) -> None:
        """Run one cycle with all that was refused, in which nothing may change."""
        self._gate.passed += self._refused
        self._refused = []
        before, mode = self._parts(), self._controller.mode
        self._see_unchanged(before, mode, self._cycle("messages that were refused", publish))

    def _see_unchanged(self, before: Mapping[str, Any], mode: Mode, report: CycleReport) -> None:
        after = self._parts()
        changed = [key for key in before.keys() | after.keys() if before.get(key) is not after.get(key)]
        if changed:
            raise Broken(f"refused messages changed {', '.join(sorted(changed))}; {report.refused}")
        if report.mode is not mode and not self._disturbed:
            raise Broken(f"refused messages led from {mode.value} to {report.mode.value} ({report.fault})")

    def _parts(self) -> dict[str, Any]:
        """All that a message may change, each as the object that it is."""
        controller = self._controller
        parts: dict[str, Any] = {
            "settings": controller.live.settings,
            "live settings": controller.live.newest,
            "supervisor.limits": controller.supervisor.limits,
        }
        for key, value in vars(controller.board).items():
            if key in controller.board.SAMPLE_CACHE:
                continue
            if isinstance(value, Mapping):
                parts |= {f"board{key}.{name}": entry for name, entry in value.items()}
            else:
                parts[f"board{key}"] = value
        return parts

    def _cycle(self, why: str, publish: bool) -> CycleReport:
        """Run one cycle of the robot and the controller, and see that all holds that must hold."""
        if publish:
            self._mock.publish()
        self.forget()
        with within(CYCLE_LIMIT, f"the cycle of {why}"):
            report = self._loop.cycle()
        self._mock.advance()
        if report.fault is not None and report.fault.code == "INTERNAL_ERROR":
            raise Broken(f"{why} led to {report.fault.code}: {report.fault.sentence}")
        stopped = report.fault is not None and report.fault.code == "ESTOP"
        for payload in self.heard["effort"]:
            tau: Array = np.asarray(decode(payload, self.types["effort"]).data)
            step = np.full(self._model.na, np.inf) if stopped and not tau.any() else self._step
            check_torques(tau, self._tau, self._model.effort_limits, step, f"the controller, at {why},")
            self._tau = tau
        self.alive = report.mode in (Mode.ACTIVE, Mode.HOLDING) or not self._disturbed
        return report


def _may_be_late(latched: LatchedInputs) -> bool:
    """Whether a cycle may find that a trajectory is over."""
    return any(isinstance(change, SetTrajectory) for changes in latched.requests.changes for change in changes)
