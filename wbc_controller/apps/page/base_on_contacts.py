"""Placement of a base without a measured pose: the robot is drawn on its contacts, as in its nominal posture."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from wbc_controller.apps.page.snapshot import Robot
from wbc_controller.records import Array


class BaseOnContacts:
    """Places the base so that the contacts stay at their places in the nominal posture.

    It serves drawing only: without a sensor, steps of the robot and a tilt of its soles are unknown.
    """

    def __init__(self, robot: Robot) -> None:
        """Record the contacts in the nominal posture, upright on the floor."""
        self._model, self._robot = robot.model, robot
        self._named = [name for name, contact in robot.settings.contacts.items() if contact.enabled]
        self._there = self._points(self._model.configuration(self._model.posture))
        if len(self._there):
            self._there[:, 2] -= self._there[:, 2].min()

    def _points(self, q: Array) -> Array:
        dynamics = self._robot.dynamics
        dynamics.update(q, np.zeros(self._model.nv))
        return np.array([p for name in self._named for p in self._robot.contacts[name].points(dynamics)]).reshape(-1, 3)

    def place(self, q: Array) -> Array:
        """Return a configuration, (nq,), with the base whose contacts fit best; the base of `q` is ignored."""
        q = self._model.configuration(q[self._model.q_index])
        here = self._points(q)
        if not len(here):
            return q
        middle, wanted = here.mean(axis=0), self._there.mean(axis=0)
        # Kabsch's algorithm: the rotation R that minimizes Σ ‖R (here - middle) - (there - wanted)‖².
        u, _, vt = np.linalg.svd((here - middle).T @ (self._there - wanted))
        turned = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T)) or 1.0])
        rotation = vt.T @ turned @ u.T if len(here) > 2 else np.eye(3)
        q[:7] = pin.SE3ToXYZQUAT(pin.SE3(rotation, wanted - rotation @ middle))
        return q
