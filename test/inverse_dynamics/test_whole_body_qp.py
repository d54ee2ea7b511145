import itertools
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from demands import demand
from snapshots import dynamics_at

from wbc_controller.errors import NoSolution
from wbc_controller.inverse_dynamics import whole_body_qp
from wbc_controller.inverse_dynamics.formulation.cost import LevelCost
from wbc_controller.inverse_dynamics.formulation.problem import FORCE_UNIT, Answer, QuadraticProgram
from wbc_controller.inverse_dynamics.formulation.unpacking import unpack
from wbc_controller.inverse_dynamics.solvers import make_solver
from wbc_controller.recording.json_records import to_json
from wbc_controller.records import frozen_mapping
from wbc_controller.validation.fuzz.problems import feasibility_margin


@pytest.fixture
def keep_contacts(monkeypatch):
    """Keep all contacts, so that the relaxed problem counts."""
    monkeypatch.setattr(whole_body_qp, "slipping_contacts", lambda *_: ())
    monkeypatch.setattr(whole_body_qp, "contacts_preventing_stop", lambda *_: ())


def busy(bench, state, rng):
    """Return references with accelerations of all tasks."""
    references = bench.references(state)
    for name, task in references.tasks.items():
        references = demand(references, name, acceleration=rng.normal(size=len(task.acceleration)))
    return references


def test_joint_brakes_with_full_torque(bench):
    g1 = bench("g1", limits={"acceleration": 1.0e5, "velocity": False})
    q, v = g1.rushing("left_elbow_joint", -0.1, 15.0)  # requires 7500 rad/s², beyond the motor
    solution = g1.controller.solve(g1.state(q, v), g1.references())
    assert solution.relaxed == ("joint_motion",)
    dynamics, contacts = dynamics_at(g1.model, q, v), g1.controller.contacts
    left = dynamics.M @ solution.v_dot + dynamics.h - g1.model.actuation.generalized_force(solution.tau)
    left -= sum(contacts[name].jacobian(dynamics).T @ force for name, force in solution.forces.items())
    assert np.abs(left).max() < 1.0e-8
    assert (np.abs(solution.tau) <= g1.model.effort_limits + 1e-5).all()
    i, formulation = g1.model.joints.index("left_elbow_joint"), g1.controller.formulation
    assert solution.tau[i] == pytest.approx(-g1.model.effort_limits[i], abs=1e-3)
    joints, v_dot = (q[g1.model.q_index], v[g1.model.v_index]), solution.v_dot[g1.model.v_index]
    lower, upper = formulation.motion_limit.bounds(*joints, formulation.period)
    assert upper[i] < v_dot[i] < -100.0
    assert solution.binding["motion:left_elbow_joint:upper"] > 1.0e5
    # The other joints violate their bounds by at most a twentieth of the elbow's violation.
    assert np.delete(np.maximum(lower - v_dot, v_dot - upper), i).max() < 0.05 * (v_dot - upper)[i]


@pytest.mark.usefixtures("keep_contacts")
@pytest.mark.parametrize("robot", ["g1", "go2"])
def test_minimal_relaxation(bench, robot):
    """By linear programs: nothing if feasible, and the torque rate alone if sufficient."""
    bench, seen = bench(robot, limits={"acceleration": 200.0}), set()
    for seed in range(60):
        state, references, before = bench.random_problem(seed)
        solution = bench.controller.solve(state, references, before)
        layout = bench.controller.formulation.build(state, references, before)
        enough = feasibility_margin(layout.problem)
        problem, rows = layout.problem, layout.torque
        problem.lower[rows], problem.upper[rows] = bench.controller.formulation.effort_bounds(references)
        without_rate = feasibility_margin(layout.problem)
        if enough > 1e-6:
            assert solution.relaxed == ()
        elif without_rate > 1e-6:
            assert solution.relaxed == ("torque_rate",)
        elif without_rate < -1e-2:
            assert "joint_motion" in solution.relaxed
        seen.add(solution.relaxed)
    assert {(), ("torque_rate",), ("joint_motion",), ("torque_rate", "joint_motion")} <= seen


