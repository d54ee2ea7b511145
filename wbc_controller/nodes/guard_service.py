"""The guard as a node: `safety.guard.Guard` on the topics of `middleware.topics.GUARD_TOPICS`, over any transport.

It runs in a process of its own, so that it survives the death of the controller. It imports neither Pinocchio nor a
solver: it takes a third of the memory, and has less that can go wrong. Another process, which ends before the guard
begins, computes its damping from the robot's model.
"""

from __future__ import annotations

import gc
import logging
import math
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.controller.build.robot_description import Description, describe
from wbc_controller.errors import ConfigurationError, InputRefused
from wbc_controller.estimation.joint_velocity import VelocityFilter
from wbc_controller.middleware.codec import decode, diagnostics, encode, message, torques
from wbc_controller.middleware.joint_states import JointStateReader
from wbc_controller.middleware.log_limit import LogLimit
from wbc_controller.middleware.topics import GUARD_TOPICS, Direction, Endpoint, endpoints
from wbc_controller.middleware.transports.graph_watch import GraphWatch, Others
from wbc_controller.middleware.transports.transport import Publish, Stream, Transport
from wbc_controller.nodes.clock import Clock, MonotonicClock
from wbc_controller.nodes.urdf import find_urdf
from wbc_controller.records import Array, Mode
from wbc_controller.safety.guard import Guard, GuardInputs, GuardLimits, GuardMode
from wbc_controller.settings import Settings

#: Name of the node, and prefix of its private topics.
NODE_NAME = "guard"
#: Longest reason of a refusal, in characters; a longer one is cut, since it may quote the message.
_LONGEST_REASON = 300

#: Time between two lines of the log, s: a guard with too little patience takes over many times a second.
_SILENCE = 1.0
#: Time before a takeover in which a command can still arrive that this computer was too busy to receive, s.
_SECOND_LOOK = 0.001

#: Topics that only the controller publishes, by key.
_OF_CONTROLLER = ("joint_commands", "controller_state")
#: Largest torque of a command, as a multiple of the effort limit: the controller's are within it, up to rounding.
_LARGEST_TORQUE = 1.0 + 1.0e-6

_OK, _WARN, _ERROR = 0, 1, 2
_log = logging.getLogger(__name__)


