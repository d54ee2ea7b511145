"""Faults of the joint sensors: what the joint states say is not what is."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from pydantic import Field

from wbc_controller.simulation.faults.fault import Effect, Fault, JointFault, Site, number
from wbc_controller.simulation.measurement import Measurement

_PLACE = "joint sensors"


class JointNoise(Fault):
    """White noise on all joint positions and velocities."""

    place = _PLACE
    sigma: float = number(0.001, 1e-5, 0.05, "rad", "standard deviation of the positions")
    velocity_sigma: float = number(0.01, 1e-4, 2.0, "rad/s", "standard deviation of the velocities")

    def begin(self, site: Site) -> Effect:
        """Add new noise to each measurement."""

        def noise(measured: Measurement) -> None:
            measured.position += site.rng.normal(0.0, self.sigma, len(measured.position))
            measured.velocity += site.rng.normal(0.0, self.velocity_sigma, len(measured.velocity))

        return Effect(noise)


class JointBias(JointFault):
    """The position of a joint gets an offset that grows to its value, as an encoder does whose zero wanders."""

    place = _PLACE
    bias: float = number(0.05, -0.5, 0.5, "rad", "the offset")
    ramp: float = number(0.2, 0.0, 1.0, "s", "time in which it grows")

    def begin(self, site: Site) -> Effect:
        """Count the time since the first measurement."""
        joint, began = site.one_of(self.joint, site.robot.joints), site.plant.time

        def bias(measured: Measurement) -> None:
            passed = site.plant.time - began
            measured.position[joint] += self.bias * (min(1.0, passed / self.ramp) if self.ramp > 0.0 else 1.0)

        return Effect(bias)


class JointScale(JointFault):
    """The position and velocity of a joint are scaled, as by a wrong gear ratio."""

    place = _PLACE
    factor: float = number(1.1, 0.5, 2.0, "", "by which both are multiplied")

    def begin(self, site: Site) -> Effect:
        """Scale each measurement."""
        joint = site.one_of(self.joint, site.robot.joints)

        def scale(measured: Measurement) -> None:
            measured.position[joint] *= self.factor
            measured.velocity[joint] *= self.factor

        return Effect(scale)


class JointQuantization(Fault):
    """All joint positions come in coarse steps."""

    place = _PLACE
    step: float = number(0.001, 1e-4, 0.1, "rad", "width of a step")

    def begin(self, site: Site) -> Effect:
        """Round each measurement."""

        def quantize(measured: Measurement) -> None:
            measured.position = np.round(measured.position / self.step) * self.step

        return Effect(quantize)


class JointLag(Fault):
    """All joint positions and velocities pass through a low-pass filter of first order."""

    place = _PLACE
    time_constant: float = number(0.005, 0.001, 0.1, "s", "of the filter")

    def begin(self, site: Site) -> Effect:
        """Filter from the first measurement on."""
        return Effect(_lagging(site, self.time_constant, position=True))


class VelocityLag(Fault):
    """All joint velocities pass through a low-pass filter of first order."""

    place = _PLACE
    time_constant: float = number(0.005, 0.001, 0.1, "s", "of the filter")

    def begin(self, site: Site) -> Effect:
        """Filter from the first measurement on."""
        return Effect(_lagging(site, self.time_constant, position=False))


class VelocitySign(JointFault):
    """The velocity of a joint has the wrong sign."""

    place = _PLACE

    def begin(self, site: Site) -> Effect:
        """Turn the sign of each measurement."""
        joint = site.one_of(self.joint, site.robot.joints)

        def turn(measured: Measurement) -> None:
            measured.velocity[joint] *= -1.0

        return Effect(turn)


class VelocityDead(Fault):
    """All joint velocities are zero."""

    place = _PLACE

    def begin(self, site: Site) -> Effect:
        """Set the velocities to zero."""

        def kill(measured: Measurement) -> None:
            measured.velocity[:] = 0.0

        return Effect(kill)


class JointSpike(JointFault):
    """Single measurements of a joint's position are far off."""

    place = _PLACE
    size: float = number(1.0, 0.05, 3.0, "rad", "how far")
    share: float = number(0.02, 0.005, 0.3, "", "of the measurements")

    def begin(self, site: Site) -> Effect:
        """Draw for each measurement whether it is off."""
        joint = site.one_of(self.joint, site.robot.joints)

        def spike(measured: Measurement) -> None:
            if site.rng.random() < self.share:
                measured.position[joint] += self.size * site.rng.choice([-1.0, 1.0])

        return Effect(spike)


