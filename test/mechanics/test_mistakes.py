"""Invalid arguments of the mechanics: each is refused by name."""

import math

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import robot

from wbc_controller import mechanics as wbm
from wbc_controller.errors import ConfigurationError, InputRefused
from wbc_controller.records import RobotState

ARM, DOG = robot("panda"), robot("go2")
Q, V = pin.neutral(DOG), np.zeros(DOG.nv)
EARLIER, LATER = RobotState(1, Q, V), RobotState(2, Q, V)
NOWHERE = wbm.ExternalWrench("bsae", np.zeros(6))
PAIR = wbm.ParticleSystem(np.ones(2), [wbm.Rod(0, 1, 1.0)])
X = np.array([[0.0, 0, 0], [1.0, 0, 0]])
STRUCTURE, NOTHING = wbm.rod_constraints(PAIR, X, 0 * X), (np.zeros((0, 6)), np.zeros(0))
EYE, ROW, ZERO = np.eye(2), np.ones((1, 2)), np.zeros(1)


def shoulder():
    """A ball joint on a floating base."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root_joint")
    model.addJoint(joint, pin.JointModelSpherical(), pin.SE3.Identity(), "shoulder")
    return model


def move(kind, **arguments):
    return wbm.constrained_dynamics(DOG, Q, V, V, [kind(**arguments)])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: wbm.actuation_matrix(DOG, ["FL_hip_jiont"]), "did you mean 'FL_hip_joint'"),
        (lambda: wbm.actuation_matrix(DOG, ["root_joint"]), "6 degrees of freedom"),
        (lambda: wbm.ExternalWrench("base", np.zeros(6), "BODY"), "valid: LOCAL, LOCAL_WORLD_ALIGNED, WORLD"),
        (lambda: wbm.generalized_force(DOG, Q, [NOWHERE]), "unknown frame 'bsae'"),
        (lambda: wbm.momentum_residual(DOG, EARLIER, LATER, [NOWHERE]), "unknown frame"),
        (lambda: wbm.PointContact(frame="FL_foot", time_constant=0.0), r"time_constant = 0\.0 s: must be positive"),
        (lambda: wbm.JointCoupling(coefficients={}, time_constant=math.nan), "time_constant = nan"),
        (lambda: move(wbm.PointContact, frame="FL_foto"), "did you mean 'FL_foot'"),
        (lambda: move(wbm.JointCoupling, coefficients={"FL_hip": 1.0}), "did you mean 'FL_hip_joint'"),
        (lambda: move(wbm.JointCoupling, coefficients={"root_joint": 1.0}), "6 degrees of freedom in 7"),
        (lambda: move(wbm.PlaneContact, frame="FL_foot", normal=np.zeros(3)), "must not be zero"),
        (lambda: move(wbm.Rolling, frame="FL_foot", radius=0.1, axis=np.eye(3)[2]), "lies flat"),
        (lambda: wbm.change_coordinates(ARM, root="panda_joint3"), "fixed to the world"),
        (lambda: wbm.change_coordinates(DOG, flip=["FL_hip_jiont"]), "did you mean 'FL_hip_joint'"),
        (lambda: wbm.change_coordinates(DOG, root="foot"), "unknown joint 'foot'"),
        (lambda: wbm.change_coordinates(shoulder()), "'shoulder' has type JointModelSpherical"),
        (lambda: wbm.ParticleSystem(np.array([1.0, np.nan]), []), "kg: must be positive"),
        (lambda: wbm.ParticleSystem(np.ones(2), [wbm.Rod(0, 2, 1.0)]), "unknown particle 2 of a rod; valid: 0 to 1"),
        (lambda: wbm.ParticleSystem(np.ones(2), [wbm.Rod(0, 1, 0.0)]), "length = 0"),
        (lambda: wbm.reduce_structure(PAIR, STRUCTURE, basis=np.eye(6)), "violates the structure"),
        (lambda: wbm.translation(ARM, [1, 0, 0]), "a floating base"),
        (lambda: wbm.joint_shift(ARM, "panda_joint9"), "unknown joint 'panda_joint9'"),
    ],
)
def test_invalid_parameters_are_named(call, words):
    with pytest.raises(ConfigurationError, match=words):
        call()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: wbm.ExternalWrench("base", np.zeros(3)), r"has shape \(3,\), expected \(6,\)"),
        (lambda: wbm.ExternalWrench("base", np.full(6, np.nan)), "not finite"),
        (lambda: wbm.energy_residual(DOG, LATER, EARLIER, V), "of the second state is not after"),
        (lambda: wbm.momentum_residual(DOG, EARLIER, EARLIER), "of the second state is not after"),
        (lambda: wbm.energy_residual(DOG, EARLIER, LATER, np.zeros(3)), r"force has shape \(3,\)"),
        (lambda: wbm.gauss(EYE, np.array([0.0, np.nan]), ROW, ZERO), "v_dot_u is not finite at"),
        (lambda: wbm.gauss(EYE, np.zeros(2), np.ones((1, 3)), ZERO), r"A has shape \(1, 3\), expected \(1, 2\)"),
        (lambda: wbm.gauss(-EYE, np.zeros(2), ROW, ZERO), "not positive definite"),
        (lambda: wbm.solve_in_one_stage(PAIR, STRUCTURE, NOTHING, np.zeros(6)), "forces has shape"),
        (lambda: wbm.rod_constraints(PAIR, X[0], X), "x has shape"),
        (lambda: wbm.lagrangian_variation(DOG, Q, V, lambda q: np.zeros(2)), r"δq\(q\) has shape \(2,\)"),
        (lambda: wbm.rotation(DOG, [np.nan, 0, 0]), "axis is not finite"),
    ],
)
def test_invalid_arrays_and_orders_are_named(call, words):
    with pytest.raises(InputRefused, match=words):
        call()
