"""Faults of requests: messages of other programs on the controller's topics."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping

import numpy as np
from pydantic import Field

from wbc_controller.middleware.codec import message
from wbc_controller.records import Array
from wbc_controller.simulation.faults.fault import Fault, number
from wbc_controller.validation.user import User, com_trajectory

_PLACE = "user"
#: Topics whose messages are a single number or switch, so that random bytes are mostly a valid request.
_ANY_BYTES = ("weight", "task_enable", "contact_enable")
#: What is sent once per control period while the fault lasts, with the present centre of mass, (3,) in m.
Act = Callable[[Array], None]


class RequestFault(Fault):
    """A fault of requests: campaigns have it, the mock robot does not."""

    place = _PLACE

    def act(self, user: User, rng: np.random.Generator) -> Act:
        """Return the act of each control period."""
        raise NotImplementedError


class Garbage(RequestFault):
    """Random bytes on random topics for requests."""

    messages: int = number(5, 1, 20, "messages", "in each control period")
    longest: int = number(200, 4, 5000, "bytes", "of a message")

    def act(self, user: User, rng: np.random.Generator) -> Act:
        """Send random bytes behind a valid encapsulation header, so that decoders read them."""
        keys = [(key, subject) for key, subject in user.requests if key not in _ANY_BYTES]

        def send(com: Array) -> None:
            for _ in range(self.messages):
                key, subject = keys[int(rng.integers(len(keys)))]
                body = rng.bytes(int(rng.integers(1, self.longest)))
                if b"estop" not in body:
                    user.send_bytes(key, b"\x00\x01\x00\x00" + body, subject)

        return send


class UnknownWords(RequestFault):
    """Words that are no command, on the topic for commands."""

    def act(self, user: User, rng: np.random.Generator) -> Act:
        """Send one in each period."""
        words = ("", "ACTIVATE", "e-stop", "resett", "start", "\n", "активировать", "a" * 1000)
        return lambda com: user.say("command", str(rng.choice(words)))


class RequestFlood(RequestFault):
    """The request for activation comes again and again, many times in each period."""

    messages: int = number(20, 1, 200, "messages", "in each control period")

    def act(self, user: User, rng: np.random.Generator) -> Act:
        """Send many requests."""

        def send(com: Array) -> None:
            for _ in range(self.messages):
                user.say("command", "activate")

        return send


class FarSetpoint(RequestFault):
    """The centre of mass is sent to where the robot cannot go, once."""

    distance: float = number(0.5, 0.05, 5.0, "m", "in a random direction")

    def act(self, user: User, rng: np.random.Generator) -> Act:
        """Send one trajectory there, of half a second."""
        direction = rng.normal(size=3)
        target = self.distance * direction / np.linalg.norm(direction)
        return _once(lambda com: _to_coms(user, [0.5], com[None, :] + target))


class StepSetpoint(RequestFault):
    """The centre of mass is sent to another side in each of a few periods."""

    distance: float = number(0.05, 0.005, 0.5, "m", "to a random side")
    every: int = number(10, 1, 100, "periods", "between two")

    def act(self, user: User, rng: np.random.Generator) -> Act:
        """Send short trajectories."""
        return _every(
            self.every,
            lambda com: _to_coms(user, [0.2], com[None, :] + self.distance * rng.uniform(-1.0, 1.0, 3)),
        )


class LongTrajectory(RequestFault):
    """Trajectories with thousands of points that stay where the robot is, in each of some periods."""

    points: int = number(1000, 100, 4900, "points", "of each trajectory")
    every: int = number(20, 5, 100, "periods", "between two")

    def act(self, user: User, rng: np.random.Generator) -> Act:
        """Send the first one at once."""
        first, times = list[Array](), np.linspace(0.1, 10.0, self.points).tolist()

        def send(com: Array) -> None:
            first.append(com.copy())
            _to_coms(user, times, np.repeat(first[0][None, :], self.points, axis=0))

        return _every(self.every, send)


class HugeMessage(RequestFault):
    """Messages of megabytes on the topics for commands and updates, once each."""

    size: int = number(4_000_000, 300_000, 10_000_000, "bytes", "of each message")

    def act(self, user: User, rng: np.random.Generator) -> Act:
        """Send both at once."""

        def send(com: Array) -> None:
            user.say("command", "a" * self.size)
            user.say("update", "{tasks: [" + "1," * (self.size // 2) + "]}")

        return _once(send)


class Estop(RequestFault):
    """An emergency stop, once."""

    def act(self, user: User, rng: np.random.Generator) -> Act:
        """Send it."""
        return _once(lambda com: user.say("command", "estop"))


class EstopInFlood(RequestFault):
    """An emergency stop among many other requests."""

    messages: int = number(100, 1, 500, "messages", "before it, in the same control period")

    def act(self, user: User, rng: np.random.Generator) -> Act:
        """Send all."""

        def send(com: Array) -> None:
            for _ in range(self.messages):
                user.say("command", "activate")
            user.say("command", "estop")

        return send


class ContactOff(RequestFault):
    """A contact that carries the robot is switched off, once; at the end nobody switches it on."""

    contact: str = Field("", description="name of the contact; empty for one at random")

    def act(self, user: User, rng: np.random.Generator) -> Act:
        """Send the request."""
        names = list(user.settings.contacts)
        name = self.contact or names[int(rng.integers(len(names)))]
        return _once(lambda com: user.send("contact_enable", message("std_msgs/msg/Bool", data=False), name))


class ConflictingUpdates(RequestFault):
    """Updates that contradict each other: weights, gains and times go up and down in each of some periods."""

    every: int = number(5, 1, 50, "periods", "between two")

    def act(self, user: User, rng: np.random.Generator) -> Act:
        """Send random changes within their ranges."""
        names = list(user.settings.tasks)

        def send(com: Array) -> None:
            name = names[int(rng.integers(len(names)))]
            weight, factor = user.settings.tasks[name].weight, float(np.exp(rng.uniform(-1.0, 1.0)))
            user.say("update", f"{{tasks: {{{name}: {{weight: {weight * factor}}}}}}}")
            user.say("update", f"{{control: {{weight_ramp: {rng.uniform(0.0, 2.0)}}}}}")
            user.say("update", f"{{tasks: {{{name}: {{weight: {weight / factor}, wieght: 1}}}}}}")

        return _every(self.every, send)


def _to_coms(user: User, times: list[float], positions: Array) -> None:
    for name in user.tasks("com"):
        user.send("trajectory", com_trajectory(times, positions), name)


def _every(periods: float, act: Act) -> Act:
    """Act in the first period, and then once in some periods."""
    count = itertools.count()

    def due(com: Array) -> None:
        if next(count) % periods == 0:
            act(com)

    return due


def _once(act: Act) -> Act:
    return _every(math.inf, act)


REQUEST_KINDS: Mapping[str, type[RequestFault]] = {
    kind.kind(): kind
    for kind in (
        Garbage, UnknownWords, RequestFlood, FarSetpoint, StepSetpoint, LongTrajectory, HugeMessage, Estop,
        EstopInFlood, ContactOff, ConflictingUpdates,
    )
}  # fmt: skip
