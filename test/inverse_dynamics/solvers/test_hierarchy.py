"""Strict priorities: random problems, and robots."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from demands import demand
from quadratic_programs import squares_problem

from wbc_controller.inverse_dynamics.formulation.problem import (
    NOT_FINITE,
    Answer,
    Level,
    QuadraticCost,
    QuadraticProgram,
)
from wbc_controller.inverse_dynamics.solvers import hierarchy as module
from wbc_controller.inverse_dynamics.solvers import make_solver
from wbc_controller.inverse_dynamics.solvers.active_set import ActiveSet
from wbc_controller.inverse_dynamics.solvers.hierarchy import Hierarchy

EPSILON = 1.0e-5  # similar to the controller's
PROBLEMS = 200


def hierarchy(solver="daqp"):
    return Hierarchy(partial(make_solver, solver), lambda: 0.0)


def level(name, rows, right, n, band=None):
    """Return the level min ½ ‖rows x - right‖² + ½ ε ‖x‖², or ‖s‖² within a band."""
    if band is None:
        A, b, G, middle, band = rows, right, rows[:0], right[:0], right[:0]
    else:
        A, b, G, middle = rows[:0], right[:0], rows, right
    cost = QuadraticCost(A.T @ A + EPSILON * np.eye(n), -A.T @ b, 0.5 * b @ b)
    return Level((name,), cost, A, G, middle - band, middle + band)


def constraints(rng, n):
    """Return equalities, some dependent, and inequalities, around a feasible point."""
    inside = rng.normal(size=n)
    problem = QuadraticProgram.empty(n, 4, 6)
    problem.A[:3] = rng.normal(size=(3, n))
    problem.A[3] = problem.A[0] - 2.0 * problem.A[1]
    problem.b[:] = problem.A @ inside
    problem.C[:] = rng.normal(size=(6, n))
    problem.lower[:] = problem.C @ inside - rng.uniform(0.1, 2.0, 6)
    problem.upper[:4] = (problem.C @ inside + rng.uniform(0.1, 2.0, 6))[:4]
    problem.x_lower[::2] = inside[::2] - rng.uniform(0.5, 3.0, len(inside[::2]))
    problem.x_upper[::3] = inside[::3] + rng.uniform(0.5, 3.0, len(inside[::3]))
    return problem


def random_levels(rng, n):
    """Return two to four conflicting levels; some are rank-deficient, some have a tolerance."""
    levels = []
    for i in range(rng.integers(2, 5)):
        k = int(rng.integers(1, 5))
        rows = rng.normal(size=(k, n))
        if rng.random() < 0.3 and levels and len(levels[-1].kept):
            rows[0] = levels[-1].kept[0]  # determined by the level above
        band = rng.uniform(0.0, 1.0, k) if rng.random() < 0.3 else None
        levels.append(level(str(i), rows, 3.0 * rng.normal(size=k), n, band))
    return levels


def off(of, x):
    """Return the residual of a level's rows, and the distance of x from its band."""
    value = of.G @ x
    outside = np.maximum(value - of.upper, 0.0) - np.maximum(of.lower - value, 0.0)
    return np.concatenate([of.kept @ x, outside])


def worsening(of, before, after):
    """Return the change of a level's residual; for a band, only its increase."""
    k = len(of.kept)
    change = np.abs(off(of, after)) - np.abs(off(of, before))
    change[:k] = np.abs(off(of, after) - off(of, before))[:k]
    return change.max()


def test_lower_levels_do_not_change_higher_ones():
    rng = np.random.default_rng(11)
    worst, moved, limited, unsolved = 0.0, 0, 0, 0
    for _ in range(PROBLEMS):
        n = int(rng.integers(10, 16))
        problem, levels = constraints(rng, n), random_levels(rng, n)
        answers = []
        for count in range(1, len(levels) + 1):
            solving = hierarchy()
            answer = solving.solve(problem, levels[:count])
            assert answer.x is not None
            assert problem.residuals(answer.x).violation < 1e-6
            if answer.relaxed:
                unsolved += 1
                break
            # Compared with the solution in which the level was the last.
            worst = max([worst, *(worsening(*parts, answer.x) for parts in zip(levels, answers, strict=False))])
            moved += bool(answers) and np.abs(answer.x - answers[-1]).max() > 1e-3
            answers.append(answer.x)
        limited += np.abs(answer.multipliers).max() > 1e-3
    assert worst < 1e-6
    assert moved > PROBLEMS / 2  # the lower levels had an effect
    assert limited > PROBLEMS / 2  # inequalities were active
    assert unsolved == 0


