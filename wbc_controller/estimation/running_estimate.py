"""Started base estimate: propagation by the IMU, and corrections by the active contacts."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.special import chdtri

from wbc_controller.estimation.absolute_pose import AbsolutePoses
from wbc_controller.estimation.anchoring import Anchoring
from wbc_controller.estimation.consistency import LIMIT, WALKING_LIMIT, ContactConsistency
from wbc_controller.estimation.invariant_filter import InvariantFilter
from wbc_controller.estimation.leg_kinematics import ContactPoints, LegKinematics
from wbc_controller.estimation.sensor_agreement import PERIOD, SensorAgreement
from wbc_controller.inverse_dynamics.arrays import all_true, cross, sum_of_squares
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of
from wbc_controller.records import Array

GAP = 0.1  # largest gap between two IMU samples, s
_FALSE_SLIP = 1.0e-5  # probability of a false slip detection per update
_MOVED, _RESTED = 0.004, 0.04  # largest motion, m, and its duration, s, after which a slipping contact is at rest
#: Least creep of soles and of balls of a stepping robot, m/s/√Hz (impacts between IMU samples would become a tilt), and
#: the time since the last touchdown for which a robot is stepping, s.
_SOLE_STEPS, _BALL_STEPS, _STEPPING_TIME = 2.4e-3, 8.0e-4, 1.0
#: Creep of a point of a tipping sole per speed above the least one, √s, and this speed, m/s.
_TIPPING, _LEAST_TIPPING = 0.3, 0.02
_ZERO = np.zeros(3)


@dataclass(frozen=True, slots=True)
class ImuSample:
    """IMU measurement in IMU axes: stamp in s, ω (3,) in rad/s, acceleration minus gravity (3,) in m/s²."""

    stamp: float
    angular_velocity: Array
    specific_force: Array


class RunningEstimate:
    """Started filter with its contacts; `poses` is the correction by absolute poses, or None."""

    def __init__(
        self, filter: InvariantFilter, last: ImuSample, kinematics: LegKinematics, poses: AbsolutePoses | None
    ) -> None:
        self.filter, self.poses = filter, poses
        self.moving: dict[str, tuple[float, Array]] = {}  # slipping contacts: stamp and points, (k, 3) in m
        self._landed = -np.inf  # last touchdown beside another contact, s
        self._last, self._interval = last, np.inf  # last sample, and time between the last two, s
        self._kinematics, self._anchoring = kinematics, Anchoring()
        self._rolled: dict[str, Array] = {}  # displacements of the centres of active balls in the world, (3,) in m
        self._consistency = ContactConsistency(kinematics)
        self._agreement, self._agreed = SensorAgreement(kinematics, "the gyroscope", with_displacements=False), False
        self._bias = filter.gyroscope_bias
        self._turned, self._compared = np.zeros(3), last.stamp  # turn since the last comparison, rad, and its stamp
        self._largest_square = {
            name: float(chdtri(3 * len(points), _FALSE_SLIP)) for name, points in kinematics.points.items()
        }

    @property
    def stamp(self) -> float:
        """Stamp of the last sample, s."""
        return self._last.stamp

    def update(self, samples: Sequence[ImuSample], contacts: tuple[str, ...], *, walking: bool = False) -> str | None:
        """Process measurements and active contacts; return the reason for a loss of the estimate, or None."""
        before = self.stamp
        for sample in samples:
            dt = sample.stamp - self._last.stamp
            if dt > GAP:
                return f"the IMU was silent for {dt:.3f} s"
            if dt > 0.0:
                self._propagate(sample, dt)
        try:
            self._correct_by_contacts(contacts)
        except np.linalg.LinAlgError as error:
            return str(error)
        limit = WALKING_LIMIT if walking else LIMIT
        lost = self.invalid_reason() or self._check_contacts(contacts, self.stamp - before, limit)
        if lost is None and self.stamp - self._compared >= PERIOD:
            lost = self._compare_turns(contacts)
        if lost is None and self.poses is not None:
            self.poses.update(self.stamp)
        elif lost is None and self.stamp >= self._anchoring.due:
            self._anchoring.update(self.stamp, self._points())
        return lost

    def invalid_reason(self) -> str | None:
        """Return the reason for an invalid state, or None."""
        if not math.isfinite(sum_of_squares(self.filter.columns) + sum_of_squares(self.filter.P)):
            return "the state is not finite"
        return None

    def _check_contacts(self, active_contacts: tuple[str, ...], elapsed: float, limit: float) -> str | None:
        """Return a message if all contacts move faster than a limit, m/s; None if one is at rest."""
        found, contacts = self.filter, self._consistency
        omega = self._last.angular_velocity - found.gyroscope_bias
        contacts.update(active_contacts, found.rotation, found.velocity, omega, elapsed)
        if contacts.speed <= limit:
            return None
        wrong_axes = self._compare_turns(active_contacts, known_wrong=True)
        if wrong_axes is not None:
            return wrong_axes
        agree = self._agreed or self._agreement.comparison.turns_agree
        wrong = "accelerometer (the gyroscope agrees with the legs)" if agree else "IMU"
        return (
            f"the IMU contradicts all contacts ({', '.join(active_contacts)}): the slowest of them moves at "
            f"{contacts.speed:.2f} m/s (limit {limit:g} m/s); the {wrong} is wrong, or all contacts slip"
        )

    def _compare_turns(self, active_contacts: tuple[str, ...], *, known_wrong: bool = False) -> str | None:
        elapsed, self._compared = self.stamp - self._compared, self.stamp
        turned, self._turned = self._turned, np.zeros(3)
        if self._agreed or not active_contacts:
            return None
        found = self._agreement.check(elapsed, turned[None], active_contacts, known_wrong=known_wrong)
        self._agreed = found is None and self._agreement.comparison.agreed
        return found

    @property
    def odometry(self) -> pin.SE3:
        """Transform to a world that no absolute pose moves."""
        return self._anchoring.transform if self.poses is None else self.poses.odometry

    def _points(self) -> dict[str, Array]:
        found = self.filter
        positions: dict[str, list[Array]] = {}
        for i, point in enumerate(found.names):
            positions.setdefault(point.rpartition("/")[0], []).append(found.columns[:, 2 + i])
        return {name: np.array(columns) for name, columns in positions.items()}

    def base(self, to: pin.SE3) -> tuple[Array, Array]:
        """Return pose, (7,), in a transformed world of the filter, and twist in base axes, (6,)."""
        found, legs = self.filter, self._kinematics
        R = found.rotation @ legs.imu_rotation.T
        linear, angular = legs.imu_motion[:3], legs.imu_motion[3:]
        omega = legs.imu_rotation @ (self._last.angular_velocity - found.gyroscope_bias) - angular
        velocity = R.T @ found.velocity - cross(omega, legs.imu_position) - linear
        position = to.rotation @ (found.position - R @ legs.imu_position) + to.translation
        pose = np.concatenate([position, quaternion_of(to.rotation @ R)])
        return pose, np.concatenate([velocity, omega])

    def covariance(self) -> tuple[Array, Array]:
        """Return the covariances of the base's pose in world axes, and of its twist in base axes, (6, 6) each.

        To first order the base at p has the errors ξ_p - pₓ ξ_R and ξ_R, and its velocity Rᵀ ξ_v + rₓ δω, with the
        position r of the IMU and the error δω of the gyroscope.
        """
        found, legs = self.filter, self._kinematics
        P, own = found.P, list(range(9)) + list(range(len(found.P) - 6, len(found.P) - 3))
        R = found.rotation @ legs.imu_rotation.T
        arm = pin.skew(legs.imu_position)
        errors = np.zeros((12, 12))
        errors[0:3, 0:3], errors[0:3, 6:9] = -pin.skew(found.position - R @ legs.imu_position), np.eye(3)
        errors[3:6, 0:3] = np.eye(3)
        errors[6:9, 3:6], errors[6:9, 9:12] = R.T, -arm @ legs.imu_rotation
        errors[9:12, 9:12] = -legs.imu_rotation
        C = errors @ P[np.ix_(own, own)] @ errors.T
        noise = np.vstack([arm, np.eye(3)])
        C[6:, 6:] += found.settings.gyroscope_noise**2 / self._interval * (noise @ noise.T)
        return C[:6, :6], C[6:, 6:]

    def _propagate(self, sample: ImuSample, dt: float) -> None:
        last, self._last, self._interval = self._last, sample, dt
        turning = 0.5 * (sample.angular_velocity + last.angular_velocity)
        force = 0.5 * (sample.specific_force + last.specific_force)
        self.filter.propagate(turning, force, dt, self._creep(sample.stamp - self._landed < _STEPPING_TIME))
        self._turned += dt * (turning - self._bias)
        if self._rolled:
            found, legs = self.filter, self._kinematics
            omega = legs.imu_rotation @ (sample.angular_velocity - found.gyroscope_bias) - legs.imu_motion[3:]
            of_links = omega + legs.contact_points(tuple(self._rolled)).link_angular_velocities
            in_world = of_links @ legs.imu_rotation @ found.rotation.T
            for name, turning in zip(self._rolled, in_world, strict=True):
                self._rolled[name] = self._rolled[name] + dt * cross(turning, legs.rolling[name])

    def _creep(self, steps: bool) -> Array:
        """Return the noise density of each contact point of the filter, (N,) in m/s/√Hz."""
        noise, creep = self.filter.settings.contact_noise, []
        for name in dict.fromkeys(point.rpartition("/")[0] for point in self.filter.names):
            least = (_BALL_STEPS if name in self._kinematics.rolling else _SOLE_STEPS) if steps else 0.0
            excess = np.maximum(self._consistency.tipping(name) - _LEAST_TIPPING, 0.0)
            creep.append(max(noise, least) + _TIPPING * excess)
        return np.concatenate([np.empty(0), *creep])

    def _correct_by_contacts(self, active_contacts: tuple[str, ...]) -> None:
        found, legs = self.filter, self._kinematics
        held = [name for name, points in legs.points.items() if points[0] in found.names]
        for name in held:
            if name not in active_contacts:
                self._remove_contact(name)
        known = tuple(name for name in active_contacts if name in held)
        slipping: list[str] = []
        if known:
            good = self._try_correction(known)
            if not all_true(good):
                slipping = [name for name, holds in zip(known, good, strict=True) if not holds]
                rest = tuple(name for name in known if name not in slipping)
                if rest:
                    self._try_correction(rest)
        for name in slipping:
            self._remove_contact(name)
        if len(known) == len(active_contacts) and not (slipping or self.moving):
            return
        alone = not found.names  # the IMU alone drifts
        self.moving = {name: seen for name, seen in self.moving.items() if name in active_contacts and not alone}
        for name in active_contacts:
            if name in slipping or name not in known:
                contact_points = legs.contact_points((name,))
                if name in slipping and not alone:
                    self.moving[name] = (self.stamp, self._points_of(contact_points))
                    continue
                steps = name not in self.moving and not alone
                if self._is_at_rest(name, contact_points):
                    covariance = contact_points.covariance
                    for i, point in enumerate(contact_points.names):
                        own = slice(3 * i, 3 * i + 3)
                        found.add(point, contact_points.positions[i], covariance[own, own])
                    if name in legs.rolling:
                        self._rolled[name] = _ZERO
                    self._landed = self.stamp if steps else self._landed

    def _try_correction(self, contacts: tuple[str, ...]) -> np.ndarray:
        """Correct unless a contact contradicts; return a flag per consistent contact, (c,)."""
        found, legs = self.filter, self._kinematics
        seen, limits = legs.contact_points(contacts), np.array([self._largest_square[name] for name in contacts])
        positions = seen.positions
        if self._rolled:  # centres of the balls without their rolling
            rolled = [self._rolled.get(name, _ZERO) for name in contacts for _ in legs.points[name]]
            positions = positions - np.array(rolled) @ found.rotation
        return found.correct(seen.names, positions, seen.covariance, ends=seen.ends, limits=limits) <= limits

    def _points_of(self, contact_points: ContactPoints) -> Array:
        return np.asarray(contact_points.positions @ self.filter.rotation.T + self.filter.position)

    def _is_at_rest(self, name: str, contact_points: ContactPoints) -> bool:
        if name not in self.moving:
            return True
        since, there = self.moving[name]
        here = self._points_of(contact_points)
        if np.abs(here - there).max() > _MOVED:
            self.moving[name] = (self.stamp, here)
        elif self.stamp - since >= _RESTED:
            del self.moving[name]
        return name not in self.moving

    def _remove_contact(self, name: str) -> None:
        for point in self._kinematics.points[name]:
            self.filter.remove(point)
        self._rolled.pop(name, None)
        self._anchoring.release(name)
