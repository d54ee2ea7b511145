"""Coordinate invariance: one robot, two models, the same physics."""

import numpy as np
import pinocchio as pin
from hypothesis import given, settings
from mechanisms import FLOATING, links, names, random_state, robot, seeds

from wbc_controller import mechanics as wbm


def another(name, seed):
    """Robot; the same with random root link and joint order and half of its joints flipped; random q, v and force."""
    model, rng = robot(name), np.random.default_rng(seed)
    joints = [model.names[j] for j in range(1, model.njoints) if model.joints[j].nv == 1]
    root = str(rng.choice(joints)) if name in FLOATING else None
    flip = [joint for joint in joints if rng.random() < 0.5]
    other = wbm.change_coordinates(model, root=root, flip=flip, shuffle=int(rng.integers(1000)))
    return model, other, rng, *random_state(model, rng), 20.0 * rng.normal(size=model.nv)


def close(a, b, scale=None):
    a, b = np.asarray(a), np.asarray(b)
    return np.abs(a - b).max() < 1e-8 * max(1.0, np.abs(b).max() if scale is None else scale)


@settings(max_examples=30)
@given(names, seeds)
def test_the_same_physics(name, seed):
    model, other, _, q, v, force = another(name, seed)
    q2, v2, force2 = other.configuration(q), other.velocity(q, v), other.force(q, force)
    a, b = wbm.Kinematics(model, q, v), wbm.Kinematics(other.model, q2, v2)
    for frame in links(model):
        assert a.placement(frame).isApprox(b.placement(frame), 1e-10)
        assert close(b.body(frame, pin.SE3.Identity())[1], a.body(frame, pin.SE3.Identity())[1])
    # Scalars are equal; vectors and covectors transform by the map and its derivative (Lemma 1).
    for scalar in (wbm.kinetic_energy, wbm.hamiltonian, wbm.lagrangian):
        assert close(scalar(other.model, q2, v2), scalar(model, q, v))
    assert close(wbm.potential_energy(other.model, q2), wbm.potential_energy(model, q))
    assert close(wbm.centroidal_momentum(other.model, q2, v2), wbm.centroidal_momentum(model, q, v))
    assert close(wbm.generalized_momentum(other.model, q2, v2), other.force(q, wbm.generalized_momentum(model, q, v)))
    assert close(wbm.generalized_gravity(other.model, q2), other.force(q, wbm.generalized_gravity(model, q)))
    T = other.jacobian(q)
    assert close(T.T @ wbm.mass_matrix(other.model, q2) @ T, wbm.mass_matrix(model, q))
    v_dot = wbm.forward_dynamics(model, q, v, force)
    v_dot2 = wbm.forward_dynamics(other.model, q2, v2, force2)
    assert close(v_dot2, other.acceleration(q, v, v_dot))
    scale = np.abs(wbm.bias_force(model, q, v)).max() + 20
    assert close(wbm.inverse_dynamics(other.model, q2, v2, v_dot2), force2, scale)
    assert close(wbm.hamiltonian_rate(other.model, q2, v2, v_dot2), wbm.hamiltonian_rate(model, q, v, v_dot), 1e2)
    rate = wbm.centroidal_momentum_rate(model, q, v, v_dot)
    assert close(wbm.centroidal_momentum_rate(other.model, q2, v2, v_dot2), rate, np.abs(v_dot).max())


@settings(max_examples=40)
@given(names, seeds)
def test_the_same_contact_forces(name, seed):
    model, other, rng, q, v, force = another(name, seed)
    first, second = (str(f) for f in rng.choice(links(model), 2, replace=False))
    # Velocities need not satisfy the constraints.
    contacts = [
        wbm.SurfaceContact(frame=first, time_constant=0.2, target=wbm.Kinematics(model, q, v).placement(first)),
        wbm.PointContact(frame=second, offset=np.array([0.05, 0.0, 0.1])),
        wbm.Rolling(frame=second, radius=0.1),
    ]
    equation = wbm.constraint_equation(contacts, wbm.Kinematics(model, q, v))
    singular = np.linalg.svd(equation.A, compute_uv=False)
    if np.any((singular < 1e-3 * singular[0]) & (singular > 1e-11 * singular[0])):
        return  # nearly singular: tested with Gauss's principle
    # Random constraints may be inconsistent: project b.
    if np.linalg.matrix_rank(equation.A, 1e-9) < len(equation.A):
        contacts = contacts[:2]
        equation = wbm.constraint_equation(contacts, wbm.Kinematics(model, q, v))
        if np.linalg.matrix_rank(equation.A, 1e-9) < len(equation.A):
            return
    wrench = [wbm.ExternalWrench(first, rng.normal(size=6), axes) for axes in ("LOCAL", "LOCAL_WORLD_ALIGNED", "WORLD")]
    q2, v2 = other.configuration(q), other.velocity(q, v)
    external, external2 = wbm.generalized_force(model, q, wrench), wbm.generalized_force(other.model, q2, wrench)
    assert close(external2, other.force(q, external))
    motion = wbm.constrained_dynamics(model, q, v, force + external, contacts)
    motion2 = wbm.constrained_dynamics(other.model, q2, v2, other.force(q, force) + external2, contacts)
    assert close(motion2.v_dot, other.acceleration(q, v, motion.v_dot))
    assert close(motion2.multipliers, motion.multipliers)  # physical forces are equal
    assert close(motion2.constraint_force, other.force(q, motion.constraint_force))


def test_limits_and_rotors_go_along():
    model = robot("go2")
    flip = ["RR_hip_joint", "FL_thigh_joint"]
    other = wbm.change_coordinates(model, root="FL_calf_joint", flip=flip, shuffle=1).model
    for name, sign in (("RR_hip_joint", -1.0), ("RR_calf_joint", 1.0), ("FL_thigh_joint", -1.0)):
        a, b = model.joints[model.getJointId(name)], other.joints[other.getJointId(name)]
        bounds = sorted(sign * x[a.idx_q] for x in (model.lowerPositionLimit, model.upperPositionLimit))
        assert [other.lowerPositionLimit[b.idx_q], other.upperPositionLimit[b.idx_q]] == bounds
        assert other.upperEffortLimit[b.idx_v] == model.upperEffortLimit[a.idx_v]
        assert other.armature[b.idx_v] == model.armature[a.idx_v]
