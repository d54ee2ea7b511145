"""Faults of stamps and of the simulator's clock: they differ from the times of the measurements."""

from typing import Any, Literal

from pydantic import Field

from wbc_controller.simulation.faults.fault import Fault, MeasurementFault, Site, number
from wbc_controller.simulation.measurement import Measurement

#: The largest time that a ROS stamp can hold, ns, and the smallest that the mock robot sends.
_LAST, _FIRST = (2**31 - 1) * 1_000_000_000, 0


class _TimeFault(MeasurementFault):
    place = "stamps and clock"

    def _streams(self) -> tuple[str, ...]:
        raise NotImplementedError

    def _spoil(self, measured: Measurement, site: Site, kept: Any) -> None:
        for stream in self._streams():
            stamp = measured.stamps[stream] + round(self._ahead(site.passed) * 1e9)
            measured.stamps[stream] = min(max(stamp, _FIRST), _LAST)

    def _ahead(self, passed: float) -> float:
        """Return the advance of the stamps, s, at a time since the beginning, s."""
        raise NotImplementedError


class _StampFault(_TimeFault):
    stream: Literal["joint_states", "odom", "both"] = Field("both", description="whose stamps")

    def _streams(self) -> tuple[str, ...]:
        return ("joint_states", "odom") if self.stream == "both" else (self.stream,)


class _ClockFault(_TimeFault):
    def _streams(self) -> tuple[str, ...]:
        return ("clock",)


class _Frozen(_TimeFault):
    def _spoil(self, measured: Measurement, site: Site, kept: dict[str, int]) -> None:
        for stream in self._streams():
            measured.stamps[stream] = kept.setdefault(stream, measured.stamps[stream])


class StampZero(_StampFault):
    """Stamps are zero."""

    def _spoil(self, measured: Measurement, site: Site, kept: Any) -> None:
        for stream in self._streams():
            measured.stamps[stream] = 0


class StampFrozen(_Frozen, _StampFault):
    """Stamps stand still, while the values go on."""


class StampBack(_StampFault):
    """Stamps are behind by a constant time."""

    by: float = number(0.1, 0.003, 100.0, "s", "how far")

    def _ahead(self, passed: float) -> float:
        return -self.by


class StampAhead(_StampFault):
    """Stamps are ahead by a constant time."""

    by: float = number(0.1, 0.003, 100.0, "s", "how far")

    def _ahead(self, passed: float) -> float:
        return self.by


class StampDrift(_StampFault):
    """Stamps run too fast or too slowly."""

    rate: float = number(1e-4, -0.3, 0.3, "s/s", "by how much they gain in time")

    def _ahead(self, passed: float) -> float:
        return self.rate * passed


class ClockJump(_ClockFault):
    """The time on /clock jumps; at the end it jumps back. Stamps stay."""

    by: float = number(-1.0, -10.0, 10.0, "s", "how far ahead")

    def _ahead(self, passed: float) -> float:
        return self.by


class ClockFrozen(_Frozen, _ClockFault):
    """The time on /clock stands still, while the robot goes on."""


class ClockDrift(_ClockFault):
    """The time on /clock runs too fast or too slowly."""

    rate: float = number(0.01, -0.5, 0.5, "s/s", "by how much it gains in time")

    def _ahead(self, passed: float) -> float:
        return self.rate * passed


KINDS: tuple[type[Fault], ...] = (
    StampZero, StampFrozen, StampBack, StampAhead, StampDrift, ClockJump, ClockFrozen, ClockDrift,
)  # fmt: skip
