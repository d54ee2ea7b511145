"""The guard as a service.

The guard survives the death of the controller. It imports neither Pinocchio nor a solver; a temporary process computes
its damping.
"""

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
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.controller.build.robot_description import Description, describe
from wbc_controller.errors import ConfigurationError, InputRefused
from wbc_controller.estimation.joint_velocity import VelocityFilter
from wbc_controller.middleware.codec import ERROR, OK, WARN, decode, diagnostics, encode, header, message, torques
from wbc_controller.middleware.log_limit import LogLimit
from wbc_controller.middleware.states import JointStateReader
from wbc_controller.middleware.topics import GUARD_NODE, GUARD_TOPICS, Direction, Endpoint, endpoints
from wbc_controller.middleware.transports.graph_watch import GraphWatch, OtherPublishers
from wbc_controller.middleware.transports.transport import Publish, Transport
from wbc_controller.nodes.clock import Clock, MonotonicClock
from wbc_controller.nodes.urdf import find_urdf
from wbc_controller.records import Array, Mode
from wbc_controller.safety.guard import Guard, GuardInputs, GuardMode
from wbc_controller.settings import Settings

_LONGEST_REASON = 300  # of a refusal, characters
_WARNING_PERIOD = 1.0  # shortest time between two log lines, s
_RECHECK_DELAY = 0.001  # in which late commands of a busy computer can still arrive, s
_CONTROLLER_KEYS = ("joint_commands", "controller_state")  # topics of the controller alone
_TAKEOVER_MODES = (GuardMode.DAMPING, GuardMode.ZERO, GuardMode.RELEASED)
_LARGEST_TORQUE = 1.0 + 1.0e-6  # multiple of the effort limit, for rounding

_log = logging.getLogger(__name__)


