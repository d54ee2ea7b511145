"""Springs and dampers of passive joints."""

from collections.abc import Mapping

import numpy as np

from wbc_controller.records import Array
from wbc_controller.settings.robot import PassiveJointSettings


class PassiveForces:
    """Torques of springs and dampers, -k (q - q₀) - d q̇: part of the bias forces h (S1, S4)."""

    def __init__(self, joints: Mapping[str, PassiveJointSettings], q_index: np.ndarray, v_index: np.ndarray) -> None:
        self.joints = dict(joints)  # by name, (k,)
        self._q_index, self.v_index = q_index, v_index  # (k,) each
        self._stiffness = np.array([joint.stiffness for joint in joints.values()])
        self._damping = np.array([joint.damping for joint in joints.values()])
        self._rest = np.array([joint.rest for joint in joints.values()])

    def torques(self, q: Array, v: Array) -> Array:
        """Return the torques at a state, (k,) in N·m."""
        return np.asarray(self._stiffness * (self._rest - q[self._q_index]) - self._damping * v[self.v_index])
