"""Structural reduction: particles on rods in one stage, in two, and in generalized coordinates (S9)."""

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller import mechanics as wbm

NOTHING = (np.zeros((0, 6)), np.zeros(0))


def double_pendulum(masses=(1.2, 0.7), lengths=(0.5, 0.8)):
    """Double pendulum as particles on rods in the plane y = 0, and as a model in joint angles."""
    system = wbm.ParticleSystem(np.array(masses), [wbm.Rod(0, np.zeros(3), lengths[0]), wbm.Rod(1, 0, lengths[1])])
    model = pin.Model()
    parent, before = 0, 0.0
    for index, (mass, length) in enumerate(zip(masses, lengths, strict=True)):
        placement = pin.SE3(np.eye(3), np.array([0.0, 0.0, -before]))
        parent = model.addJoint(parent, pin.JointModelRY(), placement, f"joint{index}")
        bob = pin.Inertia(mass, np.array([0.0, 0.0, -length]), np.zeros((3, 3)))
        model.appendBodyToJoint(parent, bob, pin.SE3.Identity())
        tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, -length]))
        model.addFrame(pin.Frame(f"bob{index}", parent, 0, tip, pin.BODY))
        before = length
    return system, model


def positions(model, q, v):
    """φ(q), ẋ, ∂φ/∂q and its rate times v, for all particles: (2, 3), (2, 3), (6, 2), (6,)."""
    data = model.createData()
    pin.forwardKinematics(model, data, q, v, np.zeros(2))
    pin.computeJointJacobians(model, data)
    pin.updateFramePlacements(model, data)
    frames = [model.getFrameId(f"bob{i}") for i in range(2)]
    axes = pin.LOCAL_WORLD_ALIGNED
    J = np.vstack([pin.getFrameJacobian(model, data, f, axes)[:3] for f in frames])
    drift = np.concatenate([pin.getFrameClassicalAcceleration(model, data, f, axes).linear for f in frames])
    return np.array([data.oMf[f].translation for f in frames]), (J @ v).reshape(2, 3), J, drift


def in_the_plane(system, x, x_dot):
    """Rods and plane y = 0."""
    A, b = wbm.rod_constraints(system, x, x_dot)
    plane = np.zeros((2, 6))
    plane[0, 1] = plane[1, 4] = 1.0
    return np.vstack([A, plane]), np.concatenate([b, np.zeros(2)])


@pytest.mark.parametrize("seed", range(60))
def test_one_stage_two_stages_and_generalized_coordinates_agree(seed):
    rng = np.random.default_rng(seed)
    system, model = double_pendulum(rng.uniform(0.3, 2.0, 2), rng.uniform(0.3, 1.0, 2))
    q, v = rng.uniform(-3, 3, 2), rng.normal(size=2)
    x, x_dot, J, drift = positions(model, q, v)
    structure = in_the_plane(system, x, x_dot)
    forces = 3.0 * rng.normal(size=(2, 3))
    forces[:, 1] = 0.0
    # Contact: the last bob slides along a line.
    normal = np.concatenate([np.zeros(3), [np.cos(0.4), 0.0, np.sin(0.4)]])[None, :]
    for contact in (NOTHING, (normal, np.array([0.7]))):
        one = wbm.solve_in_one_stage(system, structure, contact, forces)
        two = wbm.solve_in_two_stages(system, structure, contact, forces)
        scale = max(1.0, np.abs(one.v_dot).max())
        assert np.abs(one.v_dot - two.v_dot).max() < 1e-8 * scale
        assert np.allclose(one.multipliers[4:], two.multipliers, atol=1e-8 * max(1.0, np.abs(one.multipliers).max()))
        M = wbm.mass_matrix(model, q)
        free = wbm.forward_dynamics(model, q, v, J.T @ forces.reshape(-1))
        joint = wbm.gauss(M, free, contact[0] @ J, contact[1] - contact[0] @ drift)
        assert np.abs(J @ joint.v_dot + drift - one.v_dot).max() < 1e-7 * scale
        assert np.allclose(joint.multipliers, two.multipliers, atol=1e-7 * max(1.0, np.abs(one.multipliers).max()))


