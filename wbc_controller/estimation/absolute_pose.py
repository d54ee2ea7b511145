"""Correction of the base by absolute poses of a frame F.

A pose from time t is y = p_F + n and Y = exp(n_R) R_F. With the filter's error X̂ X⁻¹ = exp(ξ), to first order

    z = (y - p̂_F, heading of Y R̂_Fᵀ) = -H ξ + n        H = | -p̂_Fₓ  0  I  0 |        columns ξ_R, ξ_v, ξ_p, others
                                                         |   zᵀ    0  0  0 |

**Latency.** The correction X ← T X rotates the world about gravity and translates it. Dynamics and contacts preserve
such a ξ, so that z of time t corrects the present estimate; n grows by creep and gyroscope noise since t.

**Jumps.** Planar transforms map the filter's world to `odometry`, which no correction moves, and to `smoothed`, which
follows at a bounded rate.
"""

import bisect
import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.special import chdtri

from wbc_controller.estimation.invariant_filter import InvariantFilter
from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.inverse_dynamics.arrays import solved
from wbc_controller.inverse_dynamics.robot.orientation import heading_of, planar_transform, rotation_of
from wbc_controller.records import Array

HISTORY = 0.5  # age of the oldest stored estimate, s; older poses are refused
LARGEST_ADVANCE = 0.1  # largest advance of a pose's stamp over the IMU's, s
_MOST_WAITING = 20  # largest number of poses that wait for the IMU
_FALSE_REJECTION = 1.0e-5  # probability of rejecting a correct pose
_GATE = float(chdtri(4, _FALSE_REJECTION))
AGREEMENT_TIME = 1.0  # duration of consistent poses after which they replace the estimate, s
_ALIKE = 0.1  # largest difference between consistent poses, m and rad
_TIME_CONSTANT, SPEED, TURN = 0.2, 0.02, 0.02  # time constant of `smoothed`, s, and its largest rates, m/s and rad/s


@dataclass(frozen=True, slots=True)
class PoseSample:
    """Absolute pose."""

    stamp: float  # s, on the IMU's clock
    pose: Array  # position in m and quaternion x, y, z, w, (7,)
    covariance: Array  # in world axes, (6, 6) in m² and rad²


class _PastEstimate(NamedTuple):
    """Past estimate: stamp, and frame F in the world `odometry`."""

    stamp: float
    frame: pin.SE3


