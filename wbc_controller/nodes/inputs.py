"""The border: what comes in, within which limits, and what one cycle sees of it.

- States wait in the transport until the loop's thread takes them: no other thread runs when one comes. Requests are
  those of `nodes.requests`. Messages over their size are counted and dropped.
- A cycle decodes at most one joint state and one odometry, the newest, and takes a bounded number of requests. Where
  the base is estimated, it decodes the IMU data since the last cycle, at most `_MOST_IMU` of them, absolute poses, at
  most `_MOST_POSES`, and of each sensor at a contact the newest message.
"""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from wbc_controller.compiled import Bound
from wbc_controller.errors import InputRefused
from wbc_controller.estimation.absolute_pose import PoseSample
from wbc_controller.estimation.base_estimator import BaseEstimator, ImuSample
from wbc_controller.estimation.contact_detection import ContactSensing
from wbc_controller.estimation.joint_velocity import VelocityFilter
from wbc_controller.inverse_dynamics.references.changes import Change
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware import decoding
from wbc_controller.middleware.message_kernels import assemble
from wbc_controller.middleware.stamps import StampTracker
from wbc_controller.middleware.state_kernels import latch
from wbc_controller.middleware.states import ImuReader, JointStateReader, OdometryReader, PoseReader, StateReader
from wbc_controller.middleware.topics import Direction, Endpoint
from wbc_controller.middleware.transports.transport import Stream, Transport
from wbc_controller.nodes.clock import Clock
from wbc_controller.nodes.contact_sensors import KEYS, ContactSensors
from wbc_controller.nodes.requests import Requests, refusal
from wbc_controller.records import Array, ChangeSettings, Fault, RobotState
from wbc_controller.safety.checks import stale_inputs

_log = logging.getLogger(__name__)

#: Largest message of a state, in bytes, by row of the topic table.
_LARGEST = {"joint_states": 1 << 18, "odom": 1 << 16, "imu": 1 << 16, "pose": 1 << 16, **dict.fromkeys(KEYS, 1 << 14)}
#: IMU data that one cycle takes, at most: the newest, of an IMU that is that much faster than the loop.
_MOST_IMU = 20
#: Absolute poses that one cycle takes, at most: the newest.
_MOST_POSES = 4
#: States that wait in the transport, at most: a message that is dropped for its size takes the place of no good one.
_STATE_DEPTH = 10
#: Name of the base's estimate among the ages of the inputs.
ESTIMATE = "base estimate"
#: Time since joint states were taken after which the loop looks for newer ones: it had lost the processor, s.
_PREEMPTED = 0.005
#: Time on its way from which on a message's age is explained by it, s.
_WAITED = 0.01


@dataclass(slots=True)  # not frozen, which would take three times as long to make, in every cycle
class Latched:
    """All inputs, latched at the start of one cycle.

    Attributes:
        state: the newest state; None until all of its parts have arrived (joint states, and for a floating base its
            odometry, or IMU data from which it has been estimated).
        joint_velocity: newest joint velocities, (nj,) in rad/s; None until they have arrived.
        ages: age of each part of the state, s; infinite if it has never arrived.
        stood: how far the stamps have gone on while the clock has stood still, s.
        commands: words on the command topic, in order of arrival.
        changes: sets of changes, in order of arrival; each set is applied whole or not at all.
        refused: a sentence for each message that was refused.
        taken: number of requests since the last cycle that were read, refused or turned away.
        estimate: what to know about the base's estimate beside its age, for diagnostics.
    """

    state: RobotState | None
    joint_velocity: Array | None
    ages: dict[str, float]
    stood: float
    commands: tuple[str, ...]
    changes: tuple[tuple[Change | ChangeSettings, ...], ...]
    refused: tuple[str, ...]
    taken: int
    estimate: dict[str, str]


@dataclass(slots=True)
class _Part:
    """Newest message of one part of the state: joint states, odometry, or IMU data; or the newest absolute pose.

    Of IMU data `q` is the angular velocity, and `v` the specific force; of a pose they are the pose and its covariance.
    """

    reader: StateReader
    stamps: StampTracker
    stamp: int = 0
    q: Array = field(default_factory=lambda: np.zeros(0))
    v: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(slots=True)
