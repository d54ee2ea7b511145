"""Faults of the delivery: messages of the robot, or commands to it, come late, twice, out of order or not at all."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Literal

from pydantic import Field

from wbc_controller.simulation.faults.fault import Effect, Fault, Parcel, Site, number

_PLACE = "delivery"
_COMMANDS = "delivery of commands"
#: The stream of the torques that come to the robot.
COMMAND = "effort"
#: What the parcel of one message becomes.
_Post = Callable[[Parcel], list[Parcel]]
#: Messages that a replay keeps, at most.
_MOST_KEPT = 1000


class _StreamFault(Fault):
    """A fault in the delivery of what the robot measures."""

    place = _PLACE
    stream: Literal["joint_states", "odom", "imu", "both"] = Field(
        "both", description="whose messages; `both` are joint states and odometry"
    )

    def begin(self, site: Site) -> Effect:
        """Act on the messages of each stream by itself."""
        streams = ("joint_states", "odom") if self.stream == "both" else (self.stream,)
        return Effect(posted={stream: self.post(site) for stream in streams})

    def post(self, site: Site) -> _Post:
        """What happens to each message of a stream."""
        raise NotImplementedError


class _CommandFault(Fault):
    """A fault in the delivery of the torques."""

    place = _COMMANDS

    def begin(self, site: Site) -> Effect:
        """Act on the torques."""
        return Effect(posted={COMMAND: self.post(site)})

    def post(self, site: Site) -> _Post:
        """What happens to each command."""
        raise NotImplementedError


class MessageDelay(_StreamFault):
    """Messages come late, all by the same time."""

    delay: float = number(0.02, 0.002, 0.5, "s", "of each message")

    def post(self, site: Site) -> _Post:
        """Delay each message."""
        return _delayed(self.delay)


class MessageGrowingDelay(_StreamFault):
    """Messages come later and later, as from a queue that is filled faster than it is emptied."""

    growth: float = number(0.2, 0.02, 3.0, "s/s", "by which the delay grows in time")

    def post(self, site: Site) -> _Post:
        """Delay each message by what has grown since the beginning."""
        return lambda parcel: [_later(parcel, self.growth * site.elapsed)]


class MessageJitter(_StreamFault):
    """Messages come late by random times, so that they overtake each other."""

    jitter: float = number(0.01, 0.002, 0.2, "s", "longest delay; all up to it are equally likely")

    def post(self, site: Site) -> _Post:
        """Draw a delay for each message."""
        return lambda parcel: [_later(parcel, site.rng.uniform(0.0, self.jitter))]


class MessageLoss(_StreamFault):
    """A share of the messages is lost."""

    share: float = number(0.1, 0.01, 1.0, "", "of the messages")

    def post(self, site: Site) -> _Post:
        """Draw for each message."""
        return _lost(site, self.share)


class MessageDropout(_StreamFault):
    """No message comes."""

    def post(self, site: Site) -> _Post:
        """Lose each message."""
        return lambda parcel: []


class MessageDuplication(_StreamFault):
    """Each message comes twice."""

    gap: float = number(0.002, 0.0, 0.2, "s", "between the two")

    def post(self, site: Site) -> _Post:
        """Send each message again."""
        return _repeated(self.gap)


class MessageReordering(_StreamFault):
    """Some messages are overtaken by those after them."""

    share: float = number(0.2, 0.01, 1.0, "", "of the messages that are overtaken")
    periods: int = number(2, 1, 20, "periods", "by which they are late")

    def post(self, site: Site) -> _Post:
        """Draw for each message."""
        late = self.periods * site.period
        return lambda parcel: [_later(parcel, late) if site.rng.random() < self.share else parcel]


class MessageReplay(_StreamFault):
    """The messages since the beginning of the fault come again and again in place of new ones."""

    length: float = number(0.1, 0.002, 1.0, "s", "of what is repeated")

    def post(self, site: Site) -> _Post:
        """Keep what comes for a while, then repeat it."""
        kept: deque[Parcel] = deque()

        def replay(parcel: Parcel) -> list[Parcel]:
            if (not kept or site.elapsed < self.length) and len(kept) < _MOST_KEPT:
                kept.append(parcel)
                return [parcel]
            kept.rotate(-1)
            return [kept[-1]._replace(due=parcel.due)]

        return replay


class MessageQueue(_StreamFault):
    """Messages are held back, and all are delivered at once at the end."""

    def post(self, site: Site) -> _Post:
        """Hold each message until the end."""
        return lambda parcel: [parcel._replace(due=max(parcel.due, site.end))]


class CommandLoss(_CommandFault):
    """A share of the commands is lost."""

    share: float = number(0.1, 0.01, 1.0, "", "of the commands")

    def post(self, site: Site) -> _Post:
        """Draw for each command."""
        return _lost(site, self.share)


class CommandDelay(_CommandFault):
    """Commands come late, all by the same time."""

    delay: float = number(0.004, 0.002, 0.2, "s", "of each command")

    def post(self, site: Site) -> _Post:
        """Delay each command."""
        return _delayed(self.delay)


class CommandTwice(_CommandFault):
    """Each command comes twice."""

    gap: float = number(0.002, 0.0, 0.1, "s", "between the two")

    def post(self, site: Site) -> _Post:
        """Deliver each command again."""
        return _repeated(self.gap)


def _later(parcel: Parcel, seconds: float) -> Parcel:
    return parcel._replace(due=parcel.due + seconds)


def _delayed(seconds: float) -> _Post:
    return lambda parcel: [_later(parcel, seconds)]


def _repeated(gap: float) -> _Post:
    return lambda parcel: [parcel, _later(parcel, gap)]


def _lost(site: Site, share: float) -> _Post:
    return lambda parcel: [] if site.rng.random() < share else [parcel]


KINDS: tuple[type[Fault], ...] = (
    MessageDelay, MessageGrowingDelay, MessageJitter, MessageLoss, MessageDropout, MessageDuplication,
    MessageReordering, MessageReplay, MessageQueue, CommandLoss, CommandDelay, CommandTwice,
)  # fmt: skip
