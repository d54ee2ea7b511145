"""Faults of message delivery."""

from collections import deque
from collections.abc import Callable
from typing import Literal

from pydantic import Field

from wbc_controller.simulation.faults.fault import Effect, Fault, FaultContext, QueuedMessage, number

COMMAND = "effort"  # stream of the received torques
_Post = Callable[[QueuedMessage], list[QueuedMessage]]  # maps one message to the delivered messages
_MOST_KEPT = 1000  # largest number of stored messages of a replay


class _DeliveryFault(Fault):
    def begin(self, context: FaultContext) -> Effect:
        return Effect(posted={stream: self._post(context) for stream in self._streams(COMMAND)})

    def _post(self, context: FaultContext) -> _Post:
        raise NotImplementedError


class _StreamFault(_DeliveryFault):
    place = "delivery"
    stream: Literal["joint_states", "odom", "imu", "both"] = Field(
        "both", description="affected stream; `both`: joint states and odometry"
    )


class _CommandFault(_DeliveryFault):
    place = "delivery of commands"


class MessageDelay(_StreamFault):
    """Constant delay of all messages."""

    delay: float = number(0.02, 0.002, 0.5, "s", "delay")

    def _post(self, context: FaultContext) -> _Post:
        return lambda message: [_delayed(message, self.delay)]


class MessageGrowingDelay(_StreamFault):
    """Growing delay, as of an overloaded queue."""

    growth: float = number(0.2, 0.02, 3.0, "s/s", "growth rate")

    def _post(self, context: FaultContext) -> _Post:
        return lambda message: [_delayed(message, self.growth * context.elapsed)]


class MessageJitter(_StreamFault):
    """Random delays, so that messages overtake each other."""

    jitter: float = number(0.01, 0.002, 0.2, "s", "largest delay, uniformly distributed")

    def _post(self, context: FaultContext) -> _Post:
        return lambda message: [_delayed(message, context.rng.uniform(0.0, self.jitter))]


class MessageLoss(_StreamFault):
    """A share of the messages is lost."""

    share: float = number(0.1, 0.01, 1.0, "", "share of messages")

    def _post(self, context: FaultContext) -> _Post:
        return lambda message: [] if context.rng.random() < self.share else [message]


class MessageDropout(_StreamFault):
    """All messages are lost."""

    def _post(self, context: FaultContext) -> _Post:
        return lambda message: []


class MessageDuplication(_StreamFault):
    """Each message is delivered twice."""

    gap: float = number(0.002, 0.0, 0.2, "s", "time between duplicates")

    def _post(self, context: FaultContext) -> _Post:
        return lambda message: [message, _delayed(message, self.gap)]


class MessageReordering(_StreamFault):
    """Some messages are overtaken by later ones."""

    share: float = number(0.2, 0.01, 1.0, "", "share of overtaken messages")
    periods: int = number(2, 1, 20, "periods", "delay")

    def _post(self, context: FaultContext) -> _Post:
        late = self.periods * context.period
        return lambda message: [_delayed(message, late) if context.rng.random() < self.share else message]


class MessageReplay(_StreamFault):
    """The first messages after the start repeat in place of new ones."""

    length: float = number(0.1, 0.002, 1.0, "s", "length of the repeated part")

    def _post(self, context: FaultContext) -> _Post:
        kept: deque[QueuedMessage] = deque()

        def replay(message: QueuedMessage) -> list[QueuedMessage]:
            if (not kept or context.elapsed < self.length) and len(kept) < _MOST_KEPT:
                kept.append(message)
                return [message]
            kept.rotate(-1)
            return [kept[-1]._replace(due=message.due)]

        return replay


class MessageQueue(_StreamFault):
    """Messages are queued, and delivered together at the end."""

    def _post(self, context: FaultContext) -> _Post:
        return lambda message: [message._replace(due=max(message.due, context.end))]


class CommandLoss(_CommandFault):
    """A share of the commands is lost."""

    share: float = number(0.1, 0.01, 1.0, "", "share of commands")

    def _post(self, context: FaultContext) -> _Post:
        return lambda message: [] if context.rng.random() < self.share else [message]


class CommandDelay(_CommandFault):
    """Constant delay of all commands."""

    delay: float = number(0.004, 0.002, 0.2, "s", "delay")

    def _post(self, context: FaultContext) -> _Post:
        return lambda message: [_delayed(message, self.delay)]


class CommandTwice(_CommandFault):
    """Each command is delivered twice."""

    gap: float = number(0.002, 0.0, 0.1, "s", "time between duplicates")

    def _post(self, context: FaultContext) -> _Post:
        return lambda message: [message, _delayed(message, self.gap)]


def _delayed(message: QueuedMessage, seconds: float) -> QueuedMessage:
    return message._replace(due=message.due + seconds)
