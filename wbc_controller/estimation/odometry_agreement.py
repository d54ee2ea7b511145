"""Agreement of odometry with the legs."""

import math
from collections.abc import Collection

import numpy as np
import pinocchio as pin

from wbc_controller.estimation.axes_comparison import AxesComparison
from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.estimation.sensor_agreement import HIGH_PASS, PERIOD, SensorAgreement, gravity_contradiction
from wbc_controller.records import Array

_GAP = 0.1  # largest integration step of the twist, s


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
        keep = math.exp(-elapsed / HIGH_PASS)
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
