"""Faults of stamps and of the simulator's clock: wrong times of the measurements."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from wbc_controller.simulation.faults.fault import Fault, MeasurementFault, Site, number
from wbc_controller.simulation.measurement import Measurement

#: The largest time that a ROS stamp can hold, ns, and the smallest that the mock robot sends.
_LAST, _FIRST = (2**31 - 1) * 1_000_000_000, 0


class _TimeFault(MeasurementFault):
    """A fault of times: by default they are shifted."""

    place = "stamps and clock"

    def streams(self) -> tuple[str, ...]:
        """Names of the streams whose stamps change."""
        return ("clock",)

    def change(self, measured: Measurement, site: Site, drawn: Any) -> None:
        """Change the stamp of each stream."""
        for stream in self.streams():
            measured.stamps[stream] = self.stamp(stream, measured.stamps[stream], site, drawn)

    def stamp(self, stream: str, stamp: int, site: Site, kept: dict[str, int]) -> int:
        """Return the new stamp of a stream, ns, within the range of a message."""
        return min(max(stamp + round(self.ahead(site.elapsed) * 1e9), _FIRST), _LAST)

    def ahead(self, elapsed: float) -> float:
        """Return the shift after a time since the beginning, both in s."""
        raise NotImplementedError


class _StampFault(_TimeFault):
    """A fault of the stamps of some streams."""

    stream: Literal["joint_states", "odom", "both"] = Field("both", description="whose stamps")

    def streams(self) -> tuple[str, ...]:
        """Names of the streams whose stamps change."""
        return ("joint_states", "odom") if self.stream == "both" else (self.stream,)


class StampZero(_StampFault):
    """Stamps are zero."""

    def stamp(self, stream: str, stamp: int, site: Site, kept: dict[str, int]) -> int:
        """Return zero."""
        return 0


class StampFrozen(_StampFault):
    """Stamps stand still, while the values go on."""

    def stamp(self, stream: str, stamp: int, site: Site, kept: dict[str, int]) -> int:
        """Return the first stamp."""
        return kept.setdefault(stream, stamp)


class StampBack(_StampFault):
    """Stamps are behind by a constant time."""

    by: float = number(0.1, 0.003, 100.0, "s", "how far")

    def ahead(self, elapsed: float) -> float:
        """Return a constant."""
        return -self.by


class StampAhead(_StampFault):
    """Stamps are ahead by a constant time."""

    by: float = number(0.1, 0.003, 100.0, "s", "how far")

    def ahead(self, elapsed: float) -> float:
        """Return a constant."""
        return self.by


class StampDrift(_StampFault):
    """Stamps run too fast or too slowly."""

    rate: float = number(1e-4, -0.3, 0.3, "s/s", "by how much they gain in time")

    def ahead(self, elapsed: float) -> float:
        """Return the gained time."""
        return self.rate * elapsed


class ClockJump(_TimeFault):
    """The time on /clock jumps; at the end it jumps back. Stamps stay."""

    by: float = number(-1.0, -10.0, 10.0, "s", "how far ahead")

    def ahead(self, elapsed: float) -> float:
        """Return a constant."""
        return self.by


class ClockFrozen(_TimeFault):
    """The time on /clock stands still, while the robot goes on."""

    def stamp(self, stream: str, stamp: int, site: Site, kept: dict[str, int]) -> int:
        """Return the first stamp."""
        return kept.setdefault(stream, stamp)


class ClockDrift(_TimeFault):
    """The time on /clock runs too fast or too slowly."""

    rate: float = number(0.01, -0.5, 0.5, "s/s", "by how much it gains in time")

    def ahead(self, elapsed: float) -> float:
        """Return the gained time."""
        return self.rate * elapsed


KINDS: tuple[type[Fault], ...] = (
    StampZero, StampFrozen, StampBack, StampAhead, StampDrift, ClockJump, ClockFrozen, ClockDrift,
)  # fmt: skip
