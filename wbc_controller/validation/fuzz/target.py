"""What the fuzzer of messages needs of a node: topics, ordinary messages, and a look at what each message did."""

from __future__ import annotations

import contextlib
import gc
import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

import numpy as np

from wbc_controller.controller.build.robot import make_model
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import decode, encode
from wbc_controller.middleware.topics import TASK_TYPES, Direction, Endpoint, counterpart
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.middleware.transports.transport import Publish, Transport
from wbc_controller.nodes.clock import ManualClock
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings, parse_settings

#: Most processor time for reading a request, s: the largest trajectory takes half of it on a slow core.
READ_LIMIT = 0.5
#: Most processor time of one cycle, s, and for reading a message that a cycle reads itself.
CYCLE_LIMIT = 0.02
#: Room for rounding in comparisons of torques, N·m.
_ROUNDING = 1.0e-9

_log = logging.getLogger("wbc_controller")


class Broken(Exception):
    """What must hold whatever arrives does not hold: one sentence."""


class Slow(Broken):
    """A message or cycle took too much processor time."""


class Target(Protocol):
    """A node under test, fresh; everything about it is deterministic.

    Attributes:
        topics: its incoming topics, by name.
        alive: whether it still does its work; a message that is valid may end that.
    """

    topics: Mapping[str, Endpoint]
    alive: bool

    def example(self, topic: Endpoint) -> Any:
        """An ordinary message of one of its topics, valid now."""
        ...

    def take(self, topic: Endpoint, payload: bytes) -> None:
        """Deliver a message, and see that all holds that must hold.

        Raises:
            Broken: if it does not.
        """
        ...

    def finish(self) -> None:
        """Deliver what is held back; raises as `take`."""
        ...


@dataclass(frozen=True, slots=True)
class Robot:
    """The robot of the fuzzer."""

    settings: Settings
    model: RobotModel


@cache
def fuzzed_robot(name: str) -> Robot:
    """A shipped robot with a task of every kind and a grip, all of them off, and activated without a ramp.

    Args:
        name: of a shipped robot with a floating base.
    """
    settings = load_settings(find_configuration(name))
    content = settings.model_dump(exclude_unset=True)
    base = make_model(settings).base_link
    contact = next(iter(content["contacts"]))
    frame = content["contacts"][contact]["frame"]
    needs: dict[str, dict[str, Any]] = {
        "relative_pose": {"frame": frame, "reference_frame": base},
        "axis_alignment": {"frame": base, "axis": [0.0, 0.0, 1.0]},
        "gaze": {"frame": base, "axis": [1.0, 0.0, 0.0]},
        "contact_wrench": {"contact": contact},
    }
    needs |= {kind: {"frame": base} for kind in ("frame_pose", "frame_position", "frame_orientation")}
    there = {task["type"] for task in content["tasks"].values()}
    for kind in sorted(TASK_TYPES.keys() - there):
        content["tasks"][f"any_{kind}"] = {"type": kind, "enabled": False, **needs.get(kind, {})}
    content["contacts"]["grip"] = {
        "type": "fixed", "frame": frame, "max_force": 100.0, "max_moment": 10.0, "enabled": False
    }  # fmt: skip
    content["control"] = {**content.get("control", {}), "markers_rate": 0.0}  # they only cost time
    content["safety"] = {**content.get("safety", {}), "activation_ramp": 0.0}
    settings = parse_settings(content, f"the fuzzer's {name}")
    return Robot(settings, make_model(settings))


def writers(topics: Mapping[str, Endpoint], transport: Transport) -> dict[str, Publish]:
    """Open the other end of incoming topics, by name."""
    return {name: transport.advertise(counterpart(topic)) for name, topic in topics.items()}


def incoming(topics: list[Endpoint]) -> dict[str, Endpoint]:
    """The incoming ones of a node's topics, by name, but for its URDF, which is read before the node is there."""
    return {
        topic.name: topic for topic in topics if topic.direction is Direction.IN and topic.key != "robot_description"
    }


