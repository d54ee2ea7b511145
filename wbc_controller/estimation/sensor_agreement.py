"""Agreement of the base's sensors with the legs.

If the contacts hold, a rotation θ and a displacement p of the sensor move the contact points y, all in its axes, by

    Δy = y × θ - p

Least squares give a = θ or p, compared with the integral b of the measured ω or v after the same high-pass filter:

    Δy ← exp(-Δt / T) (Δy + δy)        b ← exp(-Δt / T) (b + ω Δt), likewise with v

Slip and moving ground also cause differences, which count only if an axis or unit error explains them
(`axes_comparison`). The balls of a trotting Go2 roll after touchdown by up to 1.4 mrad, like an inverted axis: a
comparison begins when the landed feet have settled.
"""

import math
from collections.abc import Collection, Sequence

import numpy as np
import pinocchio as pin

from wbc_controller.estimation.axes_comparison import AxesComparison, vector_text
from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.inverse_dynamics.arrays import cross, solved, sum_of_squares
from wbc_controller.records import Array

_HIGH_PASS = 0.3  # time constant T of the high-pass filter, s
PERIOD = 0.02  # time between two comparisons, s
_GAP = 0.1  # largest integration step of the twist of odometry, s
_SETTLING = 0.05  # time in which a landed foot may still roll or slip, s
_LARGEST_RESIDUAL = 0.1  # largest share of |Δy|² left by a rigid motion
_LEAST_SPREAD = 0.02  # smallest distance of points from a line, √Σ in m
_STEEPEST_COSINE = 0.5  # cosine of the largest angle between contact normal and vertical, 60°
_LEAST_HEIGHT = 0.02  # smallest distance of the centre of mass from the contact plane, m


def gravity_contradiction(kinematics: LegKinematics, active_contacts: Sequence[str], up: Array) -> str | None:
    """Return a message if no contact can hold a robot with the vertical `up`, (3,) in sensor axes; otherwise None.

    The normals are those of soles, and of the plane through all balls, towards the centre of mass.
    """
    center, balls = kinematics.center_of_mass(), tuple(name for name in active_contacts if name in kinematics.rolling)
    planes = [balls] if len(balls) > 2 else []
    planes += [(name,) for name in active_contacts if name in kinematics.corners]
    normals = [_normal(kinematics.positions(contacts), center) for contacts in planes]
    best = max((normal for normal in normals if normal is not None), key=lambda n: float(n @ up), default=None)
    if best is None or best @ up >= _STEEPEST_COSINE:
        return None
    angle = math.acos(max(-1.0, float(best @ up)))
    across = np.cross(best, up)
    axis = "xyz"[int(np.abs(across).argmax())]
    why = "wrong sign, or z axis pointing down" if angle > 2.6 else f"as if rotated about its {axis} axis"
    return (
        f"up is {vector_text(up)} in the axes of {kinematics.imu_frame}, but {vector_text(best)} by the contacts "
        f"({', '.join(active_contacts)}), {math.degrees(angle):.0f}° apart: {why}"
    )


def _normal(points: Array, center: Array) -> Array | None:
    """Return the unit normal of points, (n, 3), towards the centre of mass, (3,); None if undetermined."""
    middle = points.mean(axis=0)
    _, spread, axes = np.linalg.svd(points - middle)
    height = float((center - middle) @ axes[2])
    if spread[1] < _LEAST_SPREAD or abs(height) < _LEAST_HEIGHT:
        return None
    return np.asarray(math.copysign(1.0, height) * axes[2])


class SensorAgreement:
    """Comparison of rotations, and optionally displacements, of a sensor with the legs."""

    def __init__(self, kinematics: LegKinematics, sensor: str, *, with_displacements: bool) -> None:
        self._kinematics, self._sensor = kinematics, sensor
        self.comparison = AxesComparison(with_displacements=with_displacements)
        self._measured = np.zeros((2 if with_displacements else 1, 3))  # b, in rad and m
        self._contacts: tuple[str, ...] = ()
        self._settling = 0.0  # remaining time without a comparison, s
        self._places = self._moved = np.zeros((0, 3))  # y at the last comparison, and Δy

    def check(
        self, elapsed: float, steps: Array, active_contacts: tuple[str, ...], world: Array | None = None, *,
        known_wrong: bool = False,
    ) -> str | None:  # fmt: skip
        """Compare the motion since the last check; return a message on an axis or unit error, or None.

        Args:
            steps: measured rotation and displacement since then in sensor axes, (n, 3) in rad and m.
            world, known_wrong: as of `AxesComparison.update`.
        """
        before, self._places = self._places, self._kinematics.positions(active_contacts)
        self._settling -= elapsed
        changed = active_contacts != self._contacts
        if changed and not set(active_contacts) <= set(self._contacts):
            self._settling = _SETTLING
        self._contacts = active_contacts
        if changed or self._settling > 0.0:
            self._moved, self._measured = np.zeros_like(self._places), np.zeros_like(self._measured)
            found = self.comparison.explanation(world, known_wrong=True) if known_wrong else None
        else:
            keep = math.exp(-elapsed / _HIGH_PASS)
            self._moved = keep * (self._moved + self._places - before)
            self._measured = keep * (self._measured + steps)
            by_legs = _motion(self._places, self._moved)
            if by_legs is None:
                return None
            lever = float(np.linalg.norm(self._places.mean(axis=0))) if len(steps) > 1 else 0.0
            found = self.comparison.update(
                elapsed, by_legs[: len(steps)], self._measured, world, known_wrong=known_wrong, lever=lever
            )
        return found and f"{self._sensor} contradicts the legs ({', '.join(active_contacts)}): {found}"


