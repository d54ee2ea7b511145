"""Faults of messages: delivery, stamps and clock."""

from collections import deque
from functools import partial
from typing import Any, Literal

from pydantic import Field

from wbc_controller.simulation.faults.fault import Effect, Fault, FaultContext, QueuedMessage, number
from wbc_controller.simulation.sensors import Measurement

COMMAND = "effort"  # stream of the received torques
_MOST_KEPT = 1000  # largest number of stored messages of a replay
_LAST, _FIRST = (2**31 - 1) * 1_000_000_000, 0  # largest ROS stamp, ns, and smallest stamp of the mock robot


class _DeliveryFault(Fault):
    def begin(self, context: FaultContext) -> Effect:
        states = {stream: self._start(context) for stream in self._streams(COMMAND)}
        return Effect(
            posted={stream: partial(self._post, context=context, state=state) for stream, state in states.items()}
        )

    def _post(self, message: QueuedMessage, context: FaultContext, state: Any) -> list[QueuedMessage]:
        """Return the delivered messages: by default a share is lost, and others are delayed or have a second copy."""
        if context.rng.random() < getattr(self, "share", 0.0):
            return []
        delay, gap = getattr(self, "delay", 0.0), getattr(self, "gap", None)
        return [_delayed(message, seconds) for seconds in ([delay] if gap is None else [delay, gap])]


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


class MessageGrowingDelay(_StreamFault):
    """Growing delay, as of an overloaded queue."""

    growth: float = number(0.2, 0.02, 3.0, "s/s", "growth rate")

    def _post(self, message: QueuedMessage, context: FaultContext, state: Any) -> list[QueuedMessage]:
        return [_delayed(message, self.growth * context.elapsed)]


class MessageJitter(_StreamFault):
    """Random delays, so that messages overtake each other."""

    jitter: float = number(0.01, 0.002, 0.2, "s", "largest delay, uniformly distributed")

    def _post(self, message: QueuedMessage, context: FaultContext, state: Any) -> list[QueuedMessage]:
        return [_delayed(message, context.rng.uniform(0.0, self.jitter))]


class MessageLoss(_StreamFault):
    """A share of the messages is lost."""

    share: float = number(0.1, 0.01, 1.0, "", "share of messages")


class MessageDropout(_StreamFault):
    """All messages are lost."""

    def _post(self, message: QueuedMessage, context: FaultContext, state: Any) -> list[QueuedMessage]:
        return []


class MessageDuplication(_StreamFault):
    """Each message is delivered twice."""

    gap: float = number(0.002, 0.0, 0.2, "s", "time between duplicates")


class MessageReordering(_StreamFault):
    """Some messages are overtaken by later ones."""

    share: float = number(0.2, 0.01, 1.0, "", "share of overtaken messages")
    periods: int = number(2, 1, 20, "periods", "delay")

    def _post(self, message: QueuedMessage, context: FaultContext, state: Any) -> list[QueuedMessage]:
        late = self.periods * context.period
        return [_delayed(message, late) if context.rng.random() < self.share else message]


class MessageReplay(_StreamFault):
    """The first messages after the start repeat in place of new ones."""

    length: float = number(0.1, 0.002, 1.0, "s", "length of the repeated part")

    def _start(self, context: FaultContext) -> deque[QueuedMessage]:
        return deque()

    def _post(self, message: QueuedMessage, context: FaultContext, state: deque[QueuedMessage]) -> list[QueuedMessage]:
        if (not state or context.elapsed < self.length) and len(state) < _MOST_KEPT:
            state.append(message)
            return [message]
        state.rotate(-1)
        return [state[-1]._replace(due=message.due)]


class MessageQueue(_StreamFault):
    """Messages are queued, and delivered together at the end."""

    def _post(self, message: QueuedMessage, context: FaultContext, state: Any) -> list[QueuedMessage]:
        return [message._replace(due=max(message.due, context.end))]


class CommandLoss(_CommandFault):
    """A share of the commands is lost."""

    share: float = number(0.1, 0.01, 1.0, "", "share of commands")


class CommandDelay(_CommandFault):
    """Constant delay of all commands."""

    delay: float = number(0.004, 0.002, 0.2, "s", "delay")


class CommandTwice(_CommandFault):
    """Each command is delivered twice."""

    gap: float = number(0.002, 0.0, 0.1, "s", "time between duplicates")


def _delayed(message: QueuedMessage, seconds: float) -> QueuedMessage:
    return message._replace(due=message.due + seconds)


class _TimeFault(Fault):
    place = "stamps and clock"

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        for stream in self._streams("clock"):
            stamp = self._stamp(measured.stamps[stream], stream, context)
            measured.stamps[stream] = min(max(stamp, _FIRST), _LAST)

    def _stamp(self, true: int, stream: str, context: FaultContext) -> int:
        """Return the wrong stamp, ns, by default with a constant advance, or with an error of the clock rate."""
        return true + round((getattr(self, "by", 0.0) + getattr(self, "rate", 0.0) * context.elapsed) * 1e9)


class _StampFault(_TimeFault):
    stream: Literal["joint_states", "odom", "both"] = Field("both", description="affected stream")


class _Frozen(_TimeFault):
    def _stamp(self, true: int, stream: str, context: FaultContext) -> int:
        return int(context.memory.setdefault(stream, true))


class StampZero(_StampFault):
    """Stamps are zero."""

    def _stamp(self, true: int, stream: str, context: FaultContext) -> int:
        return 0


class StampFrozen(_Frozen, _StampFault):
    """Stamps are constant while values change."""


class StampBack(_StampFault):
    """Stamps have a constant lag."""

    by: float = number(0.1, 0.003, 100.0, "s", "size")

    def _stamp(self, true: int, stream: str, context: FaultContext) -> int:
        return true - round(self.by * 1e9)


class StampAhead(_StampFault):
    """Stamps have a constant advance."""

    by: float = number(0.1, 0.003, 100.0, "s", "size")


class StampDrift(_StampFault):
    """Stamps run too fast or too slowly."""

    rate: float = number(1e-4, -0.3, 0.3, "s/s", "clock rate error")


class ClockJump(_TimeFault):
    """The time on /clock jumps until the end; stamps do not."""

    by: float = number(-1.0, -10.0, 10.0, "s", "advance")


class ClockFrozen(_Frozen):
    """The time on /clock is constant while the robot continues."""


class ClockDrift(_TimeFault):
    """The time on /clock runs too fast or too slowly."""

    rate: float = number(0.01, -0.5, 0.5, "s/s", "clock rate error")
