"""Inverse inertia of a robot with mimic joints."""

import numpy as np
import pinocchio as pin
from scipy.linalg import null_space

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array


class Mobility:
    """Velocity change per generalized impulse: G (Gᵀ M G)⁻¹ Gᵀ with C G = 0 (`Actuation`), or M⁻¹ without followers."""

    def __init__(self, model: RobotModel) -> None:
        self._model, self._data = model, model.pinocchio.createData()
        coupling = model.actuation.C
        self._free = null_space(coupling) if len(coupling) else np.eye(model.nv)

    def __call__(self, q: Array) -> Array:
        """Return the matrix, (nv, nv), of a configuration, (nq,)."""
        M = np.triu(pin.crba(self._model.pinocchio, self._data, q))
        M += np.triu(M, 1).T
        if self._model.actuation.rotors is not None:
            M += self._model.actuation.rotors
        G = self._free
        return np.asarray(G @ np.linalg.solve(G.T @ M @ G, G.T))
