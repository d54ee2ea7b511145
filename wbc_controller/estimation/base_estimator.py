"""Estimator of the base pose and twist from an IMU, the joints and the active contacts."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from wbc_controller.estimation.absolute_pose import AbsolutePoses, PoseSample, PoseSensor
from wbc_controller.estimation.anchoring import Anchoring
from wbc_controller.estimation.consistency import LIMIT, ContactConsistency
from wbc_controller.estimation.invariant_filter import ImuNoise, InvariantFilter, hat
from wbc_controller.estimation.leg_kinematics import LegKinematics, Sight
from wbc_controller.estimation.planar_transform import IDENTITY, PlanarTransform
from wbc_controller.estimation.rolling import Rolling
from wbc_controller.estimation.sensor_agreement import PERIOD, SensorAgreement, gravity_contradiction
from wbc_controller.inverse_dynamics.arrays import all_true, cross, sum_of_squares
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of
from wbc_controller.records import Array

#: Largest relative difference of the specific force from gravity at the start: beyond it, a unit or axis is wrong.
_GRAVITY_TOLERANCE = 0.1
#: Largest bias of a gyroscope, rad/s: a larger mean at the start means rotation, or a broken gyroscope.
_MOST_BIAS = 0.5
#: Probability of a false slip detection, per update.
_SLIP = 1.0e-5
#: A slipping contact is at rest again after moving less than this distance for this time, m and s (0.1 m/s).
_MOVED, _RESTED = 0.004, 0.04
#: Share of the settling time that the samples must span.
_SETTLED = 0.9
#: Variance of the velocity at the start, (m/s)².
_VELOCITY = 1.0e-4
#: Longest gap between two IMU samples, s; after a longer one the estimate is lost.
_GAP = 0.1
#: Variances of position and heading of the IMU at the start, m² and rad²: they define the world.
_DEFINED = 1.0e-8


@dataclass(frozen=True, slots=True)
class Sensors:
    """Parameters of the IMU and of the start.

    Attributes:
        noise: noise of the IMU and of contact points.
        accelerometer_bias: standard deviation of the accelerometer's bias at the start, m/s².
        settling: duration of the rest at the start, s.
        stillness: largest standard deviation of the angular velocity in that time, rad/s.
    """

    noise: ImuNoise
    accelerometer_bias: float
    settling: float
    stillness: float


@dataclass(frozen=True, slots=True)
class ImuSample:
    """One measurement of the IMU, in its own axes.

    Attributes:
        stamp: s, on the robot's clock.
        angular_velocity: (3,) in rad/s.
        specific_force: acceleration less gravity, (3,) in m/s².
    """

    stamp: float
    angular_velocity: Array
    specific_force: Array


class BaseEstimator:
    """Estimator of the base from an IMU and the active contacts, with an `InvariantFilter`.

    At the start the robot stands still on its contacts: the mean specific force is gravity, the mean angular velocity
    is the bias of the gyroscope. The world has its origin on the ground below the base, and the heading of the base.
    Position and heading are unobservable and drift, less during long contacts (`anchoring`). With absolute poses the
    world is theirs, and there is no estimate before they agree (`absolute_pose`).

    A contact whose kinematics contradict the estimate by more than noise is excluded: it slips, or has lifted off. It
    is added again at its present place when it is at rest, or at once if no other contact is left.

    If all contacts move in the estimate (`consistency`), the gyroscope's axes or unit contradict the legs
    (`sensor_agreement`), the IMU is silent, or a number is not finite, the estimate is lost. It starts again when the
    robot stands still.

    Attributes:
        imu_frame: name of the IMU's frame.
        lost: reason for the loss of the last estimate; empty before the first one, after `restart`, and during one.
    """

    def __init__(
        self, kinematics: LegKinematics, sensors: Sensors, gravity: Array, poses: PoseSensor | None = None
    ) -> None:
        """Start without data; gravity is in the world, (3,) in m/s².

        Raises:
            ConfigurationError: if the robot has no such frame of the poses.
        """
        if poses is not None:
            kinematics.frame(poses.frame, "estimation.pose_frame")
        self._pose_sensor = poses
        self.imu_frame = kinematics.imu_frame
        self.lost = ""
        self._waits_for = "no IMU data have come"
        self._kinematics = kinematics
        self._sensors = sensors
        self._gravity = gravity
        self._still: list[ImuSample] = []
        self._running: _Running | None = None

    @property
    def waits_for(self) -> str:
        """Reason why there is no estimate, or empty."""
        return f"the base estimate was lost: {self.lost}; {self._waits_for}" if self.lost else self._waits_for

    @property
    def filter(self) -> InvariantFilter | None:
        """The filter; None until the robot has stood still."""
        return self._running.filter if self._running is not None else None

    @property
    def slipping(self) -> tuple[str, ...]:
        """Names of the contacts that are excluded because they move."""
        return self._running.slipping if self._running is not None else ()

    @property
    def base(self) -> tuple[Array, Array] | None:
        """Pose of the base, (7,), and its twist in its own axes, (6,); None without an estimate.

        The pose is in the frame on the feet (`anchoring`), which starts as the filter's world, or in the world of
        absolute poses, whose corrections are applied at a bounded rate.
        """
        if self._running is None:
            return None
        poses = self._running.poses
        if poses is None:
            return self.odometry
        return self._running.base(poses.shown) if poses.aligned else None

    @property
    def odometry(self) -> tuple[Array, Array] | None:
        """Like `base`, in a drifting world that no absolute pose moves."""
        return self._running.base(self._running.odometry) if self._running is not None else None

    @property
    def takes_poses(self) -> bool:
        """True if absolute poses are used."""
        return self._pose_sensor is not None

    @property
    def poses(self) -> AbsolutePoses | None:
        """Corrections by absolute poses; None without them or without an estimate."""
        return self._running.poses if self._running is not None else None

    @property
    def stamp(self) -> float:
        """Stamp of the newest sample in the estimate, s; minus infinity without an estimate."""
        return self._running.stamp if self._running is not None else -np.inf

    @property
    def covariance(self) -> tuple[Array, Array] | None:
        """Covariances of `odometry`, (6, 6) each: of position and turns about the axes of its world, and of the twist.

        With absolute poses it is that of the corrected pose, turned into these axes.
        """
        if self._running is None:
            return None
        of_pose, of_twist = self._running.covariance()
        turn = np.kron(np.eye(2), self._running.odometry.rotation)
        return turn @ of_pose @ turn.T, of_twist

    def restart(self) -> None:
        """Forget everything: the robot must stand still again."""
        self._running, self._still = None, []
        self.lost, self._waits_for = "", "no IMU data have come"

    def update(self, samples: Sequence[ImuSample], q: Array, v: Array, holding: Collection[str]) -> None:
        """Update the estimate with the measurements since the last update.

        Args:
            samples: of the IMU, in the order of their stamps.
            q: positions of the joints, (nj,) in rad.
            v: velocities of the joints, (nj,) in rad/s.
            holding: names of the active contacts; those without points are ignored.
        """
        self._kinematics.update(q, v)
        held = [name for name in self._kinematics.points if name in holding]
        if self._running is None:
            self._wait_for_rest(samples, held)
            return
        self._after_update(self._running.follow(samples, held))

    def correct(self, samples: list[PoseSample], *, held: bool) -> list[str]:
        """Correct the estimate by absolute poses (`AbsolutePoses.take`), after `update`; ignored before the start."""
        if self._running is None or self._running.poses is None:
            return []
        try:
            refused = self._running.poses.take(samples, held=held)
        except np.linalg.LinAlgError as error:
            self._after_update(str(error))
            return []
        self._after_update(self._running.broken())
        return refused

    def _after_update(self, lost: str | None) -> None:
        """Restart if the estimate is lost; otherwise update the reason to wait for absolute poses."""
        if lost is not None:
            self.restart()
            self.lost, self._waits_for = lost, f"the robot has to stand still for {self._sensors.settling:g} s"
        elif self._running is not None and self._running.poses is not None:
            self._waits_for = self._running.poses.waits_for

    def _wait_for_rest(self, samples: Sequence[ImuSample], holding: Sequence[str]) -> None:
        """Wait until the robot has stood still for a while, then start the filter."""
        sensors = self._sensors
        if self._still and samples and not (0.0 < samples[0].stamp - self._still[-1].stamp <= _GAP):
            self._still = []
        self._still += samples
        if not self._still:
            return
        newest = self._still[-1].stamp
        self._still = [sample for sample in self._still if newest - sample.stamp <= sensors.settling]
        if newest - self._still[0].stamp < _SETTLED * sensors.settling:
            self._waits_for = f"the robot has to stand still for {sensors.settling:g} s"
            return
        turning = np.array([sample.angular_velocity for sample in self._still])
        force = np.array([sample.specific_force for sample in self._still])
        wobble, pull = float(turning.std(axis=0).max()), float(np.linalg.norm(force.mean(axis=0)))
        turn = float(np.linalg.norm(turning.mean(axis=0)))
        gravity = float(np.linalg.norm(self._gravity))
        if not wobble <= sensors.stillness:
            self._waits_for = (
                f"the robot has to stand still for {sensors.settling:g} s: its angular velocity varies by {wobble:.3g} "
                f"rad/s (limit {sensors.stillness:g}, estimation.stillness)"
            )
            if wobble <= np.degrees(sensors.stillness):
                self._waits_for += "; the noise of a gyroscope in deg/s, instead of rad/s, may do so"
        elif not turn <= _MOST_BIAS:
            self._waits_for = (
                f"the IMU turns at {turn:.3g} rad/s (limit {_MOST_BIAS:g}): the robot turns, or the gyroscope is wrong"
            )
        elif not abs(pull - gravity) <= _GRAVITY_TOLERANCE * gravity:
            self._waits_for = (
                f"the IMU measures {pull:.3g} m/s² at rest, and gravity is {gravity:.3g}: its unit, or its "
                "accelerometer, is wrong"
            )
        elif not holding:
            self._waits_for = "no contact holds that does not roll or belong to two links of the robot"
        elif contradiction := gravity_contradiction(self._kinematics, holding, force.mean(axis=0) / pull):
            self._waits_for = f"the accelerometer contradicts the legs: {contradiction}"
        else:
            filter = self._initial_filter(turning.mean(axis=0), force.mean(axis=0), holding)
            poses = (
                AbsolutePoses(self._pose_sensor, self._kinematics, filter) if self._pose_sensor is not None else None
            )
            self._running = _Running(filter, self._still[-1], self._kinematics, sensors, poses)
            self._still, self.lost, self._waits_for = [], "", ""
            self._after_update(self._running.follow([], holding))

    def _initial_filter(self, turning: Array, force: Array, holding: Sequence[str]) -> InvariantFilter:
        """Return the filter of a robot at rest, from the mean IMU measurements."""
        sensors, noise, legs = self._sensors, self._sensors.noise, self._kinematics
        up = force / np.linalg.norm(force)
        across = np.cross(up, legs.imu_rotation[0])  # the base's x axis, levelled, is the world's
        across /= np.linalg.norm(across)
        R = np.vstack([np.cross(across, up), across, up])
        heights = [
            legs.sight((name,)).places @ R[2] - legs.rolling.get(name, np.zeros(3))[2] for name in holding
        ]  # fmt: skip
        level, height = R @ legs.imu_rotation.T @ legs.imu_position, float(np.concatenate(heights).mean())
        g = float(np.linalg.norm(self._gravity))
        mean = noise.gyroscope**2 / sensors.settling + noise.gyroscope_bias**2 * sensors.settling
        P = np.diag(np.repeat([_DEFINED, _VELOCITY, _DEFINED, mean, sensors.accelerometer_bias**2], 3))
        # The accelerometer's bias appears as a tilt, g ξ_R = up × R ζ_a, so the two errors are fully correlated. With
        # independent errors, the filter of a standing robot would underestimate both.
        tilting = hat(np.array([0.0, 0.0, 1.0 / g])) @ R
        P[:3, 12:15] = sensors.accelerometer_bias**2 * tilting
        P[12:15, :3] = P[:3, 12:15].T
        P[:3, :3] += (sensors.accelerometer_bias**2 + noise.accelerometer**2 / sensors.settling) * (tilting @ tilting.T)
        return InvariantFilter(
            noise,
            self._gravity,
            rotation=R,
            velocity=np.zeros(3),
            position=np.array([level[0], level[1], -height]),
            gyroscope_bias=turning,
            accelerometer_bias=np.zeros(3),
            P=P,
        )


class _Running:
    """A started filter with its contacts.

    Attributes:
        filter: the filter.
        slipping: contacts that are excluded because they move.
        poses: corrections by absolute poses, or None.
    """

    def __init__(
        self,
        filter: InvariantFilter,
        last: ImuSample,
        kinematics: LegKinematics,
        sensors: Sensors,
        poses: AbsolutePoses | None = None,
    ) -> None:
        self.filter = filter
        self.poses = poses
        self._moving: dict[str, tuple[float, Array]] = {}  # slipping contacts: stamp and points, (k, 3) in m
        self._last = last
        self._interval = np.inf  # between the last two samples, s
        self._kinematics = kinematics
        self._sensors = sensors
        self._anchoring = Anchoring()
        self._rolling = Rolling(kinematics.rolling)
        self._consistency = ContactConsistency(kinematics)
        self._agreement, self._bias = SensorAgreement(kinematics, "the gyroscope", moves=False), filter.gyroscope_bias
        self._agreed = False
        self._turned, self._compared = np.zeros(3), last.stamp  # turn since the last comparison, rad, and its stamp
        self._largest_square = {
            name: float(chdtri(3 * len(points), _SLIP)) for name, points in kinematics.points.items()
        }

    @property
    def stamp(self) -> float:
        """Stamp of the newest sample, s."""
        return self._last.stamp

    @property
    def slipping(self) -> tuple[str, ...]:
        return tuple(self._moving)

    def follow(self, samples: Sequence[ImuSample], holding: Sequence[str]) -> str | None:
        """Process measurements; return the reason for a loss of the estimate, or None."""
        before = self.stamp
        for sample in samples:
            dt = sample.stamp - self._last.stamp
            if dt > _GAP:
                return f"the IMU was silent for {dt:.3f} s"
            if dt > 0.0:
                self._propagate(sample, dt)
        try:
            self._correct_by_contacts(holding)
        except np.linalg.LinAlgError as error:
            return str(error)
        lost = self.broken() or self._contradicted(tuple(holding), self.stamp - before)
        if lost is None and self.stamp - self._compared >= PERIOD:
            lost = self._compare_turns(tuple(holding))
        if lost is None and self.poses is not None:
            self.poses.follow(self.stamp)
        elif lost is None and self._anchoring.due(self.stamp):
            self._anchoring.follow(self.stamp, self._points())
        return lost

    def broken(self) -> str | None:
        """Return why the numbers of the filter are unusable, or None."""
        if not math.isfinite(sum_of_squares(self.filter.columns) + sum_of_squares(self.filter.P)):
            return "it is not finite"
        return None

    def _contradicted(self, holding: tuple[str, ...], elapsed: float) -> str | None:
        """Return a sentence if all contacts move against the IMU; None if one of them is at rest."""
        found, contacts = self.filter, self._consistency
        omega = self._last.angular_velocity - found.gyroscope_bias
        contacts.update(holding, found.rotation, found.velocity, omega, elapsed)
        if contacts.speed <= LIMIT:
            return None
        wrong_axes = self._compare_turns(holding, at_once=True)
        if wrong_axes is not None:
            return wrong_axes
        agree = self._agreed or self._agreement.comparison.turns_agree
        wrong = "accelerometer (the gyroscope agrees with the legs)" if agree else "IMU"
        return (
            f"the IMU contradicts all contacts ({', '.join(holding)}): by its data each of them moves at "
            f"{contacts.speed:.2f} m/s or more (limit {LIMIT:g} m/s); the {wrong} is wrong, or no contact holds"
        )

    def _compare_turns(self, holding: tuple[str, ...], *, at_once: bool = False) -> str | None:
        """Compare the gyroscope with the legs (`sensor_agreement`) until they have agreed about all axes."""
        elapsed, self._compared = self.stamp - self._compared, self.stamp
        turned, self._turned = self._turned, np.zeros(3)
        if self._agreed or not holding:
            return None
        found = self._agreement.look(elapsed, turned[None], holding, at_once=at_once)
        self._agreed = found is None and self._agreement.comparison.agreed
        return found

    @property
    def odometry(self) -> PlanarTransform:
        """Transform from the filter's world to one that no absolute pose moves."""
        return self._anchoring.transform if self.poses is None else self.poses.odometry

    def _points(self) -> dict[str, Array]:
        """Return the contact points in the filter's world, by contact, (k, 3) each in m."""
        found = self.filter
        places: dict[str, list[Array]] = {}
        for i, point in enumerate(found.names):
            places.setdefault(point.rpartition("/")[0], []).append(found.columns[:, 2 + i])
        return {name: np.array(columns) for name, columns in places.items()}

    def base(self, to: PlanarTransform = IDENTITY) -> tuple[Array, Array]:
        """Return the base pose in the filter's world or a transformed one, (7,), and the twist in base axes, (6,)."""
        found, legs = self.filter, self._kinematics
        R = found.rotation @ legs.imu_rotation.T
        linear, angular = legs.imu_motion[:3], legs.imu_motion[3:]
        omega = legs.imu_rotation @ (self._last.angular_velocity - found.gyroscope_bias) - angular
        velocity = R.T @ found.velocity - cross(omega, legs.imu_position) - linear
        position = to.rotation @ (found.position - R @ legs.imu_position) + to.translation
        pose = np.concatenate([position, quaternion_of(to.rotation @ R)])
        return pose, np.concatenate([velocity, omega])

    def covariance(self) -> tuple[Array, Array]:
        """Covariances of the base's pose, position and turns about the world's axes, and of its twist, (6, 6) each.

        From X̂ X⁻¹ = exp(ξ), to first order: the base at p has the errors ξ_p - pₓ ξ_R and ξ_R, and its velocity in its
        own axes Rᵀ ξ_v + rₓ δω, where r is the place of the IMU, and δω what bias and noise of the gyroscope make.
        """
        found, legs = self.filter, self._kinematics
        P, own = found.P, list(range(9)) + list(range(len(found.P) - 6, len(found.P) - 3))
        R = found.rotation @ legs.imu_rotation.T
        arm = hat(legs.imu_position)
        errors = np.zeros((12, 12))
        errors[0:3, 0:3], errors[0:3, 6:9] = -hat(found.position - R @ legs.imu_position), np.eye(3)
        errors[3:6, 0:3] = np.eye(3)
        errors[6:9, 3:6], errors[6:9, 9:12] = R.T, -arm @ legs.imu_rotation
        errors[9:12, 9:12] = -legs.imu_rotation
        C = errors @ P[np.ix_(own, own)] @ errors.T
        noise = np.vstack([arm, np.eye(3)])
        C[6:, 6:] += found.noise.gyroscope**2 / self._interval * (noise @ noise.T)
        return C[:6, :6], C[6:, 6:]

    def _propagate(self, sample: ImuSample, dt: float) -> None:
        """Propagate to an IMU sample, with the mean of this sample and the previous one."""
        last, self._last, self._interval = self._last, sample, dt
        turning = 0.5 * (sample.angular_velocity + last.angular_velocity)
        self.filter.propagate(turning, 0.5 * (sample.specific_force + last.specific_force), dt)
        self._turned += dt * (turning - self._bias)
        if self._rolling.names:
            self._roll_balls(dt)

    def _roll_balls(self, dt: float) -> None:
        found, legs = self.filter, self._kinematics
        R = found.rotation @ legs.imu_rotation.T
        omega = legs.imu_rotation @ (self._last.angular_velocity - found.gyroscope_bias) - legs.imu_motion[3:]
        self._rolling.turn((omega + legs.sight(self._rolling.names).turning) @ R.T, dt)

    def _correct_by_contacts(self, holding: Sequence[str]) -> None:
        """Correct by the active contacts; exclude those that contradict the estimate."""
        found, legs = self.filter, self._kinematics
        for name in [name for name, points in legs.points.items() if points[0] in found.names and name not in holding]:
            self._remove_contact(name)
        known = tuple(name for name in holding if legs.points[name][0] in found.names)
        slipping: list[str] = []
        if known:
            good = self._corrected(known)
            if not all_true(good):
                slipping = [name for name, holds in zip(known, good, strict=True) if not holds]
                rest = tuple(name for name in known if name not in slipping)
                if rest:
                    self._corrected(rest)
        for name in slipping:
            self._remove_contact(name)
        if len(known) == len(holding) and not (slipping or self._moving):
            return
        alone = not found.names  # the IMU alone drifts
        self._moving = {name: seen for name, seen in self._moving.items() if name in holding and not alone}
        for name in holding:
            if name in slipping or name not in known:
                sight = legs.sight((name,))
                if name in slipping and not alone:
                    self._moving[name] = (self.stamp, self._points_of(sight))
                elif self._is_at_rest(name, sight):
                    self._add_contact(name, sight)

    def _corrected(self, contacts: tuple[str, ...]) -> np.ndarray:
        """Correct by some contacts unless one contradicts; return a flag per contact that agrees."""
        found, sight = self.filter, self._kinematics.sight(contacts)
        limits, places = np.array([self._largest_square[name] for name in contacts]), sight.places
        if self._rolling.names:  # positions of the balls' centres without their rolling
            places = places - self._rolling.of(contacts, sight.ends) @ found.rotation
        return found.correct(sight.names, places, sight.covariance, ends=sight.ends, limits=limits) <= limits

    def _points_of(self, sight: Sight) -> Array:
        """Return the points of a contact in the filter's world, (k, 3) in m."""
        return np.asarray(sight.places @ self.filter.rotation.T + self.filter.position)

    def _is_at_rest(self, name: str, sight: Sight) -> bool:
        """Return whether a contact is at rest, and end its exclusion."""
        if name not in self._moving:
            return True
        since, there = self._moving[name]
        here = self._points_of(sight)
        if np.abs(here - there).max() > _MOVED:
            self._moving[name] = (self.stamp, here)
        elif self.stamp - since >= _RESTED:
            del self._moving[name]
        return name not in self._moving

    def _add_contact(self, name: str, sight: Sight) -> None:
        for i, point in enumerate(sight.names):
            self.filter.add(point, sight.places[i], sight.covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3])
        self._rolling.enter(name)

    def _remove_contact(self, name: str) -> None:
        for point in self._kinematics.points[name]:
            self.filter.remove(point)
        self._rolling.leave(name)
        self._anchoring.release(name)
