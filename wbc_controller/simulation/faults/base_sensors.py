"""Faults of the base's sensors: the odometry of a state estimator, and the inertial measurement unit."""

from typing import Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import Field

from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of, rotation_of
from wbc_controller.records import Array
from wbc_controller.simulation.faults.fault import Fault, MeasurementFault, Site, low_pass, number, ramped
from wbc_controller.simulation.measurement import Measurement


class _BaseSensor(MeasurementFault):
    place = "odometry and IMU"


class OdomNoise(_BaseSensor):
    """White noise on the base's position and orientation."""

    sigma: float = number(0.001, 1e-5, 0.02, "m", "standard deviation of the position along each axis")
    turn_sigma: float = number(0.001, 1e-5, 0.02, "rad", "standard deviation of the orientation about each axis")

    def _spoil(self, measured: Measurement, site: Site, kept: Any) -> None:
        measured.pose[:3] += site.rng.normal(0.0, self.sigma, 3)
        _turn(measured.pose, site.rng.normal(0.0, self.turn_sigma, 3))


class OdomVelocityNoise(_BaseSensor):
    """White noise on the base's velocity and angular velocity."""

    sigma: float = number(0.01, 1e-4, 1.0, "m/s, rad/s", "standard deviation along and about each axis")

    def _spoil(self, measured: Measurement, site: Site, kept: Any) -> None:
        measured.twist += site.rng.normal(0.0, self.sigma, 6)


class OdomDrift(_BaseSensor):
    """The base's position drifts away in a horizontal direction."""

    speed: float = number(0.02, 0.001, 1.0, "m/s", "of the drift")

    def _start(self, site: Site) -> Array:
        return site.direction()

    def _spoil(self, measured: Measurement, site: Site, kept: Array) -> None:
        measured.pose[:3] += self.speed * site.passed * kept


class OdomTurnDrift(_BaseSensor):
    """The base's heading drifts."""

    rate: float = number(0.02, 0.001, 2.0, "rad/s", "of the drift, in a random direction")

    def _start(self, site: Site) -> float:
        return self.rate * float(site.rng.choice([-1.0, 1.0]))

    def _spoil(self, measured: Measurement, site: Site, kept: float) -> None:
        _turn(measured.pose, np.array([0.0, 0.0, kept * site.passed]))


class OdomJump(_BaseSensor):
    """The base's position jumps, also in absolute poses, and stays off, as by relocalization; then it jumps back."""

    size: float = number(0.3, 0.005, 3.0, "m", "of the jump, in a random horizontal direction")

    def _start(self, site: Site) -> Array:
        return self.size * site.direction()

    def _spoil(self, measured: Measurement, site: Site, kept: Array) -> None:
        for pose in (measured.pose, measured.absolute):
            pose[:3] += kept


class OdomTurnJump(_BaseSensor):
    """The base's heading jumps, also in absolute poses, and stays off; at the end it jumps back."""

    angle: float = number(0.3, 0.01, 3.0, "rad", "of the jump, in a random direction")

    def _start(self, site: Site) -> float:
        return self.angle * float(site.rng.choice([-1.0, 1.0]))

    def _spoil(self, measured: Measurement, site: Site, kept: float) -> None:
        for pose in (measured.pose, measured.absolute):
            _turn(pose, np.array([0.0, 0.0, kept]))


class OdomTilt(_BaseSensor):
    """The base's orientation gets a tilt that grows to its value, as with a biased inertial unit."""

    angle: float = number(0.05, 0.002, 0.4, "rad", "the tilt, about a random horizontal axis")
    ramp: float = number(0.2, 0.0, 1.0, "s", "time in which it grows")

    def _start(self, site: Site) -> Array:
        return site.direction()

    def _spoil(self, measured: Measurement, site: Site, kept: Array) -> None:
        _turn(measured.pose, self.angle * ramped(site.passed, self.ramp) * kept)


class OdomFrozen(_BaseSensor):
    """The odometry's values repeat under fresh stamps."""

    def _spoil(self, measured: Measurement, site: Site, kept: dict[str, Array]) -> None:
        measured.pose = kept.setdefault("pose", measured.pose).copy()
        measured.twist = kept.setdefault("twist", measured.twist).copy()


class OdomLag(_BaseSensor):
    """The base's position and velocity pass through a low-pass filter of first order; its orientation does not."""

    time_constant: float = number(0.01, 0.001, 0.1, "s", "of the filter")

    def _spoil(self, measured: Measurement, site: Site, kept: dict[str, Array]) -> None:
        measured.pose[:3] = low_pass(site, self.time_constant, kept, "position", measured.pose[:3].copy())
        measured.twist = low_pass(site, self.time_constant, kept, "twist", measured.twist)


