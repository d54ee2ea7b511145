"""Faults of what is known about the base: the state estimator's odometry, and the inertial measurement unit."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pinocchio as pin
from pydantic import Field

from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of, rotation_of
from wbc_controller.records import Array
from wbc_controller.simulation.faults.fault import Effect, Fault, Site, number
from wbc_controller.simulation.measurement import Measurement

_PLACE = "odometry and IMU"


class OdomNoise(Fault):
    """White noise on the base's position and orientation."""

    place = _PLACE
    sigma: float = number(0.001, 1e-5, 0.02, "m", "standard deviation of the position along each axis")
    turn_sigma: float = number(0.001, 1e-5, 0.02, "rad", "standard deviation of the orientation about each axis")

    def begin(self, site: Site) -> Effect:
        """Add new noise to each measurement."""

        def noise(measured: Measurement) -> None:
            measured.pose[:3] += site.rng.normal(0.0, self.sigma, 3)
            _turn(measured.pose, site.rng.normal(0.0, self.turn_sigma, 3))

        return Effect(noise)


class OdomVelocityNoise(Fault):
    """White noise on the base's velocity and angular velocity."""

    place = _PLACE
    sigma: float = number(0.01, 1e-4, 1.0, "m/s, rad/s", "standard deviation along and about each axis")

    def begin(self, site: Site) -> Effect:
        """Add new noise to each measurement."""

        def noise(measured: Measurement) -> None:
            measured.twist += site.rng.normal(0.0, self.sigma, 6)

        return Effect(noise)


class OdomDrift(Fault):
    """The base's position drifts away in a horizontal direction."""

    place = _PLACE
    speed: float = number(0.02, 0.001, 1.0, "m/s", "of the drift")

    def begin(self, site: Site) -> Effect:
        """Count the time since the beginning."""
        direction, began = site.direction(), site.plant.time

        def drift(measured: Measurement) -> None:
            measured.pose[:3] += self.speed * (site.plant.time - began) * direction

        return Effect(drift)


class OdomTurnDrift(Fault):
    """The base's heading drifts."""

    place = _PLACE
    rate: float = number(0.02, 0.001, 2.0, "rad/s", "of the drift, in a random direction")

    def begin(self, site: Site) -> Effect:
        """Count the time since the beginning."""
        rate, began = self.rate * site.rng.choice([-1.0, 1.0]), site.plant.time

        def drift(measured: Measurement) -> None:
            _turn(measured.pose, np.array([0.0, 0.0, rate * (site.plant.time - began)]))

        return Effect(drift)


class OdomJump(Fault):
    """The base's position jumps, also in absolute poses, and stays off, as by relocalization; then it jumps back."""

    place = _PLACE
    size: float = number(0.3, 0.005, 3.0, "m", "of the jump, in a random horizontal direction")

    def begin(self, site: Site) -> Effect:
        """Shift each measurement."""
        jump = self.size * site.direction()

        def shift(measured: Measurement) -> None:
            for pose in (measured.pose, measured.absolute):
                pose[:3] += jump

        return Effect(shift)


class OdomTurnJump(Fault):
    """The base's heading jumps, also in absolute poses, and stays off; at the end it jumps back."""

    place = _PLACE
    angle: float = number(0.3, 0.01, 3.0, "rad", "of the jump, in a random direction")

    def begin(self, site: Site) -> Effect:
        """Turn each measurement."""
        angle = self.angle * site.rng.choice([-1.0, 1.0])

        def turn(measured: Measurement) -> None:
            for pose in (measured.pose, measured.absolute):
                _turn(pose, np.array([0.0, 0.0, angle]))

        return Effect(turn)


class OdomTilt(Fault):
    """The base's orientation gets a tilt that grows to its value, as with a biased inertial unit."""

    place = _PLACE
    angle: float = number(0.05, 0.002, 0.4, "rad", "the tilt, about a random horizontal axis")
    ramp: float = number(0.2, 0.0, 1.0, "s", "time in which it grows")

    def begin(self, site: Site) -> Effect:
        """Count the time since the beginning."""
        axis, began = site.direction(), site.plant.time

        def tilt(measured: Measurement) -> None:
            passed = site.plant.time - began
            share = min(1.0, passed / self.ramp) if self.ramp > 0.0 else 1.0
            _turn(measured.pose, self.angle * share * axis)

        return Effect(tilt)


class OdomFrozen(Fault):
    """The odometry's values repeat under fresh stamps."""

    place = _PLACE

    def begin(self, site: Site) -> Effect:
        """Keep the first values."""
        kept: list[tuple[Array, Array]] = []

        def freeze(measured: Measurement) -> None:
            if not kept:
                kept.append((measured.pose.copy(), measured.twist.copy()))
            measured.pose, measured.twist = kept[0][0].copy(), kept[0][1].copy()

        return Effect(freeze)


