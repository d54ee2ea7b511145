"""Controller with a mock robot as a target."""

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from wbc_controller.controller.report import CycleReport, LatchedInputs
from wbc_controller.inverse_dynamics.references.changes import SetTrajectory
from wbc_controller.middleware.codec import decode, encode, message
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.nodes.lockstep import Lockstep
from wbc_controller.nodes.wiring import controller_endpoints, make_vocabulary
from wbc_controller.records import IN_CONTROL, Array, Mode
from wbc_controller.validation.campaign.monitor import ZEROS_AT_ONCE
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

_STATES = ("joint_states", "odom", "clock")  # read by the cycle itself
_BATCH = 16  # number of refused messages per cycle
_SETTLING_CYCLES = 8  # cycles from the activation to settled torques


class ControllerTarget(Target):
    """Active control loop, and a user with any message.

    Each message is read alone. Refused messages reach a cycle together, and must not change references, settings or
    mode.
    """

    def __init__(self, robot: str) -> None:
        self._settings, self._model = fuzzed_robot(robot)
        super().__init__(controller_endpoints(self._settings, self._model), ("effort",))
        self._robot = Lockstep(self._settings, model=self._model, bus=self.bus, use_sim_time=True)
        self._mock, self._controller, self._loop = self._robot.mock, self._robot.controller, self._robot.loop
        self._vocabulary = make_vocabulary(self._settings, self._model)
        self._latch = self._loop._inputs.latch
        self._loop._inputs.latch = self._latch_passed  # type: ignore[method-assign]
        self._passed: list[LatchedInputs] = []  # for the next cycle
        self._step = self._settings.limits.torque_rate * self._controller.period * self._model.effort_limits
        self._tau = np.zeros(self._model.na)
        self._refused: list[LatchedInputs] = []
        self._accepted: list[LatchedInputs] = []
        self._disturbed = False
        self._start()

    def _latch_passed(self, *arguments: Any, **options: Any) -> LatchedInputs:
        """Return the newest state and the requests of all passed messages, as `Inputs.latch`."""
        newest = self._latch(*arguments, **options)
        passed, self._passed = [*self._passed, newest], []
        joined: dict[str, Any] = {
            key: tuple(item for latched in passed for item in getattr(latched.requests, key))
            for key in ("commands", "changes", "refused")
        }
        refused_states = tuple(sentence for latched in passed for sentence in latched.refused_states)
        return dataclasses.replace(newest, refused_states=refused_states, requests=newest.requests._replace(**joined))

    def _start(self) -> None:
        for _ in range(3):  # odometry and joint states are required for the activation
            self._cycle("the start", publish=True)
        self.deliver(self.by_key["command"], encode(message("std_msgs/msg/String", data="activate")))
        self.finish()
        for _ in range(_SETTLING_CYCLES):
            self._cycle("the start", publish=True)
        if self._controller.mode is not Mode.ACTIVE:
            raise InvariantViolation(f"activation failed: {self._controller.mode.value} {self._controller.fault}")
        self._disturbed = False

    def example(self, topic: Endpoint) -> Any:
        """See `Target`."""
        names: Any = self._vocabulary.joints.get(topic.subject, self._model.joints)
        # Stamp between two states of the robot.
        stamp = self._mock.stamp + round(0.5e9 * self._controller.period) if topic.key in _STATES else 0
        frame = self._vocabulary.reference_frames.get(topic.subject, "world")
        content = valid_message(topic.type, names, frame, stamp)
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

    def deliver(self, topic: Endpoint, payload: bytes) -> None:
        """See `Target`."""
        state = topic.key in _STATES
        if state:
            self.finish()
            self._mock.publish()
            self._passed.append(self._latch())
        now = self._robot.clock.now()
        with time_limit(CYCLE_LIMIT if state else READ_LIMIT, f"reading {len(payload)} bytes on {topic.name}"):
            self.publish(topic, payload)
            latched = self._latch()
        self._disturbed |= self._robot.clock.now() != now
        if latched.refused and (latched.requests.commands or latched.requests.changes):
            raise InvariantViolation(f"a refused message on {topic.name} was used: {latched.refused}")
        if latched.refused:
            self._refused.append(latched)
        elif state:
            self._disturbed = True
        else:
            self._accepted.append(latched)
        if state:
            self._check_refused(publish=False)
        elif len(self._refused) + len(self._accepted) >= _BATCH:
            self.finish()

    def finish(self) -> None:
        """Run the cycles of the delivered messages."""
        if self._refused:
            self._check_refused(publish=True)
        alone = [[each] for each in self._accepted if _is_alone(each)]
        together = [each for each in self._accepted if not _is_alone(each)]
        self._accepted = []
        for batch in filter(None, [*alone, together]):
            self._passed += batch
            before, mode = self._parts(), self._controller.mode
            report = self._cycle("messages that were read", publish=True)
            # Sentences of the reading begin with a topic.
            late = [sentence for sentence in report.refused if not sentence.startswith("/")]
            if len(late) == sum(len(each.requests.commands) + len(each.requests.changes) for each in batch):
                self._check_unchanged(before, mode, report)  # refused by the cycle
            else:
                self._disturbed = True

    def _check_refused(self, publish: bool) -> None:
        self._passed, self._refused = self._passed + self._refused, []
        before, mode = self._parts(), self._controller.mode
        self._check_unchanged(before, mode, self._cycle("messages that were refused", publish))

    def _check_unchanged(self, before: Mapping[str, Any], mode: Mode, report: CycleReport) -> None:
        after = self._parts()
        changed = [key for key in before.keys() | after.keys() if before.get(key) is not after.get(key)]
        if changed:
            raise InvariantViolation(f"refused messages changed {', '.join(sorted(changed))}; {report.refused}")
        if report.mode is not mode and not self._disturbed:
            raise InvariantViolation(f"refused messages led from {mode.value} to {report.mode.value} ({report.fault})")

    def _parts(self) -> dict[str, Any]:
        controller = self._controller
        parts: dict[str, Any] = {"settings": controller.live.settings, "live settings": controller.live.newest}
        for key, value in vars(controller.board).items():
            if key in (*controller.board.SAMPLE_CACHE, "forces"):  # forces are those of the last solution
                continue
            if isinstance(value, Mapping):
                parts |= {f"board{key}.{name}": entry for name, entry in value.items()}
            else:
                parts[f"board{key}"] = value
        return parts

    def _cycle(self, why: str, publish: bool) -> CycleReport:
        if publish:
            self._mock.publish()
        self.clear_outputs()
        with time_limit(CYCLE_LIMIT, f"the cycle of {why}"):
            report = self._loop.cycle()
        self._mock.advance()
        if report.fault is not None and report.fault.code == "INTERNAL_ERROR":
            raise InvariantViolation(f"{why} led to {report.fault.code}: {report.fault.sentence}")
        stopped = report.fault is not None and report.fault.code in ZEROS_AT_ONCE
        for payload in self.outputs["effort"]:
            tau: Array = np.asarray(decode(payload, self.types["effort"]).data)
            step = np.full(self._model.na, np.inf) if stopped and not tau.any() else self._step
            check_torques(tau, self._tau, self._model.effort_limits, step, f"the controller, at {why},")
            self._tau = tau
        self.alive = report.mode in IN_CONTROL or not self._disturbed
        return report


def _is_alone(latched: LatchedInputs) -> bool:
    changes = itertools.chain.from_iterable(latched.requests.changes)
    return bool(latched.requests.commands) or any(isinstance(change, SetTrajectory) for change in changes)
