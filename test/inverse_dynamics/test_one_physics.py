"""The controller and the plain functions are one physics: what the one counts on, the other finds (S10)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller import mechanics
from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.references import make_board
from wbc_controller.controller.build.robot import make_model
from wbc_controller.records import RobotState, frozen
from wbc_controller.settings.files import find_configuration, load_settings

TIME_CONSTANT = 0.1  # s; critically damped, 2 / 0.1 s is the contacts' damping of 20 / s


@pytest.mark.parametrize("robot", ["g1", "talos"])
@pytest.mark.parametrize("seed", range(5))
def test_the_torques_lead_to_the_accelerations_and_contact_forces_that_were_counted_on(robot, seed):
    settings = load_settings(find_configuration(robot))
    model = make_model(settings)
    controller = make_qp(settings, model)
    board = make_board(settings, controller)
    rng = np.random.default_rng(seed)
    q = pin.integrate(model.pinocchio, model.configuration(model.posture), 0.02 * rng.normal(size=model.nv))
    v = 0.1 * rng.normal(size=model.nv)
    controller.dynamics.update(q, v)
    board.reset(controller.dynamics, 0.0)
    solution = controller.solve(RobotState(0, frozen(q), frozen(v)), board.sample(0.0))

    contacts = []
    for name, contact in settings.contacts.items():
        assert contact.damping == 2.0 / TIME_CONSTANT
        placement = pin.SE3(pin.rpy.rpyToMatrix(*contact.rpy), np.array(contact.translation))
        here = controller.contacts[name].placement(controller.dynamics)
        contacts.append(
            mechanics.SurfaceContact(frame=contact.frame, placement=placement, target=here, time_constant=TIME_CONSTANT)
        )
    S = mechanics.actuation_matrix(model.pinocchio, model.joints)
    motion = mechanics.constrained_dynamics(model.pinocchio, q, v, S.T @ solution.tau, contacts)

    forces = np.concatenate([solution.forces[name] for name in settings.contacts])
    np.testing.assert_allclose(solution.v_dot, motion.v_dot, atol=1e-7 * np.linalg.norm(motion.v_dot))
    np.testing.assert_allclose(forces, motion.multipliers, atol=1e-7 * np.linalg.norm(motion.multipliers))


@pytest.mark.parametrize("robot", ["g1", "talos", "go2"])
def test_the_snapshot_is_the_note_s_equations_of_motion(robot):
    settings = load_settings(find_configuration(robot))
    model = make_model(settings)
    dynamics = make_qp(settings, model).dynamics
    rng = np.random.default_rng(1)
    q = pin.integrate(model.pinocchio, model.configuration(model.posture), rng.normal(size=model.nv))
    v = rng.normal(size=model.nv)
    dynamics.update(q, v)
    wrench = rng.normal(size=6)
    force = mechanics.generalized_force(model.pinocchio, q, [mechanics.ExternalWrench(model.base_link, wrench)])
    for found, expected in (
        (dynamics.M, mechanics.mass_matrix(model.pinocchio, q)),
        (dynamics.h, mechanics.bias_force(model.pinocchio, q, v)),
        (dynamics.external_force(model.base_link, wrench), force),
        (dynamics.centroidal_matrix @ v, mechanics.centroidal_momentum(model.pinocchio, q, v)),
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
