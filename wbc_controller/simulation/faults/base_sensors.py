"""Faults of the base's sensors: the odometry of the state estimator, and the inertial measurement unit."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import Field

from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of, rotation_of
from wbc_controller.records import Array
from wbc_controller.simulation.faults.fault import Fault, MeasurementFault, Site, number
from wbc_controller.simulation.measurement import Measurement


class _BaseFault(MeasurementFault):
    """A fault of odometry or IMU."""

    place = "odometry and IMU"


class OdomNoise(_BaseFault):
    """White noise on the base's position and orientation."""

    sigma: float = number(0.001, 1e-5, 0.02, "m", "standard deviation of the position along each axis")
    turn_sigma: float = number(0.001, 1e-5, 0.02, "rad", "standard deviation of the orientation about each axis")

    def change(self, measured: Measurement, site: Site, drawn: Any) -> None:
        """Add new noise."""
        measured.pose[:3] += site.rng.normal(0.0, self.sigma, 3)
        _turn(measured.pose, site.rng.normal(0.0, self.turn_sigma, 3))


class OdomVelocityNoise(_BaseFault):
    """White noise on the base's velocity and angular velocity."""

    sigma: float = number(0.01, 1e-4, 1.0, "m/s, rad/s", "standard deviation along and about each axis")

    def change(self, measured: Measurement, site: Site, drawn: Any) -> None:
        """Add new noise."""
        measured.twist += site.rng.normal(0.0, self.sigma, 6)


class OdomDrift(_BaseFault):
    """The base's position drifts away in a horizontal direction."""

    speed: float = number(0.02, 0.001, 1.0, "m/s", "of the drift")

    def draw(self, site: Site) -> Array:
        """Draw the direction."""
        return site.direction()

    def change(self, measured: Measurement, site: Site, direction: Array) -> None:
        """Shift the position."""
        measured.pose[:3] += self.speed * site.elapsed * direction


class OdomTurnDrift(_BaseFault):
    """The base's heading drifts."""

    rate: float = number(0.02, 0.001, 2.0, "rad/s", "of the drift, in a random direction")

    def draw(self, site: Site) -> float:
        """Draw the direction."""
        return self.rate * site.sign()

    def change(self, measured: Measurement, site: Site, rate: float) -> None:
        """Turn the base."""
        _turn(measured.pose, np.array([0.0, 0.0, rate * site.elapsed]))


class OdomJump(_BaseFault):
    """The base's position jumps, also in absolute poses, and stays off, as by relocalization; then it jumps back."""

    size: float = number(0.3, 0.005, 3.0, "m", "of the jump, in a random horizontal direction")

    def draw(self, site: Site) -> Array:
        """Draw the direction."""
        return self.size * site.direction()

    def change(self, measured: Measurement, site: Site, jump: Array) -> None:
        """Shift both positions."""
        for pose in (measured.pose, measured.absolute):
            pose[:3] += jump


class OdomTurnJump(_BaseFault):
    """The base's heading jumps, also in absolute poses, and stays off; at the end it jumps back."""

    angle: float = number(0.3, 0.01, 3.0, "rad", "of the jump, in a random direction")

    def draw(self, site: Site) -> float:
        """Draw the direction."""
        return self.angle * site.sign()

    def change(self, measured: Measurement, site: Site, angle: float) -> None:
        """Turn both poses."""
        for pose in (measured.pose, measured.absolute):
            _turn(pose, np.array([0.0, 0.0, angle]))


class OdomTilt(_BaseFault):
    """The base's orientation gets a tilt that grows to its value, as with a biased inertial unit."""

    angle: float = number(0.05, 0.002, 0.4, "rad", "the tilt, about a random horizontal axis")
    ramp: float = number(0.2, 0.0, 1.0, "s", "time in which it grows")

    def draw(self, site: Site) -> Array:
        """Draw the axis."""
        return site.direction()

    def change(self, measured: Measurement, site: Site, axis: Array) -> None:
        """Tilt the base."""
        _turn(measured.pose, self.angle * site.grown(self.ramp) * axis)


class OdomFrozen(_BaseFault):
    """The odometry's values repeat under fresh stamps."""

    def change(self, measured: Measurement, site: Site, kept: dict[str, Array]) -> None:
        """Repeat the first values."""
        measured.pose = kept.setdefault("pose", measured.pose.copy()).copy()
        measured.twist = kept.setdefault("twist", measured.twist.copy()).copy()


