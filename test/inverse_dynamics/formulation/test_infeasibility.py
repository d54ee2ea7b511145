"""Diagnosis of infeasibility: conflicting constraints without others, and the smallest slack."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from conflicts import conflict_at_rest, conflict_of, set_motion_bounds
from scipy.optimize import linprog

from wbc_controller.errors import NoSolution
from wbc_controller.inverse_dynamics import whole_body_qp
from wbc_controller.inverse_dynamics.formulation import infeasibility
from wbc_controller.inverse_dynamics.formulation.infeasibility import MAX_PROGRAMS, named_constraints
from wbc_controller.inverse_dynamics.formulation.problem import Answer

KNEE = {"g1": "left_knee_joint", "talos": "leg_left_4_joint", "go2": "FL_calf_joint"}
OTHER_KNEE = {"g1": "right_knee_joint", "talos": "leg_right_4_joint"}
ELBOW = {"g1": "left_elbow_joint", "talos": "arm_left_4_joint", "go2": "FR_hip_joint"}


def weight(robot):
    return robot.model.mass * robot.model.gravity


def first_contact(robot):
    return next(iter(robot.controller.contacts.values()))


def weaken(robot, joint, limit):
    limits = np.array(robot.model.effort_limits)
    limits[robot.model.joints.index(joint)] = limit
    robot.controller.formulation.torque_limit.effort_limits = limits


def failure(robot):
    """Return the explanation of `NoSolution`, and the problem."""
    references, formulation = robot.references(), robot.controller.formulation
    with pytest.raises(NoSolution) as error:
        robot.controller.solve(robot.state(), references)
    why = error.value.infeasibility
    assert why.sentence in str(error.value)
    return why, formulation.layout(tuple(references.contacts)), formulation.effort_bounds(references)


def asked(robot, before=None):
    """Return the explanation with limits that would be relaxed, and the problem."""
    state, references, formulation = robot.state(), robot.references(), robot.controller.formulation
    why = conflict_of(robot.controller, state, references, before)
    return why, formulation.build(state, references, before), formulation.effort_bounds(references)


# Each case makes constraints contradictory, and returns their names --------------------------------------------------


def too_heavy(robot, name):
    for contact in robot.controller.contacts.values():
        contact.max_normal_force = 0.8 * weight(robot) / len(robot.controller.contacts)
    return conflict_at_rest(robot), {f"normal_force:{contact}" for contact in robot.controller.contacts}


def pulling(robot, name):
    contact = first_contact(robot)
    contact.max_normal_force = -50.0
    return failure(robot), {f"normal_force:{contact.name}", f"cone:{contact.name}"}


def one_foot_presses(robot, name):
    contact = first_contact(robot)
    contact.min_normal_force = contact.max_normal_force = (12.0 if name == "g1" else 5.0) * weight(robot)
    return failure(robot), {f"normal_force:{contact.name}", f"torque:{KNEE[name]}"}


def all_feet_press(robot, name):
    for contact in robot.controller.contacts.values():
        contact.min_normal_force = contact.max_normal_force = (7.0 if name == "g1" else 5.0) * weight(robot)
    knees = [joint for joint in robot.model.joints if "calf" in joint] or [KNEE[name], OTHER_KNEE[name]]
    feet = robot.controller.contacts
    return failure(robot), {f"normal_force:{foot}" for foot in feet} | {f"torque:{knee}" for knee in knees}


def weak_arm(robot, name):
    weaken(robot, ELBOW[name], 0.05)
    return conflict_at_rest(robot), {f"torque:{ELBOW[name]}"}


def crossed(robot, name):
    set_motion_bounds(robot, robot.model.joints.index(ELBOW[name]), 5.0, -5.0)
    return asked(robot), {f"motion:{ELBOW[name]}"}


def wrong_torque_before(robot, name):
    robot.controller.formulation.torque_limit.rate = 1.0
    i = robot.model.joints.index(KNEE[name])
    before = np.array(robot.controller.solve(robot.state(), robot.references()).tau)
    before[i] = -np.sign(before[i]) * robot.model.effort_limits[i]
    return asked(robot, before=before), {f"torque_rate:{KNEE[name]}"}


def slippery(robot, name):
    """Pushed sideways without sufficient friction."""
    robot = robot.on_soles(friction=0.05)
    push = np.array([0.0, 0.1 * weight(robot), 0.0, 0.0, 0.0, 0.0])
    references = replace(robot.references(), external_wrenches={robot.model.base_link: push})
    return conflict_at_rest(robot, references), {f"cone:{contact}" for contact in robot.controller.contacts}


def weak_and_braked(robot, name):
    """A hand that must brake hard, with a weak wrist."""
    wrist = "left_wrist_yaw_joint"
    weaken(robot, wrist, 0.2)
    set_motion_bounds(robot, slice(None), -20.0, 20.0)
    set_motion_bounds(robot, robot.model.joints.index(wrist), -500.0, -100.0)
    return asked(robot), {f"motion:{wrist}", f"torque:{wrist}"}


def two_at_once(robot, name):
    """A pulling foot, and an elbow with contradictory bounds."""
    contact = first_contact(robot)
    contact.max_normal_force = -50.0
    (_, _, _), motion = crossed(robot, name)
    return asked(robot), motion | {f"normal_force:{contact.name}", f"cone:{contact.name}"}


CASES = {
    "too heavy": (too_heavy, ("g1", "go2")),
    "a foot that pulls": (pulling, ("g1", "go2")),
    "one foot presses": (one_foot_presses, ("talos", "go2")),
    "all feet press": (all_feet_press, ("g1",)),
    "weak arm": (weak_arm, ("g1",)),
    "crossed motion": (crossed, ("go2",)),
    "wrong knee torque before": (wrong_torque_before, ("go2",)),
    "slippery": (slippery, ("g1", "go2")),
    "weak and braked": (weak_and_braked, ("g1",)),
    "two at once": (two_at_once, ("g1", "go2")),
}


def possible(layout, model, effort, given):
    """Return True if the problem is feasible with given slack, by a separate linear program."""
    problem = layout.problem
    rows, right = [np.zeros((0, len(problem.g)))], [np.zeros(0)]
    for constraint in named_constraints(layout, model, effort):
        give = given.get(constraint.name, 0.0) * constraint.scale
        for sign, bound in ((1.0, constraint.upper), (-1.0, -constraint.lower)):
            there = np.isfinite(bound)
            rows.append(sign * constraint.rows[there])
            right.append((bound + give)[there])
    mechanism = layout.mechanism
    answer = linprog(
        np.zeros(len(problem.g)), np.vstack(rows), np.concatenate(right), problem.A[mechanism], problem.b[mechanism],
        (None, None), method="highs-ipm",
    )  # fmt: skip
    return answer.status == 0


@pytest.mark.parametrize(
    ("case", "name"),
    [pytest.param(case, name, id=f"{case}, {name}") for case, (_, names) in CASES.items() for name in names],
)
def test_conflict_has_no_other_constraints_and_its_smallest_slack_is_necessary_and_sufficient(bench, case, name):
    robot = bench(name)
    (why, layout, effort), guilty = CASES[case][0](robot, name)
    assert set(why.conflict) == guilty
    assert set(why.smallest) <= guilty
    assert set(why.slack) == set(why.units) == guilty
    assert all(slack > 0.0 for slack in why.slack.values())
    constraints = {constraint.name: constraint for constraint in named_constraints(layout, robot.model, effort)}
    enough = {}
    for guilty in why.smallest:
        constraint = constraints[guilty]
        scale = min(s for s, unit in zip(constraint.scale, constraint.units, strict=True) if unit == why.units[guilty])
        enough[guilty] = 1.001 * why.slack[guilty] / constraint.factor / scale + 1e-6
    assert not possible(layout, robot.model, effort, {})
    assert possible(layout, robot.model, effort, enough)
    for guilty in why.smallest:  # each of them is needed
        assert not possible(layout, robot.model, effort, {**enough, guilty: 0.0})


@pytest.mark.parametrize("name", ["g1", "go2"])
def test_named_constraints_are_the_whole_problem(bench, name):
    robot, rng = bench(name), np.random.default_rng(0)
    before = 0.1 * robot.model.effort_limits
    layout = robot.controller.formulation.build(robot.state(), robot.references(), before)
    named = named_constraints(layout, robot.model, robot.controller.formulation.effort_bounds(robot.references()))
    assert len({constraint.name for constraint in named}) == len(named)
    problem = layout.problem
    problem.A[layout.mechanism], problem.b[layout.mechanism] = 0.0, 0.0  # without names
    for _ in range(50):
        x = 10.0 * rng.normal(size=len(problem.g))
        worst = max(
            np.max(np.maximum(constraint.rows @ x - constraint.upper, constraint.lower - constraint.rows @ x))
            for constraint in named
        )
        assert worst == pytest.approx(problem.residuals(x).violation)
    fresh = bench(name)
    assert asked(fresh)[0] is conflict_at_rest(fresh)[0] is None  # a feasible problem has no conflict


def test_failed_solver_is_named(bench, monkeypatch):
    robot = bench("go2")
    layout = robot.controller.formulation.build(robot.state(), robot.references())
    solver = robot.controller._solvers[layout.key]
    monkeypatch.setattr(solver, "solve", lambda problem: Answer(None, "cycling", 7))
    monkeypatch.setattr(whole_body_qp, "solve_carefully", lambda problem, soft=None: Answer(None, "cycling", 7))
    with pytest.raises(NoSolution, match=r"cycling.*the constraints are feasible; the solver failed") as error:
        robot.controller.solve(robot.state(), robot.references())
    assert error.value.infeasibility is None


def test_explanation_only_on_request(bench, monkeypatch):
    robot = bench("go2")
    first_contact(robot).max_normal_force = -50.0
    monkeypatch.setattr(infeasibility, "linprog", None)  # would raise
    with pytest.raises(NoSolution) as error:
        robot.controller.solve(robot.state(), robot.references(), None, False)
    assert error.value.infeasibility is None
    assert "conflict" not in str(error.value)
    without_a_program = NoSolution("the contacts conflict", "infeasible", None)
    assert without_a_program.explained() is without_a_program


def test_number_of_linear_programs_is_bounded(bench, monkeypatch):
    robot = bench("talos")
    calls = []
    monkeypatch.setattr(infeasibility, "MAX_PROGRAMS", 5)
    monkeypatch.setattr(infeasibility, "linprog", lambda *args, **kwargs: calls.append(1) or linprog(*args, **kwargs))
    (why, *_), _ = all_feet_press(robot, "talos")
    assert len(calls) == 5 < MAX_PROGRAMS
    assert why.conflict


def test_sentence_of_an_immutable_explanation(bench):
    robot = bench("talos")
    (why, *_), _ = one_foot_presses(robot, "talos")
    assert why.sentence == (
        f"conflict: torque of leg_left_4_joint (limit 300 N·m, {why.slack['torque:leg_left_4_joint']:.3g} N·m more "
        f"needed) against normal force of left_foot (at least {5.0 * weight(robot):.4g} N, "
        f"{why.slack['normal_force:left_foot']:.3g} N less needed)"
    )
    assert why.smallest == ("torque:leg_left_4_joint",)
    assert dict(why.units) == {"torque:leg_left_4_joint": "N·m", "normal_force:left_foot": "N"}
    (why, *_), _ = weak_arm(bench("g1"), "g1")
    with pytest.raises(FrozenInstanceError):
        why.sentence = ""
    with pytest.raises(TypeError):
        why.slack["x"] = 1.0