class GuardService:
    """Monitors the controller's topics, and sends the torques of the guard.

    The transport's callbacks decode commands and modes, and store joint states undecoded; everything else runs on the
    thread that calls `cycle`. Before a takeover this thread reads the newest command and mode itself, in case the
    computer is so busy that the callbacks did not run. Messages do not name their sender, so commands of any publisher
    count; a second one is reported.

    Attributes:
        guard: the decisions.
        watch: looks at the publishers of commands and modes; `run` starts its thread.

    Raises:
        TransportError: if a topic cannot be opened.
    """

    def __init__(
        self,
        settings: Settings,
        robot: Description,
        damping: Array,
        topics: Sequence[Endpoint],
        transport: Transport,
        clock: Clock,
        namespace: str = "/",
    ) -> None:
        """Subscribe to the topics; the damping is `make_guard_damping`'s, (na, nj)."""
        self.guard = Guard(guard_limits(settings, robot.effort_limits, damping))
        self._clock = clock
        self._name, self._hardware = f"{namespace.strip('/')}/{NODE_NAME}: commands".strip("/"), robot.name
        joints = settings.robot.joints
        # Each has one thread: that of the transport, and that of the cycles.
        self._commands, self._unread_commands = (JointStateReader(joints, "effort") for _ in range(2))
        known = settings.estimation
        differentiated = known.joint_velocity == "differentiated"
        self._states = JointStateReader(joints, "position" if differentiated else "velocity")
        self._velocity_filter = VelocityFilter(known.joint_velocity_time) if differentiated else None
        self._period = 1.0 / settings.control.rate
        self._diagnostics_period = 1.0 / settings.control.diagnostics_rate
        self._diagnostics_due = -math.inf
        self._said, self._limit = "", LogLimit()
        self._unlogged, self._logged_at = 0, -math.inf  # changes of the state since the last line of the log, at s
        self._lock = threading.Lock()
        self._command_at, self._torques = -math.inf, np.zeros(len(robot.effort_limits))
        self._drive = robot.drive
        self._unanswered_at = math.inf
        self._mode: Mode | None = None
        self._joint_states: tuple[float, bytes] | None = None
        self._velocity_at, self._velocity = -math.inf, np.zeros(0)
        self._refused: dict[str, str] = {}
        self._types = {topic.key: topic.type for topic in topics}
        self._publish: dict[str, Publish] = {
            topic.key: transport.advertise(topic) for topic in topics if topic.direction is Direction.OUT
        }
        self._read: dict[str, bytes] = {}  # the newest command and mode that a callback has read
        readers: dict[str, Callable[[bytes], None]] = {
            "joint_commands": partial(self._take_command, self._commands),
            "controller_state": self._take_mode,
            "joint_states": self._take_joint_states,
        }
        self._unread: dict[str, Stream] = {}
        for topic in topics:
            if topic.key in readers:
                transport.subscribe(topic, readers[topic.key])
            if topic.key in _OF_CONTROLLER:
                self._unread[topic.key] = transport.stream(topic, 1)
        watched = {topic.key: topic for topic in topics if topic.key in _OF_CONTROLLER}
        self._names = {key: topic.name for key, topic in watched.items()}
        self._shared: dict[str, str] = {}  # publishers of a topic with several, by its key
        self.watch = GraphWatch(transport, watched.values(), self._judge)

    def _read_newest(self) -> None:
        """Read the newest command and mode on this thread, unless a callback has read them."""
        newest = {key: payload for key, stream in self._unread.items() for payload in stream.take()}
        unread = {key: payload for key, payload in newest.items() if payload != self._read.get(key)}
        if "controller_state" in unread:
            self._take_mode(unread["controller_state"])
        if "joint_commands" in unread:
            self._take_command(self._unread_commands, unread["joint_commands"])

    def _take_command(self, reader: JointStateReader, payload: bytes) -> None:
        now, self._read["joint_commands"] = self._clock.now(), payload
        try:
            tau = self._torques_of(reader.read(payload).effort)
        except InputRefused as refusal:  # the guard does not count such a message as a command
            self._refuse("joint_commands", refusal)
            return
        with self._lock:
            self._command_at, self._unanswered_at = now, math.inf
            self._torques = tau
            self._refused.pop("joint_commands", None)

    def _torques_of(self, effort: Array) -> Array:
        """Return the torques of the actuators, (na,) in N·m, of a command at the joints, (nj,).

        Raises:
            InputRefused: if a torque is above its limit: it is not the controller's.
        """
        tau, limits = self._drive.from_joints(effort), self.guard.limits.effort
        within = np.abs(tau) <= _LARGEST_TORQUE * limits
        if not within.all():
            i = int((~within).argmax())
            raise InputRefused(
                f"the torque of {self._drive.names[i]!r} is {tau[i]:.4g} N·m, above the limit of {limits[i]:.4g} N·m; "
                "it is not a command of the controller"
            )
        return tau

    def _take_mode(self, payload: bytes) -> None:
        self._read["controller_state"] = payload
        try:
            mode = Mode(decode(payload, self._types["controller_state"]).data.partition(" ")[0])
        except (InputRefused, ValueError) as error:
            self._refuse("controller_state", error)
            return
        with self._lock:
            self._mode = mode
            self._refused.pop("controller_state", None)

    def _take_joint_states(self, payload: bytes) -> None:
        now = self._clock.now()
        with self._lock:
            self._joint_states = now, payload
            self._unanswered_at = min(self._unanswered_at, now)

    def _refuse(self, topic: str, reason: Exception) -> None:
        with self._lock:
            known = self._refused.get(topic)
            self._refused[topic] = str(reason)[:_LONGEST_REASON]
        if known is None and self._limit.passes(topic):
            _log.warning("%s refused: %s", topic, reason)

    def _judge(self, others: Others) -> None:
        """Report topics of the controller with several publishers; on the thread of the watch."""
        shared = {key: ", ".join(names) for key, names in others.items() if len(names) > 1}
        for key, names in shared.items():
            _log.warning(
                "%s has several publishers, %s: the guard cannot tell when the controller stops; end all but one",
                self._names[key],
                names,
            )
        self._shared = shared

    def _heard(self) -> GuardInputs:
        with self._lock:
            newest, self._joint_states = self._joint_states, None
        if newest is not None:
            try:
                velocity = self._velocity_in(newest[1])
            except InputRefused as refusal:
                self._refuse("joint_states", refusal)
            else:
                self._velocity_at, self._velocity = newest[0], velocity
                with self._lock:
                    self._refused.pop("joint_states", None)
        velocity_or_none = self._velocity if len(self._velocity) else None
        with self._lock:
            return GuardInputs(
                self._command_at, self._torques, self._unanswered_at, self._mode, velocity_or_none, self._velocity_at
            )

    def _velocity_in(self, payload: bytes) -> Array:
        """Return the joint velocities of a joint state, measured or differentiated, (nj,) in rad/s."""
        joints = self._states.read(payload)
        if self._velocity_filter is None:
            return joints.velocity
        return self._velocity_filter.update(joints.stamp, joints.position)

    def cycle(self) -> float:
        """Run one cycle: decide, send torques if the guard has taken over, and publish its state.

        Returns:
            Time of the next cycle, s on the clock.
        """
        now, heard = self._clock.now(), self._heard()
        if not self.guard.sending and now >= self.guard.deadline(heard):
            # If this thread was kept off the processor, so was the transport's thread: commands may be waiting.
            time.sleep(_SECOND_LOOK)
            self._read_newest()
            now, heard = self._clock.now(), self._heard()
        tau = self.guard.step(now, heard)
        if tau is not None:
            payload = encode(torques(self._drive.command(tau)))
            if heard.command_at == self._command_at:  # send nothing if a command arrived during this cycle
                self._publish["effort"](payload)
        self._say(now, heard)
        if self.guard.sending:
            return now + self._period
        # The deadline for answering a joint state that arrives from now on is at least the patience away.
        return min(self.guard.deadline(heard), now + self.guard.limits.patience)

    def _say(self, now: float, heard: GuardInputs) -> None:
        """Publish the state if it has changed, and diagnostics if they are due."""
        guard, stale = self.guard, ""
        if guard.mode is GuardMode.DAMPING and guard.velocity_is_stale(now, heard):
            note = f" ({self._refused['joint_states']})" if "joint_states" in self._refused else ""
            stale = f"; zero torque, as the joint velocities are not fresh{note}"
        text = guard.mode.value + (f" {guard.reason}{stale}" if guard.reason else "")
        changed = text != self._said
        if changed:
            if guard.reason or self._said.partition(" ")[0] in (GuardMode.DAMPING, GuardMode.ZERO, GuardMode.RELEASED):
                self._unlogged += 1
            self._said = text
            self._publish["state"](encode(message("std_msgs/msg/String", data=text)))
        if self._unlogged and now - self._logged_at >= _SILENCE:
            patience, others = 1e3 * guard.limits.patience, self._unlogged - 1
            hint = f"; {others} changes before, not logged: guard.patience ({patience:g} ms) may be too short"
            _log.warning("%s%s", text, hint if others > 1 else "")  # one: from a takeover to the return
            self._unlogged, self._logged_at = 0, now
        if changed or now >= self._diagnostics_due:
            self._diagnostics_due = now + self._diagnostics_period
            self._publish["diagnostics"](encode(self._diagnostics(now, heard, text)))

    def _diagnostics(self, now: float, heard: GuardInputs, text: str) -> Any:
        values = {
            "mode": self.guard.mode.value,
            "takeovers": str(self.guard.takeovers),
            "age/joint_commands": f"{now - heard.command_at:.4f} s",
            "age/joint_states": f"{now - heard.velocity_at:.4f} s",
            "controller": heard.mode.value if heard.mode is not None else "unknown",
        }
        refused = dict(self._refused)
        values |= {f"refused/{topic}": reason for topic, reason in refused.items()}
        values |= {f"publishers/{topic}": names for topic, names in self._shared.items()}
        level = _ERROR if self.guard.reason else _WARN if refused or self._shared else _OK
        return diagnostics(time.time_ns(), level, self._name, text, self._hardware, values)

    def run(self, stop: threading.Event) -> None:
        """Run until stopped; the last message sent is never a damping torque."""
        gc.collect()
        gc.freeze()  # objects from start-up live for the whole run: excluding them keeps later collections short
        self.watch.start()
        try:
            while not stop.is_set():
                stop.wait(max(0.0, self.cycle() - self._clock.now()))
        finally:
            self.watch.stop()
            if self.guard.sending:
                self._publish["effort"](encode(torques(np.zeros(self._drive.command_size))))


