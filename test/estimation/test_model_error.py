"""Disturbance observer and friction compensation, by their equations and on robots."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller import Simulation
from wbc_controller.estimation.disturbance_observer import DisturbanceLimits, DisturbanceObserver
from wbc_controller.estimation.friction import FrictionCompensation
from wbc_controller.estimation.model_error import ModelErrorCompensation
from wbc_controller.estimation.projection import mobility, split_force
from wbc_controller.records import RobotState
from wbc_controller.settings.config import load

LIMITS = DisturbanceLimits(time_constant=0.5, share=0.2)


@pytest.fixture(scope="module")
def model(robot_of):
    return robot_of("go2")[1]


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), nv=st.integers(2, 12), rows=st.integers(0, 6), double=st.booleans())
def test_the_free_part_does_what_the_force_does_on_the_contacts(seed, nv, rows, double):
    rng = np.random.default_rng(seed)
    A, J, r = rng.normal(size=(nv, nv)), rng.normal(size=(min(rows, nv - 1), nv)), rng.normal(size=nv)
    M = A @ A.T + np.eye(nv)
    J = np.vstack([J, J[:1]]) if double else J  # rows need not be independent
    inverse = np.linalg.inv(M)
    N = np.eye(nv) - inverse @ J.T @ np.linalg.pinv(J @ inverse @ J.T) @ J
    np.testing.assert_allclose(split_force(M, J, r)[0], N.T @ r, atol=1e-5)
    np.testing.assert_allclose(mobility(M, J), np.diag(N @ inverse), atol=1e-5)
    np.testing.assert_allclose(J @ inverse @ split_force(M, J, r)[0], 0.0, atol=1e-5)  # it moves no contact
    np.testing.assert_allclose(J.T @ split_force(M, J, r)[1], r - N.T @ r, atol=1e-5)


def stood(**changes):
    """Return a simulation of a standing Go2 without noise."""
    return Simulation(load("go2").replace(changes), preflight=False)


def fed(observer, model, missed, seconds, gap=0.002):
    M, J = np.eye(model.nv), np.zeros((0, model.nv))
    for _ in range(round(seconds / gap)):
        observer.update(M, J, (), gap, gap * missed)


def test_disturbance_time_constant_and_bound(model):
    observer = DisturbanceObserver(model, LIMITS)
    knee = model.v_index[model.joints.index("FL_calf_joint")]
    missed = np.zeros(model.nv)
    missed[knee] = 1.0  # N·m, as M is the unit matrix
    fed(observer, model, missed, 0.5)
    assert observer.forces[knee] == pytest.approx(0.5 / 0.5 * (1.0 - 0.02), rel=0.005)  # ∫ r / T, less the leak
    assert np.count_nonzero(observer.forces) == 1
    assert observer.at_bound == ()
    fed(observer, model, missed, 20.0)
    bound = 0.2 * model.effort_limits[model.actuators.index("FL_calf_joint")]
    assert observer.forces[knee] == pytest.approx(min(bound, 25.0 * (1.0 - np.exp(-20.5 / 12.5))), rel=0.02)
    fed(observer, model, 10.0 * missed, 5.0)
    assert observer.forces[knee] == pytest.approx(bound)
    assert observer.at_bound == ("FL_calf_joint",)
    fed(observer, model, 0.0 * missed, 5.0)  # the clamped part decays within a few T, the rest in 25
    rest = observer.forces[knee]
    assert 0.5 * bound < rest < bound
    assert observer.at_bound == ()
    fed(observer, model, 0.0 * missed, 12.5)
    assert observer.forces[knee] == pytest.approx(rest * np.exp(-1.0), rel=0.02)


def test_anti_windup(model):
    """A clamped residual also appears along other components."""
    rng, nv, gap = np.random.default_rng(4), model.nv, 0.002
    A, J = rng.normal(size=(nv, nv)), rng.normal(size=(9, nv))
    M = A @ A.T + np.eye(nv)
    observer = DisturbanceObserver(model, DisturbanceLimits(time_constant=0.05, share=0.2))
    most = 0.2 * np.concatenate([np.full(6, np.inf), model.effort_limits])
    lacking = split_force(M, J, rng.normal(size=nv))[0]
    lacking *= 1.2 * np.min(most / np.abs(lacking))  # one joint above its bound
    for _ in range(5000):
        observer.update(M, J, ("feet",), gap, gap * split_force(M, J, lacking - observer.forces)[0])
    (joint,) = observer.at_bound
    expected = 25.0 / 26.0 * lacking  # the leak takes the rest
    expected[model.v_index[model.joints.index(joint)]] *= 26.0 / 25.0 / 1.2
    np.testing.assert_allclose(observer.forces, expected, atol=1e-3 * np.abs(expected).max())


def test_decay_after_switching_off(model):
    observer = DisturbanceObserver(model, LIMITS)
    fed(observer, model, np.full(model.nv, 0.5), 0.2)
    observer.limits, before, steps = DisturbanceLimits(0.5, 0.2, on=False), observer.forces.copy(), []
    assert not observer.is_idle
    while not observer.is_idle:
        past = observer.forces
        fed(observer, model, np.ones(model.nv), 0.01)
        steps.append(np.abs(observer.forces - past).max())
    assert max(steps) < 0.05 * np.abs(before).max()  # no jump
    assert 0.5 < 0.01 * len(steps) < 5.0


def test_sums_are_dropped_at_contact_changes(model):
    observer = DisturbanceObserver(model, LIMITS)
    M, J = np.eye(model.nv), np.zeros((0, model.nv))
    for contacts in (("a",), ("b",), ("a",), ("b",)):  # shorter than a sum
        observer.update(M, J, contacts, 0.004, np.ones(model.nv))
        observer.update(M, J, contacts, 0.004, np.ones(model.nv))
    assert not observer.forces.any()


def estimated(model, *, rows=(), gap=0.002, sent=1.0, relaxed=(), growing=None):
    """Return the estimate for a growing velocity without prediction, with M = I."""
    compensation, nv = ModelErrorCompensation(DisturbanceObserver(model, LIMITS), None, None, 0.002), model.nv
    tau, J = np.ones(model.na), np.eye(nv)[list(rows)]
    solution = SimpleNamespace(v_dot=np.zeros(nv), tau=tau, forces={"foot": None}, relaxed=relaxed)
    dynamics, growing = SimpleNamespace(M=np.eye(nv), model=model), np.ones(nv) if growing is None else growing
    for i in range(20):
        state = RobotState(1 + round(1e9 * gap * i), np.zeros(model.nq), gap * i * growing)
        compensation.update(state)
        compensation.record_command(state, solution, None if sent is None else sent * tau, dynamics, lambda contacts: J)
    return compensation.observer.forces


def test_contact_forces_are_not_disturbances(model):
    found = estimated(model, rows=[3, 7])
    np.testing.assert_allclose(found[[3, 7]], 0.0, atol=1e-6)
    assert (np.delete(found, [3, 7]) > 0.01).all()


@pytest.mark.parametrize("sent", [0.5, 1.2])
def test_torques_other_than_the_programs_count_as_they_were_sent(model, sent):
    moved = model.actuation.generalized_force((sent - 1.0) * np.ones(model.na))
    np.testing.assert_allclose(estimated(model, sent=sent, growing=moved), 0.0, atol=1e-12)
    np.testing.assert_allclose(estimated(model, sent=sent, growing=moved + 1.0), estimated(model), rtol=1e-9)


@pytest.mark.parametrize("reason", [{"gap": 0.008}, {"sent": None}, {"relaxed": ("limit",)}])
def test_no_estimate_after_dropped_states_or_without_torques(model, reason):
    assert not estimated(model, **reason).any()


def test_friction_compensation_at_rest_and_in_motion(model):
    joint = model.joints[3]
    index = model.v_index[3]
    friction = FrictionCompensation(model, {joint: 2.0}, {joint: 0.5})
    M, J, v = 10.0 * np.eye(model.nv), np.zeros((0, model.nv)), np.zeros(model.nv)
    friction.update(M, J, (), v, 0.002, np.zeros(model.nv))
    assert not friction.forces.any()
    for _ in range(200):  # sticking joint, QP with 1 rad/s²
        friction.update(M, J, (), v, 0.002, np.full(model.nv, 0.002))
    assert friction.forces[index] == pytest.approx(-2.0, rel=0.01)
    assert np.count_nonzero(friction.forces) == 1
    v[index] = 1.0
    friction.update(M, J, (), v, 0.002, None)
    assert friction.forces[index] == pytest.approx(-2.5, rel=0.01)
    light = FrictionCompensation(model, {joint: 2.0}, {})
    v[index] = 0.02
    light.update(1e-3 * np.eye(model.nv), J, (), v, 0.002, None)
    assert abs(light.forces[index]) < 0.02  # reduced at a light joint


def lowered(simulation, depth=0.03):
    """Squat, and return the error of the centre of mass, m."""
    com = simulation.controller.dynamics.com.copy()
    simulation.controller.follow("com", [0.6], [com - [0.0, 0.0, depth]])
    simulation.run(1.2)
    return float(np.abs(simulation.controller.dynamics.com - com + [0.0, 0.0, depth]).max())


def test_known_friction_is_compensated_and_unknown_friction_estimated():
    known = {joint: {"dry": 2.0} for joint in stood().controller.model.joints}
    simulation = stood(**{"mock.joint_friction": 2.0, "robot.friction": known})
    assert lowered(simulation) < 0.003
    errors = {}
    for on in ("never", "always"):
        simulation = stood(**{"mock.joint_friction": 1.0, "estimation.disturbance": on})
        errors[on] = lowered(simulation)
        if on == "always":
            solution = simulation.result.solution
            assert np.abs(solution.disturbance.estimate[simulation.controller.model.v_index]).max() < 5.0
    assert errors["always"] < 0.7 * errors["never"]
    assert errors["never"] > 0.005


def test_switching_it_while_the_robot_stands_makes_no_jump():
    simulation = stood(**{"mock.joint_friction": 1.0})
    simulation.run(0.1)
    model = simulation.controller.model
    steps, last = [], [simulation.result.tau]

    def check(_):
        steps.append(np.abs(simulation.result.tau - last[0]) / model.effort_limits)
        last[0] = simulation.result.tau

    simulation.controller.update({"estimation.disturbance": "always"})
    simulation.run(0.6, check)
    assert simulation.result.solution.disturbance.estimate.any()
    simulation.controller.update({"estimation.disturbance": "never"})
    simulation.run(0.1, check)
    assert simulation.result.solution.disturbance is not None  # it fades
    assert np.max(steps) < 0.01
    simulation.controller.reset(*simulation.plant.state(), simulation.time)
    simulation.run(0.01)
    assert simulation.result.solution.disturbance is None