class _Box:
    """A stream of states.

    Attributes:
        endpoint: its topic.
        stream: what has not been taken yet.
        newest: what has been taken and not been read, with the times of arrival, s.
        largest: most bytes of a message.
        part: takes what the messages say; None of a sensor at a contact.
    """

    endpoint: Endpoint
    stream: Stream
    newest: deque[tuple[float, bytes]]
    largest: int
    part: _Part | None


class Inputs:
    """Subscribes to every incoming topic, and latches what has arrived.

    Attributes:
        requests: those of users.
        holding: names of the contacts that the estimate of the base took for holding in the last cycle.
    """

    def __init__(
        self,
        model: RobotModel,
        vocabulary: decoding.Vocabulary,
        endpoints: Iterable[Endpoint],
        transport: Transport,
        clock: Clock,
        prepare: Callable[[Mapping[str, Any]], None] = lambda change: None,
        *,
        clock_tolerance: float | None = None,
        estimator: BaseEstimator | None = None,
        sensing: ContactSensing | None = None,
        velocity_filter: VelocityFilter | None = None,
    ) -> None:
        """Subscribe.

        Args:
            model: the robot's model.
            vocabulary: the names that messages may use.
            endpoints: of the controller's node.
            transport: carries the messages.
            clock: dates the messages at their arrival.
            prepare: validates a change of the settings, before a cycle takes it; raises `ConfigurationError`.
            clock_tolerance: how far a stamp may be ahead of the clock's, s; None where the two are not synchronized.
            estimator: estimates a floating base; None where its odometry is measured elsewhere.
            sensing: what is known of the sensors at the contacts that the estimate rests on; None to read none.
            velocity_filter: makes joint velocities of their positions; None where they are measured.
        """
        self._model = model
        self._clock = clock
        self.requests = Requests(vocabulary, prepare, self.wake)
        self._boxes: list[_Box] = []
        self._woken = False
        self._clock_tolerance = clock_tolerance
        self._velocity_filter = velocity_filter
        reader = JointStateReader(model.joints, velocities=velocity_filter is None)
        self._joints = _Part(reader, self._tracker())
        self._parts = {"joint_states": self._joints}
        self._estimator = estimator
        self._samples: list[ImuSample] = []
        self._poses: list[PoseSample] = []
        self._pose: _Part | None = None  # no part of the state, as there is an estimate without
        self._pose_topic = ""
        self._base: tuple[Array, Array] | None = None  # what was estimated in the last cycle
        self._contact_sensors = ContactSensors(sensing, self._tracker) if sensing is not None else None
        self.holding: Collection[str] = ()
        if estimator is not None:
            self._parts["imu"] = _Part(ImuReader(estimator.imu_frame), self._tracker())
            self._pose = _Part(PoseReader(), self._tracker()) if estimator.takes_poses else None
        elif model.floating_base:
            self._parts["odom"] = _Part(OdometryReader(model.base_link), self._tracker())
        self._notes: dict[str, str] = {}
        for endpoint in endpoints:
            if endpoint.direction is Direction.OUT or endpoint.key in ("robot_description", "clock", "record"):
                continue
            if endpoint.key in ("odom", "imu") and endpoint.key not in self._parts:
                continue
            if endpoint.key in KEYS and self._contact_sensors is None:
                continue
            if endpoint.key == "pose":
                if self._pose is None:
                    continue
                self._pose_topic = endpoint.name
            if endpoint.key in (*self._parts, "pose", *KEYS):
                kept = {"imu": _MOST_IMU, "pose": _MOST_POSES}.get(endpoint.key, 1)
                stream = transport.stream(endpoint, max(kept, _STATE_DEPTH))
                part = self._pose if endpoint.key == "pose" else self._parts.get(endpoint.key)
                largest = _LARGEST[endpoint.key]
                self._boxes.append(_Box(endpoint, stream, deque(maxlen=kept), largest, part))
            else:
                transport.subscribe(endpoint, partial(self.requests.put, endpoint))
        self._trigger = next(box for box in self._boxes if box.endpoint.key == "joint_states")
        self._odometry = next((box for box in self._boxes if box.endpoint.key == "odom"), None)
        self._measured = estimator is None and velocity_filter is None  # whether the state is what messages say
        self._sizes = model.nj, model.nq, model.nv
        self._tables: Bound | None = None  # for `_at_once`
        self._known: tuple[Bound | None, ...] = ()  # what the readers knew when they were made
        self._bound = False  # whether that is looked at since messages were read one by one
        self._places = Bound(model.nj, model.q_index.astype(np.int64), model.v_index.astype(np.int64))
        self._no_base = np.zeros(0), np.zeros(0)

    def wait(self, seconds: float) -> bool:
        """Wait until a joint state has come, for an emergency stop, or for `wake`; whether it came to that.

        Args:
            seconds: longest wall time, s.

        Raises:
            TransportError: if the transport is closed, or the topic cannot be read.
        """
        deadline, left = time.monotonic() + seconds, seconds
        while self._trigger.stream.wait(left):
            if self._collect(self._trigger) or self._woken:
                self._woken = False
                return True
            left = max(deadline - time.monotonic(), 0.0)
        return False

    def wake(self) -> None:
        """End the wait, or the next one where nobody waits. Any thread may call it."""
        self._woken = True
        self._trigger.stream.wake()

    def _collect(self, box: _Box) -> bool:
        """Take the messages of a stream, date them, and drop those that are too large; True if any is left.

        The clock is read after the states: a simulator sends the time first, so the time of these states is there.
        """
        taken = box.stream.take()
        self._clock.refresh()
        now = self._clock.now()
        for payload in taken:
            if len(payload) <= box.largest:
                box.newest.append((now, payload))
            else:
                self.requests.turn_away(box.endpoint, f"more than {box.largest} bytes")
        return bool(taken and box.newest)

    def begin(self) -> None:
        """Drop the states that have come so far: nobody has seen when they came, so that their age is not known."""
        for box in self._boxes:
            box.stream.take()
            box.newest.clear()
        self._clock.refresh()

    def restart(self) -> None:
        """Take the next stamps as those of a new time: the clock has begun anew."""
        for part in (*self._parts.values(), *((self._pose,) if self._pose is not None else ())):
            part.stamps = self._tracker()
        self._known, self._bound = (), False
        if self._velocity_filter is not None:
            self._velocity_filter.restart()
        self.restart_estimate()
        if self._contact_sensors is not None:
            self._contact_sensors.restart()

    def restart_estimate(self) -> None:
        """Start the estimate of the base again: the robot has to stand still."""
        if self._estimator is not None:
            self._estimator.restart()
            self._base = None

    def fault(self, ages: Mapping[str, float], timeout: float) -> Fault | None:
        """Input fault, or None.

        Args:
            ages: age of each part of the state, s.
            timeout: largest allowed age, s.
        """
        stale = stale_inputs(ages, timeout, self.notes)
        if stale is None or self._estimator is None or not self._estimator.lost:
            return stale
        measured = {name: age for name, age in ages.items() if name != ESTIMATE}
        return stale_inputs(measured, timeout, self.notes) or Fault("ESTIMATE_LOST", self._estimator.waits_for)

    @property
    def estimator(self) -> BaseEstimator | None:
        """The estimator of the base, where its state is estimated here."""
        return self._estimator

    def _tracker(self) -> StampTracker:
        if self._clock_tolerance is None:
            return StampTracker()
        return StampTracker(self._clock.ahead, self._clock_tolerance)

    def stamp_of_joint_states(self) -> int:
        """Stamp of the newest joint state that was decoded, ns; 0 before the first."""
        return self._joints.stamp

    def status(self) -> dict[str, str]:
        """How the state is made, for diagnostics, by key."""
        made = self._velocity_filter
        if made is None:
            return {}
        late = f"{made.delay:.4f} s late" if math.isfinite(made.delay) else "not known yet"
        return {"joint_velocity": f"differentiated, {late}"}

    def ages(self) -> dict[str, float]:
        """Age of each part of the state at this moment, by its stamp, s; infinite before the first."""
        now = self._clock.now()
        ages = {name: part.stamps.age(now) for name, part in self._parts.items()}
        if self._estimator is not None:
            ages[ESTIMATE] = 0.0 if self._base is not None else math.inf
        return ages

    def latch(self, holding: Collection[str] = (), *, held: bool = False) -> Latched:
        """Decode the newest state, and take the requests that have been read.

        Args:
            holding: names of the contacts that are meant to hold: an estimate of the base rests on them, but for what
                sensors at the contacts say.
            held: whether the robot is under control: absolute poses that contradict must not move its world.
        """
        for box in self._boxes:
            if not box.newest:  # as `wait` has not just taken them
                self._collect(box)
        waiting = self._trigger.newest
        if waiting and self._clock.now() - waiting[0][0] > _PREEMPTED:
            self._collect(self._trigger)
        refused: list[str] = []
        at_once = self._at_once() if self._measured and not self._notes else None
        state, ages, stood = at_once or self._one_by_one(holding, refused, held=held)
        velocity = self._joints.v if len(self._joints.v) else None
        about = self._about_poses() if self._pose is not None else {}
        latched = Latched(state, velocity, ages, stood, (), (), (), 0, about)
        latched.refused = tuple(refused)
        if self.requests.wait_to_be_taken():
            taken = self.requests.take()
            latched.commands, latched.changes, latched.taken = taken.commands, taken.changes, taken.total
            latched.refused += taken.refused
        return latched

    def _at_once(self) -> tuple[RobotState, dict[str, float], float] | None:
        """Read measured joint states and odometry in one call (`middleware.state_kernels`).

        Returns:
            As `_one_by_one`; None, with nothing done, where no joint states have come, or a message needs a closer
            look: it has another shape than those before, or it may be refused.
        """
        if not self._bound:
            self._bind()
        trigger, joints, box, tables = self._trigger.newest, self._joints, self._odometry, self._tables
        if tables is None or not trigger:
            return None
        came, payload = trigger[0]
        (pose, twist), base_came, base_payload = self._no_base, came, b""
        if box is not None and box.part is not None:
            if box.newest:
                base_came, base_payload = box.newest[0]
                pose, twist = np.empty(7), np.empty(6)
            else:
                pose, twist = box.part.q, box.part.v
        nj, nq, nv = self._sizes
        positions, velocities, q, v = np.empty(nj), np.empty(nj), np.empty(nq), np.empty(nv)
        stamps = joints.stamps
        stamp, age, base_age, stood = latch(
            payload, base_payload, tables.table, came, base_came, self._clock.now(), stamps.ahead(), stamps.tolerance,
            positions, velocities, pose, twist, q, v,
        )  # fmt: skip
        if stamp < 0:
            return None
        trigger.clear()
        joints.stamp, joints.q, joints.v = stamp, positions, velocities
        if box is None or box.part is None:
            return self._frozen(q, v), {"joint_states": age}, stood
        box.newest.clear()
        box.part.q, box.part.v = pose, twist
        return self._frozen(q, v), {"joint_states": age, "odom": base_age}, stood

    def _bind(self) -> None:
        """Tell compiled code where it finds the shapes of messages, and what is remembered of their stamps."""
        self._bound = True
        parts = [self._joints] + ([self._odometry.part] if self._odometry is not None and self._odometry.part else [])
        readers = tuple(part.reader.known for part in parts)
        if readers == self._known:
            return
        self._known, self._tables = (), None
        tables = [known.table for known in readers if known is not None]
        if len(tables) == len(parts) and all(len(part.v) for part in parts):
            self._known = readers
            none = [0] * (2 - len(parts))
            memories = [part.stamps.memory for part in parts]
            self._tables = Bound(*tables, *none, *memories, *none, self._places.table)

    def _one_by_one(
        self, holding: Collection[str], refused: list[str], *, held: bool
    ) -> tuple[RobotState | None, dict[str, float], float]:
        """Read every message by itself, and estimate what is not measured.

        Args:
            holding: as `latch` takes it.
            refused: takes a sentence for each message that is refused.
            held: as `latch` takes it.

        Returns:
            The state, the age of each part of it, s, and how far the stamps have gone on while the clock has stood
            still, s.
        """
        self._bound = False
        for box in self._boxes:
            while box.newest:
                received, payload = box.newest.popleft()
                try:
                    self._read_state(box, received, payload)
                except Exception as error:
                    reason = refusal(box.endpoint, error)
                    self._notes[box.endpoint.key] = reason
                    refused.append(f"{box.endpoint.name}: {reason}")
        if self._estimator is not None:
            self.holding = holding
            if self._contact_sensors is not None:
                measured, silent = self._contact_sensors.decide(self._clock.now(), holding)
                refused += silent
                if self._estimator.filter is not None:  # a robot that hangs at the start presses on nothing
                    self.holding = measured
            refused += self._estimate(self._estimator, self.holding, held=held)
        return self._state(), self.ages(), max(part.stamps.stood for part in self._parts.values())

    def _about_poses(self) -> dict[str, str]:
        """What to know about absolute poses: their age, and what became of them."""
        if self._pose is None or self._estimator is None:
            return {}
        age = self._pose.stamps.age(self._clock.now())
        about = {"pose/age": f"{age:.3f} s" if math.isfinite(age) else "none has come"}
        if "pose" in self._notes:
            about["pose/last refusal"] = self._notes["pose"]
        return about | (self._estimator.poses.values if self._estimator.poses is not None else {})

    def notes(self) -> dict[str, str]:
        """What to know about the age of parts of the state: a refusal, or how long the newest was on its way."""
        notes, now = {}, self._clock.now()
        if self._estimator is not None and self._base is None:
            notes[ESTIMATE] = self._estimator.waits_for
        if self._contact_sensors is not None:
            notes |= self._contact_sensors.notes()
        for name, part in self._parts.items():
            waited = part.stamps.waited(now)
            if name in self._notes:
                notes[name] = f"last refusal: {self._notes[name]}"
            elif waited > _WAITED and self._clock_tolerance is not None:
                notes[name] = f"{waited:.3f} s of it on its way, or the clocks are not synchronized"
            elif waited > _WAITED:
                notes[name] = f"{waited:.3f} s of it on its way"
        return notes

    def _read_state(self, box: _Box, received: float, payload: bytes) -> None:
        """Read one part of the state, and judge its stamp; one that is refused leaves the last in force."""
        part = box.part
        if part is None:
            self._read_contact(box.endpoint, received, payload)
            return
        stamp, q, v = part.reader.read(payload)
        reason = part.stamps.judge(stamp, received)
        if reason is not None:
            raise InputRefused(reason)
        if part is self._joints and self._velocity_filter is not None:
            v = self._velocity_filter.update(stamp, q)
        part.stamp, part.q, part.v = stamp, q, v
        key = box.endpoint.key
        if self._notes:
            self._notes.pop(key, None)
        if key == "imu":
            self._samples.append(ImuSample(1.0e-9 * stamp, q, v))
        elif key == "pose":
            self._poses.append(PoseSample(1.0e-9 * stamp, q, v))

    def _read_contact(self, endpoint: Endpoint, received: float, payload: bytes) -> None:
        """Read what a sensor at a contact says."""
        if self._contact_sensors is not None:
            reason = self._contact_sensors.read(endpoint, received, payload)
            if reason is not None:
                raise InputRefused(reason)

    def _estimate(self, estimator: BaseEstimator, holding: Collection[str], *, held: bool) -> list[str]:
        """Estimate the base from what has come; a sentence for each contact that is newly left out, and each pose."""
        joints, before = self._joints, estimator.slipping
        samples, self._samples = self._samples, []
        if not samples or not len(joints.v):
            del self._poses[:-_MOST_POSES]
            return []
        estimator.update(samples, joints.q, joints.v, holding)
        poses, self._poses = self._poses, []
        refused = estimator.correct(poses, held=held) if self._pose is not None else []
        if refused:
            self._notes["pose"] = refused[-1]
        self._base = estimator.base
        return [f"{self._pose_topic}: {reason}" for reason in refused] + [
            f"the base's estimate leaves out contact {name!r}, which moves, and takes it in again where it rests"
            for name in estimator.slipping
            if name not in before
        ]

    def _state(self) -> RobotState | None:
        for part in self._parts.values():
            if not len(part.v):
                return None
        joints, odometry = self._joints, self._parts.get("odom")
        pose, twist = self._no_base
        if odometry is not None:
            pose, twist = odometry.q, odometry.v
        elif self._estimator is not None:
            if self._base is None:
                return None
            pose, twist = self._base
        q, v = np.empty(self._model.nq), np.empty(self._model.nv)
        assemble(self._places.table, joints.q, joints.v, pose, twist, q, v)
        return self._frozen(q, v)

    def _frozen(self, q: Array, v: Array) -> RobotState:
        """The state of the newest joint states, with joints that follow others placed."""
        followers = self._model.followers
        if followers is not None:
            followers.place(q)
            followers.move(v)
        q.setflags(write=False)
        v.setflags(write=False)
        return RobotState(self._joints.stamp, q, v)
