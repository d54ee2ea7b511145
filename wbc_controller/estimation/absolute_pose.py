"""Corrections of the base filter by absolute poses of a frame of the robot, which are delayed and sometimes wrong.

A pose of frame F, measured at t, has a position y = p_F + n and an orientation Y = exp(n_R) R_F: observations of the
world, Y = X b, which are left-invariant in the terms of Hartley and others (`invariant_filter`). With the filter's
right-invariant error, X̂ X⁻¹ = exp(ξ), p̂_F = exp(ξ_R) p_F + ξ_p to first order, whatever F's place on the robot, so that

    z = (y - p̂_F, heading of Y R̂_Fᵀ) = -H ξ + n        H = | -p̂_Fₓ  0  I  0 |        columns ξ_R, ξ_v, ξ_p, others
                                                         |   zᵀ    0  0  0 |

which is R̂ times the left-invariant innovation, with its ξˡ = Ad_X̂⁻¹ ξ. Only the heading of the orientation is used:
gravity determines the tilt, and markers may be mounted askew.

**Latency.** Only the unobservable part is corrected: a rotation about gravity and a translation, transforms T of the
world, X ← T X. The filter's dynamics and contacts preserve such a ξ: Φ ξ = ξ, as g × z = 0, and H_contacts ξ = 0.
Therefore z, computed with the estimate at time t, corrects the present estimate, and no step in between is repeated.
The noise n grows by the creep of the contacts and the noise of the gyroscope since then. (With the whole gain P Hᵀ S⁻¹
a position would also correct the velocity, too late: with 0.2 s of latency this oscillates.) The velocity never jumps.

**Jumps.** The estimate is also expressed in two more worlds, each related by a `PlanarTransform`: `odometry`, which no
correction moves, and `shown`, which follows the filter at a bounded rate. Past estimates are stored in the first.
"""

from __future__ import annotations

import bisect
import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.special import chdtri

from wbc_controller.estimation.invariant_filter import InvariantFilter, hat
from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.estimation.planar_transform import IDENTITY, PlanarTransform
from wbc_controller.inverse_dynamics.arrays import solved
from wbc_controller.inverse_dynamics.robot.orientation import rotation_of
from wbc_controller.records import Array

#: Time for which past estimates are stored: an older pose is refused, s.
KEPT = 0.5
#: A stamp further ahead of the IMU's belongs to another clock, s; other poses wait for the IMU.
AHEAD = 0.1
#: Largest number of poses that wait for the IMU.
_MOST_WAITING = 20
#: Probability of rejecting a correct pose.
_OUTLIER = 1.0e-5
_GATE = float(chdtri(4, _OUTLIER))
#: Poses that contradict the estimate consistently for this long replace it, s.
AGREED = 1.0
#: Largest difference between consistent poses, m and rad.
_ALIKE = 0.1
#: Time constant of `shown`, s, and its largest rates, m/s and rad/s: below the tolerance of the plausibility checks for
#: a velocity that does not match the motion.
_FOLLOWS, SPEED, TURN = 0.2, 0.02, 0.02


@dataclass(frozen=True, slots=True)
class PoseSensor:
    """Source of absolute poses.

    Attributes:
        frame: measured frame of the robot.
        position: smallest standard deviation of a position, m.
        turn: smallest standard deviation of a heading, rad.
    """

    frame: str
    position: float
    turn: float


@dataclass(frozen=True, slots=True)
class PoseSample:
    """One absolute pose.

    Attributes:
        stamp: s, on the clock of the IMU.
        pose: position in m and quaternion x, y, z, w in the world, (7,).
        covariance: of position and turns about the world's axes, (6, 6) in m² and rad².
    """

    stamp: float
    pose: Array
    covariance: Array


class _Past(NamedTuple):
    """A past estimate: stamp, orientation and position of the IMU, the measured frame in the IMU, and `odometry`."""

    stamp: float
    rotation: Array
    position: Array
    frame: pin.SE3
    odometry: PlanarTransform


