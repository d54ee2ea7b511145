"""Fuzzer of quadratic programs: relaxation is minimal; unnecessary relaxation is detected."""

import numpy as np
import pytest
from command_line import wbc

from wbc_controller.validation.fuzz import problems
from wbc_controller.validation.fuzz.problems import NO_SOLUTION, feasibility_margin, relaxation_error


@pytest.fixture(scope="module")
def qp_and_draw():
    return problems.problems_of("go2")


def test_no_unnecessary_relaxation():
    result = wbc("fuzz", "problems", "go2,g1", "--count", "40")
    found = [line.split()[:3] for line in result.stdout.splitlines()]
    assert found == [[robot, "40", "problems"] for robot in ("go2", "g1")]
    assert result.output.count("relaxed too much: 0") == 2


def test_unnecessary_relaxation_is_reported(qp_and_draw):
    (qp, draw), first = qp_and_draw, {}
    for given in map(draw, range(300)):
        first.setdefault(qp.solve(*given).relaxed, given)
    for needed, given_up, said in (
        ((), ("torque_rate",), "feasible with a margin of"),
        ((), (NO_SOLUTION,), "feasible with a margin of"),
        (("torque_rate",), ("torque_rate", "joint_motion"), "without the torque rate"),
        (("torque_rate",), (NO_SOLUTION,), "without the torque rate"),
        (("joint_motion",), (NO_SOLUTION,), "with everything relaxed"),
        (("torque_rate", "joint_motion"), (NO_SOLUTION,), "with everything relaxed"),
    ):
        assert said in relaxation_error(qp, first[needed], given_up)
        assert relaxation_error(qp, first[needed], needed) is None


def test_exit_status_after_a_solver_failure(monkeypatch):
    def give_up(*_, **__):
        raise problems.NoSolution("no", "cycling", None)

    draw = problems.random_problem
    monkeypatch.setattr(problems, "random_problem", lambda *given: draw(*given[:3], 0))
    monkeypatch.setattr(problems.WholeBodyQP, "solve", give_up)
    result = wbc("fuzz", "problems", "go2", "--count", "1", "--first", "4", status=1)
    assert "problem 4: feasible with a margin of" in result.output


def test_margin_is_the_distance_from_all_bounds(qp_and_draw):
    qp, draw = qp_and_draw
    layout = qp.formulation.build(*draw(0))
    layout.problem.bounds[:] = [[-np.inf], [np.inf]]
    assert feasibility_margin(layout.problem) == pytest.approx(1.0)
    joint = layout.joints[0]
    layout.problem.bounds[:, joint] = (3.0, 3.5)
    assert feasibility_margin(layout.problem) == pytest.approx(0.25)
    layout.problem.bounds[:, joint] = (3.0, 2.5)
    assert feasibility_margin(layout.problem) == pytest.approx(-0.25)
