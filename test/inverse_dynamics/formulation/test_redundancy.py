"""Redundant contacts: solutions of all solvers, and residuals."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from demands import demand
from scipy.linalg import null_space

from wbc_controller import Simulation
from wbc_controller.apps.new.draft import new_configuration
from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.inverse_dynamics.contacts import Rectangle, placement_of
from wbc_controller.inverse_dynamics.formulation.redundancy import (
    EXAMINED_MOBILITY,
    LEAST_MOBILITY,
    mobilities,
    separate_redundant_rows,
)
from wbc_controller.mechanics import change_coordinates
from wbc_controller.records import RobotState
from wbc_controller.settings.config import load
from wbc_controller.validation.fuzz.hostile_classes import Grip
from wbc_controller.validation.fuzz.problems import rest

SOLO_8 = "package://example-robot-data/robots/solo_description/robots/solo.urdf"
SOLVERS = {"daqp": {}, "osqp": {"solver.name": "osqp"}, "levels": {"tasks.posture.level": 2, "tasks.base.level": 1}}


@cache
def drafted():
    return load(new_configuration(SOLO_8).settings)


def solo_8(solver="daqp"):
    """Solo 8: four point feet, legs without hip abduction."""
    return drafted().replace(SOLVERS[solver]).settings


def without_ankle_roll():
    """G1 with soles that rotate about one axis only."""
    g1 = load("g1")
    robot = g1.settings.robot
    kept = [i for i, joint in enumerate(robot.joints) if "ankle_roll" not in joint]
    return g1.replace({f"robot.{key}": [getattr(robot, key)[i] for i in kept] for key in ("joints", "posture")})


def leaning(robot, share):
    """Return the stance with left legs stretched by a share."""
    joints = np.array([1.0 - share if joint.startswith(("FL", "HL")) else 1.0 for joint in robot.model.joints])
    q = robot.stance.copy()
    q[robot.model.q_index] *= joints
    return q


def near(robot, rng):
    """Return a random state near the stance, with moving contacts."""
    return robot.near_stance(rng, position=0.03, velocity=0.2)


def contact_rows(robot, state):
    """Return J and b of the contacts at a state."""
    rows = robot.controller.formulation.build(state, robot.references()).contact_rows
    return rows[:, :-1], rows[:, -1]


@pytest.mark.parametrize("solver", SOLVERS)
def test_redundant_feet_have_a_least_squares_solution(bench, solver):
    robot = bench(solo_8(solver))
    rng, missed = np.random.default_rng(3), []
    for _ in range(8):
        state = near(robot, rng)
        solution = robot.controller.solve(state, robot.references())
        J, b = contact_rows(robot, state)
        off = J @ solution.v_dot - b
        assert solution.relaxed == ()
        assert solution.residuals["contact_motion"] == pytest.approx(np.abs(off).max(), abs=1e-9)
        assert solution.residuals["equations_of_motion"] < 1e-3 if solver == "osqp" else 1e-6
        values, u = mobilities(J, np.ones(len(J)), robot.controller.dynamics)
        assert (values < LEAST_MOBILITY).sum() in (1, 2)  # of 12: all feet together, and the lean near the level stance
        held = values >= LEAST_MOBILITY
        np.testing.assert_allclose(u[:, held].T @ off, 0.0, atol=1e-3 if solver == "osqp" else 1e-6)
        (exact,) = u[:, values < 1e-9].T  # no acceleration changes this component
        assert exact @ off == pytest.approx(-exact @ b, abs=1e-9)
        missed.append(np.abs(off).max())
    assert max(missed) > 1e-3


@pytest.mark.parametrize(
    ("make", "least"), [(solo_8, 2e-3), (lambda: solo_8("levels"), 2e-3), (without_ankle_roll, 8e-3)]
)
def test_robots_with_redundant_feet_sway(make, least):
    simulation = Simulation(make())
    controller = simulation.controller
    start = controller.dynamics.com.copy()
    controller.set("com", start + [0.0, 0.01, 0.0], duration=0.3)
    results = simulation.run(0.5)
    assert {result.solution.relaxed for result in results} == {()}
    assert least < controller.dynamics.com[1] - start[1] < 12e-3


def test_mobilities_do_not_depend_on_the_coordinates(bench):
    robot = bench(solo_8())
    q = leaning(robot, 0.2)
    robot.controller.dynamics.update(q, np.zeros(robot.model.nv))
    J = np.vstack([contact.jacobian(robot.controller.dynamics) for contact in robot.controller.contacts.values()])
    other = change_coordinates(robot.model.pinocchio, root="HR_HFE", flip=["FL_KFE"], shuffle=2)
    units = np.eye(robot.model.nv)
    T = np.column_stack([other.velocity(q, unit) for unit in units])  # velocities here = T times velocities there
    M = np.linalg.inv(T).T @ robot.controller.dynamics.M @ np.linalg.inv(T)
    there = np.linalg.eigvalsh(robot.model.mass * (J @ np.linalg.inv(T)) @ np.linalg.solve(M, (J @ np.linalg.inv(T)).T))
    values, _ = mobilities(J, np.ones(len(J)), robot.controller.dynamics)
    np.testing.assert_allclose(values, there, atol=1e-9 * there.max())
    assert values[1] < LEAST_MOBILITY < values[2]


def test_mimic_joints_reduce_the_mobility():
    """Velocities that C allows are N y: the mobility of J is that of J N with the mass matrix NᵀM N."""
    rng = np.random.default_rng(4)
    root, J, C = rng.normal(size=(7, 7)), rng.normal(size=(4, 7)), rng.normal(size=(2, 7))
    M, metric, N = root @ root.T + np.eye(7), np.array([1.0, 4.0, 1.0, 9.0]), null_space(C)
    model = SimpleNamespace(mass=3.0, actuation=SimpleNamespace(C=C))
    values, directions = mobilities(J, metric, SimpleNamespace(M=M, model=model))
    rows = J @ N / np.sqrt(metric)[:, None]
    expected = 3.0 * rows @ np.linalg.solve(N.T @ M @ N, rows.T)
    np.testing.assert_allclose(directions @ np.diag(values) @ directions.T, expected, atol=1e-12)


def test_solution_is_continuous_as_a_direction_becomes_a_constraint(bench):
    robot = bench(solo_8())
    references = robot.references()
    references = demand(references, "com", position=references.tasks["com"].position + [0.0, 0.01, 0.0])
    shares, answers, held = np.linspace(0.1, 0.6, 100), [], []
    for share in shares:
        state = robot.state(leaning(robot, share), 0.1 * np.eye(robot.model.nv)[3])
        answers.append(robot.controller.solve(state, references).tau)
        J, _ = contact_rows(robot, state)
        held.append(int((mobilities(J, np.ones(len(J)), robot.controller.dynamics)[0] >= LEAST_MOBILITY).sum()))
    assert (held[0], held[-1]) == (10, 11)
    steps = np.abs(np.diff(answers, axis=0)).max(axis=1)
    assert steps.max() < 4.0 * np.median(steps)


def test_contacts_with_full_rank_are_unchanged(bench):
    robot = bench("go2")
    layout = robot.controller.formulation.build(robot.state(), robot.references())
    dynamics = robot.controller.dynamics
    assert layout.contact_rows is None
    hard, soft = separate_redundant_rows(layout.J, layout.contact_motion, layout.metric, dynamics)
    assert np.array_equal(hard, np.column_stack([layout.J, layout.contact_motion]))
    assert not soft.any()
    assert mobilities(layout.J, layout.metric, dynamics)[0].min() > 10.0 * EXAMINED_MOBILITY


def test_redundancy_in_a_motion_without_a_change_of_contacts_is_found():
    """Panda, whose held hand loses a direction while the elbow stretches."""
    settings = new_configuration("package://example-robot-data/robots/panda_description/urdf/panda.urdf").settings
    model = make_model(settings)
    qp = make_qp(settings, model, contacts=[lambda model: Grip(model, model.pinocchio.frames[-1].name, stiffness=0.0)])
    joints = np.array([-2.86, 0.78, -2.86, -0.42, -2.87, 2.54, 1.93])

    def build(elbow):
        joints[3] = elbow
        state = RobotState(0, model.configuration(joints), np.zeros(model.nv))
        layout = qp.formulation.build(state, rest(qp, settings, state))
        return layout, mobilities(layout.J, layout.metric, qp.dynamics)[0].min()

    layout, mobility = build(-0.8)
    assert mobility > EXAMINED_MOBILITY
    assert layout.contact_rows is None
    for elbow in np.arange(-0.78, -0.4, 0.02):
        layout, mobility = build(elbow)
    assert mobility < LEAST_MOBILITY
    assert np.abs(layout.contact_rows[:, :-1] - layout.problem.A[:3, : model.nv]).max() > 1e-3  # a soft direction
    layout, _ = build(-0.8)
    assert layout.contact_rows is None


def test_redundancy_after_activation_is_found(bench):
    robot, fresh = bench(solo_8()), bench(solo_8())
    rng = np.random.default_rng(5)
    for _ in range(5):
        state = near(robot, rng)
        robot.controller.formulation.redundancy = tuple(robot.controller.contacts), False, state.q
        found = robot.controller.solve(state, robot.references())
        assert robot.controller.formulation.redundancy[1]
        np.testing.assert_allclose(found.tau, fresh.controller.solve(state, fresh.references()).tau, atol=1e-7)


@pytest.mark.parametrize("solver", ["daqp", "levels"])
def test_restored_program_is_identical(bench, solver):
    robot, other = bench(solo_8(solver)), bench(solo_8(solver))
    rng = np.random.default_rng(6)
    robot.controller.solve(near(robot, rng), robot.references())
    for examined in (True, False):
        state = near(robot, rng)
        robot.controller.formulation.redundancy = tuple(robot.controller.contacts), examined, state.q
        memory = robot.controller.memory()
        other.controller.recall(memory)
        expected, found = (each.controller.solve(state, robot.references()) for each in (robot, other))
        assert found.tau.tobytes() == expected.tau.tobytes()
        assert found.iterations == expected.iterations


def test_contradictory_soles_have_the_mean_acceleration(bench):
    robot = bench("g1")
    contact = next(iter(robot.controller.contacts.values()))

    class Drifting(type(contact)):
        def acceleration_at_rest(self, dynamics):
            return super().acceleration_at_rest(dynamics) - 0.5 * np.eye(self.size)[0]

    settings = robot.settings.contacts[contact.name]
    sole = Rectangle(settings.half_length, settings.half_width)
    twin = Drifting("twin", robot.model, settings.frame, placement_of(settings.translation, settings.rpy), sole)
    qp = make_qp(robot.settings, robot.model, contacts=[lambda _: twin])
    references = replace(robot.references(), contacts={**robot.references().contacts, "twin": 1.0})
    solution = qp.solve(robot.state(), references)
    assert solution.relaxed == ()
    assert (contact.jacobian(qp.dynamics) @ solution.v_dot)[0] == pytest.approx(-0.25, abs=1e-6)
    assert solution.residuals["contact_motion"] == pytest.approx(0.25, abs=1e-6)
