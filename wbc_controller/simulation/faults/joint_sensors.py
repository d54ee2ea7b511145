"""Faults of the joint sensors: errors of the joint states."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from pydantic import Field

from wbc_controller.simulation.faults.fault import Fault, JointFault, MeasurementFault, Site, number
from wbc_controller.simulation.measurement import Measurement


class _SensorFault(MeasurementFault):
    """A fault of the sensors of all joints."""

    place = "joint sensors"


class _JointSensorFault(_SensorFault, JointFault):
    """A fault of the sensors of one joint; `change` gets its index."""

    def draw(self, site: Site) -> Any:
        """Draw the joint where none is named."""
        return site.one_of(self.joint, site.robot.joints)


class JointNoise(_SensorFault):
    """White noise on all joint positions and velocities."""

    sigma: float = number(0.001, 1e-5, 0.05, "rad", "standard deviation of the positions")
    velocity_sigma: float = number(0.01, 1e-4, 2.0, "rad/s", "standard deviation of the velocities")

    def change(self, measured: Measurement, site: Site, drawn: Any) -> None:
        """Add new noise."""
        measured.position += site.rng.normal(0.0, self.sigma, len(measured.position))
        measured.velocity += site.rng.normal(0.0, self.velocity_sigma, len(measured.velocity))


class JointBias(_JointSensorFault):
    """The position of a joint gets an offset that grows to its value, as an encoder does whose zero wanders."""

    bias: float = number(0.05, -0.5, 0.5, "rad", "the offset")
    ramp: float = number(0.2, 0.0, 1.0, "s", "time in which it grows")

    def change(self, measured: Measurement, site: Site, joint: int) -> None:
        """Add the offset."""
        measured.position[joint] += self.bias * site.grown(self.ramp)


class JointScale(_JointSensorFault):
    """The position and velocity of a joint are scaled, as by a wrong gear ratio."""

    factor: float = number(1.1, 0.5, 2.0, "", "by which both are multiplied")

    def change(self, measured: Measurement, site: Site, joint: int) -> None:
        """Scale both."""
        measured.position[joint] *= self.factor
        measured.velocity[joint] *= self.factor


class JointQuantization(_SensorFault):
    """All joint positions come in coarse steps."""

    step: float = number(0.001, 1e-4, 0.1, "rad", "width of a step")

    def change(self, measured: Measurement, site: Site, drawn: Any) -> None:
        """Round the positions."""
        measured.position = np.round(measured.position / self.step) * self.step


class JointLag(_SensorFault):
    """All joint positions and velocities pass through a low-pass filter of first order."""

    time_constant: float = number(0.005, 0.001, 0.1, "s", "of the filter")

    def change(self, measured: Measurement, site: Site, past: dict[str, np.ndarray]) -> None:
        """Filter both from the first measurement on."""
        _filter(measured, site, past, self.time_constant, ("position", "velocity"))


class VelocityLag(_SensorFault):
    """All joint velocities pass through a low-pass filter of first order."""

    time_constant: float = number(0.005, 0.001, 0.1, "s", "of the filter")

    def change(self, measured: Measurement, site: Site, past: dict[str, np.ndarray]) -> None:
        """Filter the velocities from the first measurement on."""
        _filter(measured, site, past, self.time_constant, ("velocity",))


class VelocitySign(_JointSensorFault):
    """The velocity of a joint has the wrong sign."""

    def change(self, measured: Measurement, site: Site, joint: int) -> None:
        """Reverse the velocity."""
        measured.velocity[joint] *= -1.0


class VelocityDead(_SensorFault):
    """All joint velocities are zero."""

    def change(self, measured: Measurement, site: Site, drawn: Any) -> None:
        """Set the velocities to zero."""
        measured.velocity[:] = 0.0


class JointSpike(_JointSensorFault):
    """Single measurements of a joint's position are far off."""

    size: float = number(1.0, 0.05, 3.0, "rad", "how far")
    share: float = number(0.02, 0.005, 0.3, "", "of the measurements")

    def change(self, measured: Measurement, site: Site, joint: int) -> None:
        """Shift a share of the positions."""
        if site.rng.random() < self.share:
            measured.position[joint] += self.size * site.sign()