class OtherEnd:
    """The other end of a node's topics: the fuzzer's own clock, writers, and what the node has said.

    Attributes:
        topics: the node's incoming topics, by name.
        by_key: the same, by key.
        types: type of each topic, by key.
        clock: the node's clock.
        publish: writes to an incoming topic, by name.
        heard: what came on the outgoing topics that are listened to, by key.
    """

    def __init__(self, topics: list[Endpoint], listen: Sequence[str]) -> None:
        """Open it, before the node is built.

        Args:
            topics: the node's.
            listen: keys of the outgoing topics that are listened to.
        """
        self._bus = MemoryBus()
        self.clock = ManualClock(1.0)
        self.topics = incoming(topics)
        self.by_key = {topic.key: topic for topic in self.topics.values()}
        self.types = {topic.key: topic.type for topic in topics}
        own = self.transport()
        self.publish = writers(self.topics, own)
        self.heard: dict[str, list[bytes]] = {key: [] for key in listen}
        for topic in topics:
            if topic.key in self.heard:
                own.subscribe(counterpart(topic), self.heard[topic.key].append)

    def transport(self) -> MemoryTransport:
        """A transport for the node."""
        return MemoryTransport(self._bus)

    def send(self, key: str, content: Any) -> None:
        """Write a message to the incoming topic of a key."""
        self.publish[self.by_key[key].name](encode(content))

    def refused(self) -> dict[str, str]:
        """What the newest diagnostics say to be refused: the reasons by topic."""
        if not self.heard["diagnostics"]:
            return {}
        (status,) = decode(self.heard["diagnostics"][-1], self.types["diagnostics"]).status
        said = {entry.key: str(entry.value) for entry in status.values}
        return {key.removeprefix("refused/"): reason for key, reason in said.items() if key.startswith("refused/")}


def saying_all(settings: Settings) -> Settings:
    """The settings of a node that publishes diagnostics with every cycle: each says what was refused."""
    control = settings.control.model_copy(update={"diagnostics_rate": 1000.0})
    return settings.model_copy(update={"control": control})


def check_torques(tau: Array, before: Array, limits: Array, step: Array, what: str) -> None:
    """See that torques are finite, within their limits, and changed by no more than a step.

    Args:
        tau: torques, (na,) in N·m.
        before: those before, (na,).
        limits: effort limits, (na,).
        step: largest change, (na,).
        what: who sent them, for the sentence.

    Raises:
        Broken: if they are not.
    """
    if not np.isfinite(tau).all():
        raise Broken(f"{what} sent torques that are not finite: {tau.tolist()}")
    if not (np.abs(tau) <= limits + _ROUNDING).all():
        raise Broken(f"{what} sent torques over their limits by {float((np.abs(tau) - limits).max()):g} N·m")
    if not (np.abs(tau - before) <= step + _ROUNDING).all():
        raise Broken(f"{what} changed a torque by {float((np.abs(tau - before) - step).max()):g} N·m more than allowed")


@contextlib.contextmanager
def within(seconds: float, what: str) -> Iterator[None]:
    """Hold a piece of work to a processor time of this thread, s.

    Raises:
        Slow: if it takes longer.
    """
    began = time.thread_time()
    yield
    spent = time.thread_time() - began
    if not (spent <= seconds):
        raise Slow(f"{what} took {1e3 * spent:.0f} ms of processor time; at most {1e3 * seconds:.0f} ms are allowed")


class _Errors(logging.Handler):
    """Keeps the records of errors."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.records: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        self.records.append(f"{record.getMessage()}: {type(error).__name__}: {error}")


@contextlib.contextmanager
def listening() -> Iterator[list[str]]:
    """Collect the errors that this package logs; keep its warnings, those of overflows, and Python's garbage back.

    The control loop itself collects next to no garbage, as it freezes what lives at its start.
    """
    handler, level = _Errors(), _log.level
    _log.addHandler(handler)
    _log.setLevel(logging.ERROR)
    propagate, _log.propagate = _log.propagate, False
    collecting = gc.isenabled()
    gc.disable()
    try:
        with np.errstate(all="ignore"):
            yield handler.records
    finally:
        _log.removeHandler(handler)
        _log.setLevel(level)
        _log.propagate = propagate
        if collecting:
            gc.enable()
