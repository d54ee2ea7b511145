"""Fuzzer of messages to every node.

Each episode begins with a fresh node, and is determined by seed, node and number.
"""

import base64
import contextlib
import ctypes
import faulthandler
import gc
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.nodes import processes
from wbc_controller.validation.fuzz.controller_target import ControllerTarget
from wbc_controller.validation.fuzz.other_targets import EstimatorTarget, GuardTarget, MockTarget, UrdfTarget
from wbc_controller.validation.fuzz.strategies import draw_by_key, requests
from wbc_controller.validation.fuzz.target import (
    InvariantViolation,
    Target,
    TimeLimitExceeded,
    collected_errors,
    fuzzed_robot,
)

#: Nodes under test, with their shares of the messages.
TARGETS: Mapping[str, tuple[Callable[[str], Target], float]] = {
    "controller": (ControllerTarget, 0.65),
    "guard": (GuardTarget, 0.15),
    "mock": (MockTarget, 0.15),
    "urdf": (UrdfTarget, 0.05),
    "estimator": (EstimatorTarget, 0.1),
}
_EPISODE_LENGTH = 400
_EPISODE_TIMEOUT = 120.0  # wall time, s; then the process ends with a traceback
WARM_UP, MAX_GROWTH = 0.2, 40_000  # share of messages, and growth of the memory afterwards, kB

Message = tuple[str, bytes]


@dataclass(slots=True)
class Failure:
    """A broken node."""

    target: str
    why: str  # violated invariant
    messages: list[Message]  # topic and payload
    repeated: bool  # True if reproduced with a fresh node


@dataclass(slots=True)
class Outcome:
    """Result of a run."""

    counts: Counter[str] = field(default_factory=Counter)  # messages by node and topic
    failures: list[Failure] = field(default_factory=list)  # broken nodes
    seconds: float = 0.0
    processor: float = 0.0
    growth: int = 0  # kB, after the warm-up

    @property
    def sent(self) -> int:
        """Number of all messages."""
        return sum(self.counts.values())


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
    """Send hostile messages to all nodes."""
    require_known(targets, TARGETS, "unknown node")
    shares = {key: TARGETS[key][1] for key in targets}
    done, episodes = dict.fromkeys(targets, 0), dict.fromkeys(targets, first)
    outcome, warm, began, before_all = Outcome(), 0, time.monotonic(), time.process_time()
    while outcome.sent < count and len(outcome.failures) < most_failures:
        key = min(targets, key=lambda key: done[key] / shares[key])
        progress(outcome, key, episodes[key])
        before = outcome.sent
        faulthandler.dump_traceback_later(_EPISODE_TIMEOUT, exit=True, file=sys.__stderr__ or 2)
        failure = _episode(key, robot, f"{seed} {key} {episodes[key]}", outcome, count)
        faulthandler.cancel_dump_traceback_later()
        if failure is not None:
            outcome.failures.append(failure)
        done[key] += outcome.sent - before
        episodes[key] += 1
        if not warm and outcome.sent >= WARM_UP * count:
            warm = memory()
        outcome.seconds = time.monotonic() - began
        outcome.processor = time.process_time() - before_all
    outcome.growth = memory() - warm if warm else 0
    return outcome


def memory() -> int:
    """Return this process's memory, kB, without reserves of glibc's allocator."""
    gc.collect()
    with contextlib.suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
    return processes.memory(os.getpid())


def _episode(key: str, robot: str, seed: str, outcome: Outcome, count: int) -> Failure | None:
    messages: list[Message] = []

    def draw(target: Target) -> Iterator[Message]:
        while target.alive and len(messages) < _EPISODE_LENGTH and outcome.sent < count:
            topic, payload = draw_by_key(requests(target, fuzzed_robot(robot)[1].joints), seed, len(messages))
            messages.append((topic.name, payload))
            outcome.counts[f"{key}: {topic.key}"] += 1
            yield messages[-1]

    error = _send(key, robot, draw)
    return None if error is None else _reduced(key, robot, messages, error)


def _send(key: str, robot: str, sent: Callable[[Target], Iterable[Message]]) -> Exception | None:
    with collected_errors() as errors:
        try:
            target = TARGETS[key][0](robot)
            for name, payload in sent(target):
                target.deliver(target.topics[name], payload)
                if errors:
                    break
            else:
                target.finish()
            return InvariantViolation(f"logged error: {errors[0]}") if errors else None
        except Exception as error:
            return error


def _reduced(key: str, robot: str, messages: list[Message], error: Exception) -> Failure | None:
    for length in sorted({min(length, len(messages)) for length in (1, 2, 4, 16, 64, _EPISODE_LENGTH)}):
        why = replay(key, robot, messages[-length:])
        if why is not None:
            return Failure(key, why, messages[-length:], True)
    return None if isinstance(error, TimeLimitExceeded) else Failure(key, _sentence(error), messages, False)


def replay(key: str, robot: str, sent: Sequence[Message]) -> str | None:
    """Send messages to a fresh node, and return the violated invariant or None."""
    require_known(key, TARGETS, "unknown node")
    error = _send(key, robot, lambda target: sent)
    return None if error is None else _sentence(error)


def _sentence(error: Exception) -> str:
    return str(error) if isinstance(error, InvariantViolation) else f"{type(error).__name__}: {error}"


def save(failure: Failure, robot: str, path: Path) -> None:
    """Write a failure for `load`."""
    sent = [{"topic": name, "payload": base64.b64encode(payload).decode()} for name, payload in failure.messages]
    content = {"target": failure.target, "robot": robot, "why": failure.why, "messages": sent}
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")


def load(path: Path) -> tuple[str, str, list[Message]]:
    """Read a file of `save`: node, robot and messages; raise `ConfigurationError` for other contents."""
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        sent = [(str(each["topic"]), base64.b64decode(each["payload"])) for each in content["messages"]]
        return str(content["target"]), str(content["robot"]), sent
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{path}: not a file of fuzzer messages: {type(error).__name__}: {error}") from error
