"""The fuzzer of messages: every incoming topic of every node gets random bytes, mutated and hostile messages.

Messages are sent in episodes. Each begins with a fresh node, and its messages follow from the seed, the node and the
number of the episode alone. What breaks a node is written to a file, with as many of the messages
before it as are needed.
"""

from __future__ import annotations

import base64
import contextlib
import ctypes
import faulthandler
import gc
import json
import resource
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.middleware.codec import encode, message
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.validation.fuzz.contents import hostile, hostile_text
from wbc_controller.validation.fuzz.controller_target import ControllerTarget
from wbc_controller.validation.fuzz.estimator_target import EstimatorTarget
from wbc_controller.validation.fuzz.mutations import mutated_bytes, pick
from wbc_controller.validation.fuzz.other_targets import GuardTarget, MockTarget, UrdfTarget
from wbc_controller.validation.fuzz.target import Broken, Slow, Target, fuzzed_robot, listening

#: The nodes under test, each with its share of the messages.
TARGETS: Mapping[str, tuple[Callable[[str], Target], float]] = {
    "controller": (ControllerTarget, 0.65),
    "guard": (GuardTarget, 0.15),
    "mock": (MockTarget, 0.15),
    "urdf": (UrdfTarget, 0.05),
    "estimator": (EstimatorTarget, 0.1),
}
#: Messages of an episode, at most.
_EPISODE = 400
#: Wall time after which an episode counts as hanging, s; the process then ends with a traceback.
_HANG = 120.0
#: Share of the messages after which the memory is to stay as it is, and by how much it may grow, kB.
WARM_UP, _GROWTH = 0.2, 40_000
#: Episodes between two collections of garbage, as a collection in mid-cycle would count as the cycle's time.
_COLLECT = 20
#: Longest random payload, in bytes.
_LONGEST_NOISE = 400

Sent = tuple[str, bytes]


@dataclass(slots=True)
class Failure:
    """What broke a node.

    Attributes:
        target: key of the node in `TARGETS`.
        why: what did not hold.
        messages: topic and payload of the messages that led to it.
        repeated: whether it broke again in a fresh node.
    """

    target: str
    why: str
    messages: list[Sent]
    repeated: bool


@dataclass(slots=True)
class Outcome:
    """The result of a run.

    Attributes:
        counts: number of messages, by node and kind of topic.
        failures: what broke a node.
        seconds: duration, s.
        processor: processor time, s.
        growth: growth of the memory after the warm-up, kB.
    """

    counts: Counter[str] = field(default_factory=Counter)
    failures: list[Failure] = field(default_factory=list)
    seconds: float = 0.0
    processor: float = 0.0
    growth: int = 0

    @property
    def sent(self) -> int:
        """Number of all messages."""
        return sum(self.counts.values())

    @property
    def flat(self) -> bool:
        """Whether the memory stayed as it was after the warm-up, but for what is fragmented."""
        return self.growth <= _GROWTH


def fuzz_messages(
    robot: str,
    count: int,
    seed: int,
    *,
    first: int = 0,
    targets: Sequence[str] = tuple(TARGETS),
    most_failures: int = 10,
    progress: Callable[[Outcome, str, int], None] = lambda outcome, key, episode: None,
) -> Outcome:
    """Send hostile messages to all nodes.

    Args:
        robot: name of a shipped robot with a floating base.
        count: number of messages.
        seed: of all choices.
        first: number of the first episode of each node.
        targets: keys of the nodes in `TARGETS`.
        most_failures: number of failures after which it ends.
        progress: called before each episode with the node and the number.

    Returns:
        What was sent, and what broke.

    Raises:
        ConfigurationError: if there is no such node.
    """
    shares = {key: _of(key)[1] for key in targets}
    sent, episodes = dict.fromkeys(targets, 0), dict.fromkeys(targets, first)
    outcome, warm, began, before_all = Outcome(), 0, time.monotonic(), time.process_time()
    with listening() as errors:
        while outcome.sent < count and len(outcome.failures) < most_failures:
            key = min(targets, key=lambda key: sent[key] / shares[key])
            progress(outcome, key, episodes[key])
            rng = np.random.default_rng([seed, list(TARGETS).index(key), episodes[key]])
            before = outcome.sent
            faulthandler.dump_traceback_later(_HANG, exit=True, file=sys.__stderr__ or 2)
            failure = _episode(key, robot, rng, outcome, count, errors)
            if sum(episodes.values()) % _COLLECT == 0:
                gc.collect()
            faulthandler.cancel_dump_traceback_later()
            if failure is not None:
                outcome.failures.append(failure)
            sent[key] += outcome.sent - before
            episodes[key] += 1
            if not warm and outcome.sent >= WARM_UP * count:
                warm = memory()
            outcome.seconds = time.monotonic() - began
            outcome.processor = time.process_time() - before_all
    outcome.growth = memory() - warm if warm else 0
    return outcome