def test_failed_lower_level_keeps_the_solution_above(monkeypatch):
    n = 4
    problem = QuadraticProgram.empty(n, 0, 1)
    rows, three = np.eye(n), np.array([3.0])
    levels = [
        level("first", rows[:1], np.array([1.0]), n),
        level("band", rows[:1] + rows[1:2], three, n, np.array([0.5])),
        level("last", rows[2:3], three, n),
    ]
    expected = hierarchy().solve(problem, levels)
    assert expected.relaxed == ()
    np.testing.assert_allclose(expected.x, [1.0, 1.5, 3.0, 0.0], atol=1e-3)

    made = []

    def second_fails(problem):
        made.append(make_solver("daqp", problem))
        if len(made) == 2:
            monkeypatch.setattr(made[1], "solve", lambda _: Answer(None, "taken for infeasible", 9))
        return made[-1]

    answer = Hierarchy(second_fails, lambda: 0.0).solve(problem, levels)
    assert answer.relaxed == ()  # by least distance
    np.testing.assert_allclose(answer.x, expected.x, atol=1e-6)
    made.clear()
    monkeypatch.setattr(module, "solve_by_least_distance", lambda _: Answer(None, "infeasible", 0))
    answer = Hierarchy(second_fails, lambda: 0.0).solve(problem, levels)
    assert answer.relaxed == ("level with band: taken for infeasible; infeasible",)
    np.testing.assert_allclose(answer.x, [1.0, 0.0, 3.0, 0.0], atol=1e-3)
    assert [report.tasks for report in answer.levels] == [("first",), ("band",), ("last",)]
    assert answer.levels[1].cost == pytest.approx(0.5 * 1.5**2, rel=1e-3)  # the band begins at a distance of 1.5


def test_back_ends_agree_on_every_level():
    rng = np.random.default_rng(15)
    for _ in range(20):
        problem, levels = constraints(rng, 12), random_levels(rng, 12)
        by_daqp, by_quadprog = hierarchy(), hierarchy("quadprog")
        one, other = by_daqp.solve(problem, levels), by_quadprog.solve(problem, levels)
        assert one.relaxed == other.relaxed == ()
        for of in levels:
            np.testing.assert_allclose(off(of, other.x), off(of, one.x), atol=1e-5)


def test_tolerance_is_kept_and_used():
    n = 4
    problem = QuadraticProgram.empty(n, 0, 1)
    band = level("band", np.eye(n)[:1], np.array([1.0]), n, np.array([0.25]))
    wish = level("wish", np.eye(n)[:1], np.array([5.0]), n)
    assert hierarchy().solve(problem, [band, wish]).x[0] == pytest.approx(1.25)
    near = level("wish", np.eye(n)[:1], np.array([1.1]), n)
    assert hierarchy().solve(problem, [band, near]).x[0] == pytest.approx(1.1, abs=1e-4)
    problem.x_upper[0] = 0.5  # unreachable band: smallest distance
    assert hierarchy().solve(problem, [band, wish]).x[0] == pytest.approx(0.5)


def test_infeasible_first_levels_have_no_solution():
    problem = QuadraticProgram.empty(3, 2, 1)
    problem.A[:, 0], problem.b[:] = 1.0, [0.0, 1.0]
    answer = hierarchy().solve(problem, [level("0", np.eye(3), np.zeros(3), 3)])
    assert answer.x is None
    assert "contradict" in answer.status
    problem = QuadraticProgram.empty(3, 0, 1)
    problem.C[0, 0], problem.lower[0], problem.x_upper[0] = 1.0, 1.0, 0.0
    assert hierarchy().solve(problem, [level("0", np.eye(3), np.zeros(3), 3)]).x is None


def without_squares(level):
    """Return the level with its cost as H and g, for the solution in the null space."""
    cost = level.cost
    return replace(level, cost=QuadraticCost(cost.H.copy(), cost.g.copy(), cost.constant))


