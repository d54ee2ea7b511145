"""How much a joint can be damped by a controller in discrete time."""

import numpy as np
import pinocchio as pin
from scipy.linalg import null_space

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

_HALVINGS = 30


def stable_damping(model: RobotModel, damping: float, period: float) -> Array:
    """Damping of each joint, (nj,) in N·m·s/rad: the wanted one, or the most with which no motion changes its sign.

    With torques -D v that act for one period T the joint velocities go to (I - T W D) v, where W is the block of the
    joints in the inverse of M. No motion changes its sign where the eigenvalues of T D^½ W D^½ are at most 1; beyond 2
    damping drives the robot. Joints with little inertia are reduced first: Dᵢ = min(damping, β / (T Wᵢᵢ)) with the
    largest β that holds this. M is that of the nominal posture with the base free: contacts only add inertia, and the
    factor of 2 is left for other postures.

    Args:
        period: T, s.
    """
    W = _mobility(model)
    most = 1.0 / (period * np.diag(W))

    def shaped(share: float) -> Array:
        return np.asarray(np.minimum(damping, share * most))

    def steady(D: Array) -> bool:
        root = np.sqrt(D)
        return bool(period * np.linalg.eigvalsh(root[:, None] * W * root)[-1] <= 1.0)

    low, high = 0.0, 1.0  # at 1 a joint by itself would come to rest within a period
    if steady(shaped(high)):
        return shaped(high)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if steady(shaped(middle)) else (low, middle)
    return shaped(low)


def _mobility(model: RobotModel) -> Array:
    """Block of the joints in the inverse of M at the nominal posture, (nj, nj); joints that follow others do so."""
    M = np.array(pin.crba(model.pinocchio, model.pinocchio.createData(), model.configuration(model.posture)))
    M = np.triu(M) + np.triu(M, 1).T
    if model.actuation.rotors is not None:
        M = M + model.actuation.rotors
    coupling = model.actuation.C
    G = null_space(coupling) if len(coupling) else np.eye(model.nv)
    inverse = G @ np.linalg.solve(G.T @ M @ G, G.T)
    block = inverse[np.ix_(model.v_index, model.v_index)]
    return np.asarray(0.5 * (block + block.T))
