"""Mock robot on the topics `MOCK_TOPICS`.

`MockRobot.run` runs in real time or in lockstep. On one thread, alternate `publish`, the controller, and `advance`.
"""

import gc
import logging
import math
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from wbc_controller.controller.build.estimation import imu_frame
from wbc_controller.errors import ConfigurationError, InputRefused
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware import codec as messages
from wbc_controller.middleware.codec import transform, wrench_stamped
from wbc_controller.middleware.log_limit import LogLimit
from wbc_controller.middleware.topics import MOCK_NODE, MOCK_TOPICS, Direction, Endpoint, endpoints
from wbc_controller.middleware.transports.transport import Publish, Stream, Transport
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.simulation.faults.catalogue import read_faults
from wbc_controller.simulation.faults.fault import Fault, Injector
from wbc_controller.simulation.plant import Plant
from wbc_controller.simulation.sensors import PARTS, STREAMS, WORLD_FRAME, ImperfectSensors, Measurement, PoseSource

SLOW_RATE = 100.0  # rate of contact wrenches and transform for viewers, Hz of simulated time
REPUBLISH_AFTER = 0.05  # wall time between repetitions of an unanswered state in lockstep, s
MAX_LATE = 0.2  # lateness that restarts the real-time schedule, s
_SWITCH_INTERVAL = 1.0e-4  # switch interval of the interpreter, s: torques must not wait for the physics
#: Simulated time without torques before a patient robot waits, s, and wall time of the wait, s.
LEAST_LEAD, PATIENCE = 0.01, 3.0
_WINDOW = 5.0  # averaging time of the speed, s of wall time
_LOW, _ENOUGH = 0.9, 0.95  # shares of the requested speed with hysteresis: too low, sufficient again

#: Places of faults that are incompatible with lockstep.
_NOT_IN_LOCKSTEP = ("delivery", "delivery of commands", "stamps and clock")

_log = logging.getLogger(__name__)


