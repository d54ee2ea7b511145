"""Faults of stamps and of the simulator's clock: times that are not those of the measurements."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from wbc_controller.simulation.faults.fault import Effect, Fault, Site, number
from wbc_controller.simulation.measurement import Measurement

_PLACE = "stamps and clock"
#: The largest time that a ROS stamp can hold, ns, and the smallest that the mock robot sends.
_LAST, _FIRST = (2**31 - 1) * 1_000_000_000, 0


class _StampFault(Fault):
    """A fault of the stamps of some streams."""

    place = _PLACE
    stream: Literal["joint_states", "odom", "both"] = Field("both", description="whose stamps")

    def streams(self) -> tuple[str, ...]:
        """Names of the streams."""
        return ("joint_states", "odom") if self.stream == "both" else (self.stream,)

    def begin(self, site: Site) -> Effect:
        """Shift each stamp."""
        began = site.plant.time

        def shift(measured: Measurement) -> None:
            for stream in self.streams():
                measured.stamps[stream] = _moved(measured.stamps[stream], self.ahead(site.plant.time - began))

        return Effect(shift)

    def ahead(self, passed: float) -> float:
        """By how much stamps are ahead when a time has passed since the beginning, both in s."""
        raise NotImplementedError


class StampZero(_StampFault):
    """Stamps are zero."""

    def begin(self, site: Site) -> Effect:
        """Set each stamp."""

        def zero(measured: Measurement) -> None:
            for stream in self.streams():
                measured.stamps[stream] = 0

        return Effect(zero)


class StampFrozen(_StampFault):
    """Stamps stand still, while the values go on."""

    def begin(self, site: Site) -> Effect:
        """Keep the first stamps."""
        kept: dict[str, int] = {}

        def freeze(measured: Measurement) -> None:
            for stream in self.streams():
                measured.stamps[stream] = kept.setdefault(stream, measured.stamps[stream])

        return Effect(freeze)


class StampBack(_StampFault):
    """Stamps are behind by a constant time."""

    by: float = number(0.1, 0.003, 100.0, "s", "how far")

    def ahead(self, passed: float) -> float:
        """The same at all times."""
        return -self.by


class StampAhead(_StampFault):
    """Stamps are ahead by a constant time."""

    by: float = number(0.1, 0.003, 100.0, "s", "how far")

    def ahead(self, passed: float) -> float:
        """The same at all times."""
        return self.by


class StampDrift(_StampFault):
    """Stamps run too fast or too slowly."""

    rate: float = number(1e-4, -0.3, 0.3, "s/s", "by how much they gain in time")

    def ahead(self, passed: float) -> float:
        """What has been gained."""
        return self.rate * passed


class ClockJump(Fault):
    """The time on /clock jumps; at the end it jumps back. Stamps stay."""

    place = _PLACE
    by: float = number(-1.0, -10.0, 10.0, "s", "how far ahead")

    def begin(self, site: Site) -> Effect:
        """Shift the time of the clock."""

        def jump(measured: Measurement) -> None:
            measured.stamps["clock"] = _moved(measured.stamps["clock"], self.by)

        return Effect(jump)


class ClockFrozen(Fault):
    """The time on /clock stands still, while the robot goes on."""

    place = _PLACE

    def begin(self, site: Site) -> Effect:
        """Keep the first time."""
        kept: dict[str, int] = {}

        def freeze(measured: Measurement) -> None:
            measured.stamps["clock"] = kept.setdefault("clock", measured.stamps["clock"])

        return Effect(freeze)


class ClockDrift(Fault):
    """The time on /clock runs too fast or too slowly."""

    place = _PLACE
    rate: float = number(0.01, -0.5, 0.5, "s/s", "by how much it gains in time")

    def begin(self, site: Site) -> Effect:
        """Shift the time of the clock by what has been gained since the beginning."""
        began = site.plant.time

        def drift(measured: Measurement) -> None:
            measured.stamps["clock"] = _moved(measured.stamps["clock"], self.rate * (site.plant.time - began))

        return Effect(drift)


def _moved(stamp: int, seconds: float) -> int:
    """A stamp that is shifted, ns, within what a message can hold."""
    return min(max(stamp + round(seconds * 1e9), _FIRST), _LAST)


KINDS: tuple[type[Fault], ...] = (
    StampZero, StampFrozen, StampBack, StampAhead, StampDrift, ClockJump, ClockFrozen, ClockDrift,
)  # fmt: skip
