"""Connection of a user to a robot's nodes."""

import dataclasses
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from wbc_controller.apps.terminal import DISCOVERY_PATIENCE
from wbc_controller.apps.terminal.request_parser import Request
from wbc_controller.errors import TransportError, WbcError
from wbc_controller.middleware.codec import decode, encode, velocity_message
from wbc_controller.middleware.stamps import header_time
from wbc_controller.middleware.topics import STATE_IN, Direction, Endpoint, counterpart
from wbc_controller.middleware.transports.dds import DdsPublication, DdsTransport
from wbc_controller.nodes.wiring import topics_of
from wbc_controller.settings import NODE_NAME, Settings

ANSWER_TIMEOUT = 20.0  # of a discovered node, wall time, s
#: Longest wait for the first status, and for a walking robot to stand, before the hoist lifts it, s.
_STATUS_PATIENCE, _STAND_PATIENCE = 1.5, 10.0
_RAMPED = {"activate": "active", "deactivate": "inactive"}  # commands with a torque ramp, and their final mode


class NoAnswer(WbcError):
    """A node is missing or did not answer."""


class Answer(NamedTuple):
    """Outcome of a request."""

    done: bool  # False after a refusal
    text: str


class Session:
    """Sends requests to the nodes and stores their newest messages."""

    def __init__(
        self,
        settings: Settings,
        *,
        namespace: str = "/",
        remappings: Mapping[str, str] | None = None,
        patience: float = DISCOVERY_PATIENCE,
        node: str = "wbc_user",
    ) -> None:
        """Join the DDS domain; an undiscovered node counts as absent after `patience`, wall time, s."""
        self.topics = topics_of(settings, namespace, remappings)
        self._settings = settings
        self._status_name = f"{namespace.strip('/')}/{NODE_NAME}: control loop".lstrip("/")
        self._patience = patience
        self._transport = DdsTransport(node, namespace)
        self._arrival = threading.Condition()
        self._messages: dict[tuple[str, str, str], deque[bytes]] = {}
        self._publications: dict[tuple[str, str, str], DdsPublication] = {}
        self._opening = threading.Lock()

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, *_: object) -> None:
        self._transport.close()

    def listen(self, node: str, key: str, subject: str = "", *, depth: int = 1) -> None:
        """Subscribe, and store the newest messages."""
        place = (node, key, subject)
        if place in self._messages:
            return
        payloads: deque[bytes] = deque(maxlen=depth)

        def receive(payload: bytes) -> None:
            with self._arrival:
                payloads.append(payload)
                self._arrival.notify_all()

        self._transport.subscribe(counterpart(self.topics[place]), receive)
        self._messages[place] = payloads

    def poll(self, node: str, key: str, subject: str = "") -> Callable[[], bytes | None]:
        """Return a function that returns the newest payload since its last call (best effort)."""
        topic = dataclasses.replace(counterpart(self.topics[node, key, subject]), qos=STATE_IN)
        stream = self._transport.stream(topic, depth=1)
        return lambda: next(reversed(stream.take()), None)

    def newest(self, node: str, key: str, subject: str = "") -> Any | None:
        """Return the newest message of a subscription; None before the first."""
        payloads = self._messages.get((node, key, subject))
        return decode(payloads[-1], self.topics[node, key, subject].type) if payloads else None

    def wait_for_message(self, node: str, key: str, subject: str = "") -> Any:
        """Return the newest message, or wait for the first; raise `NoAnswer` without any."""
        self.listen(node, key, subject)
        name = self.topics[node, key, subject].name
        self.until(lambda: self._messages[node, key, subject], f"no message on {name}{self._mode_note()}")
        return self.newest(node, key, subject)

    def until(self, condition: Callable[[], Any], error: str, patience: float = ANSWER_TIMEOUT) -> None:
        """Wait for a condition; raise `NoAnswer` with the text `error` otherwise."""
        with self._arrival:
            if not self._arrival.wait_for(condition, patience):
                raise NoAnswer(error)

    def publishers(self, topic: Endpoint) -> tuple[str, ...]:
        """Return the nodes that publish on a topic."""
        return self._transport.publishers(topic)

    def mode(self) -> str:
        """Return the controller's state; initially empty."""
        state = self.newest("controller", "state")
        return "" if state is None else str(state.data)

    def _mode_note(self) -> str:
        return f"; the controller is {self.mode()}" if self.mode() else ""

    def execute(self, request: Request) -> Answer:
        """Send a request, and return its outcome; raise `NoAnswer` without a node or answer."""
        if (request.node, request.key, request.summary) == ("controller", "command", "estop"):
            self._deliver(request)
            self.listen("controller", "state")
            error = "the emergency stop was delivered, but the controller has not confirmed it; check the robot"
            self.until(lambda: "ESTOP" in self.mode(), error)
            return Answer(True, f"the controller is {self.mode()}")
        if request.node == "mock":
            self._deliver(request)
            return Answer(True, f"sent to the mock robot: {request.summary}")
        self.wait_for_controller()
        return self._request_recording(request) if request.key == "record" else self._send_and_confirm(request)

    def open(self, node: str, key: str, subject: str = "") -> DdsPublication:
        """Advertise a topic for `send`: discovery takes time."""
        place = (node, key, subject)
        with self._opening:
            if place not in self._publications:
                self._publications[place] = self._transport.advertise(counterpart(self.topics[place]))
            return self._publications[place]

    def send(self, request: Request) -> DdsPublication:
        """Send a request without waiting for its outcome. Thread-safe.

        Raises `NoAnswer` without a subscriber of the topic, and `TransportError` if sending failed.
        """
        publication = self.open(request.node, request.key, request.subject)
        content = request.make(self.wait_for_message)
        if not publication.wait_for_reader(self._patience):
            raise NoAnswer(self._absent_node(request.node))
        self._stop_before(request)
        publication(encode(content))
        return publication

    def _deliver(self, request: Request) -> None:
        publication = self.send(request)
        if not publication.wait_for_acknowledgment(ANSWER_TIMEOUT):
            raise TransportError(f"a message on {publication.topic} was not acknowledged in {ANSWER_TIMEOUT:g} s")

    def _stop_before(self, request: Request) -> None:
        """Let a walking robot stand before the hoist lifts it; without a status nothing is sent."""
        if self._settings.walking is None or request.key != "hold" or not request.make(self.wait_for_message).data:
            return
        newest, stop = self.poll("controller", "diagnostics"), self.open("controller", "cmd_vel")
        deadline, stopping = time.monotonic() + _STATUS_PATIENCE, False
        while time.monotonic() < deadline:
            payload = newest()
            statuses = self._statuses_in(payload) if payload is not None else []
            if not statuses:
                time.sleep(0.02)
                continue
            values = {value.key: value.value for value in statuses[-1].values}
            if values.get("mode") != "active" or values.get("walking/phase", "stand") == "stand":
                return
            if not stopping:
                deadline, stopping = time.monotonic() + _STAND_PATIENCE, True
            stop(encode(velocity_message((0.0, 0.0, 0.0))))

    def find_controller(self) -> None:
        """Wait for a publisher of the controller's state, before the first subscription; raise `NoAnswer` without one.

        Fast DDS delays latched messages by up to 3 s for a reader announced before the writer's discovery.
        """
        state = counterpart(self.topics["controller", "state", ""])
        deadline = time.monotonic() + self._patience
        while not self._transport.publishers(state):
            if time.monotonic() >= deadline:
                raise NoAnswer(self._absent_node("controller"))
            time.sleep(0.01)

    def wait_for_controller(self) -> None:
        """Wait for state and diagnostics of the controller; raise `NoAnswer` without them."""
        self.find_controller()
        self.listen("controller", "diagnostics", depth=1000)
        self.wait_for_message("controller", "state")
        self.wait_for_message("controller", "diagnostics")

    def _send_and_confirm(self, request: Request) -> Answer:
        topic, before = self.topics[request.node, request.key, request.subject], self._status_values()
        self._deliver(request)
        error = f"the controller did not process the request{self._mode_note()}"
        later = self._status_values_until(lambda values: values["requests_taken"] != before["requests_taken"], error)
        refusals = [text for values in later for key, text in values.items() if key.startswith("refused/")]
        refusals = [text for text in refusals if not text.startswith("/") or text.startswith(topic.name)]
        if refusals:
            return Answer(False, f"refused: {'; '.join(refusals)}")
        if request.key == "command":
            return self._await_ramp(request.summary)
        return Answer(True, f"accepted: {request.summary}")

    def _request_recording(self, request: Request) -> Answer:
        before = self._status_values()
        if not before.get("recorder_said"):
            return Answer(False, f"refused: {before['recorder']}")
        self._deliver(request)
        error = f"no answer from the recorder; its last status: {before['recorder']}"
        later = self._status_values_until(lambda values: values.get("recorder_said") != before["recorder_said"], error)
        return Answer(True, later[-1]["recorder"])

    def _status_values(self) -> dict[str, str]:
        return self._status_values_until(lambda values: True, "no status of the controller on /diagnostics")[-1]

    def _status_values_until(self, condition: Callable[[dict[str, str]], bool], error: str) -> list[dict[str, str]]:
        found: list[dict[str, str]] = []

        def met() -> bool:
            found.extend({value.key: value.value for value in status.values} for status in self.statuses())
            return bool(found) and condition(found[-1])

        self.until(met, error)
        return found

    def statuses(self) -> Iterator[Any]:
        """Yield and remove the controller's statuses, oldest first."""
        payloads = self._messages["controller", "diagnostics", ""]
        while payloads:
            yield from self._statuses_in(payloads.popleft())

    def _statuses_in(self, payload: bytes) -> list[Any]:
        array = decode(payload, "diagnostic_msgs/msg/DiagnosticArray")
        return [status for status in array.status if status.name == self._status_name]

    def follow(self, topic: Endpoint) -> Callable[[float], list[Any]]:
        """Subscribe; return a function that waits up to a time, s, and returns the new messages."""
        # Inputs accept publishers of any quality of service.
        endpoint = dataclasses.replace(topic, qos=STATE_IN) if topic.direction is Direction.IN else counterpart(topic)
        stream = self._transport.stream(endpoint, depth=1000)

        def messages(wait: float) -> list[Any]:
            stream.wait(wait)
            return [decode(payload, topic.type) for payload in stream.take()]

        return messages

    def _await_ramp(self, word: str) -> Answer:
        if word not in _RAMPED:
            return Answer(True, f"accepted: {word}; the controller is {self.mode()}")
        self.listen("controller", "joint_commands")
        begun, ramp = self._command_stamp(), self._settings.safety.activation_ramp
        while self.mode().startswith("active"):
            if word == "activate" and self._command_stamp() - begun > ramp:
                return Answer(True, "the controller is active at full torque")
            before = self._command_stamp()
            self.until(
                lambda before=before: self._command_stamp() > before or not self.mode().startswith("active"),  # type: ignore[misc]
                "the controller is active, but sends no joint commands",
            )
        return Answer(self.mode() == _RAMPED[word], f"the controller is {self.mode()}")

    def _command_stamp(self) -> float:
        payloads = self._messages["controller", "joint_commands", ""]
        return header_time(payloads[-1]) if payloads else 0.0

    def _absent_node(self, owner: str) -> str:
        node, command = ("controller", "run") if owner == "controller" else ("mock robot", "mock")
        absent = f"no {node} found in DDS domain {self._transport.domain} within {self._patience:g} s"
        return f"{absent}; start it with: wbc {command}"
