"""Equations of motion, external wrenches, energy and momentum."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from mechanisms import floating, links, names, random_case, rate_along, robot, seeds

from wbc_controller import mechanics as wbm
from wbc_controller.records import RobotState


@settings(max_examples=25)
@given(names, seeds)
def test_forward_and_inverse_dynamics_are_the_equations_of_motion(name, seed):
    model, rng, q, v = random_case(name, seed)
    v_dot = rng.normal(size=model.nv)
    M, h = wbm.mass_matrix(model, q), wbm.bias_force(model, q, v)
    assert np.array_equal(M, M.T)
    force = wbm.inverse_dynamics(model, q, v, v_dot)
    assert np.allclose(force, M @ v_dot + h, rtol=1e-10, atol=1e-9)
    assert np.allclose(wbm.forward_dynamics(model, q, v, force), v_dot, rtol=1e-8, atol=1e-8)
    assert np.allclose(wbm.bias_force(model, q, 0 * v), wbm.generalized_gravity(model, q), atol=1e-9)
    assert np.abs(wbm.equations_of_motion_residual(M, h, v_dot, force, 0 * v)).max() < 1e-8


def test_they_are_the_euler_lagrange_equation():
    """Equation (7) by finite differences of L, for an arm."""
    model, rng, q, v = random_case("panda", 1)
    a = rng.normal(size=model.nv)
    eps = 1e-4

    def gradient(function):
        return np.array([function(e) - function(-e) for e in eps * np.eye(9)]) / (2 * eps)

    def momentum(q, v):
        return gradient(lambda e: wbm.lagrangian(model, q, v + e))

    rate = (momentum(q + eps * v, v + eps * a) - momentum(q - eps * v, v - eps * a)) / (2 * eps)
    slope = gradient(lambda e: wbm.lagrangian(model, q + e, v))
    assert np.allclose(rate - slope, wbm.inverse_dynamics(model, q, v, a), atol=1e-5)
    assert np.allclose(momentum(q, v), wbm.generalized_momentum(model, q, v), atol=1e-8)


def test_actuation_matrix_order():
    model = robot("go2")
    S = wbm.actuation_matrix(model, ["RR_calf_joint", "FL_hip_joint"])
    assert S.shape == (2, model.nv)
    force = S.T @ np.array([2.0, 3.0])
    assert force[model.joints[model.getJointId("RR_calf_joint")].idx_v] == 2.0
    assert force[:6].tolist() == [0.0] * 6


@settings(max_examples=20)
@given(names, seeds)
def test_one_wrench_in_any_frame_is_one_generalized_force(name, seed):
    model, rng, q, v = random_case(name, seed)
    frame = str(rng.choice(links(model)))
    force, torque, point = rng.normal(size=(3, 3))  # in world axes, at a point of the world
    kinematics = wbm.Kinematics(model, q, v)
    placement = kinematics.placement(frame)
    R, arm = placement.rotation, point - placement.translation
    turn = np.kron(np.eye(2), R.T)
    at_point = np.concatenate([force, torque])
    ways = [
        wbm.ExternalWrench(frame, at_point, "WORLD", point),
        wbm.ExternalWrench(frame, at_point, "LOCAL_WORLD_ALIGNED", arm),
        wbm.ExternalWrench(frame, turn @ at_point, "LOCAL", R.T @ arm),
        wbm.ExternalWrench(frame, np.concatenate([force, torque + np.cross(point, force)]), "WORLD"),
        wbm.ExternalWrench(frame, np.concatenate([force, torque + np.cross(arm, force)])),
    ]
    answers = [wbm.generalized_force(model, q, [way]) for way in ways]
    for way, answer in zip(ways, answers, strict=True):
        assert np.allclose(answer, answers[0], atol=1e-10)
        assert np.allclose(wbm.world_wrench(model, q, [way]), ways[3].wrench, atol=1e-10)
    # Equation (21): equal power in coordinates and in the world.
    _, velocity, _, _ = kinematics.point(frame, R.T @ arm)
    omega = R @ kinematics.body(frame, pin.SE3.Identity()).twist[3:]
    assert wbm.power(v, answers[0]) == pytest.approx(force @ velocity + torque @ omega, abs=1e-9)


@settings(max_examples=20)
@given(names, seeds)
def test_energies_and_power(name, seed):
    model, rng, q, v = random_case(name, seed)
    data = model.createData()
    pin.forwardKinematics(model, data, q, v)
    bodies = sum(0.5 * data.v[j].vector @ (model.inertias[j] * data.v[j]).vector for j in range(1, model.njoints))
    rotors = 0.5 * model.armature @ (v * v)
    assert wbm.kinetic_energy(model, q, v) == pytest.approx(bodies + rotors)
    p = wbm.generalized_momentum(model, q, v)
    assert wbm.hamiltonian(model, q, v) == pytest.approx(p @ v - wbm.lagrangian(model, q, v))
    force = 10.0 * rng.normal(size=model.nv)
    wrench = wbm.ExternalWrench(str(rng.choice(links(model))), 10.0 * rng.normal(size=6), "LOCAL")
    applied = force + wbm.generalized_force(model, q, [wrench])
    v_dot = wbm.forward_dynamics(model, q, v, applied)
    rate = rate_along(lambda q, v: wbm.hamiltonian(model, q, v), model, q, v, v_dot)
    scale = max(1.0, np.abs(v).max() * np.abs(applied).max(), abs(wbm.hamiltonian(model, q, v)))
    assert wbm.hamiltonian_rate(model, q, v, v_dot) == pytest.approx(wbm.power(v, applied), abs=1e-9 * scale)
    assert rate == pytest.approx(wbm.power(v, applied), abs=1e-4 * scale)
    # Gradient of the potential energy: equation (2).
    eps = 1e-6
    slope = np.array([wbm.potential_energy(model, pin.integrate(model, q, e)) for e in eps * np.eye(model.nv)])
    slope -= [wbm.potential_energy(model, pin.integrate(model, q, -e)) for e in eps * np.eye(model.nv)]
    assert np.allclose(slope / (2 * eps), wbm.generalized_gravity(model, q), atol=1e-2)


@settings(max_examples=20)
@given(floating, seeds)
def test_centroidal_momentum_rate_is_the_external_wrench(name, seed):
    model, rng, q, v = random_case(name, seed)
    frames = [str(f) for f in rng.choice(links(model), 2, replace=False)]
    force = np.zeros(model.nv)
    force[6:] = 30.0 * rng.normal(size=model.nv - 6)
    contacts = [wbm.SurfaceContact(frame=frames[0]), wbm.PointContact(frame=frames[1], offset=np.array([0.1, 0, 0]))]
    equation = wbm.constraint_equation(contacts, wbm.Kinematics(model, q, v))
    if np.linalg.cond(equation.A) > 1e6:
        return
    motion = wbm.constrained_dynamics(model, q, v, force, contacts)
    arm = wbm.Kinematics(model, q, v).placement(frames[1]).rotation @ [0.1, 0.0, 0.0]
    wrenches = [
        wbm.ExternalWrench(frames[0], motion.multipliers[:6], "LOCAL"),
        wbm.ExternalWrench(frames[1], np.append(motion.multipliers[6:], np.zeros(3)), "LOCAL_WORLD_ALIGNED", arm),
    ]
    rate = wbm.centroidal_momentum_rate(model, q, v, motion.v_dot)
    expected = wbm.centroidal_wrench(model, q, wrenches)
    assert np.allclose(rate, expected, atol=1e-8 * max(1.0, np.abs(motion.multipliers).max()))
    total = wbm.generalized_force(model, q, wrenches)
    assert np.allclose(total, motion.constraint_force, atol=1e-7 * np.abs(rate).max())
    slope = rate_along(lambda q, v: wbm.centroidal_momentum(model, q, v), model, q, v, motion.v_dot)
    assert np.allclose(slope, rate, rtol=1e-4, atol=1e-3 * max(1.0, np.abs(rate).max()))


@settings(max_examples=20)
@given(floating, seeds)
def test_residuals_between_two_states_are_the_unknown_power_and_wrench(name, seed):
    model, rng, q, v = random_case(name, seed)
    force, step = 10.0 * rng.normal(size=model.nv) * (np.arange(model.nv) > 5), 1e-6
    known, unknown = (wbm.ExternalWrench(str(rng.choice(links(model))), 50.0 * rng.normal(size=6)) for _ in range(2))

    def acceleration(q, v, _):
        return wbm.forward_dynamics(model, q, v, force + wbm.generalized_force(model, q, [known, unknown]))

    states = zip(*wbm.simulate(model, acceleration, q, v, step, 1), strict=True)
    before, after = (RobotState(stamp, *state) for stamp, state in zip((1, 1001), states, strict=True))
    balance = wbm.energy_residual(model, before, after, force, [known])
    power = wbm.power(v, wbm.generalized_force(model, q, [unknown]))
    assert balance.residual == pytest.approx(power, abs=0.01 * balance.throughput)
    wrench = wbm.centroidal_wrench(model, q, [unknown]) - wbm.centroidal_wrench(model, q)
    assert wbm.momentum_residual(model, before, after, [known]).residual == pytest.approx(wrench, rel=0.01, abs=0.1)
