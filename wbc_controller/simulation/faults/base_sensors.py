"""Faults of odometry and IMU."""

from typing import Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import Field

from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of, rotation_of
from wbc_controller.records import Array
from wbc_controller.simulation.faults.fault import Fault, FaultContext, number
from wbc_controller.simulation.sensors import Measurement


class _BaseSensor(Fault):
    place = "odometry and IMU"


class OdomNoise(_BaseSensor):
    """White noise on the base's position and orientation."""

    sigma: float = number(0.001, 1e-5, 0.02, "m", "standard deviation of the position")
    turn_sigma: float = number(0.001, 1e-5, 0.02, "rad", "standard deviation of the orientation")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        measured.pose[:3] += context.rng.normal(0.0, self.sigma, 3)
        _turn(measured.pose, context.rng.normal(0.0, self.turn_sigma, 3))


class OdomVelocityNoise(_BaseSensor):
    """White noise on the base's velocity and angular velocity."""

    sigma: float = number(0.01, 1e-4, 1.0, "m/s, rad/s", "standard deviation")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        measured.twist += context.rng.normal(0.0, self.sigma, 6)


class OdomDrift(_BaseSensor):
    """The base's position drifts in a random horizontal direction."""

    speed: float = number(0.02, 0.001, 1.0, "m/s", "drift")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        measured.pose[:3] += self.speed * context.elapsed * context.direction


class OdomTurnDrift(_BaseSensor):
    """The base's heading drifts."""

    rate: float = number(0.02, 0.001, 2.0, "rad/s", "drift, with random sign")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        _turn(measured.pose, np.array([0.0, 0.0, self.rate * context.sign * context.elapsed]))


class OdomJump(_BaseSensor):
    """The base's position jumps, also in absolute poses, as by relocalization, until the end."""

    size: float = number(0.3, 0.005, 3.0, "m", "horizontal, in a random direction")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        for pose in (measured.pose, measured.absolute):
            pose[:3] += self.size * context.direction


class OdomTurnJump(_BaseSensor):
    """The base's heading jumps, also in absolute poses, until the end."""

    angle: float = number(0.3, 0.01, 3.0, "rad", "with random sign")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        for pose in (measured.pose, measured.absolute):
            _turn(pose, np.array([0.0, 0.0, self.angle * context.sign]))


class OdomTilt(_BaseSensor):
    """The base's orientation has a growing tilt, as with a biased IMU."""

    angle: float = number(0.05, 0.002, 0.4, "rad", "final tilt about a random horizontal axis")
    ramp: float = number(0.2, 0.0, 1.0, "s", "duration of the growth")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        _turn(measured.pose, self.angle * context.ramp_share(self.ramp) * context.direction)


class OdomFrozen(_BaseSensor):
    """The odometry repeats its values with fresh stamps."""

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        measured.pose = context.memory.setdefault("pose", measured.pose).copy()
        measured.twist = context.memory.setdefault("twist", measured.twist).copy()


class OdomLag(_BaseSensor):
    """First-order low-pass on the base's position and velocity, without orientation."""

    time_constant: float = number(0.01, 0.001, 0.1, "s", "time constant")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        measured.pose[:3] = context.low_pass("position", measured.pose[:3].copy(), self.time_constant)
        measured.twist = context.low_pass("twist", measured.twist, self.time_constant)


class OdomSlow(_BaseSensor):
    """The odometry has a lower rate."""

    period: float = number(0.01, 0.004, 0.2, "s", "message period")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        due = context.memory.setdefault("due", context.began)
        if context.plant.time < due - 1e-9:
            measured.silent.add("odom")
        else:
            context.memory["due"] = due + self.period


class OdomBadQuaternion(_BaseSensor):
    """The quaternion of the base is not normalized."""

    length: float = number(0.0, 0.0, 0.9, "", "norm")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        measured.pose[3:] *= self.length


class OdomNotANumber(_BaseSensor):
    """A value of the odometry is NaN in a share of the messages."""

    share: float = number(1.0, 0.01, 1.0, "", "share of messages")

    def _start(self, context: FaultContext) -> int:
        return int(context.rng.integers(13))

    def _distort(self, measured: Measurement, context: FaultContext, state: int) -> None:
        if context.rng.random() < self.share:
            values = measured.pose if state < 7 else measured.twist
            values[state if state < 7 else state - 7] = np.nan


class OdomAbsurd(_BaseSensor):
    """A coordinate of the base is finite but impossible."""

    value: float = number(1e9, 1e7, 1e200, "m", "coordinate")

    def _start(self, context: FaultContext) -> int:
        return int(context.rng.integers(3))

    def _distort(self, measured: Measurement, context: FaultContext, state: int) -> None:
        measured.pose[state] = self.value


class OdomWrongFrame(_BaseSensor):
    """The odometry contains the pose of another link."""

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        measured.base = f"not_{measured.base}"


class ImuNoise(_BaseSensor):
    """White noise of the IMU (`estimation.base_state: imu`)."""

    sigma: float = number(0.1, 0.001, 100.0, "rad/s, m/s²", "standard deviation")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        measured.angular_velocity += context.rng.normal(0.0, self.sigma, 3)
        measured.specific_force += context.rng.normal(0.0, self.sigma, 3)


class ImuBias(_BaseSensor):
    """Step of the gyroscope's bias (`estimation.base_state: imu`)."""

    bias: float = number(0.05, 0.001, 10.0, "rad/s", "about a random axis")

    def _start(self, context: FaultContext) -> Array:
        axis = context.rng.normal(0.0, 1.0, 3)
        return np.asarray(self.bias * axis / np.linalg.norm(axis))

    def _distort(self, measured: Measurement, context: FaultContext, state: Array) -> None:
        measured.angular_velocity += state


class ImuShock(_BaseSensor):
    """Offset of the IMU (`estimation.base_state: imu`): a shock, or a lasting bias step."""

    axis: Literal["x", "y", "z"] = Field("x", description="axis of the IMU")
    turn: float = number(0.0, 0.0, 50.0, "rad/s", "offset of the gyroscope")
    force: float = number(20.0, 0.0, 500.0, "m/s²", "offset of the accelerometer")

    def _distort(self, measured: Measurement, context: FaultContext, state: Any) -> None:
        axis = np.eye(3)["xyz".index(self.axis)]
        measured.angular_velocity = measured.angular_velocity + self.turn * axis
        measured.specific_force = measured.specific_force + self.force * axis


def _turn(pose: Array, rotation: Array) -> None:
    """Rotate the orientation of a pose, (7,), by a rotation vector in world axes, (3,) in rad."""
    pose[3:] = quaternion_of(pin.exp3(rotation) @ rotation_of(pose[3:]))
