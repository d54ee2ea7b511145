"""Rigid-body dynamics at one state."""

import numpy as np

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics


def dynamics_at(model, q, v=None):
    """Return the dynamics at q, (nq,), and v, (nv,), by default at rest."""
    dynamics = Dynamics(model)
    dynamics.update(q, np.zeros(model.nv) if v is None else v)
    return dynamics