@pytest.mark.usefixtures("keep_contacts")
@pytest.mark.parametrize(("robot", "seed", "most"), [("talos", 3926, 1.0e-6), ("g1", 7686, 1.0e-5)])
def test_unsolved_soft_program_has_least_violations(bench, robot, seed, most):
    """DAQP reports a feasible soft program of Talos as infeasible; joints of G1 violate bounds by 10⁴ rad/s²."""
    robot = bench("talos").on_soles(half_length=0.1) if robot == "talos" else bench(robot)
    solution = robot.controller.solve(*robot.random_problem(seed))
    assert solution.relaxed == ("torque_rate", "joint_motion")
    assert max(solution.residuals.values()) < most  # DAQP's 1e-8 is for rows of norm 1; 5e-7 on some processors


def test_a_change_of_contacts_starts_with_the_active_set_of_the_last_such_change(bench):
    g1 = bench("g1")
    pushed = {"pelvis": np.array([0.0, 60.0, 0.0, 0.0, 0.0, 0.0])}

    def iterations(wrenches, left_foot=1.0):
        contacts = {"left_foot": left_foot, "right_foot": 1.0}
        references = replace(g1.references(), external_wrenches=wrenches, contacts=contacts)
        return g1.controller.solve(g1.state(), references).iterations

    assert iterations({}, left_foot=0.0) >= 1
    assert iterations(pushed) > 1
    assert iterations(pushed) == 1
    assert iterations({}) > 1  # other active bounds
    iterations({}, left_foot=0.0)
    assert iterations(pushed) == 1  # not those of the last cycle on two feet


def test_a_prepared_program_is_solved_as_a_new_one(bench):
    g1, fresh = bench("g1"), bench("g1")
    state, references, _ = g1.random_problem(3)
    g1.controller.prepare(g1.state(), g1.references())
    assert g1.controller.formulation.redundancy is None  # to be examined in the state of the first cycle
    found, wanted = (each.controller.solve(state, references) for each in (g1, fresh))
    assert found.iterations == wanted.iterations > 1
    np.testing.assert_array_equal(found.v_dot, wanted.v_dot)
    assert to_json(g1.controller.memory()) == to_json(fresh.controller.memory())


def test_relaxed_cycle_has_no_side_effect(bench):
    g1, fresh = bench("g1"), bench("g1")
    before = g1.controller.solve(g1.state(), g1.references())
    problems = (g1.random_problem(seed)[:2] for seed in range(0, 99, 4))
    state, references = next(problem for problem in problems if fresh.controller.solve(*problem).relaxed)
    first = g1.controller.solve(state, references)
    assert first.relaxed
    after = g1.controller.solve(g1.state(), g1.references())
    assert not after.relaxed
    np.testing.assert_allclose(after.tau, before.tau, atol=1e-6)
    g1.controller.forget()
    np.testing.assert_array_equal(g1.controller.solve(state, references).tau, first.tau)


@pytest.mark.parametrize("solver", ["daqp", "osqp"])
def test_failed_solver_on_a_feasible_problem_relaxes_nothing(bench, monkeypatch, solver):
    robot = bench("go2", solver={"name": solver})
    other = bench("go2")
    problems = [robot.random_problem(seed) for seed in range(0, 40, 4)]
    expected = [other.controller.solve(*problem) for problem in problems]
    (own,) = robot.controller._solvers.values()
    monkeypatch.setattr(own, "solve", lambda problem: Answer(None, "cycling", 7))
    binding = 0
    for problem, best in zip(problems, expected, strict=True):
        if not best.relaxed:
            solution = robot.controller.solve(*problem)
            assert solution.relaxed == ()
            np.testing.assert_allclose(solution.tau, best.tau, atol=1e-4)
            binding += any(name.startswith("motion:") for name in solution.binding)
    assert binding > 3