class MockRobot:
    """Publishes the plant's state every control period, and applies the controller's torques."""

    def __init__(
        self,
        model: RobotModel,
        settings: Settings,
        transport: Transport,
        *,
        real_time_factor: float = 1.0,
        lockstep: bool = False,
        patient: bool = False,
        clock: Callable[[], float] = time.monotonic,
        namespace: str = "/",
        remappings: Mapping[str, str] | None = None,
    ) -> None:
        """Build the plant, open the topics and publish the robot's description.

        Args:
            real_time_factor: simulated seconds per second; unused in lockstep.
            lockstep: wait for the ``joint_commands`` of each state instead of using the newest ``effort``.
            patient: simulated time waits for a late controller.
            remappings: as in `middleware.topics.resolve`.
        """
        if not (0.0 < real_time_factor < float("inf")):
            raise ConfigurationError(f"real-time factor {real_time_factor} must be positive and finite")
        self.plant = Plant(model, settings)
        self.faults = Injector(model, self.plant, 1.0 / settings.control.rate)
        self.sent: Callable[[str, int], None] | None = None  # called with stream and true time, ns, of each message
        self.rebased = 0  # number of restarts of the schedule
        self._real_time_factor = real_time_factor
        self._robot = model
        self._mock = settings.mock
        self._lockstep, self._patient = lockstep, patient
        self._clock = clock
        self._period = 1.0 / settings.control.rate
        self._periods = 0
        # Brakes hold the joints until the first torques, or until the base is lowered.
        self._brakes = [self.plant.lock(joint) for joint in model.joints]
        parts, seed = PARTS.get(settings.mock.sensors), settings.mock.sensor_seed
        self._sensors = ImperfectSensors(parts, model, self._period, seed) if parts is not None else None
        self._imu_frame = imu_frame(settings, model)
        self.plant.body(self._imu_frame)  # raises for an unknown frame
        self._poses = PoseSource(settings, model) if settings.mock.pose_rate > 0.0 and model.floating_base else None
        self._slow_decimation = max(1, round(settings.control.rate / SLOW_RATE))
        self._tau: Array | None = None
        self._tau_time = 0.0
        self._answered_stamp = 0  # of the newest state with an answer in lockstep, ns
        self._last_torques = math.inf  # simulated time of the last torques; inf without a sender
        self._last_refusal: dict[str, str] = {}
        self._limit = LogLimit()
        # Filled by the transport's threads; bounded for a robot that waits.
        self._requests: deque[tuple[str, str, bytes]] = deque(maxlen=100)
        self._commands: Stream  # of joint commands in lockstep, else of efforts
        self._types: dict[str, str] = {}
        self._publishers: dict[tuple[str, str], Publish] = {}
        opened = endpoints(MOCK_TOPICS, MOCK_NODE, settings, namespace=namespace, remappings=remappings)
        for endpoint in opened:
            self._open(endpoint, transport)
        self.joint_states = next(endpoint for endpoint in opened if endpoint.key == "joint_states")
        self._publish("robot_description", "", messages.message("std_msgs/msg/String", data=model.urdf))

    @property
    def stamp(self) -> int:
        """Stamp of the present state, ns; starts at one period, as ROS reserves 0."""
        return round(self._period * 1e9) + self.plant.stamp

    def run(self, stop: threading.Event) -> None:
        """Run until the event is set, with absolute deadlines in real time."""
        gc.collect()
        gc.freeze()  # avoids long garbage collections
        switch_interval = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_INTERVAL)
        try:
            self._run(stop)
        finally:
            sys.setswitchinterval(switch_interval)

    def _run(self, stop: threading.Event) -> None:
        deadline = self._clock()
        self.speed = Speed(self._real_time_factor, self._clock, self.plant.time)
        while not stop.is_set():
            self.publish()
            if self._lockstep:
                if not self.wait_for_answer(stop):
                    return
            else:
                deadline += self._period / self._real_time_factor
                late = self._clock() - deadline
                if late > MAX_LATE:
                    deadline += late
                    self.rebased += 1
                elif late < 0.0:
                    stop.wait(-late)
                if self._patient:
                    self._wait_for_torques()
                self.speed.check(self.plant.time)
            self.advance()

    def _wait_for_torques(self) -> None:
        """Pause simulated time while torques after nonzero ones are late."""
        active = self._tau is not None and bool(self._tau.any())
        late = active and self.plant.time - self._last_torques >= max(LEAST_LEAD, 2.0 * self._period)
        if self._commands.wait(PATIENCE if late else 0.0):
            self._last_torques = self.plant.time
        elif late:
            self._last_torques = math.inf

    def publish(self) -> None:
        """Publish time and present state, the joint states last."""
        stamp, base = self.stamp, self._robot.base_link
        self.faults.update()
        measured = Measurement(self._robot, self.plant, stamp, self._imu_frame)
        measured.has_velocity = self._mock.joint_velocity
        if self._sensors is not None:
            self._sensors.measure(measured)
        if self._poses is not None:
            self._poses.measure(measured, self.plant.state()[0], self.plant.time)
        self.faults.distort(measured)
        for stream in STREAMS:
            payload = messages.encode(measured.message(stream)) if stream not in measured.silent else None
            delay = self._mock.pose_delay if stream == "pose" else 0.0
            for message in self.faults.deliver(stream, stamp, payload, delay):
                self._publishers[stream, ""](message.payload)
                if self.sent is not None:
                    self.sent(stream, message.true_time)
        if self._periods % self._slow_decimation == 0:
            if self._robot.floating_base:
                self._publish("tf", "", transform(stamp, WORLD_FRAME, base, self.plant.state()[0][:7]))
            for name, wrench in self.plant.contact_wrenches().items():
                frame = name if wrench.size == 6 else self.plant.contacts[name].against or WORLD_FRAME
                self._publish("contact_wrench", name, wrench_stamped(wrench, frame, stamp))

    def wait_for_answer(self, stop: threading.Event | None = None) -> bool:
        """Republish the state in lockstep until its command arrives; return False after `stop`."""
        due = self._clock() + REPUBLISH_AFTER
        while not self._answered():
            if stop is not None and stop.is_set():
                return False
            self._commands.wait(max(0.0, due - self._clock()))
            if self._clock() >= due:
                self.publish()
                due = self._clock() + REPUBLISH_AFTER
        return True

    def advance(self) -> None:
        """Process requests, apply the newest torques, and simulate one control period."""
        uses = {"push": self._push, "hold": self._hold, "fault": self._fault}
        for _ in range(len(self._requests)):
            key, contact, payload = self._requests.popleft()
            self._try(key, payload, uses.get(key, partial(self._grip, contact)))
        if not self._lockstep:
            newest = next(iter(self._commands.take()), None)
            for message in self.faults.deliver("effort", 0, newest)[-1:]:
                self._try("effort", message.payload, self._take_effort)
        if self._tau is not None and self.plant.time - self._tau_time <= self._mock.command_timeout:
            self._release_brakes()
            tau = self._tau if self._sensors is None else self._sensors.torques(self._tau)
            self.plant.apply(self.faults.torques(tau))
        else:
            self.plant.damp(self._mock.damping)
        for _ in range(self.plant.steps_per_period):
            self.plant.step()
        self._periods += 1

    def _release_brakes(self) -> None:
        for unlock in self._brakes:
            unlock()
        self._brakes = []

    def plan(self, faults: Sequence[Fault], since: float = 0.0) -> None:
        """Plan faults; their starts count from the simulated time `since`, s."""
        if self._lockstep:
            late = [fault.kind() for fault in faults if fault.place in _NOT_IN_LOCKSTEP]
            if late:
                raise InputRefused(
                    f"{', '.join(late)}: not possible in lockstep, which waits for an answer to each state; run faults "
                    f"of {', '.join(_NOT_IN_LOCKSTEP)} in real time"
                )
        self.faults.plan(faults, since)

    def _open(self, endpoint: Endpoint, transport: Transport) -> None:
        key = endpoint.key
        if endpoint.direction is Direction.OUT:
            if (key not in ("odom", "tf") or self._robot.floating_base) and (key != "pose" or self._poses is not None):
                self._publishers[key, endpoint.subject] = transport.advertise(endpoint)
            return
        self._types[key] = endpoint.type
        if key in ("push", "hold", "grip", "fault"):
            transport.subscribe(endpoint, lambda payload: self._requests.append((key, endpoint.subject, payload)))
        elif key == ("joint_commands" if self._lockstep else "effort"):
            self._commands = transport.stream(endpoint, 10 if self._lockstep else 1)

    def _publish(self, key: str, subject: str, content: Any) -> None:
        self._publishers[key, subject](messages.encode(content))

    def _try(self, key: str, payload: bytes, use: Callable[[Any], None]) -> None:
        try:
            use(messages.decode(payload, self._types[key]))
            self._last_refusal.pop(key, None)
        except InputRefused as error:
            torques = key in ("effort", "joint_commands")  # sent each period
            if torques:
                self._tau = None
            if self._last_refusal.get(key) != str(error) and (not torques or self._limit.passes(key)):
                self._last_refusal[key] = str(error)
                _log.warning("%s refused: %s", key, error)

    def _take_effort(self, content: Any) -> None:
        values, actuation = np.array(content.data, dtype=np.float64), self._robot.actuation
        if values.shape != (actuation.command_size,):
            what = "driven joint" if actuation.by_joint else "actuator"
            raise InputRefused(
                f"got {values.size} torques; expected {actuation.command_size}, one per {what} in their order"
            )
        self._command(actuation.from_command(values))

    def _take_answer(self, content: Any) -> None:
        if messages.nanoseconds(content.header.stamp) != self.stamp:
            return
        self._answered_stamp = self.stamp
        if len(content.name) != len(content.effort):
            raise InputRefused(f"got {len(content.effort)} efforts for {len(content.name)} names; expected one each")
        efforts = dict(zip(content.name, content.effort, strict=True))
        missing = [name for name in self._robot.joints if name not in efforts]
        if missing:
            raise InputRefused(f"the joints {', '.join(missing)} are missing; expected all {self._robot.nj} joints")
        torques = np.array([efforts[name] for name in self._robot.joints], dtype=np.float64)
        self._command(self._robot.actuation.from_joints(torques))

    def _command(self, tau: Array) -> None:
        self.plant.check_torques(tau)
        self._tau, self._tau_time = tau, self.plant.time

    def _answered(self) -> bool:
        for payload in self._commands.take():
            self._try("joint_commands", payload, self._take_answer)
        return self._answered_stamp == self.stamp

    def _push(self, content: Any) -> None:
        force, torque = content.wrench.force, content.wrench.torque
        wrench = [force.x, force.y, force.z, torque.x, torque.y, torque.z]
        self.plant.push(content.header.frame_id or self._robot.base_link, wrench, self._mock.push_duration)

    def _hold(self, content: Any) -> None:
        self.plant.hold(bool(content.data))
        if not content.data:
            self._release_brakes()

    def _grip(self, contact: str, content: Any) -> None:
        self.plant.grip(contact, bool(content.data))

    def _fault(self, content: Any) -> None:
        if content.data.strip() == "clear":
            self.faults.clear()
            return
        try:
            faults = read_faults(content.data, "faults")
        except ConfigurationError as error:
            raise InputRefused(str(error)) from error
        self.plan(faults, self.plant.time)


