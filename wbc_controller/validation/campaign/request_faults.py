"""Faults of requests by other programs."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from pydantic import Field

from wbc_controller.middleware.codec import message
from wbc_controller.nodes.user import User
from wbc_controller.records import Array
from wbc_controller.simulation.faults.catalogue import kinds_of
from wbc_controller.simulation.faults.fault import Fault, number

_ANY_BYTES = ("weight", "task_enable", "contact_enable")  # topics for which random bytes would be a valid request


@dataclass(slots=True)
class RequestFaultState:
    """State of a fault."""

    user: User
    rng: np.random.Generator
    com: Array = field(default_factory=lambda: np.zeros(3))  # initial, (3,) in m
    periods: int = 0  # since the beginning


class RequestFault(Fault):
    """A fault of requests, for campaigns only."""

    place = "user"

    once: ClassVar[bool] = False  # send in the first period only; else in each period, or each `every`

    def step(self, state: RequestFaultState, com: Array) -> None:
        """Execute one period; `com`: present centre of mass, (3,) in m."""
        if state.periods == 0:
            state.com = com.copy()
        if state.periods == 0 or (not self.once and state.periods % getattr(self, "every", 1) == 0):
            self._send(state, com)
        state.periods += 1

    def _send(self, state: RequestFaultState, com: Array) -> None:
        raise NotImplementedError


class _OneTimeFault(RequestFault):
    once = True


class Garbage(RequestFault):
    """Random bytes on random topics of requests."""

    messages: int = number(5, 1, 20, "messages", "in each control period")
    longest: int = number(200, 4, 5000, "bytes", "of a message")

    def _send(self, state: RequestFaultState, com: Array) -> None:
        keys = [(key, subject) for key, subject in state.user.requests if key not in _ANY_BYTES]
        for _ in range(self.messages):
            key, subject = keys[int(state.rng.integers(len(keys)))]
            body = state.rng.bytes(int(state.rng.integers(1, self.longest)))
            if b"estop" not in body:  # after a valid encapsulation header
                state.user.send_bytes(key, b"\x00\x01\x00\x00" + body, subject)


class UnknownWords(RequestFault):
    """Unknown commands on the topic of commands."""

    def _send(self, state: RequestFaultState, com: Array) -> None:
        words = ("", "ACTIVATE", "e-stop", "resett", "start", "\n", "активировать", "a" * 1000)
        state.user.send_text("command", str(state.rng.choice(words)))


class RequestFlood(RequestFault):
    """Many activation requests in each period."""

    messages: int = number(20, 1, 200, "messages", "in each control period")

    def _send(self, state: RequestFaultState, com: Array) -> None:
        for _ in range(self.messages):
            state.user.send_text("command", "activate")


class FarSetpoint(_OneTimeFault):
    """One setpoint of the centre of mass out of the robot's reach."""

    distance: float = number(0.5, 0.05, 5.0, "m", "in a random direction")

    def _send(self, state: RequestFaultState, com: Array) -> None:
        direction = state.rng.normal(size=3)
        state.user.follow([0.5], com[None, :] + self.distance * direction / np.linalg.norm(direction))


class StepSetpoint(RequestFault):
    """Repeated steps of the centre of mass to random sides."""

    distance: float = number(0.05, 0.005, 0.5, "m", "to a random side")
    every: int = number(10, 1, 100, "periods", "between setpoints")

    def _send(self, state: RequestFaultState, com: Array) -> None:
        state.user.follow([0.2], com[None, :] + self.distance * state.rng.uniform(-1.0, 1.0, 3))


class LongTrajectory(RequestFault):
    """Repeated trajectories with thousands of points at the present position."""

    points: int = number(1000, 100, 4900, "points", "of each trajectory")
    every: int = number(20, 5, 100, "periods", "between trajectories")

    def _send(self, state: RequestFaultState, com: Array) -> None:
        state.user.follow(np.linspace(0.1, 10.0, self.points).tolist(), np.tile(state.com, (self.points, 1)))


class HugeMessage(_OneTimeFault):
    """Messages of megabytes on the topics of commands and updates, once each."""

    size: int = number(4_000_000, 300_000, 10_000_000, "bytes", "of each message")

    def _send(self, state: RequestFaultState, com: Array) -> None:
        state.user.send_text("command", "a" * self.size)
        state.user.send_text("update", "{tasks: [" + "1," * (self.size // 2) + "]}")


class Estop(_OneTimeFault):
    """One emergency stop."""

    def _send(self, state: RequestFaultState, com: Array) -> None:
        state.user.send_text("command", "estop")


class EstopInFlood(RequestFault):
    """An emergency stop among many other requests."""

    messages: int = number(100, 1, 500, "messages", "before it, in the same control period")

    def _send(self, state: RequestFaultState, com: Array) -> None:
        for _ in range(self.messages):
            state.user.send_text("command", "activate")
        state.user.send_text("command", "estop")


class ContactOff(_OneTimeFault):
    """A loaded contact is disabled, permanently."""

    contact: str = Field("", description="name of the contact; empty for one at random")

    def _send(self, state: RequestFaultState, com: Array) -> None:
        names = list(state.user.settings.contacts)
        name = self.contact or names[int(state.rng.integers(len(names)))]
        state.user.send("contact_enable", message("std_msgs/msg/Bool", data=False), name)


class ConflictingUpdates(RequestFault):
    """Repeated contradictory updates of weights, gains and times."""

    every: int = number(5, 1, 50, "periods", "between updates")

    def _send(self, state: RequestFaultState, com: Array) -> None:
        tasks, rng = state.user.settings.tasks, state.rng
        name = list(tasks)[int(rng.integers(len(tasks)))]
        weight, factor = tasks[name].weight, float(np.exp(rng.uniform(-1.0, 1.0)))
        state.user.send_text("update", f"{{tasks: {{{name}: {{weight: {weight * factor}}}}}}}")
        state.user.send_text("update", f"{{control: {{weight_ramp: {rng.uniform(0.0, 2.0)}}}}}")
        state.user.send_text("update", f"{{tasks: {{{name}: {{weight: {weight / factor}, wieght: 1}}}}}}")


REQUEST_KINDS: Mapping[str, type[Fault]] = {
    kind.kind(): kind for kind in kinds_of(sys.modules[__name__]) if kind is not RequestFault
}