class OdomLag(_BaseFault):
    """The base's position and velocity pass through a low-pass filter of first order; its orientation does not."""

    time_constant: float = number(0.01, 0.001, 0.1, "s", "of the filter")

    def draw(self, site: Site) -> list[Array]:
        """Begin with the first measurement."""
        return []

    def change(self, measured: Measurement, site: Site, past: list[Array]) -> None:
        """Filter position and velocity."""
        keep = float(np.exp(-site.period / self.time_constant))
        new = [measured.pose[:3].copy(), measured.twist]
        past[:] = [keep * old + (1.0 - keep) * value for old, value in zip(past or new, new, strict=True)]
        measured.pose[:3], measured.twist = past[0], past[1].copy()


class OdomSlow(_BaseFault):
    """The odometry is sent more rarely."""

    period: float = number(0.01, 0.004, 0.2, "s", "between two messages")

    def change(self, measured: Measurement, site: Site, memory: dict[str, float]) -> None:
        """Leave out the messages before the next one is due."""
        due = memory.setdefault("due", site.began)
        if site.plant.time < due - 1e-9:
            measured.silent.add("odom")
        else:
            memory["due"] += self.period


class OdomBadQuaternion(_BaseFault):
    """The quaternion of the base is not of length 1."""

    length: float = number(0.0, 0.0, 0.9, "", "its length")

    def change(self, measured: Measurement, site: Site, drawn: Any) -> None:
        """Shorten the quaternion."""
        measured.pose[3:] *= self.length


class OdomNotANumber(_BaseFault):
    """A value of the odometry is not a number in a share of the messages."""

    share: float = number(1.0, 0.01, 1.0, "", "of the messages")

    def draw(self, site: Site) -> int:
        """Draw the value, of 7 of the pose and 6 of the twist."""
        return int(site.rng.integers(13))

    def change(self, measured: Measurement, site: Site, at: int) -> None:
        """Spoil a share of the values."""
        if site.rng.random() < self.share:
            values = measured.pose if at < 7 else measured.twist
            values[at if at < 7 else at - 7] = np.nan


class OdomAbsurd(_BaseFault):
    """The base has a finite coordinate that no robot has."""

    value: float = number(1e9, 1e7, 1e200, "m", "the coordinate")

    def draw(self, site: Site) -> int:
        """Draw the axis."""
        return int(site.rng.integers(3))

    def change(self, measured: Measurement, site: Site, axis: int) -> None:
        """Set the coordinate."""
        measured.pose[axis] = self.value


class OdomWrongFrame(_BaseFault):
    """The odometry tells the pose of another link."""

    def change(self, measured: Measurement, site: Site, drawn: Any) -> None:
        """Name another link."""
        measured.base = f"not_{measured.base}"


class ImuNoise(_BaseFault):
    """White noise on the inertial measurement unit, read with `estimation.base_state: imu`."""

    sigma: float = number(0.1, 0.001, 100.0, "rad/s, m/s²", "standard deviation about and along each axis")

    def change(self, measured: Measurement, site: Site, drawn: Any) -> None:
        """Add new noise."""
        measured.angular_velocity += site.rng.normal(0.0, self.sigma, 3)
        measured.specific_force += site.rng.normal(0.0, self.sigma, 3)


class ImuBias(_BaseFault):
    """The gyroscope of the inertial measurement unit, read with `estimation.base_state: imu`, gets a bias at once."""

    bias: float = number(0.05, 0.001, 10.0, "rad/s", "about a random axis")

    def draw(self, site: Site) -> Array:
        """Draw the axis."""
        axis = site.rng.normal(0.0, 1.0, 3)
        return np.array(self.bias * axis / np.linalg.norm(axis))

    def change(self, measured: Measurement, site: Site, bias: Array) -> None:
        """Add the bias."""
        measured.angular_velocity += bias


class ImuShock(_BaseFault):
    """The IMU, read with `estimation.base_state: imu`, measures an offset: a shock, or a bias step if it lasts."""

    axis: Literal["x", "y", "z"] = Field("x", description="of the IMU")
    turn: float = number(0.0, 0.0, 50.0, "rad/s", "offset of the gyroscope about the axis")
    force: float = number(20.0, 0.0, 500.0, "m/s²", "offset of the accelerometer along the axis")

    def change(self, measured: Measurement, site: Site, drawn: Any) -> None:
        """Add the offset."""
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
