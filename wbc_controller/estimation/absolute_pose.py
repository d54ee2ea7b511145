"""Absolute poses of a frame of the robot, late and at times wrong, for the filter that estimates the base.

A pose of frame F, measured at t, has a position y = p_F + n and an orientation Y = exp(n_R) R_F: observations of the
world, Y = X b, which are left-invariant in the terms of Hartley and others (`invariant_filter`). With the filter's
right-invariant error, X̂ X⁻¹ = exp(ξ), p̂_F = exp(ξ_R) p_F + ξ_p to first order, whatever F's place on the robot, so that

    z = (y - p̂_F, heading of Y R̂_Fᵀ) = -H ξ + n        H = | -p̂_Fₓ  0  I  0 |        columns ξ_R, ξ_v, ξ_p, others
                                                         |   zᵀ    0  0  0 |

which is R̂ times the left-invariant innovation, with its ξˡ = Ad_X̂⁻¹ ξ. Of the orientation the heading alone is taken:
gravity tells the tilt, and markers that are mounted askew must not.

**Latency.** Only what nothing else observes is corrected: a turn about gravity and a shift of everything, motions T of
the world, X ← T X. The filter's dynamics and its contacts leave such a ξ as it is: Φ ξ = ξ, as g × z = 0, and
H_contacts ξ = 0. So z, from the estimate of the time t, corrects the present one, and no step in between is made again.
The noise n grows by what the contacts may have crept since, and by the noise of the gyroscope. (With the whole gain
P Hᵀ S⁻¹ a position would correct the velocity as well, too late: at 0.2 s that oscillates.) The velocity never jumps.

**Jumps.** The estimate then lives in two more worlds, each of them a turn and a shift (`Move`) away: `odometry`, which
no correction moves, and `shown`, which follows the filter at a bounded rate. Earlier estimates are kept in the first.
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

from wbc_controller.estimation.frame_transform import HERE, Move
from wbc_controller.estimation.invariant_filter import InvariantFilter, hat
from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.inverse_dynamics.arrays import solved
from wbc_controller.inverse_dynamics.robot.orientation import rotation_of
from wbc_controller.records import Array

#: Time for which estimates are kept: a pose that is older is refused, s.
KEPT = 0.5
#: A stamp further ahead of the IMU's is of another clock, s; nearer ones wait for the IMU.
AHEAD = 0.1
#: Poses that wait for the IMU, at most.
_MOST_WAITING = 20
#: Probability with which a pose that is right is taken for wrong.
_OUTLIER = 1.0e-5
_GATE = float(chdtri(4, _OUTLIER))
#: Poses that contradict the estimate alike for this long are right, and the estimate is wrong, s.
AGREED = 1.0
#: How far those may be from each other, m and rad.
_ALIKE = 0.1
#: `shown` follows with this time constant, s, and at most so fast, m/s and rad/s: what is seen of it is below what
#: plausibility bears of a velocity that does not fit.
_FOLLOWS, SPEED, TURN = 0.2, 0.02, 0.02


@dataclass(frozen=True, slots=True)
class PoseSensor:
    """Where absolute poses come from.

    Attributes:
        frame: of the robot, whose poses they are.
        position: least standard deviation of a position, m.
        turn: least standard deviation of a heading, rad.
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
    """An estimate: its stamp, orientation and position of the IMU, the frame from there, and how to get to odometry."""

    stamp: float
    rotation: Array
    position: Array
    frame: pin.SE3
    odometry: Move