def memory() -> int:
    """Memory of this process that is in use now, kB, without what the allocator keeps for later where it is glibc's."""
    gc.collect()
    with contextlib.suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() // 1024


def payload_for(rng: np.random.Generator, target: Target, topic: Endpoint, names: Sequence[str]) -> bytes:
    """A message for a topic: noise, a mutated one, one with hostile fields or a hostile text, or an ordinary one.

    Args:
        rng: source of the choices.
        target: the node.
        topic: one of its incoming topics.
        names: joints of the robot.
    """
    kind = rng.random()
    if kind < 0.08:
        return bytes(rng.bytes(int(rng.integers(_LONGEST_NOISE))))
    if topic.type == "std_msgs/msg/String" and kind < 0.8:
        # A text that holds no valid character for a while may stand in a message all the same.
        return encode(message(topic.type, data=hostile_text(rng, topic.key)))
    content = target.example(topic)
    if kind < 0.4:
        return mutated_bytes(rng, encode(content))
    return encode(hostile(rng, content, names) if kind < 0.96 else content)


def _of(key: str) -> tuple[Callable[[str], Target], float]:
    if key not in TARGETS:
        raise ConfigurationError(f"no node is named {key!r}; {valid_choices(key, TARGETS)}")
    return TARGETS[key]


def _episode(
    key: str, robot: str, rng: np.random.Generator, outcome: Outcome, count: int, errors: list[str]
) -> Failure | None:
    """Send the messages of one episode; what broke, if anything."""
    sent: list[Sent] = []
    errors.clear()
    try:
        target, names = _of(key)[0](robot), fuzzed_robot(robot).model.joints
        by_key: dict[str, list[Endpoint]] = {}
        for topic in target.topics.values():
            by_key.setdefault(topic.key, []).append(topic)
        kinds, topics = sorted(by_key), list(target.topics.values())
        while target.alive and len(sent) < _EPISODE and outcome.sent < count:
            # At times by kind: there are many topics of setpoints, and a single one of updates.
            topic = pick(rng, topics if rng.integers(3) else by_key[pick(rng, kinds)])
            payload = payload_for(rng, target, topic, names)
            sent.append((topic.name, payload))
            outcome.counts[f"{key}: {topic.key}"] += 1
            target.take(topic, payload)
            _see_no_error(errors)
        target.finish()
        _see_no_error(errors)
    except Exception as error:
        return _shrunk(key, robot, sent, error)
    return None


def _see_no_error(errors: list[str]) -> None:
    if errors:
        raise Broken(f"an error was logged: {errors[0]}")


def _shrunk(key: str, robot: str, sent: list[Sent], error: Exception) -> Failure | None:
    """Find the fewest of the last messages that break a fresh node; slowness that does not recur is the machine's."""
    lengths = [length for length in (1, 2, 4, 16, 64) if length < len(sent)]
    for length in [*lengths, len(sent)]:
        why = replay(key, robot, sent[-length:])
        if why is not None:
            return Failure(key, why, sent[-length:], True)
    if isinstance(error, Slow):
        return None
    return Failure(key, _sentence(error), sent, False)


def replay(key: str, robot: str, sent: Sequence[Sent]) -> str | None:
    """Send messages to a fresh node; what broke, None if nothing.

    Args:
        key: of the node in `TARGETS`.
        robot: name of the robot.
        sent: topic and payload of each message.
    """
    with listening() as errors:
        try:
            target = _of(key)[0](robot)
            for name, payload in sent:
                target.take(target.topics[name], payload)
                _see_no_error(errors)
            target.finish()
            _see_no_error(errors)
        except Exception as error:
            return _sentence(error)
    return None


def _sentence(error: Exception) -> str:
    return str(error) if isinstance(error, Broken) else f"{type(error).__name__}: {error}"


def save(failure: Failure, robot: str, path: Path) -> None:
    """Write a failure to a file for `load`."""
    sent = [{"topic": name, "payload": base64.b64encode(payload).decode()} for name, payload in failure.messages]
    content = {"target": failure.target, "robot": robot, "why": failure.why, "messages": sent}
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")


def load(path: Path) -> tuple[str, str, list[Sent]]:
    """Read a file of `save`.

    Returns:
        Key of the node, name of the robot, and the messages.

    Raises:
        ConfigurationError: if the file is none.
    """
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        sent = [(str(each["topic"]), base64.b64decode(each["payload"])) for each in content["messages"]]
        return str(content["target"]), str(content["robot"]), sent
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{path}: holds no messages of a failure: {type(error).__name__}: {error}") from error