class Speed:
    """Comparison of simulated time and wall time; `factor` is the requested speed."""

    def __init__(self, factor: float, clock: Callable[[], float], simulated: float) -> None:
        """Start the measurement at a simulated time, s."""
        self._factor, self._clock = factor, clock
        self._low = False
        self._began = self._since = clock()
        self._first = self._simulated = simulated  # simulated time at the start, and of the window, s

    def check(self, simulated: float) -> None:
        """Log a change of the speed; called in each period."""
        now = self._clock()
        if now - self._since < _WINDOW:
            return
        speed = (simulated - self._simulated) / (now - self._since)
        self._since, self._simulated = now, simulated
        if speed < _LOW * self._factor and not self._low:
            self._low = True
            _log.warning(
                "the simulation runs at %.0f %% of real time instead of %.0f %%: this computer is too slow or busy, or"
                " a patient robot waits for its controller; use a smaller real_time_factor, or lockstep",
                100.0 * speed,
                100.0 * self._factor,
            )
        elif speed >= _ENOUGH * self._factor and self._low:
            self._low = False
            _log.info("the simulation runs at %.0f %% of real time again", 100.0 * speed)

    def mean(self, simulated: float) -> float:
        """Return the mean speed as a share of real time."""
        return (simulated - self._first) / max(self._clock() - self._began, 1.0e-9)
