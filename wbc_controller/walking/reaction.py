"""Reaction of the centre of mass to the swing foot.

The inverted pendulum has no swing leg. With the sagittal component L of its angular momentum about the centre of mass,
m z (c̈ - ω² (c - p)) = -L̇. L = λ ẋ for a foot that moves at ẋ gives c̈ = ω² (c - p) + μ ẍ with μ = -λ / (m z).
"""

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.walking.feet import Foot


def swing_reaction(dynamics: Dynamics, stance: Foot, swing: Foot, height: float) -> float:
    """Return μ for a swing foot that moves forward, with the centre of mass and the base's orientation at rest.

    Args:
        dynamics: in the nominal posture.
        height: z of the centre of mass above the ground, m.
    """
    feet = [dynamics.jacobian(foot.frame, pin.LOCAL_WORLD_ALIGNED) for foot in (stance, swing)]
    rows = np.vstack([*feet, np.eye(6, dynamics.model.nv)[3:], dynamics.com_jacobian])
    wanted = np.zeros(len(rows))
    wanted[6] = 1.0  # ẋ of the swing foot
    joints = dynamics.model.pinocchio.frames
    columns = np.any([dynamics.moves[joints[foot.frame].parentJoint] for foot in (stance, swing)], axis=0)
    v = np.zeros(dynamics.model.nv)
    v[columns] = np.linalg.lstsq(rows[:, columns], wanted, rcond=None)[0]
    momentum = dynamics.centroidal_matrix @ v
    return float(-momentum[4] / (dynamics.model.mass * height))