class OdomSlow(_BaseSensor):
    """The odometry is sent more rarely."""

    period: float = number(0.01, 0.004, 0.2, "s", "between two messages")

    def _spoil(self, measured: Measurement, site: Site, kept: dict[str, float]) -> None:
        due = kept.setdefault("due", site.began)
        if site.plant.time < due - 1e-9:
            measured.silent.add("odom")
        else:
            kept["due"] = due + self.period


class OdomBadQuaternion(_BaseSensor):
    """The quaternion of the base is not of length 1."""

    length: float = number(0.0, 0.0, 0.9, "", "its length")

    def _spoil(self, measured: Measurement, site: Site, kept: Any) -> None:
        measured.pose[3:] *= self.length


class OdomNotANumber(_BaseSensor):
    """A value of the odometry is not a number in a share of the messages."""

    share: float = number(1.0, 0.01, 1.0, "", "of the messages")

    def _start(self, site: Site) -> int:
        return int(site.rng.integers(13))

    def _spoil(self, measured: Measurement, site: Site, kept: int) -> None:
        if site.rng.random() < self.share:
            values = measured.pose if kept < 7 else measured.twist
            values[kept if kept < 7 else kept - 7] = np.nan


class OdomAbsurd(_BaseSensor):
    """The base has a finite coordinate that no robot has."""

    value: float = number(1e9, 1e7, 1e200, "m", "the coordinate")

    def _start(self, site: Site) -> int:
        return int(site.rng.integers(3))

    def _spoil(self, measured: Measurement, site: Site, kept: int) -> None:
        measured.pose[kept] = self.value


class OdomWrongFrame(_BaseSensor):
    """The odometry tells the pose of another link."""

    def _spoil(self, measured: Measurement, site: Site, kept: Any) -> None:
        measured.base = f"not_{measured.base}"


class ImuNoise(_BaseSensor):
    """White noise on the inertial measurement unit, read with `estimation.base_state: imu`."""

    sigma: float = number(0.1, 0.001, 100.0, "rad/s, m/s²", "standard deviation about and along each axis")

    def _spoil(self, measured: Measurement, site: Site, kept: Any) -> None:
        measured.angular_velocity += site.rng.normal(0.0, self.sigma, 3)
        measured.specific_force += site.rng.normal(0.0, self.sigma, 3)


class ImuBias(_BaseSensor):
    """The gyroscope of the inertial measurement unit, read with `estimation.base_state: imu`, gets a bias at once."""

    bias: float = number(0.05, 0.001, 10.0, "rad/s", "about a random axis")

    def _start(self, site: Site) -> Array:
        axis = site.rng.normal(0.0, 1.0, 3)
        return np.asarray(self.bias * axis / np.linalg.norm(axis))

    def _spoil(self, measured: Measurement, site: Site, kept: Array) -> None:
        measured.angular_velocity += kept


class ImuShock(_BaseSensor):
    """The IMU, read with `estimation.base_state: imu`, measures an offset: a shock, or a bias step if it lasts."""

    axis: Literal["x", "y", "z"] = Field("x", description="of the IMU")
    turn: float = number(0.0, 0.0, 50.0, "rad/s", "offset of the gyroscope about the axis")
    force: float = number(20.0, 0.0, 500.0, "m/s²", "offset of the accelerometer along the axis")

    def _spoil(self, measured: Measurement, site: Site, kept: Any) -> None:
        axis = np.eye(3)["xyz".index(self.axis)]
        measured.angular_velocity = measured.angular_velocity + self.turn * axis
        measured.specific_force = measured.specific_force + self.force * axis


def _turn(pose: Array, rotation: Array) -> None:
    """Turn the orientation of a pose, (7,), by a rotation vector in the world's axes, (3,) in rad."""
    pose[3:] = quaternion_of(pin.exp3(rotation) @ rotation_of(pose[3:]))


KINDS: tuple[type[Fault], ...] = (
    OdomNoise, OdomVelocityNoise, OdomDrift, OdomTurnDrift, OdomJump, OdomTurnJump, OdomTilt, OdomFrozen, OdomLag,
    OdomSlow, OdomBadQuaternion, OdomNotANumber, OdomAbsurd, OdomWrongFrame, ImuNoise, ImuBias,
    ImuShock,
)  # fmt: skip
