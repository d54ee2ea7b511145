"""Base class of the fuzzer's targets, and valid messages for them."""

import contextlib
import gc
import time
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np

from wbc_controller.controller.build.robot import make_model
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import com_trajectory, decode, encode, header, joint_trajectory, message
from wbc_controller.middleware.topics import TASK_TYPES, Direction, Endpoint, counterpart
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.clock import ManualClock
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.settings.config import load
from wbc_controller.validation.campaign.monitor import logged_errors

READ_LIMIT = 0.5  # processor time of reading a request, s
CYCLE_LIMIT = 0.02  # processor time of a cycle and its messages, s
_ROUNDING = 1.0e-9  # N·m


class InvariantViolation(Exception):
    """Violated invariant after a message."""


class TimeLimitExceeded(InvariantViolation):
    """Excessive processor time of a message or cycle."""


class Target:
    """A deterministic, fresh node under test on its own bus and simulated time."""

    def __init__(self, topics: Sequence[Endpoint], subscribed: Sequence[str] = ()) -> None:
        self.bus, self.clock = MemoryBus(), ManualClock(1.0)
        self.alive = True  # while the node works; a valid message may end this
        received = [each for each in topics if each.direction is Direction.IN and each.key != "robot_description"]
        self.topics = {topic.name: topic for topic in received}
        self.by_key = {topic.key: topic for topic in self.topics.values()}
        self.types = {topic.key: topic.type for topic in topics}
        self.outputs: dict[str, list[bytes]] = {key: [] for key in subscribed}  # messages on outgoing topics
        other_end = MemoryTransport(self.bus)
        for topic in topics:
            if topic.key in self.outputs:
                other_end.subscribe(counterpart(topic), self.outputs[topic.key].append)

    def example(self, topic: Endpoint) -> Any:
        """Return a valid message of a topic."""
        raise NotImplementedError

    def deliver(self, topic: Endpoint, payload: bytes) -> None:
        """Deliver a message; raise `InvariantViolation` if an invariant of the node is violated."""
        raise NotImplementedError

    def finish(self) -> None:
        """Deliver delayed messages; raises as `deliver`."""

    def publish(self, topic: Endpoint, payload: bytes) -> None:
        """Publish a payload as a temporary participant, because a permanent one would be a second publisher."""
        user = MemoryTransport(self.bus)
        user.advertise(counterpart(topic))(payload)
        user.close()

    def send(self, key: str, content: Any) -> None:
        """Publish a message on the topic of a key."""
        self.publish(self.by_key[key], encode(content))

    def clear_outputs(self) -> None:
        """Delete the received messages."""
        for messages in self.outputs.values():
            messages.clear()

    def refused(self) -> dict[str, str]:
        """Return the reasons of refusals in the newest diagnostics, by topic."""
        if not self.outputs["diagnostics"]:
            return {}
        (status,) = decode(self.outputs["diagnostics"][-1], self.types["diagnostics"]).status
        entries = {entry.key: str(entry.value) for entry in status.values}
        return {key.removeprefix("refused/"): reason for key, reason in entries.items() if key.startswith("refused/")}


def valid_message(type_name: str, names: Sequence[str], frame: str, stamp: int) -> Any:
    """Return a valid message."""
    zeros, times = np.zeros(len(names)), range(1, 4)
    match type_name.rpartition("/")[2]:
        case "JointState":
            content = message(type_name, name=list(names), position=zeros, velocity=zeros, effort=zeros)
        case "Float64MultiArray":
            content = message(type_name, data=zeros)
        case "Vector3Stamped":
            content = message(type_name, vector={"z": 1.0})
        case "PoseArray":
            content = message(type_name, poses=[message("geometry_msgs/msg/Pose")])
        case "JointTrajectory":
            content = joint_trajectory(names, times, np.tile(zeros, (len(times), 1)))
        case "MultiDOFJointTrajectory":
            content = com_trajectory(times, np.tile([0.0, 0.0, 1.0], (len(times), 1)), task="frame")
        case _:
            content = message(type_name)
    if hasattr(content, "header"):
        content.header = header(stamp, frame)
    return content


@cache
def fuzzed_robot(name: str) -> tuple[Settings, RobotModel]:
    """Return a supplied robot with a task of every type and a grip, all disabled, and without ramps."""
    config = load(name)
    base = make_model(config.settings).base_link
    contact, spec = next(iter(config.settings.contacts.items()))
    frame = spec.frame
    needs: dict[str, dict[str, Any]] = {
        "relative_pose": {"frame": frame, "reference_frame": base},
        "axis_alignment": {"frame": base, "axis": [0.0, 0.0, 1.0]},
        "gaze": {"frame": base, "axis": [1.0, 0.0, 0.0]},
        "contact_wrench": {"contact": contact},
    }
    needs |= {kind: {"frame": base} for kind in ("frame_pose", "frame_position", "frame_orientation")}
    grip = {"type": "fixed", "frame": frame, "max_force": 100.0, "max_moment": 10.0, "enabled": False}
    changes = {"contacts.grip": grip, "safety.activation_ramp": 0.0, "control.markers_rate": 0.0}  # markers cost time
    present = {task.type for task in config.settings.tasks.values()}
    for kind in sorted(TASK_TYPES.keys() - present):
        changes[f"tasks.any_{kind}"] = {"type": kind, "enabled": False, **needs.get(kind, {})}
    settings = config.replace(changes).settings
    return settings, make_model(settings)


def check_torques(tau: Array, before: Array, limits: Array, step: Array, what: str) -> None:
    """Check that torques are finite, within limits, and changed by at most `step`; raise `InvariantViolation`."""
    if not np.isfinite(tau).all():
        raise InvariantViolation(f"{what} sent non-finite torques: {tau.tolist()}")
    over, fast = np.abs(tau) - limits, np.abs(tau - before) - step
    if not (over <= _ROUNDING).all():
        raise InvariantViolation(f"{what} exceeded a torque limit by {float(over.max()):g} N·m")
    if not (fast <= _ROUNDING).all():
        raise InvariantViolation(f"{what} exceeded the torque step by {float(fast.max()):g} N·m")


@contextlib.contextmanager
def time_limit(seconds: float, what: str) -> Iterator[None]:
    """Limit the processor time of this thread in the context, s; raise `TimeLimitExceeded`."""
    began = time.thread_time()
    yield
    spent = time.thread_time() - began
    if not (spent <= seconds):
        raise TimeLimitExceeded(f"{what} took {1e3 * spent:.0f} ms of processor time; limit {1e3 * seconds:.0f} ms")


@contextlib.contextmanager
def collected_errors() -> Iterator[list[str]]:
    """Collect logged errors, without overflow warnings and garbage collections."""
    gc.disable()
    try:
        with np.errstate(all="ignore"), logged_errors() as errors:
            yield errors
    finally:
        gc.enable()