class JointJump(_JointSensorFault):
    """The position of a joint jumps and stays off."""

    size: float = number(0.5, 0.02, 3.0, "rad", "of the jump, in a random direction")

    def draw(self, site: Site) -> tuple[int, float]:
        """Draw the joint and the direction."""
        return super().draw(site), self.size * site.sign()

    def change(self, measured: Measurement, site: Site, drawn: tuple[int, float]) -> None:
        """Shift the position."""
        joint, size = drawn
        measured.position[joint] += size


class JointFrozen(_JointSensorFault):
    """The position of a joint stays at one value, while its velocity is measured."""

    def draw(self, site: Site) -> tuple[int, dict[str, float]]:
        """Draw the joint."""
        return super().draw(site), {}

    def change(self, measured: Measurement, site: Site, drawn: tuple[int, dict[str, float]]) -> None:
        """Repeat the first position."""
        joint, kept = drawn
        measured.position[joint] = kept.setdefault("position", float(measured.position[joint]))


class JointStatesFrozen(_SensorFault):
    """All values of the joint states repeat under fresh stamps."""

    def change(self, measured: Measurement, site: Site, kept: dict[str, np.ndarray]) -> None:
        """Repeat the first values."""
        for quantity in ("position", "velocity", "effort"):
            first = kept.setdefault(quantity, getattr(measured, quantity).copy())
            setattr(measured, quantity, first.copy())


class JointNotANumber(_JointSensorFault):
    """The position of a joint is not a number in a share of the messages."""

    share: float = number(1.0, 0.01, 1.0, "", "of the messages")

    def change(self, measured: Measurement, site: Site, joint: int) -> None:
        """Spoil a share of the positions."""
        if site.rng.random() < self.share:
            measured.position[joint] = np.nan


class JointAbsurd(_JointSensorFault):
    """A joint has a finite value that no robot has."""

    value: float = number(1e9, 1e4, 1e200, "rad, rad/s", "the value")
    quantity: Literal["position", "velocity"] = Field("velocity", description="which quantity has it")

    def change(self, measured: Measurement, site: Site, joint: int) -> None:
        """Set the value."""
        getattr(measured, self.quantity)[joint] = self.value


class JointMissing(_JointSensorFault):
    """The joint states lack a joint."""

    def change(self, measured: Measurement, site: Site, joint: int) -> None:
        """Leave the joint out."""
        measured.absent.add(site.robot.joints[joint])


class JointsSwapped(_JointSensorFault):
    """Two joints have each other's values, as with crossed cables."""

    def draw(self, site: Site) -> tuple[int, int]:
        """Draw both joints."""
        one, count = super().draw(site), len(site.robot.joints)
        return one, (one + int(site.rng.integers(1, max(2, count)))) % count

    def change(self, measured: Measurement, site: Site, drawn: tuple[int, int]) -> None:
        """Swap all values of the two."""
        one, other = drawn
        for values in (measured.position, measured.velocity, measured.effort):
            values[[one, other]] = values[[other, one]]


def _filter(
    measured: Measurement, site: Site, past: dict[str, np.ndarray], time_constant: float, quantities: tuple[str, ...]
) -> None:
    """Pass quantities through a filter of first order."""
    keep = float(np.exp(-site.period / time_constant))
    for quantity in quantities:
        new = getattr(measured, quantity)
        past[quantity] = keep * past.get(quantity, new) + (1.0 - keep) * new
        setattr(measured, quantity, past[quantity].copy())


KINDS: tuple[type[Fault], ...] = (
    JointNoise, JointBias, JointScale, JointQuantization, JointLag, JointSpike, JointJump, JointFrozen,
    JointStatesFrozen, JointNotANumber, JointAbsurd, JointMissing, JointsSwapped, VelocityLag, VelocitySign,
    VelocityDead,
)  # fmt: skip
