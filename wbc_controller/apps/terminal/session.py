"""A user's connection to the nodes of one robot: their newest messages, and requests with their answers."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from wbc_controller.apps.terminal import DISCOVERY_PATIENCE
from wbc_controller.apps.terminal.request_parser import Request
from wbc_controller.errors import WbcError
from wbc_controller.middleware.codec import decode, encode
from wbc_controller.middleware.stamps import header_time
from wbc_controller.middleware.topics import (
    CONTROLLER_TOPICS,
    ESTIMATOR_NODE,
    ESTIMATOR_TOPICS,
    GUARD_TOPICS,
    MOCK_NODE,
    MOCK_TOPICS,
    STATE_IN,
    Direction,
    Endpoint,
    counterpart,
    endpoints,
)
from wbc_controller.middleware.transports.dds import DdsPublication, DdsTransport
from wbc_controller.nodes.guard_service import NODE_NAME as GUARD_NODE
from wbc_controller.nodes.wiring import named_frames
from wbc_controller.settings import NODE_NAME, Settings

#: Name of the user's node.
_NODE = "wbc_user"
#: Wall time in which a node that is there has to answer, s: on a computer that is busy, several times what it takes.
ANSWER = 20.0
#: Commands that take the ramp of the torques, and the mode in which they end.
_RAMPED = {"activate": "active", "deactivate": "inactive"}


class NoAnswer(WbcError):
    """No node was found, or it did not answer."""


@dataclasses.dataclass(frozen=True, slots=True)
class Answer:
    """The outcome of a request."""

    done: bool  # False if it was refused
    sentence: str  # the outcome in words


def topics_of(
    settings: Settings, namespace: str = "/", remappings: Mapping[str, str] | None = None
) -> dict[tuple[str, str, str], Endpoint]:
    """Return every topic of all nodes, by node, row and subject."""
    kinds = {name: task.type for name, task in settings.tasks.items()}
    tables = {
        "controller": (CONTROLLER_TOPICS, NODE_NAME),
        "mock": (MOCK_TOPICS, MOCK_NODE),
        "guard": (GUARD_TOPICS, GUARD_NODE),
        "estimator": (ESTIMATOR_TOPICS, ESTIMATOR_NODE),
    }
    return {
        (owner, topic.key, topic.subject): topic
        for owner, (table, node) in tables.items()
        for topic in endpoints(
            table,
            node,
            task_kinds=kinds,
            contacts=settings.contacts,
            frames=named_frames(settings),
            namespace=namespace,
            remappings=remappings,
        )
    }


class Session:
    """Sends messages to the nodes, and keeps their newest messages."""

    def __init__(
        self,
        settings: Settings,
        *,
        namespace: str = "/",
        remappings: Mapping[str, str] | None = None,
        patience: float = DISCOVERY_PATIENCE,
        node: str = _NODE,
    ) -> None:
        """Join the DDS domain as a node; an undiscovered node counts as absent after `patience`, s of wall time."""
        self.topics = topics_of(settings, namespace, remappings)
        self._settings = settings
        self._status_name = f"{namespace.strip('/')}/{NODE_NAME}: control loop".lstrip("/")
        self._patience = patience
        self._transport = DdsTransport(node, namespace)
        self._came = threading.Condition()
        self._kept: dict[tuple[str, str, str], deque[bytes]] = {}
        self._publications: dict[tuple[str, str, str], DdsPublication] = {}
        self._opening = threading.Lock()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self._transport.close()

    def listen(self, node: str, key: str, subject: str = "", *, depth: int = 1) -> None:
        """Keep the newest messages of a topic from now on, and of a latched one the last."""
        place = (node, key, subject)
        if place not in self._kept:
            self._kept[place] = self._subscribe(counterpart(self.topics[place]), depth)

    def _subscribe(self, endpoint: Endpoint, depth: int) -> deque[bytes]:
        """Subscribe to a topic; returns the queue of its serialized messages."""
        kept: deque[bytes] = deque(maxlen=depth)

        def receive(payload: bytes) -> None:
            with self._came:
                kept.append(payload)
                self._came.notify_all()

        self._transport.subscribe(endpoint, receive)
        return kept

    def poll(self, node: str, key: str, subject: str = "") -> Callable[[], bytes | None]:
        """Follow a stream without a callback; the result returns the newest serialized message since its last call.

        The subscription is best effort: the publisher waits for no acknowledgment.
        """
        topic = dataclasses.replace(counterpart(self.topics[node, key, subject]), qos=STATE_IN)
        stream = self._transport.stream(topic, depth=1)

        def newest() -> bytes | None:
            taken = stream.take()
            return taken[-1] if taken else None

        return newest

    def newest(self, node: str, key: str, subject: str = "") -> Any | None:
        """Return the newest message of a topic that is listened to; None before the first one."""
        kept = self._kept[node, key, subject]
        return decode(kept[-1], self.topics[node, key, subject].type) if kept else None

    def take(self, node: str, key: str, subject: str = "") -> Iterator[Any]:
        """Take the messages of a topic that were kept, oldest first."""
        kept = self._kept[node, key, subject]
        while kept:
            yield decode(kept.popleft(), self.topics[node, key, subject].type)

    def hear(self, node: str, key: str, subject: str = "") -> Any:
        """Return the newest message of a topic; waits for the first one.

        Raises:
            NoAnswer: if none arrives.
        """
        self.listen(node, key, subject)
        name = self.topics[node, key, subject].name
        self.until(lambda: self._kept[node, key, subject], f"no message on {name}{self._mode_said()}")
        return self.newest(node, key, subject)

    def until(self, condition: Callable[[], Any], otherwise: str, patience: float = ANSWER) -> None:
        """Wait until messages have made a condition true.

        Raises:
            NoAnswer: with the sentence `otherwise`, if it is not true in time.
        """
        with self._came:
            if not self._came.wait_for(condition, patience):
                raise NoAnswer(otherwise)

    def publishers(self, topic: Endpoint) -> tuple[str, ...]:
        """Return the names of the nodes that publish on a topic."""
        return self._transport.publishers(topic)

    def mode(self) -> str:
        """Return the controller's state; empty before its first message."""
        state = self.newest("controller", "state") if ("controller", "state", "") in self._kept else None
        return "" if state is None else str(state.data)

    def _mode_said(self) -> str:
        return f"; the controller is {self.mode()}" if self.mode() else ""

    def ask(self, request: Request) -> Answer:
        """Send a request, and wait for its outcome.

        Raises:
            NoAnswer: if its node is not found, or does not answer.
        """
        if (request.node, request.key, request.summary) == ("controller", "command", "estop"):
            return self._stop(request)
        if request.node == "mock":
            self._deliver(request)
            return Answer(True, f"sent to the mock robot: {request.summary}")
        self.wait_for_controller()
        return self._ask_recorder(request) if request.key == "record" else self._ask_controller(request)

    def open(self, node: str, key: str, subject: str = "") -> DdsPublication:
        """Open a topic for `send`, once: a node needs a moment to discover a new publisher."""
        place = (node, key, subject)
        with self._opening:
            if place not in self._publications:
                self._publications[place] = self._transport.advertise(counterpart(self.topics[place]))
            return self._publications[place]

    def send(self, request: Request) -> None:
        """Send a request without waiting for its outcome; a refusal is on the controller's diagnostics. Thread-safe.

        Raises:
            NoAnswer: if nobody reads its topic.
            TransportError: if it could not be sent.
        """
        publication, content = self.open(request.node, request.key, request.subject), request.make(self.hear)
        if not publication.wait_for_reader(self._patience):
            raise NoAnswer(self._absent(request.node))
        publication(encode(content))

    def _stop(self, request: Request) -> Answer:
        """Send an emergency stop first, then wait until the controller confirms it."""
        self._deliver(request)
        self.listen("controller", "state")
        self.until(
            lambda: "ESTOP" in self.mode(), "the emergency stop is delivered; the controller has not confirmed it"
        )
        return Answer(True, f"the controller is {self.mode()}")

    def find_controller(self) -> None:
        """Wait until DDS has discovered the publisher of the controller's state.

        Call it before the first subscription. Fast DDS sends latched messages with its next heartbeat, up to 3 s later,
        to a reader that announced itself before it had discovered the writer.

        Raises:
            NoAnswer: if no publisher is discovered within the session's patience.
        """
        state = counterpart(self.topics["controller", "state", ""])
        deadline = time.monotonic() + self._patience
        while not self._transport.publishers(state):
            if time.monotonic() >= deadline:
                raise NoAnswer(self._absent("controller"))
            time.sleep(0.01)

    def wait_for_controller(self) -> None:
        """Wait for a message on each of the controller's topics state and diagnostics.

        Raises:
            NoAnswer: if the controller is not found, or publishes nothing on one of them.
        """
        self.find_controller()
        self.listen("controller", "state")
        self.listen("controller", "diagnostics", depth=1000)
        for key in ("state", "diagnostics"):
            name = self.topics["controller", key, ""].name
            self.until(lambda key=key: self._kept["controller", key, ""], f"no message on {name}{self._mode_said()}")  # type: ignore[misc]

    def _ask_controller(self, request: Request) -> Answer:
        topic, before = self.topics[request.node, request.key, request.subject], self._values()
        self._deliver(request)
        later = self._values_until(
            lambda values: values["requests_taken"] != before["requests_taken"],
            f"the controller has not taken it{self._mode_said()}",
        )
        refusals = [text for values in later for key, text in values.items() if key.startswith("refused/")]
        refusals = [text for text in refusals if not text.startswith("/") or text.startswith(topic.name)]
        if refusals:
            return Answer(False, f"refused: {'; '.join(refusals)}")
        if request.key == "command":
            return self._await_ramp(request.summary)
        return Answer(True, f"accepted: {request.summary}")

    def _ask_recorder(self, request: Request) -> Answer:
        before = self._values()
        if not before.get("recorder_said"):
            return Answer(False, f"refused: {before['recorder']}")
        self._deliver(request)
        later = self._values_until(
            lambda values: values.get("recorder_said") != before["recorder_said"],
            f"the recorder does not answer; its last status: {before['recorder']}",
        )
        return Answer(True, later[-1]["recorder"])

    def _values(self) -> dict[str, str]:
        """Return the values of the controller's newest status; waits for one."""
        return self._values_until(lambda values: True, "no status of this controller on /diagnostics")[-1]

    def _values_until(self, condition: Callable[[dict[str, str]], bool], otherwise: str) -> list[dict[str, str]]:
        """Return the values of the controller's statuses from now on, up to the first that meets a condition."""
        found: list[dict[str, str]] = []

        def met() -> bool:
            found.extend({value.key: value.value for value in status.values} for status in self.statuses())
            return bool(found) and condition(found[-1])

        self.until(met, otherwise)
        return found

    def statuses(self) -> Iterator[Any]:
        """Take the controller's statuses since the last call, oldest first: diagnostic_msgs/DiagnosticStatus."""
        for array in self.take("controller", "diagnostics"):
            yield from (status for status in array.status if status.name == self._status_name)

    def follow(self, topic: Endpoint) -> Callable[[float], list[Any]]:
        """Listen to any topic; the result waits up to a time, in s, and takes the messages that have arrived."""
        # Of a node's outputs, use its quality of service; of its inputs, receive from publishers of any quality.
        endpoint = dataclasses.replace(topic, qos=STATE_IN) if topic.direction is Direction.IN else counterpart(topic)
        kept = self._subscribe(dataclasses.replace(endpoint, qos=dataclasses.replace(endpoint.qos, depth=1000)), 1000)

        def messages(wait: float) -> list[Any]:
            with self._came:
                self._came.wait_for(lambda: kept, wait)
                taken = list(kept)
                kept.clear()
            return [decode(payload, topic.type) for payload in taken]

        return messages

    def _await_ramp(self, word: str) -> Answer:
        """Wait for the end of the ramp that a command begins."""
        if word not in _RAMPED:
            return Answer(True, f"accepted: {word}; the controller is {self.mode()}")
        self.listen("controller", "joint_commands")
        begun, ramp = self._stamp(), self._settings.safety.activation_ramp
        while self.mode().startswith("active"):
            if word == "activate" and self._stamp() - begun > ramp:
                return Answer(True, "the controller is active, and its torques are ramped in")
            before = self._stamp()
            self.until(
                lambda before=before: self._stamp() > before or not self.mode().startswith("active"),  # type: ignore[misc]
                "the controller is active, but sends no commands",
            )
        done = self.mode() == _RAMPED[word]
        return Answer(done, f"the controller is {self.mode()}")

    def _stamp(self) -> float:
        """Return the stamp of the newest joint command, s; 0 before the first one."""
        kept = self._kept["controller", "joint_commands", ""]
        return header_time(kept[-1]) if kept else 0.0

    def _deliver(self, request: Request) -> None:
        topic = self.topics[request.node, request.key, request.subject]
        content = request.make(self.hear)
        if not self._transport.deliver(counterpart(topic), encode(content), self._patience, ANSWER):
            raise NoAnswer(self._absent(request.node))

    def _absent(self, owner: str) -> str:
        """Return the message for an absent node."""
        node, command = ("controller", "run") if owner == "controller" else ("mock robot", "mock")
        return (
            f"no {node} found on DDS domain {self._transport.domain} within {self._patience:g} s; "
            f"start it with: wbc {command}"
        )
