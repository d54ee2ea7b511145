"""Inputs of a cycle: decoded, checked, latched.

- States wait in the transport until the loop's thread takes them; requests pass `nodes.requests`. Messages above their
  size limit are counted and dropped.
- A cycle decodes the newest joint state, odometry and contact sensors, and bounded numbers of requests, IMU samples and
  absolute poses.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from wbc_controller.controller.build.estimation import (
    make_contact_detector,
    make_odometry_agreement,
    make_velocity_filter,
)
from wbc_controller.controller.report import LatchedInputs
from wbc_controller.errors import InputRefused
from wbc_controller.estimation.absolute_pose import PoseSample
from wbc_controller.estimation.base_estimator import BaseEstimator
from wbc_controller.estimation.contact_detection import ContactDetector
from wbc_controller.estimation.running_estimate import ImuSample
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.references.changes import Change
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware import decoding, states
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.stamps import StampTracker
from wbc_controller.middleware.topics import CONTACT_SENSORS, Direction, Endpoint
from wbc_controller.middleware.transports.transport import Stream, Transport
from wbc_controller.nodes.clock import Clock
from wbc_controller.nodes.requests import Requests, refusal_reason
from wbc_controller.records import Array, ChangeSettings, Fault, RobotState
from wbc_controller.safety.checks import stale_inputs
from wbc_controller.safety.sample_plausibility import SampleCheck
from wbc_controller.settings import Settings

#: Largest state message, bytes, by row of the topic table.
_MAX_BYTES = {"joint_states": 1 << 18, "odom": 1 << 16, "imu": 1 << 16, "pose": 1 << 16}
_MAX_BYTES |= dict.fromkeys(CONTACT_SENSORS, 1 << 14)
_MAX_IMU_SAMPLES = 20  # newest of one cycle, for an IMU faster than the loop
_MAX_POSES = 4  # newest absolute poses of one cycle
_STATE_DEPTH = 10  # an oversized message must not displace a valid one
_NOT_LATCHED = ("robot_description", "clock", "record", "guard_commands")  # rows outside the control cycle
ESTIMATE = "base estimate"  # in the ages of the inputs
_PREEMPTED = 0.005  # age of taken joint states that indicates a preemption, s
_MIN_DELAY = 0.01  # smallest reported transit time, s


@dataclass(slots=True)
class _Input:
    """Topic of a state, with its waiting messages and newest sample."""

    topic: Endpoint
    stream: Stream
    pending: deque[tuple[float, bytes]]  # arrival, s, and serialized message
    stamps: StampTracker
    reader: states.StateReader | None  # None for a contact switch
    check: SampleCheck | None  # plausibility of the samples
    newest: Any = None


class Inputs:
    """Subscriptions of all incoming topics, latched at the start of each cycle.

    `prepare` validates a change; it raises `ConfigurationError` or `InputRefused`. `estimator` is None for odometry.
    """

    def __init__(
        self,
        settings: Settings,
        model: RobotModel,
        contacts: Mapping[str, Contact],
        vocabulary: decoding.Vocabulary,
        endpoints: Iterable[Endpoint],
        transport: Transport,
        clock: Clock,
        prepare: Callable[[Change | ChangeSettings], None] = lambda change: None,
        *,
        estimator: BaseEstimator | None = None,
    ) -> None:
        safety, estimated = settings.safety, estimator is not None
        self._model = model
        self._clock = clock
        self.requests = Requests(vocabulary, prepare, self.wake)
        self._woken = False
        #: Largest lead of a timestamp over the clock, s; None without synchronized clocks.
        self.clock_tolerance = safety.clock_tolerance if safety.synchronized_clocks else None
        self._velocity_filter = velocity_filter = make_velocity_filter(settings)
        self.estimator = estimator
        self._agreement = None if estimated else make_odometry_agreement(settings, model, contacts)
        self._imu: list[ImuSample] = []  # since the last estimate
        self._poses: list[PoseSample] = []
        self._base: tuple[Array, Array] | None = None  # pose and twist of the last cycle
        self._detector = ContactDetector({}, 0.0, 0.0, 0.0)  # without sensors
        if estimated:
            self._detector = make_contact_detector(settings, model, contacts)
        self.holding: Collection[str] = ()  # active contacts of the base estimate in the last cycle
        self._refusals: dict[str, str] = {}  # by topic with a refused newest message
        self.shared: Callable[[], Mapping[str, str]] = dict  # publishers of inputs with several, by topic name
        columns = ("position", "velocity") if velocity_filter is None else ("position",)
        readers: dict[tuple[str, str], states.StateReader] = {}
        readers["joint_states", ""] = states.JointStateReader(model.joints, *columns)
        checks = {"joint_states": SampleCheck.of_joints(model, safety, measured=velocity_filter is None)}
        if estimator is not None:
            readers["imu", ""] = states.ImuReader(estimator.imu_frame)
            if estimator.uses_poses:
                readers["pose", ""] = states.PoseReader()
            for name, normals in self._detector.normals.items():
                readers["measured_wrench", name] = states.ContactForceReader(name, normals)
        elif model.floating_base:
            readers["odom", ""] = states.OdometryReader(model.base_link)
            checks["odom"] = SampleCheck.of_base(safety)
        self._inputs: dict[tuple[str, str], _Input] = {}
        for topic in endpoints:
            place = topic.key, topic.subject
            if topic.direction is Direction.OUT or topic.key in _NOT_LATCHED:
                continue
            if place in readers or (estimated and topic.key == "holds"):
                capacity = {"imu": _MAX_IMU_SAMPLES, "pose": _MAX_POSES}.get(topic.key, 1)
                stream = transport.stream(topic, max(capacity, _STATE_DEPTH))
                pending: deque[tuple[float, bytes]] = deque(maxlen=capacity)
                check = checks.get(topic.key)
                self._inputs[place] = _Input(topic, stream, pending, self._tracker(), readers.get(place), check)
            elif topic.key not in _MAX_BYTES:
                transport.subscribe(topic, partial(self.requests.put, topic))
        self.joints = self._inputs["joint_states", ""]
        parts = [key for key in ("joint_states", "imu", "odom") if (key, "") in self._inputs]
        self._parts = {key: self._inputs[key, ""] for key in parts}  # required for a state
        self._forces = {name: each for (key, name), each in self._inputs.items() if key == "measured_wrench"}

    def wait(self, seconds: float) -> bool:
        """Wait for a joint state, an emergency stop, or `wake`, in wall time; return True if in time."""
        deadline, left = time.monotonic() + seconds, seconds
        while self.joints.stream.wait(left):
            self._collect(self.joints)
            if self.joints.pending or self._woken:
                self._woken = False
                return True
            left = max(deadline - time.monotonic(), 0.0)
        return False

    def wake(self) -> None:
        """End the present or next wait, from any thread."""
        self._woken = True
        self.joints.stream.wake()

    def _collect(self, source: _Input) -> None:
        """Take the messages of a topic, and drop oversized ones."""
        taken, largest = source.stream.take(), _MAX_BYTES[source.topic.key]
        self._clock.refresh()  # after the states, because a simulator publishes the time first
        now = self._clock.now()
        for payload in taken:
            if len(payload) <= largest:
                source.pending.append((now, payload))
            else:
                self.requests.drop_unread(source.topic, f"more than {largest} bytes")

    def discard_pending(self) -> None:
        """Drop all waiting states: their ages are unknown."""
        for source in self._inputs.values():
            source.stream.take()
            source.pending.clear()
        self._clock.refresh()

    def restart(self) -> None:
        """Restart the timestamp trackers, filters and estimates after a jump of the clock."""
        for source in self._inputs.values():
            source.stamps = self._tracker()
            if source.check is not None:
                source.check.restart()
        if self._velocity_filter is not None:
            self._velocity_filter.restart()
        self.restart_estimator()
        self._detector.forget_forces()

    def restart_estimator(self) -> None:
        """Restart the base estimate or the comparison of odometry, at rest."""
        if self._agreement is not None:
            self._agreement.restart()
        if self.estimator is not None:
            self.estimator.restart()
            self._base = None

    def _tracker(self) -> StampTracker:
        if self.clock_tolerance is None:
            return StampTracker()
        return StampTracker(self._clock.clock_offset, self.clock_tolerance)

    def latch(self, holding: Collection[str] = (), *, controlled: bool = False, walking: bool = False) -> LatchedInputs:
        """Decode the newest states, assemble the robot's state, and take the decoded requests.

        The commanded contacts `holding` serve the base estimate, unless contact sensors disagree. Contradicting
        absolute poses must not move the world of a `controlled` robot. `walking`: see `BaseEstimator.update`.
        """
        refused: list[str] = []
        for source in self._inputs.values():
            if not source.pending:  # otherwise just taken by `wait`
                self._collect(source)
        if self.joints.pending and self._clock.now() - self.joints.pending[0][0] > _PREEMPTED:
            self._collect(self.joints)
        for source in self._inputs.values():
            while source.pending:
                self._decode(source, refused)
        if self.estimator is not None:
            refused += self._estimate(self.estimator, holding, controlled=controlled, walking=walking)
        joints: states.JointStates | None = self.joints.newest
        base, state = self._newest_base(), None
        if joints is not None and base is not None:
            q, v = self._model.state(joints.position, joints.velocity, *base)
            q.setflags(write=False)
            v.setflags(write=False)
            state = RobotState(joints.stamp, q, v)
        return LatchedInputs(
            state=state,
            joint_velocity=None if joints is None else joints.velocity,
            ages=self.ages(),
            clock_stall=max([part.stamps.clock_stall for part in self._parts.values()]),
            refused_states=tuple(refused),
            requests=self.requests.take(),
            estimate=self._pose_notes(),
            touching=self._detector.measured,
        )

    def compare_odometry(self, holding: Collection[str], *, controlled: bool) -> None:
        """Compare the newest odometry with the legs; arguments as for `latch`."""
        if self._agreement is None:
            return
        joints, odometry = self.joints.newest, self._inputs["odom", ""].newest
        if joints is not None and odometry is not None:
            base, motion = (odometry.pose, odometry.twist), (joints.position, joints.velocity)
            self._agreement.update(1.0e-9 * odometry.stamp, base, motion, holding, controlled=controlled)

    def _decode(self, source: _Input, refused: list[str]) -> None:
        """Decode, check and store one message; a refused one leaves the last one in force."""
        topic, key = source.topic, source.topic.key
        arrival, payload = source.pending.popleft()
        try:
            if source.reader is None:
                self._detector.update_switch(topic.subject, bool(decode(payload, topic.type).data))
                return
            newest = source.reader.read(payload)
            reason = source.stamps.refusal(newest.stamp, arrival)
            if not reason and source.check is not None:  # it stores a plausible sample
                reason = source.check.check(*newest[:3])
            if reason:
                raise InputRefused(reason)
            source.stamps.accept(newest.stamp, arrival)
        except Exception as error:
            self._refusals[key] = refusal_reason(topic, error) + self._publishers_note(topic.name)
            refused.append(f"{topic.name}: {self._refusals[key]}")
            return
        self._refusals.pop(key, None)
        if source is self.joints and self._velocity_filter is not None:
            newest = newest._replace(velocity=self._velocity_filter.update(newest.stamp, newest.position))
        source.newest = newest
        if key == "imu":
            self._imu.append(ImuSample(1.0e-9 * newest.stamp, newest.angular_velocity, newest.specific_force))
        elif key == "pose":
            self._poses.append(PoseSample(1.0e-9 * newest.stamp, newest.pose, newest.covariance))
        elif key == "measured_wrench":
            self._detector.update_force(topic.subject, newest.normal)

    def _publishers_note(self, topic: str) -> str:
        names = self.shared().get(topic)
        return f"; {topic} has several publishers: {names}" if names else ""

    def _newest_base(self) -> tuple[()] | tuple[Array, Array] | None:
        if self.estimator is not None:
            return self._base
        if not self._model.floating_base:
            return ()
        odometry = self._inputs["odom", ""].newest
        return None if odometry is None else (odometry.pose, odometry.twist)

    def _estimate(
        self, estimator: BaseEstimator, holding: Collection[str], *, controlled: bool, walking: bool
    ) -> list[str]:
        """Update the base estimate; return a sentence per new sensor timeout, slipping contact and refused pose."""
        detector, now = self._detector, self._clock.now()
        silent = detector.silent
        measured = detector.active(holding, {name: force.stamps.age(now) for name, force in self._forces.items()})
        sentences = [
            f"{self._forces[name].topic.name}: {detector.timeout_note(name)}"
            for name in detector.silent
            if name not in silent
        ]
        # A hanging robot has no contact forces at the start.
        self.holding = holding if estimator.filter is None else measured
        joints: states.JointStates | None = self.joints.newest
        imu, self._imu = self._imu, []
        if not imu or joints is None:
            del self._poses[:-_MAX_POSES]
            return sentences
        slipping = estimator.slipping
        estimator.update(imu, joints.position, joints.velocity, self.holding, walking=walking)
        poses, self._poses = self._poses, []
        contradictions = estimator.correct(poses, controlled=controlled) if ("pose", "") in self._inputs else []
        if contradictions:
            self._refusals["pose"] = contradictions[-1]
            sentences += [f"{self._inputs['pose', ''].topic.name}: {reason}" for reason in contradictions]
        self._base = estimator.base
        return sentences + [
            f"the base estimate ignores the slipping contact {name!r} until it rests"
            for name in estimator.slipping
            if name not in slipping
        ]

    def ages(self) -> dict[str, float]:
        """Return the age of each part of the state, s; infinite before the first message."""
        now = self._clock.now()
        ages = {name: part.stamps.age(now) for name, part in self._parts.items()}
        if self.estimator is not None:
            ages[ESTIMATE] = 0.0 if self._base is not None else math.inf
        return ages

    def fault(self, ages: Mapping[str, float], timeout: float) -> Fault | None:
        """Return the input fault, or None, for the ages of the parts of the state and their limit, s."""
        for part in self._parts.values():
            found = part.check.fault(part.topic.name) if part.check is not None and part.check.in_row else None
            if found is not None:
                return Fault(found.code, found.sentence + self._publishers_note(part.topic.name))
        stale = stale_inputs(ages, timeout, self.notes)
        if stale is None and self._agreement is not None and self._agreement.contradiction is not None:
            return Fault("IMPLAUSIBLE_STATE", self._agreement.contradiction)
        if stale is None or self.estimator is None or not self.estimator.lost:
            return stale
        measured = {name: age for name, age in ages.items() if name != ESTIMATE}
        return stale_inputs(measured, timeout, self.notes) or Fault("ESTIMATE_LOST", self.estimator.waits_for)

    def status(self) -> dict[str, str]:
        """Return diagnostics: rejected samples, and delay of differentiated joint velocities."""
        values = {
            f"rejected/{key}": str(source.check.rejected)
            for (key, _), source in self._inputs.items()
            if source.check is not None and source.check.rejected
        }
        velocity_filter = self._velocity_filter
        if velocity_filter is not None:
            delay = f"{velocity_filter.delay:.4f} s" if math.isfinite(velocity_filter.delay) else "still unknown"
            values["joint_velocity"] = f"differentiated, delay {delay}"
        return values

    def notes(self) -> dict[str, str]:
        """Return explanations of the ages by part of the state: a refusal, or the transit time."""
        now = self._clock.now()
        notes = {self._forces[name].topic.name: self._detector.timeout_note(name) for name in self._detector.silent}
        if self.estimator is not None and self._base is None:
            notes[ESTIMATE] = self.estimator.waits_for
        for name, part in self._parts.items():
            transit_time = part.stamps.transit_time(now)
            if name in self._refusals:
                notes[name] = f"last refusal: {self._refusals[name]}"
            elif transit_time > _MIN_DELAY:
                alternative = ", or the clocks are not synchronized" if self.clock_tolerance is not None else ""
                notes[name] = f"{transit_time:.3f} s of it in transit{alternative}"
        return notes

    def _pose_notes(self) -> dict[str, str]:
        if self.estimator is None or ("pose", "") not in self._inputs:
            return {}
        age = self._inputs["pose", ""].stamps.age(self._clock.now())
        notes = {"pose/age": f"{age:.3f} s" if math.isfinite(age) else "no pose received"}
        if "pose" in self._refusals:
            notes["pose/last refusal"] = self._refusals["pose"]
        return notes | (self.estimator.poses.values if self.estimator.poses is not None else {})
