"""The controller's snapshot and contacts are fast paths of what is said here: they must be the same, to rounding."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mechanisms import random_state

from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.check.preflight import stance
from wbc_controller.inverse_dynamics.contacts import SurfaceContact as ControllerSurface
from wbc_controller.mechanics import (
    ExternalWrench,
    Kinematics,
    Rolling,
    SurfaceContact,
    actuation_matrix,
    bias_force,
    centroidal_momentum,
    gauss,
    generalized_force,
    mass_matrix,
)
from wbc_controller.records import Reference, References, RobotState
from wbc_controller.settings.files import find_configuration, load_settings

CONTROLLERS = {}


def controller_of(name):
    if name not in CONTROLLERS:
        configuration = load_settings(find_configuration(name))
        CONTROLLERS[name] = make_qp(configuration, make_model(configuration))
    return CONTROLLERS[name]


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(["go2", "g1", "talos"]), st.integers(0, 2**32 - 1))
def test_snapshot_contacts_and_wrenches_agree(name, seed):
    controller, rng = controller_of(name), np.random.default_rng(seed)
    dynamics, model = controller.dynamics, controller.model.pinocchio
    q, v = random_state(model, rng)
    dynamics.update(q, v)
    assert np.allclose(dynamics.M, mass_matrix(model, q), atol=1e-10)
    assert np.allclose(dynamics.h, bias_force(model, q, v), atol=1e-9)
    assert np.allclose(controller.model.mass * dynamics.com_velocity, centroidal_momentum(model, q, v)[:3], atol=1e-9)
    wrench = rng.normal(size=6)
    base = controller.model.base_link
    ours = generalized_force(model, q, [ExternalWrench(base, wrench)])
    assert np.allclose(dynamics.external_force(base, wrench), ours, atol=1e-10)

    kinematics = Kinematics(model, q, v)
    configured = load_settings(find_configuration(name)).contacts
    for contact_name, contact in controller.contacts.items():
        spec = configured[contact_name]
        if isinstance(contact, ControllerSurface):
            placement = kinematics.placement(spec.frame).inverse() * contact.placement(dynamics)
            constraint = SurfaceContact(frame=spec.frame, placement=placement)
        else:
            constraint = Rolling(frame=spec.frame, radius=spec.radius, centre=np.array(spec.translation))
        terms = constraint.terms(kinematics)
        scale = max(1.0, np.abs(terms.drift).max())
        assert np.allclose(contact.jacobian(dynamics), terms.jacobian, atol=1e-10)
        assert np.allclose(contact.drift(dynamics), terms.drift, atol=1e-10 * scale)


@pytest.mark.parametrize("name", ["go2", "g1", "talos"])
def test_a_solution_is_a_motion_of_gauss(name):
    """What the program answers, from rest, is what Gauss's principle gives for its torques (S10, both ways)."""
    controller = controller_of(name)
    configured = load_settings(find_configuration(name)).contacts
    made = [contact for contact, spec in configured.items() if spec.enabled]
    model = controller.model.pinocchio
    q = stance(controller.model, controller, made)
    v = np.zeros(model.nv)
    controller.dynamics.update(q, v)
    references = {task: each.rest(controller.dynamics) for task, each in controller.tasks.items()}
    there = references["com"]
    references["com"] = Reference(there.position + np.array([0.01, 0.005, -0.01]), there.velocity, there.acceleration)
    asked = References(references, dict.fromkeys(references, 1.0), dict.fromkeys(made, 1.0))
    solution = controller.solve(RobotState(0, q, v), asked)
    dynamics = controller.dynamics
    A = np.vstack([controller.contacts[contact].jacobian(dynamics) for contact in made])
    b = -np.concatenate([controller.contacts[contact].drift(dynamics) for contact in made])
    force = actuation_matrix(model, controller.model.joints).T @ solution.tau
    free = np.linalg.solve(dynamics.M, force - dynamics.h)
    motion = gauss(dynamics.M, free, A, b)
    assert np.abs(solution.v_dot).max() > 0.1
    assert np.abs(motion.v_dot - solution.v_dot).max() < 1e-4 * max(1.0, np.abs(solution.v_dot).max())
    forces = A.T @ np.concatenate([solution.forces[contact] for contact in made])
    assert np.allclose(motion.constraint_force, forces, atol=1e-4 * max(1.0, np.abs(forces).max()))