class GuardService:
    """Monitor of the controller's topics, and publisher of the guard's torques.

    Callbacks decode commands and modes and store joint states; the rest runs on the thread of `cycle`. Before a
    takeover it also reads the newest command and mode, since callbacks may be late. Commands of any publisher count;
    `watch` reports a second publisher.
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
        """Subscribe to the topics; `damping` is (na, nj), from `make_guard_damping`."""
        self.guard = Guard(settings, robot.effort_limits, damping)
        self._clock = clock
        self._name, self._hardware = f"{namespace.strip('/')}/{GUARD_NODE}: commands".strip("/"), robot.name
        joints = self._joints = list(settings.robot.joints)
        # One reader per thread: transport, and cycle.
        self._commands, self._unread_commands = (JointStateReader(joints, "effort") for _ in range(2))
        known = settings.estimation
        differentiated = known.joint_velocity == "differentiated"
        self._states = JointStateReader(joints, "position" if differentiated else "velocity")
        self._velocity_filter = VelocityFilter(known.joint_velocity_time) if differentiated else None
        self._period, self._patience = 1.0 / settings.control.rate, settings.guard.patience
        self._diagnostics_period = 1.0 / settings.control.diagnostics_rate
        self._diagnostics_due = -math.inf
        self._published_text, self._limit = "", LogLimit()
        self._unlogged, self._logged_at = 0, -math.inf  # changes since the last log line, and its time, s
        self._lock = threading.Lock()
        self._drive, self._effort_limits, zeros = robot.drive, robot.effort_limits, np.zeros(len(robot.effort_limits))
        self._received = GuardInputs(
            command_at=-math.inf, torques=zeros, unanswered_at=math.inf, mode=None, velocity=None, velocity_at=-math.inf
        )
        self._joint_states: tuple[float, bytes] | None = None
        self._refused: dict[str, str] = {}
        self._publish: dict[str, Publish] = {
            topic.key: transport.advertise(topic) for topic in topics if topic.direction is Direction.OUT
        }
        self._processed: dict[str, bytes] = {}  # newest command and mode
        readers: dict[str, Callable[[bytes], None]] = {
            "joint_commands": partial(self._process_command, self._commands),
            "controller_state": self._process_mode,
            "joint_states": self._store_joint_states,
        }
        for topic in topics:
            if topic.key in readers:
                transport.subscribe(topic, readers[topic.key])
        watched = [topic for topic in topics if topic.key in _CONTROLLER_KEYS]
        self._streams = {topic.key: transport.stream(topic, 1) for topic in watched}
        self._names = {topic.key: topic.name for topic in watched}
        self._shared: dict[str, str] = {}  # of topics with several publishers, by key
        self.watch = GraphWatch(transport, watched, self._update_publishers)

    def _process_newest(self) -> None:
        newest = {key: payload for key, stream in self._streams.items() for payload in stream.take()}
        unread = {key: payload for key, payload in newest.items() if payload != self._processed.get(key)}
        if "controller_state" in unread:
            self._process_mode(unread["controller_state"])
        if "joint_commands" in unread:
            self._process_command(self._unread_commands, unread["joint_commands"])

    def _process_command(self, reader: JointStateReader, payload: bytes) -> None:
        now, self._processed["joint_commands"] = self._clock.now(), payload
        try:
            command = reader.read(payload)
            tau, limits = self._drive.from_joints(command.effort), self._effort_limits
            within = np.abs(tau) <= _LARGEST_TORQUE * limits
            if not within.all():
                i = int((~within).argmax())
                raise InputRefused(
                    f"torque of {self._drive.names[i]!r} is {tau[i]:.4g} N·m (limit {limits[i]:.4g} N·m): not a "
                    "command of the controller"
                )
        except InputRefused as refusal:  # does not count as a command
            self._refuse("joint_commands", refusal)
            return
        self._store("joint_commands", command_at=now, command_stamp=command.stamp, unanswered_at=math.inf, torques=tau)

    def _store(self, topic: str, **values: Any) -> None:
        with self._lock:
            self._received = replace(self._received, **values)
            self._refused.pop(topic, None)

    def _process_mode(self, payload: bytes) -> None:
        self._processed["controller_state"] = payload
        try:
            mode = Mode(decode(payload, "std_msgs/msg/String").data.partition(" ")[0])
        except (InputRefused, ValueError) as error:
            self._refuse("controller_state", error)
            return
        self._store("controller_state", mode=mode)

    def _store_joint_states(self, payload: bytes) -> None:
        now = self._clock.now()
        with self._lock:
            self._joint_states = now, payload
            self._received = replace(self._received, unanswered_at=min(self._received.unanswered_at, now))

    def _refuse(self, topic: str, reason: Exception) -> None:
        with self._lock:
            known = self._refused.get(topic)
            self._refused[topic] = str(reason)[:_LONGEST_REASON]
        if known is None and self._limit.passes(topic):
            _log.warning("%s refused: %s", topic, reason)

    def _update_publishers(self, others: OtherPublishers) -> None:
        shared = {key: ", ".join(names) for key, names in others.items() if len(names) > 1}
        text = "%s has several publishers: %s; the guard cannot detect the end of the controller: stop all but one"
        for key, names in shared.items():
            _log.warning(text, self._names[key], names)
        self._shared = shared

    def _read_inputs(self) -> GuardInputs:
        with self._lock:
            newest, self._joint_states = self._joint_states, None
        if newest is not None:
            try:
                joints = self._states.read(newest[1])
                velocity = joints.velocity
                if self._velocity_filter is not None:
                    velocity = self._velocity_filter.update(joints.stamp, joints.position)
            except InputRefused as refusal:
                self._refuse("joint_states", refusal)
            else:
                self._store("joint_states", velocity=velocity if len(velocity) else None, velocity_at=newest[0])
        return self._received

    def cycle(self) -> float:
        """Decide, send torques after a takeover, publish the state; return the time of the next cycle, s."""
        now, received = self._clock.now(), self._read_inputs()
        if not self.guard.sending and now >= self.guard.deadline(received):
            time.sleep(_RECHECK_DELAY)
            self._process_newest()
            now, received = self._clock.now(), self._read_inputs()
        tau = self.guard.step(now, received)
        if tau is not None:
            payload = encode(torques(self._drive.command(tau)))
            if received.command_at == self._received.command_at:  # no command arrived during this cycle
                self._publish["effort"](payload)
                top, effort = header(received.command_stamp), self._drive.at_joints(tau)
                own = message("sensor_msgs/msg/JointState", header=top, name=self._joints, effort=effort)
                self._publish["guard_commands"](encode(own))
        self._publish_diagnostics(now, received)
        if self.guard.sending:
            return now + self._period
        # A joint state that arrives later has a later deadline.
        return min(self.guard.deadline(received), now + self._patience)

    def _publish_diagnostics(self, now: float, received: GuardInputs) -> None:
        guard, stale = self.guard, ""
        if guard.mode is GuardMode.DAMPING and guard.velocity_is_stale(now, received):
            note = f" ({self._refused['joint_states']})" if "joint_states" in self._refused else ""
            stale = f"; zero torque, because the joint velocities are stale{note}"
        text = guard.mode.value + (f" {guard.reason}{stale}" if guard.reason else "")
        changed = text != self._published_text
        if changed:
            if guard.reason or self._published_text.partition(" ")[0] in _TAKEOVER_MODES:
                self._unlogged += 1
            self._published_text = text
            self._publish["state"](encode(message("std_msgs/msg/String", data=text)))
        if self._unlogged and now - self._logged_at >= _WARNING_PERIOD:
            patience, others = 1e3 * self._patience, self._unlogged - 1
            hint = f"; {others} earlier changes not logged: guard.patience ({patience:g} ms) may be too short"
            _log.warning("%s%s", text, hint if others > 1 else "")  # a takeover and its end are two changes
            self._unlogged, self._logged_at = 0, now
        if not changed and now < self._diagnostics_due:
            return
        self._diagnostics_due = now + self._diagnostics_period
        values = {
            "mode": guard.mode.value,
            "takeovers": str(guard.takeovers),
            "age/joint_commands": f"{now - received.command_at:.4f} s",
            "age/joint_states": f"{now - received.velocity_at:.4f} s",
            "controller": received.mode.value if received.mode is not None else "unknown",
        }
        refused = dict(self._refused)
        values |= {f"refused/{topic}": reason for topic, reason in refused.items()}
        values |= {f"publishers/{topic}": names for topic, names in self._shared.items()}
        level = ERROR if guard.reason else WARN if refused or self._shared else OK
        content = diagnostics(time.time_ns(), level, self._name, text, self._hardware, values)
        self._publish["diagnostics"](encode(content))

    def run(self, stop: threading.Event) -> None:
        """Run until stopped; the last message is never a damping torque."""
        gc.collect()
        gc.freeze()  # shortens later collections
        self.watch.start()
        try:
            while not stop.is_set():
                stop.wait(max(0.0, self.cycle() - self._clock.now()))
        finally:
            self.watch.stop()
            if self.guard.sending:
                self._publish["effort"](encode(torques(np.zeros(self._drive.command_size))))


def _compute_damping(settings: Settings, urdf: str) -> Array:
    """Compute the damping, (na, nj), in a separate process with Pinocchio.

    `multiprocessing` would import the main module and start a second guard.
    """
    place = str(Path(__file__).resolve().parents[2])
    done = subprocess.run(  # noqa: S603 - of this package
        [sys.executable, "-c", f"from {__name__} import write_damping; write_damping()"],
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


def write_damping() -> None:
    """Write the pickled damping for the pickled settings and URDF on standard input."""
    from wbc_controller.controller.build.guard import make_guard_damping
    from wbc_controller.controller.build.robot import make_model

    settings, urdf = pickle.loads(sys.stdin.buffer.read())  # noqa: S301 - written by the guard
    sys.stdout.buffer.write(pickle.dumps(make_guard_damping(settings, make_model(settings, urdf))))


def run_guard(
    settings: Settings,
    transport: Transport,
    stop: threading.Event,
    *,
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
) -> None:
    """Run the guard until the event is set; arguments and errors as for `run_controller`."""
    topics = endpoints(GUARD_TOPICS, GUARD_NODE, namespace=namespace, remappings=remappings)
    urdf = find_urdf(settings, transport, stop, topics)
    if stop.is_set():
        return
    robot, damping = describe(urdf, settings.robot), _compute_damping(settings, urdf)
    GuardService(settings, robot, damping, topics, transport, MonotonicClock(), namespace).run(stop)