@pytest.mark.parametrize("seed", range(40))
def test_with_the_generalized_basis_the_reduction_is_the_equations_of_motion(seed):
    """M = (∂φ/∂q)ᵀ M_x ∂φ/∂q, without structural forces: (19) and section 4.2.1."""
    rng = np.random.default_rng(seed)
    system, model = double_pendulum()
    q, v = rng.uniform(-3, 3, 2), rng.normal(size=2)
    x, x_dot, J, drift = positions(model, q, v)
    reduced = wbm.reduce_structure(system, in_the_plane(system, x, x_dot), basis=J)
    assert np.allclose(reduced.M, wbm.mass_matrix(model, q), atol=1e-10)
    assert np.allclose(J.T @ wbm.particle_mass_matrix(system) @ J, reduced.M, atol=1e-12)
    # ẍ = J q̈ + J̇ q̇ = particular + J a.
    q_ddot = np.linalg.solve(wbm.mass_matrix(model, q), -wbm.bias_force(model, q, v))
    assert np.allclose(reduced.particular + J @ reduced.a_u, J @ q_ddot + drift, atol=1e-7)


def test_the_motion_is_the_same_over_time():
    """Integrate two seconds as particles and in joint angles."""
    system, model = double_pendulum()
    q, v = np.array([0.9, -0.4]), np.array([0.3, 1.0])
    x, x_dot, _, _ = positions(model, q, v)
    zero = np.zeros(2)
    step, steps = 2.5e-3, 800
    qs, vs = wbm.simulate(model, lambda q, v, t: wbm.forward_dynamics(model, q, v, zero), q, v, step, steps)
    expected = positions(model, qs[-1], vs[-1])[0]

    def follow(solve):
        def rates(state):
            A, b = wbm.rod_constraints(system, state[0], state[1], time_constant=0.1)
            return np.array([state[1], solve(system, (A, b), NOTHING).v_dot.reshape(2, 3)])

        state = np.array([x, x_dot])
        for _ in range(steps):
            k1 = rates(state)
            k2 = rates(state + 0.5 * step * k1)
            k3 = rates(state + 0.5 * step * k2)
            state = state + step / 6.0 * (k1 + 2 * k2 + 2 * k3 + rates(state + step * k3))
        return state[0]

    one, two = follow(wbm.solve_in_one_stage), follow(wbm.solve_in_two_stages)
    assert np.abs(one - two).max() < 1e-9
    assert np.abs(one - expected).max() < 1e-6


def test_a_rigid_tetrahedron_is_a_rigid_body():
    """Four particles and six rods are a rigid body; without gravity momentum is conserved."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    rods = [wbm.Rod(i, j, float(np.linalg.norm(corners[i] - corners[j]))) for i in range(4) for j in range(i)]
    system = wbm.ParticleSystem(np.array([1.0, 2.0, 3.0, 4.0]), rods, np.zeros(3))
    omega, velocity = np.array([0.3, -0.5, 0.8]), np.array([0.1, 0.2, 0.3])
    x_dot = velocity + np.cross(omega, corners)
    structure = wbm.rod_constraints(system, corners, x_dot)
    reduced = wbm.reduce_structure(system, structure)
    assert reduced.M.shape == (6, 6)
    x_ddot = wbm.solve_in_one_stage(system, structure, (np.zeros((0, 12)), np.zeros(0))).v_dot.reshape(4, 3)
    assert np.allclose(system.masses @ x_ddot, 0.0, atol=1e-10)
    assert np.allclose((system.masses[:, None] * np.cross(corners, x_ddot)).sum(axis=0), 0.0, atol=1e-10)
    com = system.masses @ corners / system.masses.sum()
    r = corners - com
    inertia = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(system.masses, r, strict=True))
    alpha = np.linalg.solve(inertia, -np.cross(omega, inertia @ omega))  # Euler's equation
    expected = np.cross(alpha, r) + np.cross(omega, np.cross(omega, r))
    assert np.allclose(x_ddot, expected, atol=1e-9)
