"""Tasks on contact forces."""

from dataclasses import replace

import numpy as np
import pytest

from wbc_controller.settings.tasks import ContactWrenchTask

VERTICAL = [False, False, True, False, False, False]


def with_task(bench, robot="g1", **keys):
    made = bench(robot)
    task = ContactWrenchTask.model_validate({"type": "contact_wrench", **keys})
    return made.rebuilt(tasks=dict(made.settings.tasks) | {"effort": task})


def solve(robot, references=None):
    return robot.controller.solve(robot.state(), robot.references() if references is None else references)


def test_wrench_task_of_an_inactive_contact(bench):
    pressed = {"contact": "front_left_foot", "mask": VERTICAL, "target": [0, 0, 500.0, 0, 0, 0], "weight": 1.0}
    made = with_task(bench, "go2", **pressed)
    references = made.references()
    broken = replace(references, contacts={**references.contacts, "front_left_foot": 0.0})
    with_it, without = solve(made, broken), solve(made, replace(broken, weights={**broken.weights, "effort": 0.0}))
    np.testing.assert_allclose(with_it.v_dot, without.v_dot, atol=1e-9)
    assert "effort" not in with_it.task_errors


def test_wrench_task_with_tolerance(bench):
    """The left foot's load may be 100 to 140 N; balance has priority."""
    loaded = {"contact": "left_foot", "mask": VERTICAL, "target": [0, 0, 120, 0, 0, 0], "weight": 1.0, "level": 1}
    made = with_task(bench, tolerance=20.0, **loaded)
    solution = solve(made)
    plain = solve(made, made.references(effort=0.0))
    load = solution.forces["left_foot"][2]
    assert abs(plain.forces["left_foot"][2] - 120.0) > 25.0
    assert load == pytest.approx(140.0, abs=1e-2)  # the near bound
    moved = made.controller.dynamics.com_jacobian @ (solution.v_dot - plain.v_dot)
    np.testing.assert_allclose(moved, np.zeros(3), atol=1e-7)