class OdometryAgreement:
    """Comparison of the odometry's twist with its pose and the legs, and of its vertical with the contacts.

    `contradiction` is a message on an axis or unit error, or None; a wrong twist is latched until `restart`.
    """

    def __init__(self, kinematics: LegKinematics) -> None:
        """Start without data, with kinematics relative to the base link."""
        self._kinematics = kinematics
        self.restart()

    def restart(self) -> None:
        """Reset."""
        self.contradiction: str | None = None
        self._by_legs = SensorAgreement(self._kinematics, "odometry", with_displacements=True)
        self._by_pose = AxesComparison(with_displacements=True)
        self._moved, self._measured = np.zeros((2, 3)), np.zeros((2, 3))  # rotation and displacement by pose and twist
        self._twist = np.zeros(6)  # integral since the last comparison, m and rad
        self._stamp, self._elapsed = math.inf, 0.0  # of the newest message, and since the last comparison, s
        self._before: pin.SE3 | None = None  # placement of the base at the last comparison
        self._is_twist_wrong = self._agreed = False

    def update(
        self, stamp: float, base: tuple[Array, Array], joints: tuple[Array, Array], active_contacts: Collection[str],
        *, controlled: bool,
    ) -> None:  # fmt: skip
        """Process the newest odometry and joints; the vertical is compared until the robot is `controlled`.

        `base`: pose, (7,), and twist in base axes, (6,); `joints`: q and v, (nj,) each.
        """
        dt, self._stamp = stamp - self._stamp, stamp
        if not dt > 0.0 or self._is_twist_wrong or (controlled and self._agreed):
            return
        if dt > _GAP:
            self._before = None
            return
        self._twist += dt * base[1]
        self._elapsed += dt
        if self._elapsed < PERIOD:
            return
        elapsed, self._elapsed = self._elapsed, 0.0
        steps, self._twist = self._twist.reshape(2, 3)[::-1], np.zeros(6)  # rotation and displacement, rad and m
        legs, present = self._kinematics, pin.XYZQUATToSE3(base[0])
        contacts = tuple(name for name in legs.points if name in active_contacts)
        before, self._before = self._before, present
        if before is None:
            self._moved, self._measured = np.zeros((2, 3)), np.zeros((2, 3))
            return
        keep = math.exp(-elapsed / _HIGH_PASS)
        back, R = present.actInv(before), present.rotation
        self._moved = keep * (self._moved - [pin.log3(back.rotation), back.translation])
        self._measured = keep * (self._measured + steps)
        found = self._by_pose.update(elapsed, self._moved, self._measured, R)
        found = found and f"the twist of odometry contradicts its pose: {found}"
        if found is None and contacts:
            legs.update(*joints)
            found = self._by_legs.check(elapsed, steps, contacts, R)
        self._is_twist_wrong = found is not None
        self._agreed = found is None and self._by_pose.agreed and self._by_legs.comparison.agreed
        if found is None and contacts and not controlled:
            tilted = gravity_contradiction(legs, contacts, R[2])
            found = tilted and f"the orientation of odometry contradicts the legs: {tilted}"
        self.contradiction = found


def _motion(positions: Array, moved: Array) -> Array | None:
    """Return θ and p, (2, 3) in rad and m, of points y moved by Δy, (k, 3) in m; None if not rigid.

    With means ȳ, Δȳ and deviations Y, D: (tr(YᵀY) - YᵀY) θ = Σ Dᵢ × Yᵢ and p = ȳ × θ - Δȳ.
    """
    middle, mean = np.array([positions, moved]).sum(axis=1) / len(positions)
    Y, D = positions - middle, moved - mean
    products, size = Y.T @ D, sum_of_squares(Y)
    inertia = size * np.eye(3) - Y.T @ Y
    # Two eigenvalues are about `size`; the third is small for points on a line.
    if not float(inertia[0] @ cross(inertia[1], inertia[2])) >= _LEAST_SPREAD**2 * size**2 > 0.0:
        return None
    torque = (products - products.T)[[2, 0, 1], [1, 2, 0]]
    turn = solved(inertia, torque)
    left, size = sum_of_squares(D) - float(torque @ turn), sum_of_squares(moved)
    if not left <= _LARGEST_RESIDUAL * size:
        return None
    return np.array([turn, cross(middle, turn) - mean])