def rising(bench, speed):
    """Talos, with a rising base and its feet on the ground; its left knee is 0.05 rad before its limit."""
    talos = bench("talos")
    model, q, v = talos.model, np.array(talos.stance), np.zeros(talos.model.nv)
    knee = model.joints.index("leg_left_4_joint")
    q[model.q_index[knee]] = model.position_lower[knee] + 0.05
    v[model.v_index[knee]] = -speed
    dynamics = dynamics_at(model, q, v)
    legs = {name: talos.controller.contacts[name].jacobian(dynamics) for name in ("left_foot", "right_foot")}
    v[:6] -= np.linalg.solve(legs["left_foot"][:, :6], legs["left_foot"] @ v)
    right = [model.v_index[model.joints.index(f"leg_right_{i}_joint")] for i in range(1, 7)]
    v[right] -= np.linalg.solve(legs["right_foot"][:, right], legs["right_foot"] @ v)
    return talos, talos.state(q, v), knee


def test_contact_preventing_a_stop_is_released(bench, monkeypatch):
    talos, state, knee = rising(bench, 8.0)
    solution = talos.controller.solve(state, talos.references())
    assert "contact_motion" in solution.relaxed
    assert "left_foot" not in solution.forces
    acceleration = solution.v_dot[talos.model.v_index[knee]]
    assert acceleration > talos.settings.limits.acceleration  # it brakes
    assert max(solution.residuals.values()) < 1e-5
    monkeypatch.setattr(whole_body_qp, "contacts_preventing_stop", lambda *_: ())
    held = talos.controller.solve(state, talos.references())
    assert "left_foot" in held.forces
    assert held.v_dot[talos.model.v_index[knee]] < 0.0  # it accelerates further


@pytest.mark.parametrize("speed", [0.9, 1.1])
def test_slipping_contact_is_released(bench, speed):
    g1 = bench("g1", limits={"acceleration": 1.0e5})
    q, v = g1.rushing("left_elbow_joint", -0.1, 15.0)  # the elbow cannot brake
    v[0] = speed  # both feet slide
    solution = g1.controller.solve(g1.state(q, v), g1.references())
    assert solution.relaxed == (("contact_motion", "joint_motion") if speed > 1.0 else ("joint_motion",))
    assert set(solution.forces) == (set() if speed > 1.0 else {"left_foot", "right_foot"})
    sliding = g1.controller.solve(g1.state(v=speed * np.eye(g1.model.nv)[0]), g1.references())
    assert sliding.relaxed == ()
    assert set(sliding.forces) == {"left_foot", "right_foot"}


@pytest.mark.parametrize(("share", "feet"), [(0.6, {"left_foot", "right_foot"}), (0.4, {"right_foot"})])
def test_release_must_halve_the_shortfall(bench, monkeypatch, share, feet):
    talos, state, _ = rising(bench, 8.0)
    monkeypatch.setattr(whole_body_qp, "contacts_preventing_stop", lambda *_: ("left_foot",))
    shortfall = {1: share, 2: 1.0}  # by the number of feet
    monkeypatch.setattr(whole_body_qp, "stopping_shortfall", lambda _, layout, __: shortfall[len(layout.key)])
    assert set(talos.controller.solve(state, talos.references()).forces) == feet


def test_failed_release_keeps_the_first_solution(bench, monkeypatch):
    talos, state, _ = rising(bench, 8.0)
    attempt, calls = talos.controller._solve_with_relaxation, []

    def fails_at_last(layout, references):
        calls.append(layout.key)
        found = attempt(layout, references)
        return found if len(calls) == 1 else Answer(None, found.status, found.iterations)

    monkeypatch.setattr(talos.controller, "_solve_with_relaxation", fails_at_last)
    solution = talos.controller.solve(state, talos.references())
    assert calls[0] == ("left_foot", "right_foot")
    assert "left_foot" not in calls[1]
    assert len(calls) == 2
    assert set(solution.forces) == {"left_foot", "right_foot"}
    assert "contact_motion" not in solution.relaxed
    assert max(solution.residuals.values()) < 1e-5
    formulation = talos.controller.formulation
    assert formulation.structure.layout.key == calls[0]  # effort tasks use the columns of this solution
    lifted = {name: float(name in calls[1]) for name in calls[0]}
    assert formulation.build(state, replace(talos.references(), contacts=lifted)).key == calls[1]


