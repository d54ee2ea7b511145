"""Consistency of the estimate with the contacts: at least one contact is at rest.

A contact point at y from the IMU moves in the world, by the filter's R, v, b_g and the joint velocities, with

    u = v + R ((ω - b_g) × y + ẏ)

A foot that slips has a velocity u, but others have none. If all contacts move, either the IMU is wrong or nothing
holds: in both cases the estimate has no support left. The filter cannot find this out by itself. Its covariance
describes the noise of a good IMU, so it rejects contacts that contradict a wrong velocity, and it takes a slow
contradiction for creep of the contacts.
"""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.records import Array

#: Mean speed of the slowest contact above which the estimate is lost, m/s.
LIMIT = 0.12
#: Time constant of the mean, s: noise of the joint velocities and short slips average out.
_MEAN = 0.1
#: Speed to which each velocity is limited, m/s: a single wrong sample of the gyroscope must not decide.
_FASTEST = 1.0


class ContactConsistency:
    """Mean velocities of the contacts in the world of the filter.

    A contact that holds no longer still counts until it moves: an unloaded foot at rest also supports the estimate.

    Attributes:
        speed: mean speed of the slowest contact, m/s; 0 if no contact holds.
    """

    def __init__(self, kinematics: LegKinematics) -> None:
        """Begin without contacts."""
        self.speed = 0.0
        self._kinematics = kinematics
        self._contacts: tuple[str, ...] = ()
        self._velocities = np.zeros((0, 3))
        self._radii = np.zeros((0, 3))

    def update(self, holding: tuple[str, ...], R: Array, velocity: Array, omega: Array, elapsed: float) -> None:
        """Average the velocities of the contacts that hold; the mean of a new contact begins at zero.

        R is from the IMU's axes to the world, the velocity of the IMU in the world, (3,) in m/s, its omega in its own
        axes without the bias, (3,) in rad/s, and `elapsed` the time since the last update, s.
        """
        if holding != self._contacts:
            self._choose(holding)
        if not holding:
            self.speed = 0.0
            return
        legs = self._kinematics
        seen = legs.sight(self._contacts)
        starts = np.concatenate([[0], seen.ends[:-1]])
        in_imu = np.cross(omega, seen.places) + seen.rates  # (k, 3)
        center = np.add.reduceat(in_imu, starts) / np.diff(seen.ends, prepend=0)[:, None]  # mean of each contact
        # The contact point of a ball is at -r n from its centre, and moves less by the turning of the link.
        spin = (seen.turning - legs.imu_motion[3:]) @ legs.imu_rotation + omega
        u = velocity + center @ R.T - np.cross(spin @ R.T, self._radii)
        speeds = np.linalg.norm(u, axis=1, keepdims=True)
        u *= _FASTEST / np.maximum(speeds, _FASTEST)
        self._velocities += (1.0 - math.exp(-elapsed / _MEAN)) * (u - self._velocities)
        self.speed = float(np.linalg.norm(self._velocities, axis=1).min())

    def _choose(self, holding: tuple[str, ...]) -> None:
        """Take the contacts that hold, and those that held before and are at rest."""
        means, at_rest, radii = (
            dict(zip(self._contacts, self._velocities, strict=True)),
            np.zeros(3),
            self._kinematics.rolling,
        )
        former = (name for name, mean in means.items() if name not in holding and np.linalg.norm(mean) <= LIMIT)
        self._contacts = (*holding, *former) if holding else ()
        self._velocities = np.array([means.get(name, at_rest) for name in self._contacts]).reshape(-1, 3)
        self._radii = np.array([radii.get(name, at_rest) for name in self._contacts]).reshape(-1, 3)