def guard_limits(settings: Settings, effort: Array, damping: Array) -> GuardLimits:
    """Derive the guard's limits from the settings, the effort limits, (na,) in N·m, and the damping, (na, nj)."""
    guard, period = settings.guard, 1.0 / settings.control.rate
    return GuardLimits(
        patience=guard.patience,
        period=period,
        triggered=settings.control.trigger == "joint_states",
        state_timeout=settings.safety.state_timeout,
        damping=damping,
        damping_time=guard.damping_time,
        damping_torque=guard.torque * effort,
        torque_rate=settings.limits.torque_rate * effort,
        effort=effort,
    )


def _damping(settings: Settings, urdf: str) -> Array:
    """Compute the damping, (na, nj), in a process of its own, which loads Pinocchio.

    The process imports this module only: `multiprocessing` would run the main module again, and thus a second guard.

    Raises:
        ConfigurationError: if the process fails, with its last line.
    """
    place = str(Path(__file__).resolve().parents[2])
    done = subprocess.run(  # noqa: S603 - of this package
        [sys.executable, "-c", f"from {__name__} import print_damping; print_damping()"],
        input=pickle.dumps((settings, urdf)),
        capture_output=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [place, os.environ.get("PYTHONPATH")]))},
        check=False,
    )
    if done.returncode:
        reason = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise ConfigurationError(f"the guard's damping cannot be computed: {reason}")
    damping: Array = pickle.loads(done.stdout)  # noqa: S301 - written by the process above
    return damping


def print_damping() -> None:
    """Write the damping for the settings and the URDF on standard input, both pickled."""
    from wbc_controller.controller.build.guard import make_guard_damping
    from wbc_controller.controller.build.robot import make_model

    settings, urdf = pickle.loads(sys.stdin.buffer.read())  # noqa: S301 - written by the guard
    damping = make_guard_damping(settings, make_model(settings, urdf))
    sys.stdout.buffer.write(pickle.dumps(damping))


def run_guard(
    settings: Settings,
    transport: Transport,
    stop: threading.Event,
    *,
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
) -> None:
    """Run the guard until the event is set; arguments as for `run_controller`.

    Raises:
        ConfigurationError: if the URDF and the settings do not fit together.
        TransportError: if a topic cannot be opened.
    """
    topics = list(endpoints(GUARD_TOPICS, NODE_NAME, namespace=namespace, remappings=remappings))
    urdf = find_urdf(settings, transport, stop, topics)
    if stop.is_set():
        return
    description = describe(urdf, settings.robot)
    damping = _damping(settings, urdf)
    GuardService(settings, description, damping, topics, transport, MonotonicClock(), namespace).run(stop)
