"""Gauss's principle compared with Udwadia–Kalaba, Pinocchio and its definition."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import event, example, given, note, reject, settings
from mechanisms import names, random_case, random_constraints, seeds

from wbc_controller import mechanics as wbm
from wbc_controller.errors import NoSolution

#: Condition number of A above which the tolerance is 1e-6 in place of 1e-8.
ILL_CONDITIONED = 1.0e3
#: Relative singular values of A between rounding and this share make the rank ambiguous: not compared (romeo 5281 and
#: 632485).
UNDECIDED, ROUNDING = 1.0e-9, 1.0e-13


def relative(a, b):
    return np.linalg.norm(np.asarray(a) - np.asarray(b)) / max(1.0, np.linalg.norm(b))


def problem(name, seed):
    """M, v̇ᵤ, A, b of a random robot, state, torque and consistent constraints."""
    model, rng, q, v = random_case(name, seed)
    np.random.seed(seed % 2**32)  # pin.SE3.Random
    pin.seed(seed % 2**31)
    force = 20.0 * rng.normal(size=model.nv)
    equation = wbm.constraint_equation(random_constraints(model, rng), wbm.Kinematics(model, q, v, rng.uniform(0, 2)))
    A, b = equation.A, equation.b
    # Random constraints may be inconsistent.
    U, s, _ = np.linalg.svd(A)
    if ((s > ROUNDING * s[0]) & (s < UNDECIDED * s[0])).any():
        reject()
    rank = int(np.sum(s > max(1e-10 * s[0], 1e-12)))
    b = U[:, :rank] @ (U[:, :rank].T @ b)
    return wbm.mass_matrix(model, q), wbm.forward_dynamics(model, q, v, force), A, b, rng


@settings(max_examples=60)
@given(names, seeds)
@example("talos", 3000534)  # condition number 3e8
def test_gauss_is_udwadia_kalaba_and_pinocchio(name, seed):
    M, free, A, b, _ = problem(name, seed)
    motion = wbm.gauss(M, free, A, b)
    note(f"{name}: condition number of A {motion.condition:.3g}, rank {motion.rank} of {len(A)} rows")
    event("ill-conditioned" if motion.condition > ILL_CONDITIONED else "well-conditioned")
    event("redundant" if motion.rank < len(A) else "full rank")
    tolerance = 1e-6 if motion.condition > ILL_CONDITIONED else 1e-8
    assert relative(wbm.udwadia_kalaba(M, free, A, b), motion.v_dot) < tolerance, f"condition {motion.condition:.3g}"
    if motion.rank == len(A):
        # Pinocchio factors A M⁻¹Aᵀ with the squared condition number, and is less accurate.
        tolerance = max(tolerance, 1e-15 * motion.condition**2)
        model, _, q, v = random_case(name, seed)
        data = model.createData()
        force = M @ free + wbm.bias_force(model, q, v)
        theirs = pin.forwardDynamics(model, data, q, v, force, A, -b, 0.0)
        assert relative(theirs, motion.v_dot) < tolerance, f"condition {motion.condition:.3g}"
        assert relative(data.lambda_c, motion.multipliers) < tolerance, f"condition {motion.condition:.3g}"


@settings(max_examples=60)
@given(names, seeds)
@example("icub", 5904289)  # nearly redundant constraints, with multipliers of 3e14
def test_constraints_hold_and_their_forces_do_no_work(name, seed):
    M, free, A, b, rng = problem(name, seed)
    motion = wbm.gauss(M, free, A, b)
    scale = max(1.0, np.abs(b).max(), np.abs(motion.v_dot).max())
    assert np.abs(A @ motion.v_dot - b).max() < 1e-9 * scale
    N = wbm.admissible_directions(A)
    assert np.abs(A @ N).max(initial=0.0) < 1e-12 * max(1.0, np.abs(A).max())
    if N.shape[1]:
        directions = N @ rng.normal(size=(N.shape[1], 20))
        directions /= np.linalg.norm(directions, axis=0)
        size = max(1.0, np.linalg.norm(motion.constraint_force))
        assert np.abs(motion.constraint_force @ directions).max() < 1e-10 * size
    assert relative(M @ motion.v_dot, M @ free + motion.constraint_force) < 1e-9
    # With nearly redundant constraints, products of large multipliers contain rounding errors.
    rounding = max(A.shape) * np.finfo(float).eps * np.linalg.norm(np.abs(A).T @ np.abs(motion.multipliers))
    rounding /= max(1.0, np.linalg.norm(motion.constraint_force))
    assert relative(A.T @ motion.multipliers, motion.constraint_force) < max(1e-9, rounding)
    least = wbm.gauss_functional(M, motion.v_dot, free)
    for size in (1e-3, 1e-1, 10.0):  # no feasible perturbation lowers the functional
        other = motion.v_dot + size * N @ rng.normal(size=N.shape[1])
        assert wbm.gauss_functional(M, other, free) >= least * (1.0 - 1e-12)


@settings(max_examples=40)
@given(names, seeds)
def test_redundancy_changes_no_motion_and_the_multipliers_are_shortest(name, seed):
    M, free, A, b, rng = problem(name, seed)
    once = wbm.gauss(M, free, A, b)
    if not once.rank:
        return  # a link welded to itself: rounding errors only
    mix = rng.normal(size=(3, len(A)))
    more = wbm.gauss(M, free, np.vstack([A, mix @ A, A[:1]]), np.concatenate([b, mix @ b, b[:1]]))
    tolerance = 1e-6 if once.condition > ILL_CONDITIONED else 1e-8
    assert more.rank == once.rank
    assert relative(more.v_dot, once.v_dot) < tolerance
    assert relative(more.constraint_force, once.constraint_force) < tolerance
    shortest = np.linalg.pinv(np.vstack([A, mix @ A, A[:1]]).T, rcond=1e-10) @ (M @ (more.v_dot - free))
    assert relative(more.multipliers, shortest) < tolerance


def test_constraint_independent_of_the_motion():
    """A link welded to itself yields rounding errors, not constraints."""
    A = 1e-15 * np.random.default_rng(0).normal(size=(6, 5))
    free = np.arange(5.0)
    motion = wbm.gauss(np.eye(5), free, A, np.zeros(6))
    assert motion.rank == 0
    assert np.allclose(motion.v_dot, free)
    assert np.allclose(wbm.udwadia_kalaba(np.eye(5), free, A, np.zeros(6)), free)
    with pytest.raises(NoSolution):
        wbm.gauss(np.eye(5), free, A, np.ones(6))


def test_the_same_answer_solves_the_equations_that_a_program_gets():
    model, rng, q, v = random_case("talos", 5)
    tau = rng.normal(size=model.nv - 6)
    S = np.eye(model.nv)[6:]
    contacts = [wbm.SurfaceContact(frame="left_sole_link"), wbm.PointContact(frame="right_sole_link")]
    motion = wbm.constrained_dynamics(model, q, v, S.T @ tau, contacts)
    equation = wbm.constraint_equation(contacts, wbm.Kinematics(model, q, v))
    M, h = wbm.mass_matrix(model, q), wbm.bias_force(model, q, v)
    E, e = wbm.contact_dynamics_equations(M, h, S, equation.A, equation.b)
    x = np.concatenate([motion.v_dot, tau, motion.multipliers])
    assert np.abs(E @ x - e).max() < 1e-8 * max(1.0, np.abs(x).max())


def test_contradicting_constraints_are_named():
    A = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    with pytest.raises(NoSolution, match=r"row \d requires .*, best value 0\.5") as caught:
        wbm.gauss(np.eye(3), np.zeros(3), A, np.array([0.0, 1.0]))
    assert caught.value.problem[0] is not None
    C = np.array([[1.0, 0.0], [-1.0, 0.0]])
    with pytest.raises(NoSolution):
        wbm.gauss_unilateral(np.eye(2), np.zeros(2), np.zeros((0, 2)), np.zeros(0), C, np.ones(2))


@settings(max_examples=30)
@given(names, seeds)
def test_pushing_contacts_are_least_constraint_too(name, seed):
    """By the conditions (32), which are sufficient."""
    M, free, A, b, rng = problem(name, seed)
    N = wbm.admissible_directions(A)
    if N.shape[1] < 6:
        return
    C = rng.normal(size=(4, len(M)))
    C[3] = C[0]  # one of them twice
    d = 5.0 * rng.normal(size=4)
    d[3] = d[0]
    motion = wbm.gauss_unilateral(M, free, A, b, C, d)
    gap = C @ motion.v_dot - d
    scale = max(1.0, np.abs(motion.v_dot).max(), np.abs(d).max())
    assert (motion.push >= 0.0).all()
    assert gap.min() > -1e-8 * scale
    assert np.abs(motion.push * gap).max() < 1e-7 * scale * max(1.0, motion.push.max())
    assert np.abs(A @ motion.v_dot - b).max() < 1e-8 * scale
    assert relative(M @ (motion.v_dot - free), motion.constraint_force + motion.push_force) < 1e-8
    assert np.abs(motion.constraint_force @ N).max() < 1e-8 * max(1.0, np.linalg.norm(motion.constraint_force))
    np.testing.assert_array_equal(motion.push_force, C.T @ motion.push)
