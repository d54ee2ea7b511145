"""Consistency with contacts at rest.

By the filter's R, v, b_g, a contact point at y from the IMU moves in the world with

    u = v + R ((ω - b_g) × y + ẏ)

If all contacts move, the IMU is wrong or no contact holds, and the estimate is lost. The filter cannot detect this: it
rejects the contacts, or explains a slow contradiction by creep.
"""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.records import Array

#: Mean speed of the slowest contact above which the estimate is lost, m/s.
LIMIT = 0.1
#: Time constant of the mean, s.
_MEAN = 0.1
#: Clamp of each velocity, m/s, against outliers.
_FASTEST = 1.0


class ContactConsistency:
    """Mean velocities of the contacts; inactive contacts count until they move.

    `speed` is the mean speed of the slowest contact, m/s; 0 without contacts.
    """

    def __init__(self, kinematics: LegKinematics) -> None:
        self.speed = 0.0
        self._kinematics = kinematics
        self._contacts: tuple[str, ...] = ()
        self._velocities = np.zeros((0, 3))
        self._radii = np.zeros((0, 3))

    def update(self, active_contacts: tuple[str, ...], R: Array, velocity: Array, omega: Array, elapsed: float) -> None:
        """Average the contact velocities, from zero for a new contact.

        R is from IMU to world; `velocity` in the world, m/s, `omega` without bias in IMU axes, rad/s, (3,) each.
        """
        if active_contacts != self._contacts:
            self._choose(active_contacts)
        if not active_contacts:
            self.speed = 0.0
            return
        legs = self._kinematics
        seen = legs.contact_points(self._contacts)
        starts = np.concatenate([[0], seen.ends[:-1]])
        in_imu = np.cross(omega, seen.positions) + seen.velocities  # (k, 3)
        center = np.add.reduceat(in_imu, starts) / np.diff(seen.ends, prepend=0)[:, None]  # mean of each contact
        # A ball's contact point is at -r n from its centre and rotates with the link.
        spin = (seen.link_angular_velocities - legs.imu_motion[3:]) @ legs.imu_rotation + omega
        u = velocity + center @ R.T - np.cross(spin @ R.T, self._radii)
        speeds = np.linalg.norm(u, axis=1, keepdims=True)
        u *= _FASTEST / np.maximum(speeds, _FASTEST)
        self._velocities += (1.0 - math.exp(-elapsed / _MEAN)) * (u - self._velocities)
        self.speed = float(np.linalg.norm(self._velocities, axis=1).min())

    def _choose(self, active_contacts: tuple[str, ...]) -> None:
        means = dict(zip(self._contacts, self._velocities, strict=True))
        at_rest, radii = np.zeros(3), self._kinematics.rolling
        former = (name for name, mean in means.items() if name not in active_contacts and np.linalg.norm(mean) <= LIMIT)
        self._contacts = (*active_contacts, *former) if active_contacts else ()
        self._velocities = np.array([means.get(name, at_rest) for name in self._contacts]).reshape(-1, 3)
        self._radii = np.array([radii.get(name, at_rest) for name in self._contacts]).reshape(-1, 3)