class AbsolutePoses:
    """Corrects a filter by absolute poses.

    Poses that agree for `AGREED` begin the world: until then it is the filter's own. Later ones that contradict the
    filter by more than noise can are left out; where they agree for as long that it is elsewhere, as after the
    relocalization of a SLAM system, the world is moved to them, unless it is `held` by a controller that is active.

    Attributes:
        aligned: whether the world is that of the poses.
        odometry: from the filter's world to one that no pose moves.
        shown: from the filter's world to one that follows it without jumps.
        taken: number of poses that were used.
        left_out: number of poses that contradicted.
        moved: how often the world was moved to poses that contradicted.
        contradiction: what is wrong with the poses for a whole while; empty where nothing is.
    """

    def __init__(self, sensor: PoseSensor, kinematics: LegKinematics, filter: InvariantFilter) -> None:
        self.aligned = False
        self.odometry = self.shown = HERE
        self.taken = self.left_out = self.moved = 0
        self.contradiction = ""
        self._kinematics, self._filter = kinematics, filter
        self._frame = kinematics.frame(sensor.frame, "estimation.pose_frame")
        self._floor = np.array([sensor.position, sensor.position, sensor.position, sensor.turn]) ** 2
        noise = filter.noise
        self._creep = np.array([noise.contact, noise.contact, noise.contact, noise.gyroscope]) ** 2
        self._past: deque[_Past] = deque()
        self._begun = math.inf
        self._against: tuple[float, Array] | None = None  # since when poses contradict, and by what at first
        self._waiting: deque[PoseSample] = deque(maxlen=_MOST_WAITING)

    @property
    def values(self) -> dict[str, str]:
        """What became of the poses, for diagnostics."""
        turn, shift = self.shown.turn, math.dist(self.shown.of(*self._filter.columns[:, 1]), self._filter.columns[:, 1])
        return {
            "pose/taken": str(self.taken),
            "pose/left out": f"{self.left_out}, as they contradict the estimate",
            "pose/world moved": f"{self.moved} times",
            "pose/still to be followed": f"{shift:.4f} m, {abs(turn):.4f} rad",
        } | ({"pose/contradiction": self.contradiction} if self.contradiction else {})

    @property
    def waits_for(self) -> str:
        """Why the world is not that of the poses; empty where it is."""
        if self.aligned:
            return ""
        if self._against is None:
            return "no absolute pose has come (estimation.absolute_pose)"
        return f"the absolute poses have to agree for {AGREED:g} s"

    def follow(self, stamp: float) -> None:
        """Keep the present estimate, and bring what is shown nearer to it."""
        past, found = self._past, self._filter
        if past and self.shown is not HERE:
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
        at = self.shown.of(x, y, z)
        gap = x - at[0], y - at[1], z - at[2]
        far, share = math.hypot(*gap), min(1.0, dt / _FOLLOWS)
        step = min(share, SPEED * dt / far) if far > 0.0 else share
        turn = self.shown.turn - max(-TURN * dt, min(TURN * dt, share * self.shown.turn))
        turned = Move(turn, (0.0, 0.0, 0.0)).of(x, y, z)
        self.shown = Move(
            turn,
            (
                at[0] + step * gap[0] - turned[0],
                at[1] + step * gap[1] - turned[1],
                at[2] + step * gap[2] - turned[2],
            ),
        )

    def take(self, samples: list[PoseSample], *, held: bool) -> list[str]:
        """Correct the filter, once per pose that the IMU has reached; the others wait.

        Args:
            samples: poses that have come.
            held: whether the world must not be moved to poses that contradict.

        Returns:
            A sentence for what is refused; one alone for poses that contradict one after the other.

        Raises:
            LinAlgError: where the covariance is lost.
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
        """Where the estimate of a time that is kept has the frame, in the present world.

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
        back = self.odometry.back()
        return back.rotation @ placed.rotation, np.array(back.of(*placed.translation.tolist()))

    def innovation(self, sample: PoseSample) -> tuple[Array, Array, Array, Array]:
        """What a pose contradicts the estimate of its time by.

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
        """Take one pose; why it is left out, where that has not been said."""
        found = self._filter
        z, H, noise, p = self.innovation(sample)
        S = H @ found.P @ H.T + noise
        if self.aligned and z @ solved(S, z) <= _GATE:
            turn, shift = found.correct_world(H, z, noise, p)
            undo = Move(turn, (float(shift[0]), float(shift[1]), float(shift[2]))).back()
            self.odometry, self.shown = self.odometry.after(undo), self.shown.after(undo)
            self.taken += 1
            self._against, self.contradiction = None, ""
            return ""
        return self._contradicted(sample, z, p, noise, held=held and self.aligned)

    def _contradicted(self, sample: PoseSample, z: Array, p: Array, noise: Array, *, held: bool) -> str:
        """Leave a pose out; where poses agree for a while, move the world to them."""
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
        move = Move.taking(p, sample.pose[:3], float(z[3]))
        self._filter.move(move.rotation, np.array(move.shift), sample.pose[:3], noise)
        self.odometry, self.shown = self.odometry.after(move.back()), HERE
        self.moved += self.aligned
        self.aligned, self._against, self.contradiction = True, None, ""
        return ""


def _placed(past: _Past) -> pin.SE3:
    """The frame of a past estimate in the world of odometry."""
    imu = pin.SE3(past.odometry.rotation @ past.rotation, np.array(past.odometry.of(*past.position.tolist())))
    return imu * past.frame


def _heading(R: Array) -> float:
    """The turn about z of a rotation that else tilts: its twist about z, rad."""
    return math.atan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
