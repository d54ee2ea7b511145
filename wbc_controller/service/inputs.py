"""Incoming messages: latches the mailboxes into a state, commands and changes; unusable messages are refused."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from wbc_controller.core.references.changes import Change
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.errors import InputRefused
from wbc_controller.records import Array, ChangeSettings, RobotState
from wbc_controller.service.clock import Clock
from wbc_controller.service.mailbox import Mailbox
from wbc_controller.transports.transport import Transport
from wbc_controller.wire import decoding
from wbc_controller.wire.joint_order import JointOrder
from wbc_controller.wire.messages import decode
from wbc_controller.wire.topics import Direction, Endpoint

_log = logging.getLogger(__name__)

_REQUEST_DEPTH = 100
#: Longest reason of a refusal, in characters; a longer one is cut, since it may quote the message.
_LONGEST_REASON = 1000


@dataclass(frozen=True, slots=True)
class Latched:
    """All inputs, latched at the start of one cycle.

    Attributes:
        state: the newest state; None until all of its parts have arrived (joint states, and odometry for a floating
            base).
        joint_velocity: newest joint velocities, (nj,) in rad/s; None until they have arrived.
        ages: age of each part of the state, s; infinite if it has never arrived.
        notes: for each part of the state whose last message was refused, the reason.
        commands: words on the command topic, in order of arrival.
        changes: sets of changes, in order of arrival; each set is applied whole or not at all.
        refused: a sentence for each message that was refused.
    """

    state: RobotState | None
    joint_velocity: Array | None
    ages: dict[str, float]
    notes: dict[str, str]
    commands: tuple[str, ...]
    changes: tuple[tuple[Change | ChangeSettings, ...], ...]
    refused: tuple[str, ...]


@dataclass(slots=True)
class _Part:
    """Newest message of one part of the state: joint states or odometry."""

    received: float = -np.inf
    stamp: int = 0
    q: Array = field(default_factory=lambda: np.zeros(0))
    v: Array = field(default_factory=lambda: np.zeros(0))


class Inputs:
    """Subscribes to every incoming topic, and latches the messages that have arrived.

    Attributes:
        arrived: set when a joint state arrives.
    """

    def __init__(
        self,
        model: RobotModel,
        vocabulary: decoding.Vocabulary,
        endpoints: Iterable[Endpoint],
        transport: Transport,
        clock: Clock,
    ) -> None:
        """Subscribe to the incoming topics.

        Args:
            model: the robot's model.
            vocabulary: the names that messages may use.
            endpoints: endpoints of the controller's node.
            transport: carries the messages.
            clock: gives each message its time of arrival.
        """
        self.arrived = threading.Event()
        self._model = model
        self._vocabulary = vocabulary
        self._clock = clock
        self._joint_order = JointOrder(model.joints)
        self._boxes: list[tuple[Endpoint, Mailbox]] = []
        self._parts = {"joint_states": _Part()}
        if model.floating_base:
            self._parts["odom"] = _Part()
        self._notes: dict[str, str] = {}
        for endpoint in endpoints:
            if endpoint.direction is Direction.OUT or endpoint.key in ("robot_description", "clock"):
                continue
            if endpoint.key == "odom" and not model.floating_base:
                continue
            stream = endpoint.key in self._parts
            box = Mailbox(clock, 1 if stream else _REQUEST_DEPTH,
                          self.arrived if endpoint.key == "joint_states" else None)  # fmt: skip
            self._boxes.append((endpoint, box))
            transport.subscribe(endpoint, box.put)

    def age_of_joint_states(self) -> float:
        """Age of the newest joint state that was latched, s; infinite if there is none."""
        return self._clock.now() - self._parts["joint_states"].received

    def latch(self) -> Latched:
        """Empty all mailboxes and decode their messages."""
        now = self._clock.now()
        commands: list[str] = []
        changes: list[tuple[Change | ChangeSettings, ...]] = []
        refused: list[str] = []
        arrivals: list[tuple[float, Endpoint, bytes]] = []
        for endpoint, box in self._boxes:
            messages, turned_away = box.take()
            if turned_away:
                refused.append(f"{endpoint.name}: {turned_away} messages refused: more than {_REQUEST_DEPTH} at once")
            arrivals += [(received, endpoint, payload) for received, payload in messages]
        arrivals.sort(key=lambda arrival: arrival[0])  # in order of arrival: a later request overrides an earlier one
        for received, endpoint, payload in arrivals:
            try:
                self._read(endpoint, received, payload, commands, changes)
            except InputRefused as refusal:
                self._refuse(endpoint, str(refusal), refused)
            except Exception as error:  # a defect in a reader must not end the loop
                _log.exception("reading a message on %s failed", endpoint.name)
                self._refuse(endpoint, f"cannot be read: {type(error).__name__}: {error}", refused)
        ages = {name: now - part.received for name, part in self._parts.items()}
        return Latched(
            self._state(), self._joint_velocity(), ages, dict(self._notes), tuple(commands), tuple(changes),
            tuple(refused),
        )  # fmt: skip

    def _refuse(self, endpoint: Endpoint, reason: str, refused: list[str]) -> None:
        if len(reason) > _LONGEST_REASON:
            reason = reason[:_LONGEST_REASON] + "…"
        refused.append(f"{endpoint.name}: {reason}")
        if endpoint.key in self._parts:
            self._notes[endpoint.key] = reason

    def _read(
        self,
        endpoint: Endpoint,
        received: float,
        payload: bytes,
        commands: list[str],
        changes: list[tuple[Change | ChangeSettings, ...]],
    ) -> None:
        content = decode(payload, endpoint.type)
        if endpoint.key == "joint_states":
            q, v = self._joint_order.read(content)
            self._parts["joint_states"] = _Part(received, decoding.stamp_of(content), q, v)
            self._notes.pop("joint_states", None)
        elif endpoint.key == "odom":
            q, v = decoding.read_odometry(content, self._model.base_link)
            self._parts["odom"] = _Part(received, decoding.stamp_of(content), q, v)
            self._notes.pop("odom", None)
        elif endpoint.key == "command":
            commands.append(content.data.strip())
        else:
            reader: Callable[..., tuple[Change | ChangeSettings, ...]] = decoding.READERS[endpoint.key]
            changes.append(reader(self._vocabulary, endpoint.subject, content))

    def _joint_velocity(self) -> Array | None:
        part = self._parts["joint_states"]
        return part.v if len(part.v) else None

    def _state(self) -> RobotState | None:
        model = self._model
        if any(not len(part.v) for part in self._parts.values()):
            return None
        joints = self._parts["joint_states"]
        base = self._parts.get("odom")
        q, v = model.state(joints.q, joints.v) if base is None else model.state(joints.q, joints.v, base.q, base.v)
        q.setflags(write=False)
        v.setflags(write=False)
        return RobotState(joints.stamp, q, v)
