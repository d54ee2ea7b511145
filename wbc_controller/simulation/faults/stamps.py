"""Faults of stamps and clock."""

from typing import Any, Literal

from pydantic import Field

from wbc_controller.simulation.faults.fault import Fault, FaultContext, number
from wbc_controller.simulation.sensors import Measurement

_LAST, _FIRST = (2**31 - 1) * 1_000_000_000, 0  # largest ROS stamp, ns, and smallest stamp of the mock robot


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
