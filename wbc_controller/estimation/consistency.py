"""Velocities of contact points: consistency with contacts at rest, and tipping soles.

By the filter's R, v, b_g, a contact point at y from the IMU moves in the world with

    u = v + R ((ω - b_g) × y + ẏ)

If all points move, the IMU is wrong or no contact holds, and the estimate is lost; a tipping sole rests at a point. The
filter cannot detect this: it rejects the contacts, or explains a slow contradiction by creep.

A tipping sole would tilt the estimate; so its points creep with their vertical speed relative to the resting point.
"""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.records import Array

#: Mean speed of the slowest point above which the estimate is lost, m/s.
LIMIT = 0.1
#: Time constants of the means of velocities, and of vertical ones for tipping, s.
_MEAN, _TIPPING_MEAN = 0.1, 0.02
#: Clamp of each velocity, m/s, against outliers.
_FASTEST = 1.0


class ContactConsistency:
    """Velocities of the contact points; inactive contacts count until they move.

    The speed of a point is the smaller of those of its present and its mean velocity: neither a single wrong sample nor
    the motion before a touchdown decides. `speed` is that of the slowest point, m/s; 0 without contacts.
    """

    def __init__(self, kinematics: LegKinematics) -> None:
        self.speed = 0.0
        self._kinematics = kinematics
        self._speeds: dict[str, float] = {}  # of the slowest point of each contact, m/s
        self._means: dict[str, Array] = {}  # velocities of the points of each contact, (k, 3) in m/s
        self._rising: dict[str, Array] = {}  # the same, vertical, (k,)

    def tipping(self, contact: str) -> Array | float:
        """Return the mean vertical speeds of a contact's points relative to its slowest one, (k,) in m/s; 0 without."""
        rising = self._rising.get(contact)
        return 0.0 if rising is None else np.abs(rising - rising[np.abs(rising).argmin()])

    def update(self, active_contacts: tuple[str, ...], R: Array, velocity: Array, omega: Array, elapsed: float) -> None:
        """Average the velocities of the points, from zero for a new contact.

        R is from IMU to world; `velocity` in the world, m/s, `omega` without bias in IMU axes, rad/s, (3,) each.
        """
        if not active_contacts:
            self.speed, self._speeds, self._means, self._rising = 0.0, {}, {}, {}
            return
        former = (name for name, speed in self._speeds.items() if name not in active_contacts and speed <= LIMIT)
        contacts, legs = (*active_contacts, *former), self._kinematics
        seen = legs.contact_points(contacts)
        starts, counts = [0, *seen.ends[:-1].tolist()], np.diff(seen.ends, prepend=0)
        # A ball's contact point is at -r n from its centre and rotates with the link.
        radii = np.array([legs.rolling.get(name, np.zeros(3)) for name in contacts])
        spin = (seen.link_angular_velocities - legs.imu_motion[3:]) @ legs.imu_rotation + omega
        u = velocity + (np.cross(omega, seen.positions) + seen.velocities) @ R.T  # (k, 3)
        u -= np.repeat(np.cross(spin @ R.T, radii), counts, axis=0)
        speeds = np.linalg.norm(u, axis=1)
        u *= _FASTEST / np.maximum(speeds, _FASTEST)[:, None]
        means = np.concatenate(
            [self._means.get(name, np.zeros((k, 3))) for name, k in zip(contacts, counts.tolist(), strict=True)]
        )
        means += (1.0 - math.exp(-elapsed / _MEAN)) * (u - means)
        rising, share = np.split(u[:, 2], starts[1:]), 1.0 - math.exp(-elapsed / _TIPPING_MEAN)
        before = self._rising
        self._rising = {
            name: (1.0 - share) * before.get(name, 0.0) + share * v for name, v in zip(contacts, rising, strict=True)
        }
        slowest = np.minimum.reduceat(np.minimum(np.linalg.norm(means, axis=1), speeds), starts)
        self._means = dict(zip(contacts, np.split(means, starts[1:]), strict=True))
        self._speeds = dict(zip(contacts, slowest.tolist(), strict=True))
        self.speed = min(self._speeds.values())