def test_relaxation_with_strict_priorities(bench):
    g1 = bench("g1")
    strict, count = g1.on_levels(posture=1), 0
    for seed in range(0, 30, 2):
        state, references, before = g1.random_problem(seed)
        solution = strict.controller.solve(state, references, before)
        plain = g1.controller.solve(state, references, before)
        assert solution.relaxed == plain.relaxed
        assert max(solution.residuals.values()) < 1e-5
        assert len(solution.levels) == 2
        count += bool(solution.relaxed)
    assert count > 2


@pytest.mark.parametrize("solver", ["daqp", "osqp", "proxqp", "quadprog"])
def test_no_solution_of_an_infeasible_problem(bench, solver):
    g1 = bench("g1", solver={"name": solver})
    for contact in g1.controller.contacts.values():
        contact.min_normal_force = contact.max_normal_force = 20000.0  # more than the motors can press with
    with pytest.raises(NoSolution, match=rf"left_foot, right_foot.*torque limits together \({solver}: ") as failure:
        g1.controller.solve(g1.state(), g1.references())
    problem = failure.value.problem
    assert isinstance(problem, QuadraticProgram)
    assert failure.value.status
    evidence = np.array(problem.x_lower)
    # The evidence is self-contained: another solver finds no solution either.
    assert make_solver("daqp", problem).solve(problem).x is None
    # The controller continues normally.
    for contact in g1.controller.contacts.values():
        contact.min_normal_force, contact.max_normal_force = 0.0, 1000.0
    solution = g1.controller.solve(g1.state(), g1.references())
    assert not solution.relaxed
    assert np.abs(solution.v_dot).max() < 0.1
    np.testing.assert_array_equal(problem.x_lower, evidence)


@pytest.mark.parametrize("where", ["reference", "wrench", "torques before"])
def test_non_finite_values_are_refused(bench, where):
    go2 = bench("go2")
    references, before = go2.references(), None
    bad = np.array([np.nan, 0.0, 0.0])
    if where == "reference":
        references = demand(references, "com", position=bad)
    elif where == "wrench":
        references = replace(references, external_wrenches={"base": np.concatenate([bad, bad])})
    else:
        before = np.full(go2.model.na, np.nan)
    with pytest.raises(NoSolution, match="not finite"):
        go2.controller.solve(go2.state(), references, before)
    assert go2.controller.solve(go2.state(), go2.references()).relaxed == ()


def test_residuals_by_group_and_errors_as_distances(bench):
    g1, rng = bench("g1"), np.random.default_rng(4)
    state = g1.near_stance(rng)
    references = busy(g1, state, rng)
    for name, off in (("com", [0.03, 0.0, 0.04]), ("posture", 0.01)):
        references = demand(references, name, position=references.tasks[name].position + off)
    solution = g1.controller.solve(state, references)
    assert set(solution.residuals) == {"equations_of_motion", "contact_motion", "inequalities"}
    assert max(solution.residuals.values()) < 1.0e-8
    assert set(solution.task_errors) == {name for name, task in g1.settings.tasks.items() if task.enabled}
    assert solution.task_errors["com"] == pytest.approx(0.05)
    assert solution.task_errors["posture"] == pytest.approx(0.01 * np.sqrt(g1.model.na))
    assert set(solution.stage_seconds) == {"build", "solve", "unpack"}
    assert solution.iterations > 0


def test_residuals_of_an_inaccurate_and_of_no_answer(bench):
    g1 = bench("g1")
    state, references = g1.state(), g1.references()
    layout = g1.controller.formulation.build(state, references)
    x = np.array(make_solver("daqp", layout.problem).solve(layout.problem).x)
    x[0] += 1.0e-4  # the base accelerates without a force
    multipliers = np.zeros(len(x) + len(layout.problem.upper))
    answer = Answer(x, "made", 0, multipliers, layout.problem.residuals(x))
    found = unpack(g1.controller.formulation, layout, answer, references)
    assert found.residuals["equations_of_motion"] == pytest.approx(1.0e-4 * g1.model.mass, rel=0.01)
    assert found.residuals["contact_motion"] == pytest.approx(1.0e-4, rel=0.2)
    with pytest.raises(ValueError, match="'infeasible' has no residuals"):
        unpack(g1.controller.formulation, layout, Answer(None, "infeasible", 3), references)