class JointJump(JointFault):
    """The position of a joint jumps and stays off."""

    place = _PLACE
    size: float = number(0.5, 0.02, 3.0, "rad", "of the jump, in a random direction")

    def begin(self, site: Site) -> Effect:
        """Shift each measurement."""
        joint = site.one_of(self.joint, site.robot.joints)
        size = self.size * site.rng.choice([-1.0, 1.0])

        def jump(measured: Measurement) -> None:
            measured.position[joint] += size

        return Effect(jump)


class JointFrozen(JointFault):
    """The position of a joint stays at one value, while its velocity is measured."""

    place = _PLACE

    def begin(self, site: Site) -> Effect:
        """Keep the first value."""
        joint, kept = site.one_of(self.joint, site.robot.joints), list[float]()

        def freeze(measured: Measurement) -> None:
            if not kept:
                kept.append(float(measured.position[joint]))
            measured.position[joint] = kept[0]

        return Effect(freeze)


class JointStatesFrozen(Fault):
    """All values of the joint states repeat under fresh stamps."""

    place = _PLACE

    def begin(self, site: Site) -> Effect:
        """Keep the first values."""
        kept: list[tuple[Any, Any, Any]] = []

        def freeze(measured: Measurement) -> None:
            if not kept:
                kept.append((measured.position.copy(), measured.velocity.copy(), measured.effort.copy()))
            measured.position, measured.velocity, measured.effort = (values.copy() for values in kept[0])

        return Effect(freeze)


class JointNotANumber(JointFault):
    """The position of a joint is not a number in a share of the messages."""

    place = _PLACE
    share: float = number(1.0, 0.01, 1.0, "", "of the messages")

    def begin(self, site: Site) -> Effect:
        """Draw for each measurement."""
        joint = site.one_of(self.joint, site.robot.joints)

        def spoil(measured: Measurement) -> None:
            if site.rng.random() < self.share:
                measured.position[joint] = np.nan

        return Effect(spoil)


class JointAbsurd(JointFault):
    """A joint has a finite value that no robot has."""

    place = _PLACE
    value: float = number(1e9, 1e4, 1e200, "rad, rad/s", "the value")
    quantity: Literal["position", "velocity"] = Field("velocity", description="which quantity has it")

    def begin(self, site: Site) -> Effect:
        """Set the value in each measurement."""
        joint = site.one_of(self.joint, site.robot.joints)

        def spoil(measured: Measurement) -> None:
            getattr(measured, self.quantity)[joint] = self.value

        return Effect(spoil)


class JointMissing(JointFault):
    """The joint states lack a joint."""

    place = _PLACE

    def begin(self, site: Site) -> Effect:
        """Leave the joint out of each measurement."""
        name = site.robot.joints[site.one_of(self.joint, site.robot.joints)]

        def leave_out(measured: Measurement) -> None:
            measured.absent.add(name)

        return Effect(leave_out)


class JointsSwapped(JointFault):
    """Two joints have each other's values, as with crossed cables."""

    place = _PLACE

    def begin(self, site: Site) -> Effect:
        """Swap the joint with another one at random."""
        one = site.one_of(self.joint, site.robot.joints)
        other = (one + int(site.rng.integers(1, max(2, len(site.robot.joints))))) % len(site.robot.joints)

        def swap(measured: Measurement) -> None:
            for values in (measured.position, measured.velocity, measured.effort):
                values[[one, other]] = values[[other, one]]

        return Effect(swap)


def _lagging(site: Site, time_constant: float, *, position: bool) -> Any:
    """A filter of first order on the velocities, and on the positions where asked for."""
    keep = float(np.exp(-site.period / time_constant))
    past: dict[str, np.ndarray] = {}

    def lag(measured: Measurement) -> None:
        for quantity in ("position", "velocity") if position else ("velocity",):
            new = getattr(measured, quantity)
            past[quantity] = keep * past.get(quantity, new) + (1.0 - keep) * new
            setattr(measured, quantity, past[quantity].copy())

    return lag


KINDS: tuple[type[Fault], ...] = (
    JointNoise, JointBias, JointScale, JointQuantization, JointLag, JointSpike, JointJump, JointFrozen,
    JointStatesFrozen, JointNotANumber, JointAbsurd, JointMissing, JointsSwapped, VelocityLag, VelocitySign,
    VelocityDead,
)  # fmt: skip
