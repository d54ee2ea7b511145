"""Rigid-body dynamics at one state, and differences between states."""

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.orientation import rotation_of


def random_state(model, rng):
    """Return (q, v) with any base orientation and joints within limits."""
    joints = rng.uniform(np.maximum(model.position_lower, -3.0), np.minimum(model.position_upper, 3.0))
    axis = rng.normal(size=3)
    turn = axis / np.linalg.norm(axis) * rng.uniform(0.0, np.pi)
    base = pin.SE3(pin.exp3(turn), rng.normal(size=3))
    return model.configuration(joints, base), 2.0 * rng.normal(size=model.nv)


def displacement(start, end):
    """Return the displacement between vectors, quaternions (4,) or poses (7,), with rotations in world axes."""
    if len(start) not in (4, 7):
        return end - start
    turn = pin.log3(rotation_of(end[-4:]) @ rotation_of(start[-4:]).T)
    return np.concatenate([end[:-4] - start[:-4], turn])


def close(found, expected, tolerance=1e-9):
    """Compare arrays up to a share of the largest expected number, at least of 1."""
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance * max(1.0, np.abs(expected).max()))


def dynamics_at(model, q, v=None):
    """Return the dynamics at q, (nq,), and v, (nv,), by default at rest."""
    dynamics = Dynamics(model)
    dynamics.update(q, np.zeros(model.nv) if v is None else v)
    return dynamics


def rate_along(value, model, q, v, step, v_dot=0.0, change=lambda start, end: end - start):
    """Return the rate of `value`, a function of the dynamics, along a motion, by central differences in time, s."""
    dynamics, ends = Dynamics(model), []
    for t in (-step, step):
        dynamics.update(pin.integrate(model.pinocchio, q, t * v + 0.5 * t**2 * v_dot), v + t * v_dot)
        ends.append(np.array(value(dynamics)))
    return change(*ends) / (2.0 * step)