def test_binding_constraints_hold_with_equality(bench):
    g1, rng = bench("g1"), np.random.default_rng(5)
    seen = set()
    for _ in range(20):
        state = g1.near_stance(rng, velocity=3.0)
        references = g1.references(posture=5.0)
        kick = 300.0 * rng.normal(size=g1.model.na)
        solution = g1.controller.solve(state, demand(references, "posture", acceleration=kick))
        limits = g1.model.effort_limits
        torques = {
            f"torque:{name}:{side}"
            for sign, side in ((1.0, "upper"), (-1.0, "lower"))
            for name, tau, limit in zip(g1.model.joints, solution.tau, limits, strict=True)
            if sign * tau >= limit - 1e-4
        }
        cones = {
            f"cone:{name}"
            for name, force in solution.forces.items()
            if (g1.controller.contacts[name].cone @ force).max() >= -1e-4
        }
        named = set(solution.binding)
        assert len(named) == len(solution.binding)
        if not solution.relaxed:
            assert {name for name in named if name.startswith("torque:")} == torques
            assert {name for name in named if name.startswith("cone:")} == cones
        seen |= {name.split(":")[0] for name in named}
    assert {"torque", "cone"} <= seen


@pytest.mark.parametrize("kind", ["torque", "motion", "normal_force", "cone"])
def test_multipliers_are_cost_gradients(bench, kind):
    """By finite differences: relax one bound, solve again, and compare the cost."""
    most = {"motion": 100.0, "torque": 1.0e4}.get(kind, 200.0)
    g1 = bench("g1", limits={"velocity": False, "acceleration": most})  # velocity would bind before the torque
    formulation, elbow = g1.controller.formulation, g1.model.joints.index("left_elbow_joint")
    references = g1.references(posture=5.0)
    wish = np.zeros(g1.model.na)
    wish[elbow] = {"torque": 2000.0, "motion": 150.0}.get(kind, 0.0)
    references = demand(references, "posture", acceleration=wish)
    references = demand(references, "com", acceleration=np.array([9.0 if kind == "cone" else 0.0, 0.0, 2.0]))
    if kind == "normal_force":
        g1.controller.contacts["left_foot"].max_normal_force = 150.0
    solution = g1.controller.solve(g1.state(), references)
    costs = {name: cost for name, cost in solution.binding.items() if name.startswith(f"{kind}:")}
    name = max(costs, key=costs.get)
    assert costs[name] > 1e-6

    layout = formulation.build(g1.state(), references)
    problem, given = layout.problem.copy(), 1e-3
    owner = name.split(":")[1]
    if kind == "torque":
        problem.upper[layout.torque.start + g1.model.joints.index(owner)] += given
    elif kind == "motion":
        problem.x_upper[layout.joints[g1.model.joints.index(owner)]] += given
    elif kind == "normal_force":
        problem.x_upper[layout.places[layout.key.index(owner)].columns] += given / FORCE_UNIT
    else:
        problem.upper[layout.places[layout.key.index(owner)].cone] += given / FORCE_UNIT
    solve = make_solver("daqp", problem).solve
    before, after = (p.cost.value(solve(p).x) for p in (layout.problem, problem))
    assert (before - after) / given == pytest.approx(costs[name], rel=1e-3)


def test_solution_is_immutable(bench):
    go2 = bench("go2")
    solution = go2.controller.solve(go2.state(), go2.references())
    for array in (solution.v_dot, solution.tau, *solution.forces.values()):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    for mapping in (solution.forces, solution.residuals, solution.task_errors, solution.stage_seconds):
        with pytest.raises(TypeError):
            mapping["x"] = 1.0
    with pytest.raises(AttributeError):
        solution.tau = None


