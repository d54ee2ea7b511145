"""Symmetries and conserved quantities: equations (23) to (28)."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mechanisms import FLOATING, floating, random_case, random_state, rate_along, robot, seeds

from wbc_controller import mechanics as wbm


@pytest.mark.parametrize("name", FLOATING)
def test_space_is_symmetric_but_for_gravity(name):
    model, rng = robot(name), np.random.default_rng(4)
    states = [random_state(model, rng) for _ in range(5)]
    point, weightless = np.array([0.3, -0.2, 0.5]), model.copy()
    weightless.gravity = pin.Motion.Zero()
    for axis, level in zip(np.eye(3), (True, True, False), strict=True):
        for symmetry, holds in ((wbm.translation(model, axis), level), (wbm.rotation(model, axis, point), not level)):
            report = wbm.check_symmetry(model, states, symmetry)
            assert report.invariant == holds, report.variation
            assert not holds or report.variation < 1e-8
        for symmetry in (wbm.translation(weightless, axis), wbm.rotation(weightless, axis, point)):
            assert wbm.check_symmetry(weightless, states, symmetry).invariant  # all directions are equal


@settings(max_examples=20)
@given(floating, seeds)
def test_the_conserved_quantities_are_the_momenta(name, seed):
    model, _, q, v = random_case(name, seed)
    com = np.array(pin.centerOfMass(model, model.createData(), q))
    # Rotors (armature) do not contribute to the centroidal momentum.
    momentum = wbm.centroidal_momentum(model, q, v)
    scale = max(1.0, np.abs(momentum).max())
    for axis in range(3):
        along = wbm.conserved_quantity(model, q, v, wbm.translation(model, np.eye(3)[axis]))
        about = wbm.conserved_quantity(model, q, v, wbm.rotation(model, np.eye(3)[axis], com))
        assert along == pytest.approx(momentum[axis], abs=1e-9 * scale)
        assert about == pytest.approx(momentum[3 + axis], abs=1e-9 * scale)


@settings(max_examples=25)
@given(st.sampled_from((*FLOATING, "panda")), seeds)
def test_momentum_changes_by_the_broken_symmetry_and_by_forces(name, seed):
    """d/dt(pᵀδq) = δL + δqᵀf for any field δq(q): (27) with a force."""
    model, rng, q, v = random_case(name, seed)
    force = 5.0 * rng.normal(size=model.nv)
    v_dot = wbm.forward_dynamics(model, q, v, force)
    constant, mix = rng.normal(size=model.nv), rng.normal(size=(model.nv, model.nq)) / model.nq

    def field(at):
        return constant + mix @ np.sin(at)

    rate = rate_along(lambda q, v: wbm.conserved_quantity(model, q, v, field), model, q, v, v_dot)
    expected = wbm.lagrangian_variation(model, q, v, field) + field(q) @ force
    assert rate == pytest.approx(expected, abs=1e-3 * max(1.0, abs(rate), np.abs(v_dot).max()))


def test_an_arm_on_an_upright_axis_keeps_its_momentum():
    model, rng = robot("panda"), np.random.default_rng(0)
    states = [random_state(model, rng) for _ in range(4)]
    assert wbm.check_symmetry(model, states, wbm.joint_shift(model, "panda_joint1")).invariant
    assert not wbm.check_symmetry(model, states, wbm.joint_shift(model, "panda_joint2")).invariant
