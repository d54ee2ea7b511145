"""Rigid-body dynamics at one state."""

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics


def dynamics_at(model, q, v=None):
    """Return the dynamics at q, (nq,), and v, (nv,), by default at rest."""
    dynamics = Dynamics(model)
    dynamics.update(q, np.zeros(model.nv) if v is None else v)
    return dynamics


def rate_along(value, model, q, v, step, v_dot=0.0):
    """Return the rate of `value`, a function of the dynamics, along a motion, by central differences in time, s."""
    ends = []
    for t in (-step, step):
        end = pin.integrate(model.pinocchio, q, t * v + 0.5 * t**2 * v_dot)
        ends.append(np.array(value(dynamics_at(model, end, v + t * v_dot))))
    return (ends[1] - ends[0]) / (2.0 * step)