class AbsolutePoses:
    """Correction of a filter by absolute poses.

    Poses that agree for `AGREEMENT_TIME` define the world (`aligned`). Later outliers are rejected by a χ² gate. If
    they agree with each other for that time (relocalization), the world moves to them, unless the robot is under
    control. `odometry` and `smoothed` transform from the filter's world.
    """

    def __init__(self, frame: tuple[int, pin.SE3], kinematics: LegKinematics, filter: InvariantFilter) -> None:
        """Start without poses; `frame` is the measured frame of the robot (`LegKinematics.frame`)."""
        self.aligned = False
        self.odometry, self.smoothed = pin.SE3.Identity(), pin.SE3.Identity()
        self.used = self.rejected = self.relocations = 0
        self.contradiction = ""
        self._kinematics, self._filter, self._frame = kinematics, filter, frame
        own = filter.settings
        self._least_variances = np.repeat([own.pose_noise, own.pose_turn_noise], [3, 1]) ** 2
        self._creep = np.repeat([own.contact_noise, own.gyroscope_noise], [3, 1]) ** 2
        self._past: deque[_PastEstimate] = deque()
        self._first_stamp = math.inf
        self._contradicting: tuple[float, Array] | None = None  # stamp and difference of the first contradicting pose
        self._waiting: deque[PoseSample] = deque(maxlen=_MOST_WAITING)

    @property
    def values(self) -> dict[str, str]:
        """Counters for diagnostics."""
        turn, position = heading_of(self.smoothed), self._filter.position
        shift = float(np.linalg.norm(self.smoothed.act(position) - position))
        return {
            "pose/taken": str(self.used),
            "pose/left out": f"{self.rejected}, as they contradict the estimate",
            "pose/world moved": f"{self.relocations} times",
            "pose/still to be followed": f"{shift:.4f} m, {abs(turn):.4f} rad",
        } | ({"pose/contradiction": self.contradiction} if self.contradiction else {})

    @property
    def map_to_odometry(self) -> Array:
        """Pose of the world `odometry` in the world of the poses, (7,)."""
        return np.array(pin.SE3ToXYZQUAT(self.odometry.inverse()))

    @property
    def waits_for(self) -> str:
        """Reason of a missing alignment, or empty."""
        if self.aligned:
            return ""
        if self._contradicting is None:
            return "no absolute pose received (estimation.absolute_pose)"
        return f"the absolute poses must agree for {AGREEMENT_TIME:g} s"

    def update(self, stamp: float) -> None:
        """Store the present estimate, and move `smoothed` towards it."""
        past, found = self._past, self._filter
        if past and self.smoothed != pin.SE3.Identity():
            self._smooth(stamp - past[-1].stamp)
        if past and past[-1].stamp == stamp:
            past.pop()
        imu = pin.SE3(found.rotation, found.position)
        past.append(_PastEstimate(stamp, self.odometry * imu * self._kinematics.from_imu(*self._frame)))
        self._first_stamp = min(self._first_stamp, stamp)
        while stamp - past[0].stamp > HISTORY:
            past.popleft()

    def _smooth(self, dt: float) -> None:
        position, heading = self._filter.position, heading_of(self.smoothed)
        at = self.smoothed.act(position)
        far, share = float(np.linalg.norm(position - at)), min(1.0, dt / _TIME_CONSTANT)
        step = min(share, SPEED * dt / far) if far > 0.0 else share
        heading -= max(-TURN * dt, min(TURN * dt, share * heading))
        self.smoothed = planar_transform(heading, position, at + step * (position - at))

    def correct(self, samples: list[PoseSample], *, controlled: bool) -> list[str]:
        """Correct the filter by poses up to the IMU's stamp, and return the refusals; newer ones wait.

        If `controlled`, contradicting poses do not move the world.
        """
        refused, newest = [], self._past[-1].stamp
        for sample in samples:
            if sample.stamp - newest > LARGEST_ADVANCE:
                refused.append(
                    f"header.stamp is {sample.stamp - newest:.3f} s ahead of the IMU's (limit {LARGEST_ADVANCE:g} s): "
                    "both sensors must use the same clock"
                )
            else:
                self._waiting.append(sample)
        ready = [sample for sample in self._waiting if sample.stamp <= newest]
        self._waiting = deque((sample for sample in self._waiting if sample.stamp > newest), _MOST_WAITING)
        for sample in ready:
            if sample.stamp >= self._past[0].stamp:
                refused.append(self._correct(sample, controlled=controlled))
            elif sample.stamp >= self._first_stamp:
                refused.append(f"header.stamp is {newest - sample.stamp:.3f} s before the IMU's (limit {HISTORY:g} s)")
        return [reason for reason in refused if reason]

    def frame_at(self, stamp: float) -> pin.SE3:
        """Return frame F at a past stamp, in the present world."""
        after = bisect.bisect_left(self._past, stamp, key=lambda past: past.stamp)
        end, frame = self._past[after]
        if end > stamp:
            start, before = self._past[after - 1]
            frame = pin.SE3.Interpolate(before, frame, (stamp - start) / (end - start))
        return self.odometry.actInv(frame)

    def innovation(self, sample: PoseSample) -> tuple[Array, Array, Array, Array]:
        """Return z, (4,) in m and rad; H, (4, n); the noise covariance, (4, 4); p̂_F, (3,) in m, at the pose's stamp."""
        frame, Y = self.frame_at(sample.stamp), rotation_of(sample.pose[3:])
        R, p = frame.rotation, frame.translation
        turn = Y @ R.T
        z = np.append(sample.pose[:3] - p, math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
        H = np.zeros((4, len(self._filter.P)))
        H[:3, :3], H[:3, 6:9], H[3, 2] = -pin.skew(p), np.eye(3), 1.0
        noise = sample.covariance[np.ix_([0, 1, 2, 5], [0, 1, 2, 5])].copy()
        known = np.maximum(noise.diagonal(), self._least_variances)
        noise[np.diag_indices(4)] = known + (self._past[-1].stamp - sample.stamp) * self._creep
        return z, H, noise, p

    def _correct(self, sample: PoseSample, *, controlled: bool) -> str:
        found = self._filter
        z, H, noise, p = self.innovation(sample)
        S = H @ found.P @ H.T + noise
        if self.aligned and z @ solved(S, z) <= _GATE:
            undo = found.correct_world(H, z, noise, p).inverse()
            self.odometry, self.smoothed = self.odometry * undo, self.smoothed * undo
            self.used += 1
            self._contradicting, self.contradiction = None, ""
            return ""
        return self._contradicted(sample, z, p, noise, controlled=controlled and self.aligned)

    def _contradicted(self, sample: PoseSample, z: Array, p: Array, noise: Array, *, controlled: bool) -> str:
        """Reject a pose; move the world after consistent contradictions."""
        first = self._contradicting is None
        if self._contradicting is None or not (np.abs(z - self._contradicting[1]) <= _ALIKE).all():
            self._contradicting = sample.stamp, z
        lasted = sample.stamp - self._contradicting[0]
        by = f"by {math.hypot(*z[:3].tolist()):.3f} m and {abs(z[3]):.3f} rad"
        if self.aligned:
            self.rejected += 1
        if not lasted >= AGREEMENT_TIME:
            return f"the pose contradicts the estimate {by} and is rejected" if first and self.aligned else ""
        if controlled:
            before = self.contradiction
            self.contradiction = (
                f"poses have contradicted the estimate {by} for {lasted:.1f} s: they are rejected while the "
                "controller is active; after the deactivation the world moves to them"
            )
            return "" if before else self.contradiction
        move = planar_transform(float(z[3]), p, sample.pose[:3])
        self._filter.move(move, sample.pose[:3], noise)
        self.odometry, self.smoothed = self.odometry * move.inverse(), pin.SE3.Identity()
        self.relocations += self.aligned
        self.aligned, self._contradicting, self.contradiction = True, None, ""
        return ""