def both_ways(robot, rng):
    """Return solutions on two to four random levels, with the active sets of the same problem and in null spaces."""
    count = int(rng.integers(2, 5))
    level = {name: int(rng.integers(0, count)) for name in robot.settings.tasks}
    if rng.random() < 0.7:
        level["posture"] = max(level.values())
    robot = robot.on_levels(**level)
    layout = robot.controller.formulation.build(*robot.random_problem(int(rng.integers(0, 1000))))
    plain, fast = hierarchy(), hierarchy()
    expected = plain.solve(layout.problem, [without_squares(each) for each in layout.levels])
    for _ in range(2):  # the first solution adopts the active sets
        found = fast.solve(layout.problem, layout.levels)
    return expected, found


def test_active_sets_equal_null_spaces(bench, monkeypatch):
    monkeypatch.setattr(module, "_CLEARANCE", 1.0e-11)  # clearance of the solution in null spaces
    rng, same = np.random.default_rng(17), 0
    for _ in range(40):
        expected, found = both_ways(bench("g1"), rng)
        if found.x is None or expected.relaxed or found.residuals is None:
            continue
        same += 1
        assert expected.multipliers.any()
        size = np.abs(expected.multipliers).max()
        np.testing.assert_allclose(found.x, expected.x, atol=1e-6 * np.abs(expected.x).max())
        np.testing.assert_allclose(found.multipliers, expected.multipliers, atol=1e-5 * size)
        for one, other in zip(found.levels, expected.levels, strict=True):
            assert one.tasks == other.tasks
            assert one.cost == pytest.approx(other.cost, rel=1e-5, abs=1e-7)
    assert same >= 15


def moving(robot, count):
    """Return a robot with growing demands on three levels, until limits bind and are free again."""
    references = robot.references(left_hand=10.0)
    position = references.tasks["left_hand"].position
    for i in range(count):
        moved = np.array([0.6 * np.sin(0.1 * i), 0.0, 0.1 * np.cos(0.1 * i), 0.0, 0.0, 0.0, 0.0])
        yield demand(references, "left_hand", position=position + moved)


def test_restored_hierarchy_is_identical(bench):
    """After every cycle: with right, followed, wrong and skipped active sets."""
    robot, other = (bench("g1").on_levels(left_hand=1, posture=2) for _ in range(2))
    met = set()
    for references in moving(robot, 60):
        memory = robot.controller.memory()
        solution = robot.controller.solve(robot.state(), references)
        other.controller.recall(memory)
        again = other.controller.solve(robot.state(), references)
        assert again.v_dot.tobytes() == solution.v_dot.tobytes()
        assert again.levels == solution.levels
        assert again.binding == solution.binding
        after = dict(robot.controller.memory()["hierarchies"])[tuple(robot.controller.contacts)]
        for was in (before for _, before in memory["hierarchies"]):
            right = "at once" if solution.iterations == len(solution.levels) else "followed"
            met.add("not tried" if was["rest"] else "wrong" if after["misses"] else right)
    assert met == {"at once", "followed", "wrong", "not tried"}


def test_wrong_active_sets_are_tried_less_often(monkeypatch):
    rng = np.random.default_rng(18)
    problem = squares_problem(rng)
    only = Level(("0",), problem.cost, np.zeros((0, problem.n)), np.zeros((0, problem.n)), np.zeros(0), np.zeros(0))
    solving, tried = hierarchy(), []
    monkeypatch.setattr(ActiveSet, "solve_level", lambda *_: (tried.append(len(memories)), (0, 1, 0.0))[1])
    memories = []
    for _ in range(60):
        assert solving.solve(problem, [only]).x is not None
        memories.append(solving.memory())
    assert tried == [0, 1, 3, 7, 15, 31, 47]
    monkeypatch.undo()
    assert [solving.solve(problem, [only]).residuals is not None for _ in range(5)] == [False] * 3 + [True] * 2
    assert solving.memory()["misses"] == 0


@pytest.mark.parametrize("spoilt", ["A", "bounds"])
def test_non_finite_values_are_named(bench, spoilt):
    robot = bench("g1").on_levels(posture=1)
    layout = robot.controller.formulation.build(robot.state(), robot.references())
    solving = hierarchy()
    assert solving.solve(layout.problem, layout.levels).residuals is not None
    getattr(layout.problem, spoilt)[0, 3] = np.nan
    answer = solving.solve(layout.problem, layout.levels)
    assert (answer.x, answer.status, answer.levels) == (None, NOT_FINITE, ())
