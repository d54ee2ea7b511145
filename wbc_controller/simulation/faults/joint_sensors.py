"""Faults of the joint sensors: the joint states differ from the true positions and velocities."""

from typing import Any, Literal

import numpy as np
from pydantic import Field

from wbc_controller.records import Array
from wbc_controller.simulation.faults.fault import Fault, JointFault, MeasurementFault, Site, low_pass, number, ramped
from wbc_controller.simulation.measurement import Measurement

_PLACE = "joint sensors"


class _AllJoints(MeasurementFault):
    place = _PLACE


class _OneJoint(JointFault, MeasurementFault):
    place = _PLACE


class JointNoise(_AllJoints):
    """White noise on all joint positions and velocities."""

    sigma: float = number(0.001, 1e-5, 0.05, "rad", "standard deviation of the positions")
    velocity_sigma: float = number(0.01, 1e-4, 2.0, "rad/s", "standard deviation of the velocities")

    def _spoil(self, measured: Measurement, site: Site, kept: Any) -> None:
        measured.position += site.rng.normal(0.0, self.sigma, len(measured.position))
        measured.velocity += site.rng.normal(0.0, self.velocity_sigma, len(measured.velocity))


class JointBias(_OneJoint):
    """The position of a joint gets an offset that grows to its value, as an encoder does whose zero wanders."""

    bias: float = number(0.05, -0.5, 0.5, "rad", "the offset")
    ramp: float = number(0.2, 0.0, 1.0, "s", "time in which it grows")

    def _spoil(self, measured: Measurement, site: Site, kept: int) -> None:
        measured.position[kept] += self.bias * ramped(site.passed, self.ramp)


class JointScale(_OneJoint):
    """The position and velocity of a joint are scaled, as by a wrong gear ratio."""

    factor: float = number(1.1, 0.5, 2.0, "", "by which both are multiplied")

    def _spoil(self, measured: Measurement, site: Site, kept: int) -> None:
        measured.position[kept] *= self.factor
        measured.velocity[kept] *= self.factor


class JointQuantization(_AllJoints):
    """All joint positions come in coarse steps."""

    step: float = number(0.001, 1e-4, 0.1, "rad", "width of a step")

    def _spoil(self, measured: Measurement, site: Site, kept: Any) -> None:
        measured.position = np.round(measured.position / self.step) * self.step


class VelocityLag(_AllJoints):
    """All joint velocities pass through a low-pass filter of first order."""

    time_constant: float = number(0.005, 0.001, 0.1, "s", "of the filter")

    def _spoil(self, measured: Measurement, site: Site, kept: dict[str, Array]) -> None:
        measured.velocity = low_pass(site, self.time_constant, kept, "velocity", measured.velocity)


class JointLag(VelocityLag):
    """All joint positions and velocities pass through a low-pass filter of first order."""

    def _spoil(self, measured: Measurement, site: Site, kept: dict[str, Array]) -> None:
        super()._spoil(measured, site, kept)
        measured.position = low_pass(site, self.time_constant, kept, "position", measured.position)


class VelocitySign(_OneJoint):
    """The velocity of a joint has the wrong sign."""

    def _spoil(self, measured: Measurement, site: Site, kept: int) -> None:
        measured.velocity[kept] *= -1.0


class VelocityDead(_AllJoints):
    """All joint velocities are zero."""

    def _spoil(self, measured: Measurement, site: Site, kept: Any) -> None:
        measured.velocity[:] = 0.0


class JointSpike(_OneJoint):
    """Single measurements of a joint's position are far off."""

    size: float = number(1.0, 0.05, 3.0, "rad", "how far")
    share: float = number(0.02, 0.005, 0.3, "", "of the measurements")

    def _spoil(self, measured: Measurement, site: Site, kept: int) -> None:
        if site.rng.random() < self.share:
            measured.position[kept] += self.size * site.rng.choice([-1.0, 1.0])


class JointJump(_OneJoint):
    """The position of a joint jumps and stays off."""

    size: float = number(0.5, 0.02, 3.0, "rad", "of the jump, in a random direction")

    def _start(self, site: Site) -> tuple[int, float]:
        return super()._start(site), self.size * site.rng.choice([-1.0, 1.0])

    def _spoil(self, measured: Measurement, site: Site, kept: tuple[int, float]) -> None:
        joint, jump = kept
        measured.position[joint] += jump


class JointFrozen(_OneJoint):
    """The position of a joint stays at one value, while its velocity is measured."""

    def _start(self, site: Site) -> tuple[int, dict[str, float]]:
        return super()._start(site), {}

    def _spoil(self, measured: Measurement, site: Site, kept: tuple[int, dict[str, float]]) -> None:
        joint, values = kept
        measured.position[joint] = values.setdefault("position", float(measured.position[joint]))


class JointStatesFrozen(_AllJoints):
    """All values of the joint states repeat under fresh stamps."""

    def _spoil(self, measured: Measurement, site: Site, kept: dict[str, Array]) -> None:
        for quantity in ("position", "velocity", "effort"):
            setattr(measured, quantity, kept.setdefault(quantity, getattr(measured, quantity)).copy())


class JointNotANumber(_OneJoint):
    """The position of a joint is not a number in a share of the messages."""

    share: float = number(1.0, 0.01, 1.0, "", "of the messages")

    def _spoil(self, measured: Measurement, site: Site, kept: int) -> None:
        if site.rng.random() < self.share:
            measured.position[kept] = np.nan


class JointAbsurd(_OneJoint):
    """A joint has a finite value that no robot has."""

    value: float = number(1e9, 1e4, 1e200, "rad, rad/s", "the value")
    quantity: Literal["position", "velocity"] = Field("velocity", description="which quantity has it")

    def _spoil(self, measured: Measurement, site: Site, kept: int) -> None:
        getattr(measured, self.quantity)[kept] = self.value


class JointMissing(_OneJoint):
    """The joint states lack a joint."""

    def _spoil(self, measured: Measurement, site: Site, kept: int) -> None:
        measured.absent.add(site.robot.joints[kept])


class JointsSwapped(_OneJoint):
    """Two joints have each other's values, as with crossed cables."""

    def _start(self, site: Site) -> list[int]:
        """Return the indices of the joint and of another one at random."""
        joint, count = super()._start(site), len(site.robot.joints)
        return [joint, (joint + int(site.rng.integers(1, max(2, count)))) % count]

    def _spoil(self, measured: Measurement, site: Site, kept: list[int]) -> None:
        for values in (measured.position, measured.velocity, measured.effort):
            values[kept] = values[kept[::-1]]


KINDS: tuple[type[Fault], ...] = (
    JointNoise, JointBias, JointScale, JointQuantization, JointLag, JointSpike, JointJump, JointFrozen,
    JointStatesFrozen, JointNotANumber, JointAbsurd, JointMissing, JointsSwapped, VelocityLag, VelocitySign,
    VelocityDead,
)  # fmt: skip
