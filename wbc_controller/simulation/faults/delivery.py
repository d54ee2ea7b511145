"""Faults of the delivery: messages of the robot, or commands to it, arrive late, twice, out of order or not at all."""

from collections import deque
from collections.abc import Callable
from typing import Literal

from pydantic import Field

from wbc_controller.simulation.faults.fault import Effect, Fault, Parcel, Site, number

#: The stream of the torques that the robot receives.
COMMAND = "effort"
#: Turns the parcel of one message into the parcels that are delivered.
_Post = Callable[[Parcel], list[Parcel]]
#: Largest number of messages that a replay keeps.
_MOST_KEPT = 1000


class _DeliveryFault(Fault):
    def begin(self, site: Site) -> Effect:
        """Begin on each stream by itself."""
        return Effect(posted={stream: self._post(site) for stream in self._streams()})

    def _streams(self) -> tuple[str, ...]:
        raise NotImplementedError

    def _post(self, site: Site) -> _Post:
        raise NotImplementedError


class _StreamFault(_DeliveryFault):
    place = "delivery"
    stream: Literal["joint_states", "odom", "imu", "both"] = Field(
        "both", description="whose messages; `both` are joint states and odometry"
    )

    def _streams(self) -> tuple[str, ...]:
        return ("joint_states", "odom") if self.stream == "both" else (self.stream,)


class _CommandFault(_DeliveryFault):
    place = "delivery of commands"

    def _streams(self) -> tuple[str, ...]:
        return (COMMAND,)


class MessageDelay(_StreamFault):
    """Messages come late, all by the same time."""

    delay: float = number(0.02, 0.002, 0.5, "s", "of each message")

    def _post(self, site: Site) -> _Post:
        return lambda parcel: [_later(parcel, self.delay)]


class MessageGrowingDelay(_StreamFault):
    """Messages come later and later, as from a queue that is filled faster than it is emptied."""

    growth: float = number(0.2, 0.02, 3.0, "s/s", "by which the delay grows in time")

    def _post(self, site: Site) -> _Post:
        began = site.plant.time
        return lambda parcel: [_later(parcel, self.growth * (site.plant.time - began))]


class MessageJitter(_StreamFault):
    """Messages come late by random times, so that they overtake each other."""

    jitter: float = number(0.01, 0.002, 0.2, "s", "longest delay; all up to it are equally likely")

    def _post(self, site: Site) -> _Post:
        return lambda parcel: [_later(parcel, site.rng.uniform(0.0, self.jitter))]


class MessageLoss(_StreamFault):
    """A share of the messages is lost."""

    share: float = number(0.1, 0.01, 1.0, "", "of the messages")

    def _post(self, site: Site) -> _Post:
        return lambda parcel: [] if site.rng.random() < self.share else [parcel]


class MessageDropout(_StreamFault):
    """No message comes."""

    def _post(self, site: Site) -> _Post:
        return lambda parcel: []


class MessageDuplication(_StreamFault):
    """Each message comes twice."""

    gap: float = number(0.002, 0.0, 0.2, "s", "between the two")

    def _post(self, site: Site) -> _Post:
        return lambda parcel: [parcel, _later(parcel, self.gap)]


class MessageReordering(_StreamFault):
    """Some messages are overtaken by those after them."""

    share: float = number(0.2, 0.01, 1.0, "", "of the messages that are overtaken")
    periods: int = number(2, 1, 20, "periods", "by which they are late")

    def _post(self, site: Site) -> _Post:
        late = self.periods * site.period
        return lambda parcel: [_later(parcel, late) if site.rng.random() < self.share else parcel]


class MessageReplay(_StreamFault):
    """The messages since the beginning of the fault come again and again in place of new ones."""

    length: float = number(0.1, 0.002, 1.0, "s", "of what is repeated")

    def _post(self, site: Site) -> _Post:
        kept: deque[Parcel] = deque()
        began = site.plant.time

        def replay(parcel: Parcel) -> list[Parcel]:
            if (not kept or site.plant.time - began < self.length) and len(kept) < _MOST_KEPT:
                kept.append(parcel)
                return [parcel]
            kept.rotate(-1)
            return [kept[-1]._replace(due=parcel.due)]

        return replay


class MessageQueue(_StreamFault):
    """Messages are held back, and all are delivered at once at the end."""

    def _post(self, site: Site) -> _Post:
        return lambda parcel: [parcel._replace(due=max(parcel.due, site.end))]


class CommandLoss(_CommandFault):
    """A share of the commands is lost."""

    share: float = number(0.1, 0.01, 1.0, "", "of the commands")

    def _post(self, site: Site) -> _Post:
        return lambda parcel: [] if site.rng.random() < self.share else [parcel]


class CommandDelay(_CommandFault):
    """Commands come late, all by the same time."""

    delay: float = number(0.004, 0.002, 0.2, "s", "of each command")

    def _post(self, site: Site) -> _Post:
        return lambda parcel: [_later(parcel, self.delay)]


class CommandTwice(_CommandFault):
    """Each command comes twice."""

    gap: float = number(0.002, 0.0, 0.1, "s", "between the two")

    def _post(self, site: Site) -> _Post:
        return lambda parcel: [parcel, _later(parcel, self.gap)]


def _later(parcel: Parcel, seconds: float) -> Parcel:
    return parcel._replace(due=parcel.due + seconds)


KINDS: tuple[type[Fault], ...] = (
    MessageDelay, MessageGrowingDelay, MessageJitter, MessageLoss, MessageDropout, MessageDuplication,
    MessageReordering, MessageReplay, MessageQueue, CommandLoss, CommandDelay, CommandTwice,
)  # fmt: skip
