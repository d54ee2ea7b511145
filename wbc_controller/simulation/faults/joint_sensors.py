"""Faults of the joint sensors."""

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from wbc_controller.simulation.faults.fault import Fault, FaultContext, JointFault, number
from wbc_controller.simulation.sensors import Measurement


class _AllJoints(Fault):
    place = "joint sensors"


class _OneJoint(JointFault, _AllJoints):
    pass


class JointNoise(_AllJoints):
    """White noise on all joint positions and velocities."""

    sigma: float = number(0.001, 1e-5, 0.05, "rad", "standard deviation of positions")
    velocity_sigma: float = number(0.01, 1e-4, 2.0, "rad/s", "standard deviation of velocities")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        measured.position += context.rng.normal(0.0, self.sigma, len(measured.position))
        measured.velocity += context.rng.normal(0.0, self.velocity_sigma, len(measured.velocity))


class JointBias(_OneJoint):
    """The position of a joint has a growing offset, as with a drifting encoder zero."""

    bias: float = number(0.05, -0.5, 0.5, "rad", "final offset")
    ramp: float = number(0.2, 0.0, 1.0, "s", "duration of the growth")

    def _distort(self, measured: Measurement, context: FaultContext, state: int) -> None:
        measured.position[state] += self.bias * context.ramp_share(self.ramp)


class JointScale(_OneJoint):
    """Position and velocity of a joint are scaled, as by a wrong gear ratio."""

    factor: float = number(1.1, 0.5, 2.0, "", "scale")

    def _distort(self, measured: Measurement, context: FaultContext, state: int) -> None:
        measured.position[state] *= self.factor
        measured.velocity[state] *= self.factor


class JointQuantization(_AllJoints):
    """All joint positions are quantized."""

    step: float = number(0.001, 1e-4, 0.1, "rad", "resolution")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        measured.position = np.round(measured.position / self.step) * self.step


class JointLag(_AllJoints):
    """First-order low-pass on all joint positions and velocities."""

    filtered: ClassVar[tuple[str, ...]] = ("position", "velocity")
    time_constant: float = number(0.005, 0.001, 0.1, "s", "time constant")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        for quantity in self.filtered:
            setattr(measured, quantity, context.low_pass(quantity, getattr(measured, quantity), self.time_constant))


class JointSpike(_OneJoint):
    """A joint position has outliers."""

    size: float = number(1.0, 0.05, 3.0, "rad", "size of an outlier")
    share: float = number(0.02, 0.005, 0.3, "", "share of measurements")

    def _distort(self, measured: Measurement, context: FaultContext, state: int) -> None:
        if context.rng.random() < self.share:
            measured.position[state] += self.size * context.rng.choice([-1.0, 1.0])


class JointJump(_OneJoint):
    """A joint position jumps until the end."""

    size: float = number(0.5, 0.02, 3.0, "rad", "with random sign")

    def _distort(self, measured: Measurement, context: FaultContext, state: int) -> None:
        measured.position[state] += self.size * context.sign


class JointFrozen(_OneJoint):
    """A joint position is constant while its velocity is measured."""

    def _distort(self, measured: Measurement, context: FaultContext, state: int) -> None:
        measured.position[state] = context.memory.setdefault("position", float(measured.position[state]))


class JointStatesFrozen(_AllJoints):
    """The joint states repeat all values with fresh stamps."""

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        for quantity in ("position", "velocity", "effort"):
            setattr(measured, quantity, context.memory.setdefault(quantity, getattr(measured, quantity)).copy())


class JointNotANumber(_OneJoint):
    """A joint position is NaN in a share of the messages."""

    share: float = number(1.0, 0.01, 1.0, "", "share of messages")

    def _distort(self, measured: Measurement, context: FaultContext, state: int) -> None:
        if context.rng.random() < self.share:
            measured.position[state] = np.nan


class JointAbsurd(_OneJoint):
    """A joint value is finite but impossible."""

    value: float = number(1e9, 1e4, 1e200, "rad, rad/s", "value")
    quantity: Literal["position", "velocity"] = Field("velocity", description="affected quantity")

    def _distort(self, measured: Measurement, context: FaultContext, state: int) -> None:
        getattr(measured, self.quantity)[state] = self.value


class JointMissing(_OneJoint):
    """A joint is missing in the joint states."""

    def _distort(self, measured: Measurement, context: FaultContext, state: int) -> None:
        measured.absent.add(context.robot.joints[state])


class JointsSwapped(_OneJoint):
    """Two joints have swapped values, as by crossed cables."""

    def _start(self, context: FaultContext) -> list[int]:
        joint, count = super()._start(context), len(context.robot.joints)
        return [joint, (joint + int(context.rng.integers(1, max(2, count)))) % count]

    def _distort(self, measured: Measurement, context: FaultContext, state: list[int]) -> None:
        for values in (measured.position, measured.velocity, measured.effort):
            values[state] = values[state[::-1]]


class VelocityLag(JointLag):
    """First-order low-pass on all joint velocities."""

    filtered = ("velocity",)


class VelocitySign(_OneJoint):
    """The velocity of a joint has the wrong sign."""

    def _distort(self, measured: Measurement, context: FaultContext, state: int) -> None:
        measured.velocity[state] *= -1.0


class VelocityDead(_AllJoints):
    """All joint velocities are zero."""

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        measured.velocity[:] = 0.0
