"""Estimator of base pose and twist."""

from collections.abc import Collection, Sequence

import numpy as np
import pinocchio as pin

from wbc_controller.estimation.absolute_pose import AbsolutePoses, PoseSample
from wbc_controller.estimation.invariant_filter import InvariantFilter
from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.estimation.running_estimate import GAP, ImuSample, RunningEstimate
from wbc_controller.estimation.sensor_agreement import gravity_contradiction
from wbc_controller.records import Array
from wbc_controller.settings.estimation import EstimationSettings

_GRAVITY_TOLERANCE = 0.1  # largest relative difference of specific force and gravity
_LARGEST_BIAS = 0.5  # largest mean angular velocity at the start, rad/s
_SETTLED = 0.9  # share of the settling time that the samples must span
_INITIAL_VELOCITY_VARIANCE = 1.0e-4  # variance of the initial velocity, (m/s)²
_INITIAL_POSE_VARIANCE = 1.0e-8  # variance of the initial position and heading, m² and rad²


class BaseEstimator:
    """Estimator of the base from an IMU and the active contacts, with an `InvariantFilter`.

    At the start the robot rests: the mean specific force is gravity, the mean angular velocity the gyroscope's bias.
    The world begins below the base with its heading, and drifts (`anchoring`) without absolute poses (`absolute_pose`).
    Contradicting contacts are excluded until they rest.

    The estimate is `lost` and restarts at rest if all contacts move (`consistency`), the gyroscope contradicts the legs
    (`sensor_agreement`), the IMU is silent, or the state is not finite.
    """

    def __init__(
        self, kinematics: LegKinematics, settings: EstimationSettings, gravity: Array, pose_frame: str | None = None
    ) -> None:
        """Start without data; gravity is in the world, (3,) in m/s². `pose_frame` is the frame of absolute poses."""
        self._pose_frame = None if pose_frame is None else kinematics.frame(pose_frame, "estimation.pose_frame")
        self.imu_frame, self.uses_poses = kinematics.imu_frame, pose_frame is not None
        self._kinematics, self._settings, self._gravity = kinematics, settings, gravity
        self.restart()

    @property
    def waits_for(self) -> str:
        """Reason for a missing estimate, or empty."""
        return f"the base estimate was lost: {self.lost}; {self._waits_for}" if self.lost else self._waits_for

    @property
    def slipping(self) -> tuple[str, ...]:
        """Names of the contacts excluded due to slip."""
        return tuple(self._running.moving) if self._running is not None else ()

    @property
    def base(self) -> tuple[Array, Array] | None:
        """Pose, (7,), and twist in base axes, (6,); None without an estimate.

        The world is the frame of `anchoring`, or the smoothed world of absolute poses.
        """
        if self._running is None or self.poses is None:
            return self.odometry
        return self._running.base(self.poses.smoothed) if self.poses.aligned else None

    @property
    def odometry(self) -> tuple[Array, Array] | None:
        """Pose and twist in a world that no absolute pose moves."""
        return self._running.base(self._running.odometry) if self._running is not None else None

    @property
    def stamp(self) -> float:
        """Stamp of the newest sample in the estimate, s; -inf without an estimate."""
        return self._running.stamp if self._running is not None else -np.inf

    @property
    def covariance(self) -> tuple[Array, Array] | None:
        """Covariances of `odometry`: pose in its world's axes, twist in base axes, (6, 6) each."""
        if self._running is None:
            return None
        of_pose, of_twist = self._running.covariance()
        turn = np.kron(np.eye(2), self._running.odometry.rotation)
        return turn @ of_pose @ turn.T, of_twist

    def restart(self) -> None:
        """Discard the estimate and wait for standstill."""
        self._running: RunningEstimate | None = None
        self.filter: InvariantFilter | None = None  # before the robot was at rest
        self.poses: AbsolutePoses | None = None  # correction by absolute poses
        self._still: list[ImuSample] = []
        self.lost, self._waits_for = "", "no IMU data received"

    def update(
        self, samples: Sequence[ImuSample], q: Array, v: Array, active: Collection[str], *, walking: bool = False
    ) -> None:
        """Process IMU samples by increasing stamp, with q and v of the joints, (nj,) each, and the active contacts.

        If the robot is `walking`, larger velocities of all contacts are tolerated.
        """
        self._kinematics.update(q, v)
        active = tuple(name for name in self._kinematics.points if name in active)
        if self._running is None:
            self._wait_for_rest(samples, active)
            return
        self._after_update(self._running.update(samples, active, walking=walking))

    def correct(self, samples: list[PoseSample], *, controlled: bool) -> list[str]:
        """Correct the estimate by absolute poses (`AbsolutePoses.correct`), after `update`."""
        if self._running is None or self.poses is None:
            return []
        refused: list[str] = []
        try:
            refused, lost = self.poses.correct(samples, controlled=controlled), self._running.invalid_reason()
        except np.linalg.LinAlgError as error:
            lost = str(error)
        self._after_update(lost)
        return refused

    def _after_update(self, lost: str | None) -> None:
        if lost is not None:
            self.restart()
            self.lost, self._waits_for = lost, f"the robot has to stand still for {self._settings.settling:g} s"
        elif self.poses is not None:
            self._waits_for = self.poses.waits_for

    def _wait_for_rest(self, samples: Sequence[ImuSample], active_contacts: tuple[str, ...]) -> None:
        settings = self._settings
        if self._still and samples and not (0.0 < samples[0].stamp - self._still[-1].stamp <= GAP):
            self._still = []
        self._still += samples
        if not self._still:
            return
        newest = self._still[-1].stamp
        self._still = [sample for sample in self._still if newest - sample.stamp <= settings.settling]
        if newest - self._still[0].stamp < _SETTLED * settings.settling:
            self._waits_for = f"the robot has to stand still for {settings.settling:g} s"
            return
        turning = np.array([sample.angular_velocity for sample in self._still])
        force = np.array([sample.specific_force for sample in self._still])
        wobble, pull = float(turning.std(axis=0).max()), float(np.linalg.norm(force.mean(axis=0)))
        turn = float(np.linalg.norm(turning.mean(axis=0)))
        gravity = float(np.linalg.norm(self._gravity))
        if not wobble <= settings.stillness:
            self._waits_for = (
                f"the robot has to stand still for {settings.settling:g} s: its angular velocity varies by "
                f"{wobble:.3g} rad/s (limit {settings.stillness:g}, estimation.stillness)"
            )
            if wobble <= np.degrees(settings.stillness):
                self._waits_for += "; possible cause: a gyroscope in deg/s instead of rad/s"
        elif not turn <= _LARGEST_BIAS:
            self._waits_for = (
                f"the IMU turns at {turn:.3g} rad/s (limit {_LARGEST_BIAS:g}): the robot moves, or the gyroscope fails"
            )
        elif not abs(pull - gravity) <= _GRAVITY_TOLERANCE * gravity:
            self._waits_for = (
                f"the IMU measures {pull:.3g} m/s² at rest, but gravity is {gravity:.3g} m/s²: wrong unit, or faulty "
                "accelerometer"
            )
        elif not active_contacts:
            self._waits_for = (
                "no usable contact is active; wheels and contacts between two links of the robot are not used"
            )
        elif contradiction := gravity_contradiction(self._kinematics, active_contacts, force.mean(axis=0) / pull):
            self._waits_for = f"the accelerometer contradicts the legs: {contradiction}"
        else:
            self.filter = self._initial_filter(turning.mean(axis=0), force.mean(axis=0), active_contacts)
            if self._pose_frame is not None:
                self.poses = AbsolutePoses(self._pose_frame, self._kinematics, self.filter)
            self._running = RunningEstimate(self.filter, self._still[-1], self._kinematics, self.poses)
            self._still, self.lost, self._waits_for = [], "", ""
            self._after_update(self._running.update([], active_contacts))

    def _initial_filter(self, turning: Array, force: Array, active_contacts: Sequence[str]) -> InvariantFilter:
        settings, legs = self._settings, self._kinematics
        up = force / np.linalg.norm(force)
        across = np.cross(up, legs.imu_rotation[0])  # the world's x axis is the levelled x axis of the base
        across /= np.linalg.norm(across)
        R = np.vstack([np.cross(across, up), across, up])
        heights = [
            legs.contact_points((name,)).positions @ R[2] - legs.rolling.get(name, np.zeros(3))[2]
            for name in active_contacts
        ]  # fmt: skip
        level, height = R @ legs.imu_rotation.T @ legs.imu_position, float(np.concatenate(heights).mean())
        g = float(np.linalg.norm(self._gravity))
        rest, bias = settings.settling, settings.accelerometer_bias**2
        mean = settings.gyroscope_noise**2 / rest + settings.gyroscope_bias_walk**2 * rest
        at_rest = [_INITIAL_POSE_VARIANCE, _INITIAL_VELOCITY_VARIANCE, _INITIAL_POSE_VARIANCE]
        P = np.diag(np.repeat([*at_rest, mean, bias], 3))
        # The accelerometer's bias appears as a tilt, g ξ_R = up × R ζ_a: both errors are fully correlated.
        tilting = pin.skew(np.array([0.0, 0.0, 1.0 / g])) @ R
        P[:3, 12:15] = bias * tilting
        P[12:15, :3] = P[:3, 12:15].T
        P[:3, :3] += (bias + settings.accelerometer_noise**2 / rest) * (tilting @ tilting.T)
        return InvariantFilter(
            settings, self._gravity, rotation=R, velocity=np.zeros(3), position=np.array([level[0], level[1], -height]),
            gyroscope_bias=turning, accelerometer_bias=np.zeros(3), P=P,
        )  # fmt: skip
