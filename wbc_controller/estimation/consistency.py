"""Velocities of contact points: consistency with contacts at rest, and tipping soles.

By the filter's R, v, b_g, a contact point at y from the IMU moves in the world with

    u = v + R ((ω - b_g) × y + ẏ)

If all points move, the IMU is wrong or no contact holds: the estimate is lost. The filter cannot detect this: it
rejects the contacts, or explains a slow contradiction by creep. A sole that tips over an edge rests between its
corners; its points creep with their vertical speed relative to that place, as it would tilt the estimate.
"""

import math

import numpy as np
import pinocchio as pin

from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.inverse_dynamics.arrays import cross
from wbc_controller.records import Array

#: Mean speed of the slowest point above which the estimate is lost, m/s. Feet of a walking robot tip and slip, and a
#: damped one falls.
LIMIT, WALKING_LIMIT = 0.1, 0.3
_MEAN, _TIPPING_MEAN = 0.1, 0.02  # time constants of the means of velocities, and of vertical ones for tipping, s
_FASTEST = 1.0  # clamp of each velocity, m/s, against outliers


class ContactConsistency:
    """Velocities of the contact points; inactive contacts count until they move.

    The speed of a point is the smaller of those of its present and its mean velocity: neither a single wrong sample nor
    the motion before a touchdown decides. `speed` is that of the slowest point, also between the corners of a sole,
    m/s; 0 without contacts.
    """

    def __init__(self, kinematics: LegKinematics) -> None:
        self.speed = 0.0
        self._kinematics = kinematics
        self._speeds: dict[str, float] = {}  # of the slowest point of each contact, m/s
        self._means: dict[str, Array] = {}  # velocities of points, and vertical for tipping, (k, 4) in m/s

    def tipping(self, contact: str) -> Array:
        """Return mean vertical speeds of a contact's points relative to its slowest place, (k,) in m/s; 0 without."""
        none = np.zeros((len(self._kinematics.points[contact]), 4))
        rising = self._means.get(contact, none)[:, 3]
        corners = self._corners(contact, rising)
        return np.asarray(np.abs(rising - min(max(0.0, corners.min()), corners.max())))

    def update(self, active_contacts: tuple[str, ...], R: Array, velocity: Array, omega: Array, elapsed: float) -> None:
        """Average the velocities of the points, from zero for a new contact.

        R is from IMU to world; `velocity` in the world, m/s, `omega` without bias in IMU axes, rad/s, (3,) each.
        """
        if not active_contacts:
            self.speed, self._speeds, self._means = 0.0, {}, {}
            return
        former = (name for name, speed in self._speeds.items() if name not in active_contacts and speed <= LIMIT)
        contacts, legs = (*active_contacts, *former), self._kinematics
        seen = legs.contact_points(contacts)
        ends = [0, *seen.ends.tolist()]
        rows = dict(zip(contacts, map(slice, ends[:-1], ends[1:]), strict=True))
        u = velocity + (seen.positions @ pin.skew(omega).T + seen.velocities) @ R.T  # (k, 3)
        if legs.rolling:  # a ball's contact point, at -r n from its centre, rotates with the link
            spins = (seen.link_angular_velocities - legs.imu_motion[3:]) @ legs.imu_rotation + omega
            for spin, name in zip(spins @ R.T, contacts, strict=True):
                if name in legs.rolling:
                    u[rows[name]] -= cross(spin, legs.rolling[name])
        speeds = np.linalg.norm(u, axis=1)
        u *= _FASTEST / np.maximum(speeds, _FASTEST)[:, None]
        means = np.zeros((len(u), 4))
        for name in rows.keys() & self._means.keys():
            means[rows[name]] = self._means[name]
        means[:, :3] += (1.0 - math.exp(-elapsed / _MEAN)) * (u - means[:, :3])
        share = 1.0 - math.exp(-elapsed / _TIPPING_MEAN)
        means[:, 3] = (1.0 - share) * means[:, 3] + share * u[:, 2]
        slowest = np.minimum.reduceat(np.minimum(np.linalg.norm(means[:, :3], axis=1), speeds), ends[:-1])
        self._means = {name: means[own] for name, own in rows.items()}
        self._speeds = dict(zip(contacts, slowest.tolist(), strict=True))
        for name, own in rows.items():
            if self._speeds[name] > LIMIT:
                present, mean = self._corners(name, u[own]), self._corners(name, means[own, :3])
                self._speeds[name] = min(_slowest_between(present), _slowest_between(mean))
        self.speed = min(self._speeds.values())

    def _corners(self, contact: str, velocities: Array) -> Array:
        """Return the velocities of a sole's corners, or else of the points."""
        weights = self._kinematics.corners.get(contact)
        return velocities if weights is None else weights @ velocities


def _slowest_between(velocities: Array) -> float:
    """Return the least speed on lines between points of a rigid body with these velocities, (k, 3) in m/s.

    On a line, u + s (w - u) is least at s = -u·(w - u) / ‖w - u‖², limited to 0 and 1.
    """
    u, w = velocities[:, None], velocities[None]
    change = w - u  # (k, k, 3)
    size = (change * change).sum(axis=2)
    share = np.clip(-(u * change).sum(axis=2) / np.where(size > 0.0, size, 1.0), 0.0, 1.0)
    return float(np.linalg.norm(u + share[:, :, None] * change, axis=2).min())