def said(solution):
    """Return a copy of all content of a solution and its levels, in its order."""
    names = ("forces", "residuals", "task_errors", "binding", "external_wrenches")
    mappings = [list(getattr(solution, name).items()) for name in names]
    levels = [(level.tasks, level.cost, level.iterations) for level in solution.levels]
    return deepcopy([solution.v_dot, solution.tau, mappings, levels])


def test_solution_details_belong_to_their_cycle(bench):
    late, at_once, rng = bench("g1"), bench("g1"), np.random.default_rng(11)
    solutions, expected, bound = [], [], 0
    for count, scale in enumerate((1.0, 300.0, 1.0, 200.0, 50.0)):
        state = late.near_stance(rng)
        references = busy(late, state, rng)
        references = replace(
            demand(references, "posture", acceleration=scale * rng.normal(size=late.model.na)),
            weights={**references.weights, "posture": rng.uniform(1.0, 5.0), "com": float(count % 2)},
            external_wrenches={late.model.base_link: 10.0 * rng.normal(size=6)},
        )
        solutions.append(late.controller.solve(state, references))
        other = at_once.controller.solve(state, references)
        expected.append(said(other))
        bound += len(other.binding)
    layout = late.controller.formulation.layout(tuple(late.controller.contacts))
    layout.labels = [("renamed", "renamed", 1.0)] * len(layout.labels)  # as with row limits in every cycle
    np.testing.assert_equal([said(solution) for solution in solutions], expected)
    assert bound > 0


def test_changes_in_mutable_mappings_are_noticed(bench):
    g1 = bench("g1")
    state, references, before = g1.random_problem(3)
    weights, contacts = dict(references.weights), dict(references.contacts)
    friction = dict.fromkeys(contacts, 1.0)
    mutable = {"weights": weights, "contacts": contacts, "friction": friction}  # of the caller
    own = replace(references, **mutable)
    task, contact = next(iter(weights)), next(iter(contacts))

    def answers():
        fixed = replace(references, **{name: frozen_mapping(values) for name, values in mutable.items()})
        return [g1.controller.solve(state, each, before).v_dot for each in (own, fixed, fixed, own)]

    seen = [answers()]
    weights[task] *= 100.0
    seen.append(answers())
    friction[contact] = 0.01
    seen.append(answers())
    contacts[contact] = 0.0
    seen.append(answers())
    for of_one in seen:
        for v_dot in of_one[1:]:
            np.testing.assert_allclose(v_dot, of_one[0], rtol=0, atol=1e-9)
    for one, other in itertools.pairwise(seen):
        assert np.abs(one[0] - other[0]).max() > 1e-3


@pytest.mark.parametrize("sizes", [(4, 2, 3), (4, 3, 3), (3, 4, 3), (3, 3, 4)])
def test_references_of_wrong_size_are_refused(bench, sizes):
    g1 = bench("g1")
    state, references, before = g1.random_problem(3)
    g1.controller.solve(state, references, before)
    position, velocity, acceleration = (np.zeros(size) for size in sizes)
    wrong = demand(references, "com", position=position, velocity=velocity, acceleration=acceleration)
    said = "'com' has {} positions, {} velocities and {} accelerations; expected 3, 3 and 3".format(*sizes)
    with pytest.raises(ValueError, match=said):
        g1.controller.solve(state, wrong, before)


def test_a_problem_after_an_error_in_another_one_is_complete(bench, monkeypatch):
    """Problems of the same contacts share arrays."""
    robot = bench("g1")
    state, references = robot.state(), robot.references()
    expected = robot.controller.solve(state, references).tau

    def fails(*_):
        raise RuntimeError("weights")

    other = replace(
        references, weights={**references.weights, "com": 0.0}, contacts={**references.contacts, "left_foot": 0.1}
    )
    with monkeypatch.context() as broken:
        broken.setattr(LevelCost, "set_parameters", fails)  # after the bounds of the contacts
        with pytest.raises(RuntimeError, match="weights"):
            robot.controller.solve(state, other)
    np.testing.assert_allclose(robot.controller.solve(state, references).tau, expected, atol=1e-9)