class OdomLag(Fault):
    """The base's position and velocity pass through a low-pass filter of first order; its orientation does not."""

    place = _PLACE
    time_constant: float = number(0.01, 0.001, 0.1, "s", "of the filter")

    def begin(self, site: Site) -> Effect:
        """Filter from the first measurement on."""
        keep = float(np.exp(-site.period / self.time_constant))
        past: list[Array] = []

        def lag(measured: Measurement) -> None:
            new = [measured.pose[:3].copy(), measured.twist]
            past[:] = [keep * old + (1.0 - keep) * value for old, value in zip(past or new, new, strict=True)]
            measured.pose[:3], measured.twist = past[0], past[1].copy()

        return Effect(lag)


class OdomSlow(Fault):
    """The odometry is sent more rarely."""

    place = _PLACE
    period: float = number(0.01, 0.004, 0.2, "s", "between two messages")

    def begin(self, site: Site) -> Effect:
        """Leave out what comes before it is due."""
        due = [site.plant.time]

        def thin_out(measured: Measurement) -> None:
            if site.plant.time < due[0] - 1e-9:
                measured.silent.add("odom")
            else:
                due[0] += self.period

        return Effect(thin_out)


class OdomBadQuaternion(Fault):
    """The quaternion of the base is not of length 1."""

    place = _PLACE
    length: float = number(0.0, 0.0, 0.9, "", "its length")

    def begin(self, site: Site) -> Effect:
        """Shorten it in each measurement."""

        def shorten(measured: Measurement) -> None:
            measured.pose[3:] *= self.length

        return Effect(shorten)


class OdomNotANumber(Fault):
    """A value of the odometry is not a number in a share of the messages."""

    place = _PLACE
    share: float = number(1.0, 0.01, 1.0, "", "of the messages")

    def begin(self, site: Site) -> Effect:
        """Draw for each measurement."""
        at = int(site.rng.integers(13))

        def spoil(measured: Measurement) -> None:
            if site.rng.random() < self.share:
                values = measured.pose if at < 7 else measured.twist
                values[at if at < 7 else at - 7] = np.nan

        return Effect(spoil)


class OdomAbsurd(Fault):
    """The base has a finite coordinate that no robot has."""

    place = _PLACE
    value: float = number(1e9, 1e7, 1e200, "m", "the coordinate")

    def begin(self, site: Site) -> Effect:
        """Set it in each measurement."""
        axis = int(site.rng.integers(3))

        def spoil(measured: Measurement) -> None:
            measured.pose[axis] = self.value

        return Effect(spoil)


class OdomWrongFrame(Fault):
    """The odometry tells the pose of another link."""

    place = _PLACE

    def begin(self, site: Site) -> Effect:
        """Name another link in each measurement."""

        def rename(measured: Measurement) -> None:
            measured.base = f"not_{measured.base}"

        return Effect(rename)


class ImuNoise(Fault):
    """White noise on the inertial measurement unit, read with `estimation.base_state: imu`."""

    place = _PLACE
    sigma: float = number(0.1, 0.001, 100.0, "rad/s, m/s²", "standard deviation about and along each axis")

    def begin(self, site: Site) -> Effect:
        """Add new noise to each measurement."""

        def noise(measured: Measurement) -> None:
            measured.angular_velocity += site.rng.normal(0.0, self.sigma, 3)
            measured.specific_force += site.rng.normal(0.0, self.sigma, 3)

        return Effect(noise)


class ImuBias(Fault):
    """The gyroscope of the inertial measurement unit, read with `estimation.base_state: imu`, gets a bias at once."""

    place = _PLACE
    bias: float = number(0.05, 0.001, 10.0, "rad/s", "about a random axis")

    def begin(self, site: Site) -> Effect:
        """Draw the axis."""
        axis = site.rng.normal(0.0, 1.0, 3)
        bias = self.bias * axis / np.linalg.norm(axis)

        def shift(measured: Measurement) -> None:
            measured.angular_velocity += bias

        return Effect(shift)


class ImuShock(Fault):
    """The IMU, read with `estimation.base_state: imu`, measures an offset: a shock, or a bias step if it lasts."""

    place = _PLACE
    axis: Literal["x", "y", "z"] = Field("x", description="of the IMU")
    turn: float = number(0.0, 0.0, 50.0, "rad/s", "offset of the gyroscope about the axis")
    force: float = number(20.0, 0.0, 500.0, "m/s²", "offset of the accelerometer along the axis")

    def begin(self, site: Site) -> Effect:
        """Add the offset to each measurement."""
        axis = np.eye(3)["xyz".index(self.axis)]

        def shift(measured: Measurement) -> None:
            measured.angular_velocity = measured.angular_velocity + self.turn * axis
            measured.specific_force = measured.specific_force + self.force * axis

        return Effect(shift)


def _turn(pose: Array, rotation: Array) -> None:
    """Turn the orientation of a pose, (7,), by a rotation vector in the world's axes, (3,) in rad."""
    pose[3:] = quaternion_of(pin.exp3(rotation) @ rotation_of(pose[3:]))


KINDS: tuple[type[Fault], ...] = (
    OdomNoise, OdomVelocityNoise, OdomDrift, OdomTurnDrift, OdomJump, OdomTurnJump, OdomTilt, OdomFrozen, OdomLag,
    OdomSlow, OdomBadQuaternion, OdomNotANumber, OdomAbsurd, OdomWrongFrame, ImuNoise, ImuBias,
    ImuShock,
)  # fmt: skip