class AbsolutePoses:
    """Corrections of a filter by absolute poses.

    Poses that agree for `AGREED` define the world; before, it is the filter's own. Later poses that contradict the
    filter by more than noise are rejected. If they consistently do so for `AGREED`, as after a relocalization of a SLAM
    system, the world is moved to them, unless an active controller holds it (`held`).

    Attributes:
        aligned: True if the world is that of the poses.
        odometry: transform from the filter's world to one that no pose moves.
        shown: transform from the filter's world to one that follows it without jumps.
        taken: number of used poses.
        left_out: number of rejected poses.
        moved: number of times the world was moved to contradicting poses.
        contradiction: description of a persistent contradiction, or empty.
    """

    def __init__(self, sensor: PoseSensor, kinematics: LegKinematics, filter: InvariantFilter) -> None:
        self.aligned = False
        self.odometry = self.shown = IDENTITY
        self.taken = self.left_out = self.moved = 0
        self.contradiction = ""
        self._kinematics, self._filter = kinematics, filter
        self._frame = kinematics.frame(sensor.frame, "estimation.pose_frame")
        self._floor = np.array([sensor.position, sensor.position, sensor.position, sensor.turn]) ** 2
        noise = filter.noise
        self._creep = np.array([noise.contact, noise.contact, noise.contact, noise.gyroscope]) ** 2
        self._past: deque[_Past] = deque()
        self._begun = math.inf
        self._against: tuple[float, Array] | None = None  # stamp and difference of the first contradicting pose
        self._waiting: deque[PoseSample] = deque(maxlen=_MOST_WAITING)

    @property
    def values(self) -> dict[str, str]:
        """Counters of the poses, for diagnostics."""
        turn, shift = (
            self.shown.heading,
            math.dist(self.shown.point(*self._filter.columns[:, 1]), self._filter.columns[:, 1]),
        )
        return {
            "pose/taken": str(self.taken),
            "pose/left out": f"{self.left_out}, as they contradict the estimate",
            "pose/world moved": f"{self.moved} times",
            "pose/still to be followed": f"{shift:.4f} m, {abs(turn):.4f} rad",
        } | ({"pose/contradiction": self.contradiction} if self.contradiction else {})

    @property
    def waits_for(self) -> str:
        """Reason why the world is not yet that of the poses, or empty."""
        if self.aligned:
            return ""
        if self._against is None:
            return "no absolute pose has come (estimation.absolute_pose)"
        return f"the absolute poses have to agree for {AGREED:g} s"

    def follow(self, stamp: float) -> None:
        """Store the present estimate, and move `shown` towards it."""
        past, found = self._past, self._filter
        if past and self.shown is not IDENTITY:
            self._approach(stamp - past[-1].stamp)
        if past and past[-1].stamp == stamp:
            past.pop()
        seen = self._kinematics.from_imu(*self._frame)
        past.append(_Past(stamp, found.rotation, found.columns[:, 1], seen, self.odometry))
        self._begun = min(self._begun, stamp)
        while stamp - past[0].stamp > KEPT:
            past.popleft()

    def _approach(self, dt: float) -> None:
        x, y, z = self._filter.columns[:, 1].tolist()
        at = self.shown.point(x, y, z)
        gap = x - at[0], y - at[1], z - at[2]
        far, share = math.hypot(*gap), min(1.0, dt / _FOLLOWS)
        step = min(share, SPEED * dt / far) if far > 0.0 else share
        turn = self.shown.heading - max(-TURN * dt, min(TURN * dt, share * self.shown.heading))
        turned = PlanarTransform(turn, (0.0, 0.0, 0.0)).point(x, y, z)
        self.shown = PlanarTransform(
            turn,
            (
                at[0] + step * gap[0] - turned[0],
                at[1] + step * gap[1] - turned[1],
                at[2] + step * gap[2] - turned[2],
            ),
        )

    def take(self, samples: list[PoseSample], *, held: bool) -> list[str]:
        """Correct the filter by each pose that is not newer than the IMU; the others wait.

        Args:
            samples: received poses.
            held: True if the world must not be moved to contradicting poses.

        Returns:
            A sentence per refusal; a single one for consecutive contradicting poses.

        Raises:
            LinAlgError: if the covariance is not positive definite.
        """
        refused, newest = [], self._past[-1].stamp
        for sample in samples:
            if sample.stamp - newest > AHEAD:
                refused.append(
                    f"header.stamp is {sample.stamp - newest:.3f} s ahead of the IMU's (limit {AHEAD:g} s): both have "
                    "to be of the same clock"
                )
            else:
                self._waiting.append(sample)
        waiting = list(self._waiting)
        self._waiting.clear()
        for sample in waiting:
            if sample.stamp > newest:
                self._waiting.append(sample)
            elif sample.stamp < self._past[0].stamp:
                if sample.stamp >= self._begun:
                    refused.append(
                        f"header.stamp is {newest - sample.stamp:.3f} s before the IMU's; estimates are kept for "
                        f"{KEPT:g} s"
                    )
            else:
                reason = self._correct(sample, held=held)
                if reason:
                    refused.append(reason)
        return refused

    def seen(self, stamp: float) -> tuple[Array, Array]:
        """Return the measured frame of a past estimate in the present world.

        Returns:
            Its orientation, (3, 3), and position, (3,) in m.
        """
        after = bisect.bisect_left(self._past, stamp, key=lambda past: past.stamp)
        later = self._past[after]
        placed = _placed(later)
        if later.stamp > stamp:
            earlier = self._past[after - 1]
            share = (stamp - earlier.stamp) / (later.stamp - earlier.stamp)
            placed = pin.SE3.Interpolate(_placed(earlier), placed, share)
        back = self.odometry.inverse()
        return back.rotation @ placed.rotation, np.array(back.point(*placed.translation.tolist()))

    def innovation(self, sample: PoseSample) -> tuple[Array, Array, Array, Array]:
        """Compute the innovation of a pose against the estimate at its time.

        Returns:
            z, (4,) in m and rad; H, (4, n); the covariance of its noise, (4, 4); and p̂_F, (3,) in m.
        """
        R, p = self.seen(sample.stamp)
        Y = rotation_of(sample.pose[3:])
        z = np.append(sample.pose[:3] - p, _heading(Y @ R.T))
        H = np.zeros((4, len(self._filter.P)))
        H[:3, :3], H[:3, 6:9], H[3, 2] = -hat(p), np.eye(3), 1.0
        noise = sample.covariance[np.ix_([0, 1, 2, 5], [0, 1, 2, 5])].copy()
        known = np.maximum(noise.diagonal(), self._floor)
        noise[np.diag_indices(4)] = known + (self._past[-1].stamp - sample.stamp) * self._creep
        return z, H, noise, p

    def _correct(self, sample: PoseSample, *, held: bool) -> str:
        """Use one pose; return the reason of a rejection, the first time."""
        found = self._filter
        z, H, noise, p = self.innovation(sample)
        S = H @ found.P @ H.T + noise
        if self.aligned and z @ solved(S, z) <= _GATE:
            turn, shift = found.correct_world(H, z, noise, p)
            undo = PlanarTransform(turn, (float(shift[0]), float(shift[1]), float(shift[2]))).inverse()
            self.odometry, self.shown = self.odometry.compose(undo), self.shown.compose(undo)
            self.taken += 1
            self._against, self.contradiction = None, ""
            return ""
        return self._contradicted(sample, z, p, noise, held=held and self.aligned)

    def _contradicted(self, sample: PoseSample, z: Array, p: Array, noise: Array, *, held: bool) -> str:
        """Reject a pose; after consistent contradictions, move the world to them."""
        first = self._against is None
        if self._against is None or not (np.abs(z - self._against[1]) <= _ALIKE).all():
            self._against = sample.stamp, z
        lasted = sample.stamp - self._against[0]
        by = f"by {math.hypot(*z[:3].tolist()):.3f} m and {abs(z[3]):.3f} rad"
        if self.aligned:
            self.left_out += 1
        if not lasted >= AGREED:
            return f"the pose contradicts the estimate {by}, and is left out" if first and self.aligned else ""
        if held:
            said = self.contradiction
            self.contradiction = (
                f"poses have contradicted the estimate {by} for {lasted:.1f} s: they are left out as long as the "
                "controller is active, and the world is moved to them once it is not"
            )
            return "" if said else self.contradiction
        move = PlanarTransform.mapping(p, sample.pose[:3], float(z[3]))
        self._filter.move(move.rotation, np.array(move.translation), sample.pose[:3], noise)
        self.odometry, self.shown = self.odometry.compose(move.inverse()), IDENTITY
        self.moved += self.aligned
        self.aligned, self._against, self.contradiction = True, None, ""
        return ""


def _placed(past: _Past) -> pin.SE3:
    """Return the measured frame of a past estimate in the world of odometry."""
    imu = pin.SE3(past.odometry.rotation @ past.rotation, np.array(past.odometry.point(*past.position.tolist())))
    return imu * past.frame


def _heading(R: Array) -> float:
    """Return the heading of a rotation (its twist about z), rad."""
    return math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
