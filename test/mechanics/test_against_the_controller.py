"""Dynamics and contacts of the controller are equal to the mechanics, to rounding."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mechanisms import random_state

from wbc_controller import mechanics as wbm
from wbc_controller.controller.build.program import make_qp
from wbc_controller.inverse_dynamics.contacts import SurfaceContact as ControllerSurface
from wbc_controller.records import RobotState, frozen
from wbc_controller.validation.fuzz.problems import rest


@settings(max_examples=20)
@given(st.sampled_from(["go2", "g1", "talos"]), st.integers(0, 2**32 - 1))
def test_snapshot_contacts_and_wrenches_agree(robot_of, name, seed):
    (configuration, model), rng = robot_of(name), np.random.default_rng(seed)
    controller = make_qp(configuration, model)
    dynamics, model = controller.dynamics, controller.model.pinocchio
    q, v = random_state(model, rng)
    dynamics.update(q, v)
    assert np.allclose(dynamics.M, wbm.mass_matrix(model, q), atol=1e-10)
    assert np.allclose(dynamics.h, wbm.bias_force(model, q, v), atol=1e-9)
    momentum = controller.model.mass * dynamics.com_velocity
    assert np.allclose(momentum, wbm.centroidal_momentum(model, q, v)[:3], atol=1e-9)
    wrench = rng.normal(size=6)
    base = controller.model.base_link
    ours = wbm.generalized_force(model, q, [wbm.ExternalWrench(base, wrench)])
    assert np.allclose(dynamics.external_force(base, wrench), ours, atol=1e-10)

    kinematics = wbm.Kinematics(model, q, v)
    for contact_name, contact in controller.contacts.items():
        spec = configuration.contacts[contact_name]
        if isinstance(contact, ControllerSurface):
            placement = kinematics.placement(spec.frame).inverse() * contact.placement(dynamics)
            constraint = wbm.SurfaceContact(frame=spec.frame, placement=placement)
        else:
            constraint = wbm.Rolling(frame=spec.frame, radius=spec.radius, centre=np.array(spec.translation))
        terms = constraint.terms(kinematics)
        scale = max(1.0, np.abs(terms.drift).max())
        assert np.allclose(contact.jacobian(dynamics), terms.jacobian, atol=1e-10)
        assert np.allclose(contact.drift(dynamics), terms.drift, atol=1e-10 * scale)


class Sole(wbm.SurfaceContact):
    """Sole with the controller's damping D of 20 1/s, and 50 1/s for the rotation."""

    def right_side(self, terms):
        return -terms.drift - np.repeat([20.0, 50.0], 3) * terms.velocity


@pytest.mark.parametrize("robot", ["g1", "talos"])
@pytest.mark.parametrize("seed", range(3))
def test_the_torques_lead_to_the_accelerations_and_contact_forces_that_were_counted_on(robot_of, robot, seed):
    """The solution of the program is the constrained motion (S10)."""
    configured, model = robot_of(robot)
    controller, rng = make_qp(configured, model), np.random.default_rng(seed)
    q = pin.integrate(model.pinocchio, model.configuration(model.posture), 0.02 * rng.normal(size=model.nv))
    v = 0.1 * rng.normal(size=model.nv)
    state = RobotState(0, frozen(q), frozen(v))
    solution = controller.solve(state, rest(controller, configured, state))

    contacts = []
    for name, contact in configured.contacts.items():
        placement = pin.SE3(pin.rpy.rpyToMatrix(*contact.rpy), np.array(contact.translation))
        here = controller.contacts[name].placement(controller.dynamics)
        contacts.append(Sole(frame=contact.frame, placement=placement, target=here))
    S = wbm.actuation_matrix(model.pinocchio, model.joints)
    motion = wbm.constrained_dynamics(model.pinocchio, q, v, S.T @ solution.tau, contacts)

    forces = np.concatenate([solution.forces[name] for name in configured.contacts])
    np.testing.assert_allclose(solution.v_dot, motion.v_dot, atol=1e-7 * np.linalg.norm(motion.v_dot))
    np.testing.assert_allclose(forces, motion.multipliers, atol=1e-7 * np.linalg.norm(motion.multipliers))
