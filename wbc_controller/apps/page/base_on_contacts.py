"""Placement of an unmeasured base on its contacts."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from wbc_controller.apps.page.snapshot import Robot
from wbc_controller.records import Array


class BaseOnContacts:
    """Fits the base to the contacts of the nominal posture, for drawing only."""

    def __init__(self, robot: Robot) -> None:
        self._model, self._robot = robot.model, robot
        self._enabled = [name for name, contact in robot.settings.contacts.items() if contact.enabled]
        self._reference_points = self._points(self._model.configuration(self._model.posture))
        if len(self._reference_points):
            self._reference_points[:, 2] -= self._reference_points[:, 2].min()

    def _points(self, q: Array) -> Array:
        dynamics = self._robot.dynamics
        dynamics.update(q, np.zeros(self._model.nv))
        return np.array([p for name in self._enabled for p in self._robot.contacts[name].points(dynamics)]).reshape(
            -1, 3
        )

    def place(self, q: Array) -> Array:
        """Return a configuration, (nq,), with the best fit of the base."""
        q = self._model.configuration(q[self._model.q_index])
        here = self._points(q)
        if not len(here):
            return q
        middle, reference_middle = here.mean(axis=0), self._reference_points.mean(axis=0)
        # Kabsch's algorithm: the rotation R minimizes Σ ‖R (here - middle) - (reference - reference_middle)‖².
        u, _, vt = np.linalg.svd((here - middle).T @ (self._reference_points - reference_middle))
        turned = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T)) or 1.0])
        rotation = vt.T @ turned @ u.T if len(here) > 2 else np.eye(3)
        q[:7] = pin.SE3ToXYZQUAT(pin.SE3(rotation, reference_middle - rotation @ middle))
        return q
